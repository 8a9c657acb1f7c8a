"""Parts of a training in parallel processes, by joblib's executor."""

import logging
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from functools import partial
from typing import Any, Protocol, TypeVar

from wordcraft_kg.base.errors import ArtefactError, TrainingError, WordCraftKGError, reason
from wordcraft_kg.base.settings import cores
from wordcraft_kg.runs.checkpoints import Checkpoints

_TICK = 0.2
"""Seconds between calls of ``note``: Ctrl-C is noticed within this time."""


class Job(Protocol):
    """A part of a training, such as the model for one fold, with a checkpoint for its result."""

    @property
    def fold(self) -> int:
        """Number of the fold (or other part) that this job trains, and of its checkpoint."""

    @property
    def done(self) -> Any:
        """Progress record of the finished job; a checkpoint with another record is trained anew."""

    def train(self, after: Callable[[int], None]) -> None:
        """Train and save the result; call ``after`` with the number of finished steps or epochs."""


P = TypeVar("P", bound=Job)


def not_done(jobs: Iterable[P], kept: Checkpoints[Any]) -> list[P]:
    """Return all jobs that have no intact result among the checkpoints ``kept``."""

    def is_done(job: P) -> bool:
        try:
            return job.fold in kept.records() and bool(kept.read(job.fold).progress == job.done)
        except ArtefactError as error:
            logging.getLogger(__name__).warning("%s Training fold %s again.", error, job.fold)
            return False

    return [job for job in jobs if not is_done(job)]


def train_jobs(
    jobs: Sequence[Job],
    threads: int,
    note: Callable[..., None],
    *,
    is_long: bool,
) -> None:
    """Run all jobs, in parallel if they are long and there are enough CPU cores.

    Args:
        jobs: the jobs; their results do not depend on the order or the process.
        threads: CPU threads with which each job computes.
        note: called with a job's fold and its number of finished steps or epochs; in parallel, with
            those of the last one, and also regularly without arguments. It may raise, such as after
            Ctrl-C, to end all jobs.
        is_long: whether the jobs take longer than the start of a process, some seconds.

    Raises:
        WordCraftKGError: raised by a job; any other exception, too, if the jobs run in this
            process.
        TrainingError: in parallel, if a job raises another exception or its process dies.
    """
    workers = min(len(jobs), max(cores() // threads, 1))
    # A process takes seconds to start, which short jobs would not win back.
    if is_long and workers > 1:
        train_in_processes(jobs, workers, note)
        return
    for job in jobs:
        job.train(partial(note, job.fold))


def train_in_processes(
    jobs: Sequence[Job],
    workers: int,
    note: Callable[..., None],
) -> None:
    """Run jobs in processes; an error, or one that ``note`` raises, ends all at once.

    Processes and not threads, because threads would share PyKEEN's global random generators.

    Args:
        jobs: the jobs, see :func:`train_jobs`.
        workers: number of processes, from 1.
        note: see :func:`train_jobs`.

    Raises:
        WordCraftKGError: raised by a job.
        TrainingError: if a job raises another exception or its process dies.
    """
    from joblib.externals.loky import ProcessPoolExecutor
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    executor = ProcessPoolExecutor(workers)
    try:
        fold_of = {executor.submit(_last_number, job): job.fold for job in jobs}
        waiting = set(fold_of)
        while waiting:
            # First: after Ctrl-C, jobs fail in their own ways.
            note()
            ended, waiting = wait(waiting, timeout=_TICK, return_when=FIRST_COMPLETED)
            for future in ended:
                note(fold_of[future], future.result())
    except TerminatedWorkerError as error:
        raise TrainingError(
            f"a process that trained folds ended ({reason(error)}); perhaps the memory is too "
            "small for several at once. Use more `threads`, or fewer `folds`."
        ) from error
    finally:
        executor.shutdown(kill_workers=True)


def _last_number(job: Job) -> int:
    """Train a job; return its number of finished steps or epochs."""
    numbers = [0]
    try:
        job.train(numbers.append)
    except WordCraftKGError:
        raise
    except Exception as error:
        raise TrainingError(f"a fold could not be trained ({reason(error)}).") from error
    return numbers[-1]
