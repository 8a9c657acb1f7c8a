"""Studies: agent comparisons as data, their tasks, and their results.

A study is a TOML file; ``plan`` turns it into tasks: a graph, a scorer or a run. A task's folder is named by a hash
over non-default settings and input addresses, so studies share finished tasks. ``figures.json`` is
written last and marks a task as done. The engine uses :class:`~wordcraft_kg.studies.tasks.Workers`: processes on this
machine, or a Ray cluster with a shared results folder. All tables, figures, claims and pages derive from one record,
``StudyResults``.
"""
