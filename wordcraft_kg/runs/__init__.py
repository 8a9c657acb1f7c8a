"""Run folders: each training (a run) has a folder with settings, status, checkpoints and results.

The folder exists from the start, and ``run.json`` records the run's status: running, interrupted,
failed or done. Only one process at a time trains in a folder. The last two checkpoints are kept in
case the last is damaged. A finished run has results instead of checkpoints, and ``run.json``
records the result hashes.

Read ``training`` first: :func:`~wordcraft_kg.runs.training.train` begins a run or resumes an
interrupted run with the same settings, and a trainer is a subclass of
:class:`~wordcraft_kg.runs.training.Training`. Then read ``config_file`` (settings and
``config.toml``), ``run_folder`` (begin, resume, interrupt, finish, fail, replace), ``record``
(``run.json``, verified files, model cards) and ``checkpoints`` (also of parts that are trained in
parallel processes). ``trackers`` sends metrics to other tools, and ``progress`` shows a bar.

Trackers and texts of cards may be added freely. ``run.json`` and ``config.toml`` are read by later
versions, so fields are only added, with a default. The order of writes in ``run_folder`` and
``checkpoints`` is what survives a power failure: change it only with the slow tests in
``tests/runs``, which kill a run at every point.
"""
