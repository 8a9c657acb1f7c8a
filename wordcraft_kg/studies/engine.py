"""The engine: what of a study is missing is made, in the order that inputs demand, and nothing is made twice."""

import logging
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from wordcraft_kg.base.errors import ArtefactError, WordCraftKGError
from wordcraft_kg.studies.perform import check_whole, is_done, make_graph
from wordcraft_kg.studies.plan import Plan
from wordcraft_kg.studies.store import forget_failure, note_failure, own_results, write_plan
from wordcraft_kg.studies.tasks import Outcome, Task
from wordcraft_kg.studies.workers import Workers

TICK = 0.5
"""Seconds between looks at what has ended."""


@dataclass
class State:
    """How far a study has come; changes while it runs.

    Attributes:
        total: tasks of the study.
        kept: tasks that were done before.
        done: tasks done now.
        failed: outcome of each task that failed, or cannot be made because what it needs failed.
        running: when each task that runs was started, by :func:`time.monotonic`.
    """

    total: int
    kept: int = 0
    done: int = 0
    failed: dict[str, Outcome] = field(default_factory=dict)
    running: dict[str, float] = field(default_factory=dict)

    @property
    def left(self) -> int:
        """Tasks that neither run nor have ended."""
        return self.total - self.kept - self.done - len(self.failed) - len(self.running)


Watch = Callable[[Plan, State], None]


class FullDiskError(WordCraftKGError, OSError):
    """The disk is full; what was done is safe."""


def run_plan(
    plan: Plan, root: Path, make_workers: Callable[[], Workers], *, command: str = "", watch: Watch | None = None
) -> State:
    """Make what of a study is not there yet.

    A task that fails does not stop the others; only what needs it is left out. The next call tries it again.

    Args:
        plan: the study.
        root: results folder.
        make_workers: starts those who perform the tasks; called only if there is something to do.
        command: the command line, for the record.
        watch: called regularly.

    Raises:
        ArtefactError: if another engine works in the folder.
        FullDiskError: if the disk is full.
        KeyboardInterrupt: after Ctrl-C, saying how to go on; trainings that ran have kept a checkpoint.
    """
    with own_results(root):
        write_plan(root, plan, command)
        return _Engine(plan, root, watch).run(make_workers)


class _Engine:
    def __init__(self, plan: Plan, root: Path, watch: Watch | None):
        self.plan, self.root, self.watch = plan, root, watch
        self.state = State(len(plan.tasks))
        self._there: set[str] = set()
        self._waiting: dict[str, Task] = {}

    def run(self, make_workers: Callable[[], Workers]) -> State:
        tasks = self.plan.tasks
        self._waiting = {address: task for address, task in tasks.items() if not self._is_there(task, is_done)}
        for kind in ("scorers", "graphs"):  # a scorer that is made again needs its graph
            needed = {tasks[address] for task in self._waiting.values() for address in task.needs}
            for task in [task for task in needed if task.kind == kind and task.address not in self._waiting]:
                if not self._is_there(task, check_whole):
                    shutil.rmtree(task.folder(self.root))
                    self._waiting[task.address] = task
        self._there = tasks.keys() - self._waiting.keys()
        self.state.kept = len(self._there)
        for task in [task for task in self._waiting.values() if task.kind == "graphs"]:
            make_graph(task, self.root, self.plan.books[task.address])
            self._end(Outcome(self._taken(task).address, "done"))
        if self._waiting:
            workers = make_workers()
            try:
                self._work(workers)
            except KeyboardInterrupt:
                done = self.state.kept + self.state.done
                raise KeyboardInterrupt(
                    f"interrupted; {done:,} of {len(tasks):,} tasks are done, the same command goes on with the others"
                ) from None
            finally:
                workers.stop()
        self._show()
        return self.state

    def _is_there(self, task: Task, check: Callable[[Task, Path], bool | None]) -> bool:
        try:
            return check(task, self.root) is not False
        except ArtefactError as error:
            logging.getLogger(__name__).warning("%s It is made again now.", error)
            return False

    def _work(self, workers: Workers) -> None:
        is_full = False
        while self.state.running or (self._waiting and not is_full):
            while not is_full and len(self.state.running) < workers.places and (task := self._next()):
                forget_failure(self.root, task.address)  # of an earlier call
                self.state.running[task.address] = time.monotonic()
                workers.start(task)
            self._show()
            for outcome in workers.wait(TICK):
                is_full = is_full or outcome.disk_full
                del self.state.running[outcome.address]
                if outcome.ending == "interrupted":
                    raise KeyboardInterrupt
                self._end(outcome)
        if is_full:
            raise FullDiskError(
                f"the disk of '{self.root}' is full. All that was done is safe, and trainings have kept their last "
                "checkpoint; free some space, then the same command goes on."
            )

    def _next(self) -> Task | None:
        """Return a task whose inputs are there."""
        for task in self._waiting.values():
            if self._there.issuperset(task.needs):
                return self._taken(task)
        return None

    def _taken(self, task: Task) -> Task:
        return self._waiting.pop(task.address)

    def _end(self, outcome: Outcome) -> None:
        task = self.plan.tasks[outcome.address]
        if outcome.ending == "done":
            self._there.add(task.address)
            self.state.done += 1
            forget_failure(self.root, task.address)
            return
        self._fail(task, outcome)
        for other in [other for other in self._waiting.values() if task.address in other.needs]:
            self._fail(self._taken(other), Outcome(other.address, "failed", f"{task.title} failed: {outcome.error}"))

    def _fail(self, task: Task, outcome: Outcome) -> None:
        self.state.failed[task.address] = outcome
        try:
            note_failure(self.root, task, outcome)
        except OSError as error:  # the disk may be full
            logging.getLogger(__name__).warning("why '%s' failed cannot be kept (%s).", task.title, error.strerror)

    def _show(self) -> None:
        if self.watch:
            self.watch(self.plan, self.state)
