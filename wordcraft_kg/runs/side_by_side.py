"""Pieces of a training in processes of their own, side by side where cores allow."""

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
"""Environment variable: the number of cores that a process may use, where it is not bound to cores of its own."""
THREADS_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Environment variables from which libraries take their number of threads when they are loaded."""


class Job(Protocol):
    """A piece of a training, which keeps its result beside the checkpoints of the run."""

    @property
    def fold(self) -> int:
        """Its number."""

    @property
    def done(self) -> Any:
        """The record that its result has; a result with another one is not used."""

    def train(self, after: Callable[[int], None]) -> None:
        """Do it; ``after`` takes how far it has come."""


J = TypeVar("J", bound=Job)


def cores() -> int:
    """Return the number of cores that this process may use."""
    if (given := os.environ.get(CORES_VARIABLE, "")).isdecimal():
        return max(int(given), 1)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def not_done(jobs: Iterable[J], kept: Checkpoints[Any]) -> list[J]:
    """Return the jobs of which no whole result is kept."""

    def is_done(job: J) -> bool:
        try:
            return job.fold in kept.records() and bool(kept.read(job.fold).progress == job.done)
        except ArtefactError as error:
            logging.getLogger(__name__).warning("%s Training fold %s again.", error, job.fold)
            return False

    return [job for job in jobs if not is_done(job)]


def train_jobs(jobs: Sequence[Job], threads: int, note: Callable[..., None], *, is_long: bool) -> None:
    """Do jobs, side by side if they are worth the start of more processes.

    Args:
        jobs: the jobs.
        threads: CPU threads of each.
        note: called with a job's number and how far it is, and without arguments while nothing happens.
        is_long: whether they are worth it.

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
    """Train in processes of their own: PyKEEN seeds global generators, which threads would share.

    They are ended, not asked to end, when anything goes wrong or the user presses Ctrl-C: an epoch may take minutes.
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
    """Start a process for some jobs; what it has to say comes from the connection."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(sender, jobs), daemon=True)
    with own_start():
        process.start()
    sender.close()
    return receiver, process


@contextmanager
def own_start() -> Iterator[None]:
    """Keep the caller's program and Ctrl-C out of a process that starts in this block.

    A new process would import the program that was started, and thereby run it if it has no ``__main__`` guard; ours
    needs nothing of it. Ctrl-C on a terminal goes to all processes; this one hears it and ends the others.
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
    """Do jobs in a process of its own: send fold and number of each epoch, or the error that ended it."""
    with suppress(BrokenPipeError):  # nobody is there any more
        try:
            for job in jobs:
                job.train(lambda epoch, fold=job.fold: connection.send((fold, epoch)))  # type: ignore[misc]
        except WordCraftKGError as error:
            connection.send(error)
        except Exception as error:
            connection.send(TrainingError(f"a fold could not be trained ({reason(error)})."))
