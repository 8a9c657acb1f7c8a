"""Processes of this machine that perform tasks, each bound to separate cores if the system supports it."""

import logging
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

from wordcraft_kg.base.settings import MAX_THREADS, whole
from wordcraft_kg.runs.parallel import THREADS_VARIABLES, cores, isolated_start
from wordcraft_kg.studies.tasks import Outcome, Task

_Perform = Callable[[Task, Path], Outcome]
ATTEMPTS = 2
"""Attempts at a task whose process dies."""
_PATIENCE = 60.0
"""Seconds for writing a checkpoint after Ctrl-C."""


@dataclass
class _Place:
    """A process and its task."""

    process: BaseProcess
    connection: Connection
    task: Task | None = None
    attempts: int = 0


class LocalWorkers:
    """Performs tasks in persistent processes, because starting a process and importing torch takes seconds."""

    def __init__(self, root: Path, jobs: int, perform: _Perform, threads: int = 1):
        """Prepare ``jobs`` processes of ``threads`` CPU threads and cores each; they start with their first task."""
        self.root, self._perform = root, perform
        self._threads = threads
        self._places: list[_Place | None] = [None] * whole("jobs", jobs, 1, MAX_THREADS)

    @property
    def places(self) -> int:
        """Number of processes."""
        return len(self._places)

    def start(self, task: Task) -> None:
        """Send a task to an idle process."""
        number = next(i for i, place in enumerate(self._places) if place is None or place.task is None)
        place = self._places[number]
        self._begin(number, place if place and place.process.is_alive() else self._started(number), task, 1)

    def wait(self, seconds: float) -> list[Outcome]:
        """Return outcomes of finished tasks; a task whose process has died starts again, once."""
        busy = {place.connection: (number, place) for number, place in enumerate(self._places) if place and place.task}
        found = []
        for ready in wait(list(busy), timeout=seconds):
            number, place = busy[ready]  # type: ignore[index]
            try:
                found.append(place.connection.recv())
                place.task = None
            except (EOFError, OSError):
                found += self._replaced(number, place)
        return found

    def stop(self) -> None:
        """Request checkpoints of running tasks, and end the processes."""
        deadline = time.monotonic() + _PATIENCE
        busy = [place for place in self._places if place and place.task]
        while busy and time.monotonic() < deadline:
            for place in busy:
                if place.process.pid and place.process.is_alive():
                    os.kill(place.process.pid, signal.SIGINT)
            ended = wait([place.connection for place in busy], timeout=0.5)
            busy = [place for place in busy if place.connection not in ended]
        for place in filter(None, self._places):
            place.connection.close()  # it ends by itself when nobody asks any more
            place.process.join(timeout=1)
            place.process.terminate()
            place.process.join()
        self._places = [None] * len(self._places)

    def _begin(self, number: int, place: _Place, task: Task, attempt: int) -> None:
        place.task, place.attempts = task, attempt
        self._places[number] = place
        place.connection.send(task)

    def _replaced(self, number: int, place: _Place) -> list[Outcome]:
        """Restart the task of a dead process, or give up after the last attempt."""
        place.process.join()
        assert place.task is not None
        self._places[number] = None
        if place.attempts < ATTEMPTS:
            self._begin(number, self._started(number), place.task, place.attempts + 1)
            return []
        why = f"its process was ended {ATTEMPTS} times, the last time with code {place.process.exitcode}"
        if place.process.exitcode == -signal.SIGKILL:
            why += "; perhaps there is too little memory for as many at once: take fewer `jobs`"
        return [Outcome(place.task.address, "failed", f"{why}.")]

    def _started(self, number: int) -> _Place:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        own = _cores_of(number, self.places, self._threads)
        arguments = (theirs, self.root, self._perform, own, os.getpid())
        process = context.Process(target=_work, args=arguments)
        with isolated_start(), _threads_of(self._threads):
            process.start()
        theirs.close()
        return _Place(process, ours)


def _cores_of(number: int, places: int, threads: int) -> list[int]:
    """Return the cores of a process; none if there are too few for all processes."""
    if not hasattr(os, "sched_getaffinity") or places * threads > cores():
        return []
    return sorted(os.sched_getaffinity(0))[number * threads : (number + 1) * threads]


@contextmanager
def _threads_of(threads: int) -> Iterator[None]:
    """Set the number of threads of processes started in this block; libraries read it once."""
    before = {name: os.environ[name] for name in THREADS_VARIABLES if name in os.environ}
    os.environ.update(dict.fromkeys(THREADS_VARIABLES, str(threads)))
    try:
        yield
    finally:
        for name in THREADS_VARIABLES:
            os.environ.pop(name)
        os.environ.update(before)


def _work(connection: Connection, root: Path, perform: _Perform, own: list[int], parent: int) -> None:
    # A training takes Ctrl-C as a request to write a checkpoint; between trainings it is nobody's business here.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    # A study's settings are meant as they are, and hundreds of trainings would repeat the same warnings.
    logging.getLogger("wordcraft_kg").setLevel(logging.ERROR)
    if own:
        os.sched_setaffinity(0, own)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    with suppress(EOFError, OSError):
        while True:
            connection.send(perform(connection.recv(), root))


def _end_with(parent: int) -> None:
    """End this process after its parent, so that no folder stays in use."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)
