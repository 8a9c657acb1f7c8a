"""Studies: comparisons of agents as data, their tasks, and their results.

A study is a TOML file; ``plan`` turns it into tasks: a graph, a scorer or a run. The folder of a task is named by a
hash of its non-default settings and its input addresses, so studies share finished tasks. ``figures.json`` is
written last and marks a task as done. The engine uses :class:`~wordcraft_kg.studies.tasks.Workers`: processes of this
machine, or a Ray cluster with a shared results folder. All tables, figures, claims and pages derive from one record,
``StudyResults``.
"""
