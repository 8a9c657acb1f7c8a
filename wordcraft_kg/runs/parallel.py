"""Jobs in parallel processes: parts of a training, or whole trainings of a study.

:class:`Workers` alone knows processes: their start, cores, crashes, Ctrl-C and end. Cross-fitting
(:func:`train_jobs`) and studies (``studies/local_workers.py``) choose which job comes next.
"""

import logging
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import ModuleType
from typing import Any, Generic, Protocol, TypeVar

from wordcraft_kg.base.errors import ArtefactError, TrainingError, WordCraftKGError, reason
from wordcraft_kg.base.settings import cores
from wordcraft_kg.runs.checkpoints import Checkpoints

THREADS_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Environment variables: number of CPU threads, which numerical libraries read at import."""
_TICK = 0.2
"""Seconds between calls of ``note`` without a message: Ctrl-C is noticed within this time."""
J = TypeVar("J")
R = TypeVar("R")


# --- processes -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ended(Generic[J, R]):
    """A job that came to an end in a worker process.

    Attributes:
        job: the job, as started.
        result: return value of the work function; None if the process died.
        exitcode: of the process that died, negative for a signal; None with a result.
    """

    job: J
    result: R | None = None
    exitcode: int | None = None


@dataclass
class _Worker:
    process: BaseProcess
    connection: Connection
    job: Any = None
    attempts: int = 0


class Workers(Generic[J, R]):
    """Processes on this machine that perform jobs, each process one job at a time.

    A process is started with its first job and reused, because importing torch is slow. It ends
    with its parent, even if the parent is killed, so that no run folder stays locked.
    """

    def __init__(
        self,
        number: int,
        work: Callable[[J, Callable[..., None]], R],
        *,
        threads: int | None = None,
        attempts: int = 1,
        progress: Callable[..., None] = lambda *values: None,
    ):
        """Prepare the processes; none is started yet.

        Args:
            number: number of processes.
            work: performs a job in a process, a function that can be pickled. Takes the job and a
                function that sends its arguments to ``progress``; returns the result. A
                WordCraftKGError that it raises is raised by :meth:`wait`; it should raise nothing
                else, since any other exception ends the process.
            threads: CPU threads of each process and, if there are enough cores for all, cores to
                which it is bound. None leaves both as they are in this process.
            attempts: how often a job is begun whose process dies.
            progress: called by :meth:`wait` in this process.
        """
        self._workers: list[_Worker | None] = [None] * number
        self._work = work
        self._threads = threads
        self._attempts = attempts
        self._progress = progress

    @property
    def number(self) -> int:
        """Number of processes."""
        return len(self._workers)

    @property
    def num_busy(self) -> int:
        """Number of processes with a job."""
        return len(self._busy())

    def start(self, job: J) -> None:
        """Send a job to an idle process; there must be one, see :attr:`num_busy`."""
        busy = self._busy()
        number = next(number for number in range(self.number) if number not in busy)
        self._begin(number, job, attempt=1)

    def wait(self, seconds: float) -> list[Ended[J, R]]:
        """Return the jobs that have ended, after waiting for a message for at most ``seconds``.

        Raises:
            WordCraftKGError: raised by the work function; the other jobs go on.
        """
        busy = self._busy()
        number_of = {worker.connection: number for number, worker in busy.items()}
        ended: list[Ended[J, R]] = []
        for ready in wait(list(number_of), timeout=seconds):
            number = number_of[ready]  # type: ignore[index]
            worker = busy[number]
            try:
                kind, content = worker.connection.recv()
            except (EOFError, OSError):  # the process died
                ended += self._after_death(number, worker)
                continue
            if kind == "progress":
                self._progress(*content)
                continue
            # Idle before an error is raised, so that the process can take another job.
            job = worker.job
            worker.job = None
            if kind == "error":
                raise content
            ended.append(Ended(job, content))
        return ended

    def stop(self, patience: float = 0.0) -> None:
        """End all processes, after their jobs have saved a checkpoint or at once.

        Args:
            patience: seconds in which jobs may react to Ctrl-C, which each of them gets; 0 ends
                them at once, as does a second Ctrl-C while this process waits.

        Raises:
            WordCraftKGError: raised by a job while this process waits; all processes end
                nevertheless.
        """
        deadline = time.monotonic() + patience
        # A process that dies now is not replaced.
        self._attempts = 0
        try:
            while self._busy() and time.monotonic() < deadline:
                # Again and again, because a training may not listen yet.
                for worker in self._busy().values():
                    if worker.process.pid and worker.process.is_alive():
                        os.kill(worker.process.pid, signal.SIGINT)
                self.wait(0.5)
        finally:
            for worker in filter(None, self._workers):
                worker.connection.close()
                worker.process.terminate()
                worker.process.join()
            self._workers = [None] * self.number

    def _busy(self) -> dict[int, _Worker]:
        return {
            number: worker
            for number, worker in enumerate(self._workers)
            if worker is not None and worker.job is not None
        }

    def _begin(
        self,
        number: int,
        job: J,
        attempt: int,
    ) -> None:
        worker = self._workers[number]
        if worker is None or not worker.process.is_alive():
            worker = self._started(number)
            self._workers[number] = worker
        worker.job = job
        worker.attempts = attempt
        # It died just now, and :meth:`wait` notices.
        with suppress(OSError):
            worker.connection.send(job)

    def _after_death(self, number: int, worker: _Worker) -> list[Ended[J, R]]:
        worker.process.join()
        worker.connection.close()
        self._workers[number] = None
        if worker.attempts < self._attempts:
            self._begin(number, worker.job, worker.attempts + 1)
            return []
        return [Ended(worker.job, exitcode=worker.process.exitcode)]

    def _started(self, number: int) -> _Worker:
        # Not forked: torch's threads and locks do not survive a fork.
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        own_cores = _cores_of(number, self.number, self._threads)
        process = context.Process(
            target=_perform_jobs, args=(theirs, self._work, own_cores, os.getpid())
        )
        with _isolated_start(), _threads_of(self._threads):
            process.start()
        # Closed on this side, so that the death of the process closes the connection.
        theirs.close()
        return _Worker(process, ours)


def _cores_of(
    number: int,
    places: int,
    threads: int | None,
) -> list[int]:
    """Return the cores to which a process is bound, none without enough cores for all."""
    # With more threads than cores, bound processes would share a core while another is idle.
    if threads is None or not hasattr(os, "sched_getaffinity") or places * threads > cores():
        return []
    return sorted(os.sched_getaffinity(0))[number * threads : (number + 1) * threads]


@contextmanager
def _threads_of(threads: int | None) -> Iterator[None]:
    """Set the number of threads for processes started in this block; libraries read it once."""
    if threads is None:
        yield
        return
    # Variables, since libraries read the number when the new process loads them.
    before = {name: os.environ[name] for name in THREADS_VARIABLES if name in os.environ}
    os.environ.update(dict.fromkeys(THREADS_VARIABLES, str(threads)))
    try:
        yield
    finally:
        for name in THREADS_VARIABLES:
            os.environ.pop(name)
        os.environ.update(before)


@contextmanager
def _isolated_start() -> Iterator[None]:
    """Hide the main program and Ctrl-C from processes that start in this block.

    A new process would import the main program, and so run a program without a ``__main__`` guard.
    Ctrl-C on a terminal reaches all processes, also one that does not ignore the signal yet.
    """
    # spawn looks the main program up here, and starts a nameless one without a file.
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


def _perform_jobs(
    connection: Connection,
    work: Callable[[Any, Callable[..., None]], Any],
    own_cores: list[int],
    parent: int,
) -> None:
    """Perform jobs until the connection ends; the main function of a worker process."""
    # Only the parent reacts to Ctrl-C on a terminal. A training of a study sets a handler of its
    # own, which takes the parent's Ctrl-C as a request to write a checkpoint.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    if own_cores:
        os.sched_setaffinity(0, own_cores)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()

    def report(*values: Any) -> None:
        connection.send(("progress", values))

    # The parent has closed the connection.
    with suppress(EOFError, OSError):
        while True:
            job = connection.recv()
            try:
                message = ("result", work(job, report))
            except WordCraftKGError as error:
                message = ("error", error)
            connection.send(message)


def _end_with(parent: int) -> None:
    """End this process after its parent, so that no folder stays in use."""
    # A killed parent can tell nobody, but its children then belong to another process.
    while os.getppid() == parent:
        time.sleep(0.5)
    # At once: an orderly exit would wait for the job.
    os._exit(1)


# --- parts of a training -------------------------------------------------------------------------


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
        note: called with a job's fold and its number of finished steps or epochs; in parallel, also
            regularly without arguments. It may raise, such as after Ctrl-C, to end all jobs.
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
    pool: Workers[Job, None] = Workers(workers, _train, progress=note)
    waiting = list(jobs)
    try:
        while waiting or pool.num_busy:
            while waiting and pool.num_busy < workers:
                pool.start(waiting.pop(0))
            for ended in pool.wait(_TICK):
                if ended.exitcode is not None:
                    raise TrainingError(
                        f"a process that trained folds ended with code {ended.exitcode}; perhaps "
                        "the memory is too small for several at once. Use more `threads`, or "
                        "fewer `folds`."
                    )
            note()
    finally:
        pool.stop()


def _train(job: Job, note: Callable[..., None]) -> None:
    try:
        job.train(partial(note, job.fold))
    except WordCraftKGError:
        raise
    except Exception as error:
        raise TrainingError(f"a fold could not be trained ({reason(error)}).") from error
