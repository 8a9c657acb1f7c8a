"""Foundations of every package: errors, records, settings, labels, files and statistics.

Files are written whole or not at all (``artefacts``). Values read from disk are typed records (``records``): a missing
key or a wrong type is an error with the key's name. One set of functions checks settings (``settings``). Long work
reports progress to a listener, if one is set (``progress``).
"""
