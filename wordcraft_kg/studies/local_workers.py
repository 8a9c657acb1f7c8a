"""Processes on this machine that perform tasks, each bound to separate cores if the system supports it."""

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
_PATIENCE = 60.0
"""Seconds for writing a checkpoint after Ctrl-C."""


@dataclass
class _Place:
    process: BaseProcess
    connection: Connection
    task: Task | None = None
    attempts: int = 0


class LocalWorkers:
    """Workers that perform tasks in processes on this machine; a process is reused, because importing torch is slow."""

    def __init__(self, root: Path, jobs: int, perform: _Perform, threads: int = 1):
        """Prepare ``jobs`` processes with ``threads`` CPU threads and cores each; they start with their first task."""
        self.root, self._perform = root, perform
        self._threads = threads
        self._places: list[_Place | None] = [None] * whole("jobs", jobs, 1, MAX_THREADS)

    @property
    def places(self) -> int:
        """Number of processes."""
        return len(self._places)

    def start(self, task: Task) -> None:
        """Send a task to an idle process."""
        number = next(
            i for i, place in enumerate(self._places) if place is None or place.task is None
        )
        place = self._places[number]
        self._begin(
            number, place if place and place.process.is_alive() else self._started(number), task, 1
        )

    def wait(self, seconds: float) -> list[Outcome]:
        """Return outcomes for finished tasks after at most ``seconds``; a task whose process died is repeated once."""
        busy = {
            place.connection: (number, place)
            for number, place in enumerate(self._places)
            if place and place.task
        }
        outcomes = []
        for ready in wait(list(busy), timeout=seconds):
            number, place = busy[ready]  # type: ignore[index]
            try:
                outcomes.append(place.connection.recv())
                place.task = None
            except (EOFError, OSError):
                outcomes += self._replaced(number, place)
        return outcomes

    def stop(self) -> None:
        """Let running tasks write a checkpoint, then end the processes."""
        deadline = time.monotonic() + _PATIENCE
        busy = [place for place in self._places if place and place.task]
        while busy and time.monotonic() < deadline:
            for place in busy:
                if place.process.pid and place.process.is_alive():
                    os.kill(place.process.pid, signal.SIGINT)
            ended = wait([place.connection for place in busy], timeout=0.5)
            busy = [place for place in busy if place.connection not in ended]
        for place in filter(None, self._places):
            place.connection.close()  # an idle process ends when its connection closes
            place.process.join(timeout=1)
            place.process.terminate()
            place.process.join()
        self._places = [None] * len(self._places)

    def _begin(self, number: int, place: _Place, task: Task, attempt: int) -> None:
        place.task, place.attempts = task, attempt
        self._places[number] = place
        place.connection.send(task)

    def _replaced(self, number: int, place: _Place) -> list[Outcome]:
        place.process.join()
        assert place.task is not None
        self._places[number] = None
        if place.attempts < ATTEMPTS:
            self._begin(number, self._started(number), place.task, place.attempts + 1)
            return []
        why = f"the process died {ATTEMPTS} times, the last time with code {place.process.exitcode}"
        if place.process.exitcode == -9:  # killed, as by the system without memory
            why += "; perhaps memory is too small for this many processes: use fewer `jobs`"
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
    if not hasattr(os, "sched_getaffinity") or places * threads > cores():
        return []
    return sorted(os.sched_getaffinity(0))[number * threads : (number + 1) * threads]


@contextmanager
def _threads_of(threads: int) -> Iterator[None]:
    """Set the number of threads for processes started in this block; libraries read the variables once."""
    before = {name: os.environ[name] for name in THREADS_VARIABLES if name in os.environ}
    os.environ.update(dict.fromkeys(THREADS_VARIABLES, str(threads)))
    try:
        yield
    finally:
        for name in THREADS_VARIABLES:
            os.environ.pop(name)
        os.environ.update(before)


def _work(
    connection: Connection, root: Path, perform: _Perform, own: list[int], parent: int
) -> None:
    # A training takes Ctrl-C as a request to write a checkpoint; between trainings, ignore the signal.
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
