"""Studies: comparisons of agents as data, the tasks that follow from them, and their results.

A study is a TOML file; ``plan`` turns it into tasks: a graph, a scorer or a run. The folder of a task is named by a
hash of its settings that differ from their defaults and of the addresses of its inputs, so nothing that exists is made
again, whichever study needs it. ``figures.json``, with a hash of its own, is written last and marks a task as done. The
engine uses :class:`~wordcraft_kg.studies.tasks.Workers`: processes of this machine, or a Ray cluster with a shared
results folder. Tables, figures, claims and pages are made from one record, ``StudyResults``.
"""
