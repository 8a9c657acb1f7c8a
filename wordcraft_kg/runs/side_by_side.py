"""Parallel processes for the parts of a training."""

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
"""Environment variable: number of cores for a process that is not bound to cores."""
THREADS_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Environment variables: number of threads, read by libraries at import."""


class Job(Protocol):
    """A part of a training, such as a fold, which saves its result among the run's checkpoints."""

    @property
    def fold(self) -> int:
        """Number of the part."""

    @property
    def done(self) -> Any:
        """Expected record of the result; other results are discarded."""

    def train(self, after: Callable[[int], None]) -> None:
        """Train; call ``after`` with the number of steps done."""


J = TypeVar("J", bound=Job)


def cores() -> int:
    """Return the number of cores for this process."""
    if (given := os.environ.get(CORES_VARIABLE, "")).isdecimal():
        return max(int(given), 1)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def not_done(jobs: Iterable[J], kept: Checkpoints[Any]) -> list[J]:
    """Return the jobs without an intact result."""

    def is_done(job: J) -> bool:
        try:
            return job.fold in kept.records() and bool(kept.read(job.fold).progress == job.done)
        except ArtefactError as error:
            logging.getLogger(__name__).warning("%s Training fold %s again.", error, job.fold)
            return False

    return [job for job in jobs if not is_done(job)]


def train_jobs(jobs: Sequence[Job], threads: int, note: Callable[..., None], *, is_long: bool) -> None:
    """Run jobs, in parallel if they are long.

    Args:
        jobs: the jobs.
        threads: CPU threads of each job.
        note: called with a job's number and steps, and regularly without arguments.
        is_long: whether parallel processes are worth their start.

    Raises:
        TrainingError: if a process dies.
    """
    workers = min(len(jobs), max(cores() // threads, 1))
    if is_long and workers > 1:
        side_by_side(jobs, workers, note)
        return
    for job in jobs:
        job.train(partial(note, job.fold))


def side_by_side(jobs: Sequence[Job], workers: int, note: Callable[..., None]) -> None:
    """Run jobs in processes, because PyKEEN seeds global generators, which threads would share.

    After an error or Ctrl-C all processes are terminated at once: an epoch may take minutes.
    """
    running = dict(_started(jobs[number::workers]) for number in range(workers))
    try:
        while running:
            for ready in wait(list(running), timeout=0.2):
                assert isinstance(ready, Connection)
                try:
                    message = ready.recv()
                except EOFError:  # it is done, or was killed
                    process = running.pop(ready)
                    process.join()
                    if process.exitcode:
                        raise TrainingError(
                            f"a process that trained folds ended with code {process.exitcode}; perhaps there is too "
                            "little memory for several at once. Take more `threads`, or fewer `folds`."
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
    """Start a process for jobs; return the receiver of its messages, and the process."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(sender, jobs), daemon=True)
    with own_start():
        process.start()
    sender.close()
    return receiver, process


@contextmanager
def own_start() -> Iterator[None]:
    """Hide the caller's program and Ctrl-C from processes that start in this block.

    A new process would import the main program, and so run a program without a ``__main__`` guard. Ctrl-C on a terminal
    reaches all processes; only the parent handles it and ends the others.
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
    """Run jobs in this process; send fold and number of each epoch, or the final error."""
    with suppress(BrokenPipeError):  # nobody is there any more
        try:
            for job in jobs:
                job.train(lambda epoch, fold=job.fold: connection.send((fold, epoch)))  # type: ignore[misc]
        except WordCraftKGError as error:
            connection.send(error)
        except Exception as error:
            connection.send(TrainingError(f"a fold could not be trained ({reason(error)})."))
