"""Foundations of every package: errors, records, settings, labels, files and statistics.

Read ``errors`` first: every error that a user can cause is one of its classes. Then read
``records`` (typed JSON, read strictly) and ``artefacts`` (files that are written whole or not at
all). ``settings`` checks the values of settings, ``extras`` names missing packages and lets other
packages add named objects, ``progress`` reports long work to a listener, if one is set. ``labels``,
``answers`` and ``wording`` read and write texts; ``statistics`` and ``tensors`` compute.

This package imports no other package of wordcraft-kg. Texts of errors and new helpers may change
freely. Formats on disk may not: a changed :class:`~wordcraft_kg.base.records.Record` makes files
of earlier versions unreadable. The statistics are quoted in reports and papers, so a change there
needs a higher number in ``VERSIONS`` (``studies/plan.py``).
"""
