"""The life cycle of runs: every training takes place in a folder of this kind.

The folder exists from the start, and its ``run.json`` gives the status of the run: running, interrupted, failed or
done. Only one process at a time works in it. The last two checkpoints are kept: if the last one is damaged, the one
before it is used. A finished run has results instead of checkpoints, and ``run.json`` records their hashes.

Read ``training`` first: :func:`~wordcraft_kg.runs.training.train` begins a run or goes on with an interrupted one of
the same settings, and a trainer is a subclass of :class:`~wordcraft_kg.runs.training.Training`. Then read
``config_file`` (settings and ``config.toml``), ``folder`` (begin, go on, finish, fail, replace), ``record``
(``run.json``), ``files`` (reading the files of a run) and ``checkpoints``.
"""
