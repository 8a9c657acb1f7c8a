"""Studies: comparisons between agents, described in TOML files, with their trainings and results.

``plan`` turns a study into tasks: each makes a graph, a scorer or an agent's run. A task's folder name (its address) is
a hash over non-default settings and input addresses, so studies share finished tasks. ``figures.json``, with a task's
results, is written last and marks the task as done. The engine uses processes on this machine. All tables, pictures,
claims and pages derive from one record, ``StudyResults``.
"""
