"""Foundations used by every package: errors, records, settings, labels, files and statistics.

Files are written whole or not at all (``artefacts``). Values read back from disk are typed records (``records``): a
missing key or a wrong type is an error that names it. Settings are checked by one set of functions (``settings``).
Long work reports progress to whichever listener is set, and is silent without one (``progress``).
"""
