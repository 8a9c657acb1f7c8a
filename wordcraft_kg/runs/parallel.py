"""Jobs (parts of a training, such as a model for each cross-fitting fold) in parallel processes."""

import logging
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import ModuleType
from typing import Any, Protocol, TypeVar

from wordcraft_kg.base.errors import ArtefactError, TrainingError, WordCraftKGError, reason
from wordcraft_kg.runs.checkpoints import Checkpoints

CORES_VARIABLE = "WORDCRAFT_KG_CORES"
"""Environment variable: number of CPU cores to use, for processes without core affinity."""
THREADS_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Environment variables: number of CPU threads, which numerical libraries read at import."""


class Job(Protocol):
    """A job: a part of a training, such as the model for one fold, that saves a result among the run's checkpoints."""

    @property
    def fold(self) -> int:
        """Number of the cross-fitting fold (or other part) that this job trains; its checkpoint has the same number."""

    @property
    def done(self) -> Any:
        """The expected progress record of a finished job; a checkpoint with a different record is trained again."""

    def train(self, after: Callable[[int], None]) -> None:
        """Train and save the result; call ``after`` with the number of finished steps or epochs."""


J = TypeVar("J", bound=Job)


def cores() -> int:
    """Return the number of CPU cores that this process may use."""
    if (given := os.environ.get(CORES_VARIABLE, "")).isdecimal():
        return max(int(given), 1)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def not_done(jobs: Iterable[J], kept: Checkpoints[Any]) -> list[J]:
    """Return all jobs that have no intact result among the checkpoints ``kept``."""

    def is_done(job: J) -> bool:
        try:
            return job.fold in kept.records() and bool(kept.read(job.fold).progress == job.done)
        except ArtefactError as error:
            logging.getLogger(__name__).warning("%s Training fold %s again.", error, job.fold)
            return False

    return [job for job in jobs if not is_done(job)]


def train_jobs(
    jobs: Sequence[Job], threads: int, note: Callable[..., None], *, is_long: bool
) -> None:
    """Run all jobs, in parallel processes if the jobs are long and there are enough CPU cores.

    ``threads`` is the number of CPU threads per job. ``note`` is called with job number and number of finished steps;
    in parallel, also regularly without arguments. Raises TrainingError if a process dies.
    """
    workers = min(len(jobs), max(cores() // threads, 1))
    if is_long and workers > 1:
        train_in_processes(jobs, workers, note)
        return
    for job in jobs:
        job.train(partial(note, job.fold))


def train_in_processes(jobs: Sequence[Job], workers: int, note: Callable[..., None]) -> None:
    """Run jobs in processes (threads share PyKEEN's global generators); an error or Ctrl-C ends all at once."""
    running = dict(_started(jobs[number::workers]) for number in range(workers))
    try:
        while running:
            for ready in wait(list(running), timeout=0.2):
                assert isinstance(ready, Connection)
                try:
                    message = ready.recv()
                except EOFError:  # finished or killed
                    process = running.pop(ready)
                    process.join()
                    if process.exitcode:
                        raise TrainingError(
                            f"a process that trained folds ended with code {process.exitcode}; perhaps the "
                            "memory is too small for several at once. Use more `threads`, or fewer `folds`."
                        ) from None
                    continue
                if isinstance(message, Exception):
                    raise message
                note(*message)
            note()
    finally:
        for process in running.values():
            process.terminate()
            process.join()


def _started(jobs: Sequence[Job]) -> tuple[Connection, BaseProcess]:
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(sender, jobs), daemon=True)
    with isolated_start():
        process.start()
    sender.close()
    return receiver, process


@contextmanager
def isolated_start() -> Iterator[None]:
    """Hide the main program and Ctrl-C from processes that start in this block.

    A new process would import the main program, and so run a program without a ``__main__`` guard. Ctrl-C on a terminal
    reaches all processes; only the parent handles the signal and stops its workers.
    """
    program = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    can_block = hasattr(signal, "pthread_sigmask")
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT]) if can_block else set()
    try:
        yield
    finally:
        sys.modules["__main__"] = program
        if can_block:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(connection: Connection, jobs: Sequence[Job]) -> None:
    with suppress(BrokenPipeError):  # the parent has ended
        try:
            for job in jobs:
                job.train(lambda epoch, fold=job.fold: connection.send((fold, epoch)))  # type: ignore[misc]
        except WordCraftKGError as error:
            connection.send(error)
        except Exception as error:
            connection.send(TrainingError(f"a fold could not be trained ({reason(error)})."))
