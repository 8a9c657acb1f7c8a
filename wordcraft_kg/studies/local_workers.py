"""Processes on this machine that perform the tasks of a study."""

import logging
from collections.abc import Callable, Generator
from functools import partial
from pathlib import Path
from typing import Any

from wordcraft_kg.base.settings import MAX_THREADS, whole
from wordcraft_kg.runs.parallel import Ended, Workers
from wordcraft_kg.studies.tasks import Outcome, Task

_Perform = Callable[[Task, Path], Outcome]
ATTEMPTS = 2
"""A task is begun again once if its process dies; a second death has a cause in the task."""
PATIENCE = 60.0
"""Seconds for writing a checkpoint after Ctrl-C."""
TICK = 0.5
"""Seconds between looks at the progress of a study."""


class LocalWorkers:
    """Processes that perform tasks, see :class:`~wordcraft_kg.runs.parallel.Workers`."""

    def __init__(
        self,
        root: Path,
        jobs: int,
        perform: _Perform,
        threads: int = 1,
    ):
        """Prepare the processes; each starts with its first task.

        Args:
            root: results folder.
            jobs: number of processes.
            perform: performs a task and returns its outcome, which has its errors; see
                :func:`~wordcraft_kg.studies.perform.perform`. It can be pickled.
            threads: CPU threads of each process, and cores to which it is bound.

        Raises:
            ConfigError: if ``jobs`` is out of range.
        """
        self._workers: Workers[Task, Outcome] = Workers(
            whole("jobs", jobs, 1, MAX_THREADS),
            partial(_work, root=root, perform=perform),
            threads=threads,
            attempts=ATTEMPTS,
        )

    def outcomes(self, take: Callable[[], Task | None]) -> Generator[Outcome | None, None, None]:
        """Perform tasks until there are no more, see :class:`~.studies.tasks.TaskWorkers`.

        A task whose process died :data:`ATTEMPTS` times has failed.
        """
        workers = self._workers
        try:
            while True:
                while workers.num_busy < workers.number:
                    task = take()
                    if task is None:
                        break
                    workers.start(task)
                if not workers.num_busy:
                    return
                for ended in workers.wait(TICK):
                    yield ended.result or _death(ended)
                yield None
        finally:
            workers.stop(PATIENCE)


def _death(ended: Ended[Task, Outcome]) -> Outcome:
    why = f"the process died {ATTEMPTS} times, the last time with code {ended.exitcode}"
    # -9: killed, as by the system without memory.
    if ended.exitcode == -9:
        why += "; perhaps memory is too small for this many processes: use fewer `jobs`"
    return Outcome(ended.job.address, "failed", f"{why}.")


def _work(
    task: Task,
    note: Callable[..., Any],
    *,
    root: Path,
    perform: _Perform,
) -> Outcome:
    # A study's settings are meant as they are, and hundreds of trainings would repeat warnings.
    logging.getLogger("wordcraft_kg").setLevel(logging.ERROR)
    return perform(task, root)
