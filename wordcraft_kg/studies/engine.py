"""The engine: performs a study's missing tasks, inputs first, and estimates their duration."""

import logging
import shutil
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from statistics import median

from wordcraft_kg.agents.config import ImpalaConfig
from wordcraft_kg.base.errors import ArtefactError, WordCraftKGError
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.runs.record import RUN_FILE
from wordcraft_kg.studies.cells import exchange_cells, keep_cell, read_cell
from wordcraft_kg.studies.local_workers import LocalWorkers
from wordcraft_kg.studies.packs import CellFiles
from wordcraft_kg.studies.perform import METRICS, check_whole, is_done, make_graph, perform
from wordcraft_kg.studies.plan import Plan, make_plan
from wordcraft_kg.studies.results import StudyResults, read_metrics
from wordcraft_kg.studies.store import (
    collect_study,
    forget_failure,
    note_failure,
    own_results,
    write_plan,
)
from wordcraft_kg.studies.study import Study, check_study
from wordcraft_kg.studies.tasks import Outcome, Task, TaskWorkers


@dataclass
class StudyProgress:
    """The progress of a running study, in numbers of tasks.

    Attributes:
        total: tasks of the study.
        kept: tasks that were finished before the start.
        taken: those of ``kept`` that were copied from the store of cells.
        done: tasks finished since the start.
        failed: outcomes by task address, also for tasks whose inputs failed.
        running: start times by task address, by :func:`time.monotonic`.
    """

    total: int
    kept: int = 0
    taken: int = 0
    done: int = 0
    failed: dict[str, Outcome] = field(default_factory=dict)
    running: dict[str, float] = field(default_factory=dict)


Watch = Callable[[Plan, StudyProgress], None]


class FullDiskError(WordCraftKGError, OSError):
    """The disk is full; finished tasks are safe."""


def run_plan(
    plan: Plan,
    root: Path,
    workers: TaskWorkers,
    *,
    command: str = "",
    watch: Watch | None = None,
    store: Path | None = None,
) -> StudyProgress:
    """Perform the tasks in a study without results in the folder ``root``; return the final state.

    A failed task stops only the tasks that need its result; the next call repeats failed tasks.

    Args:
        plan: the study.
        root: results folder.
        workers: perform the tasks; started only if there are tasks for them.
        command: command line, for the study's record.
        watch: called regularly with the plan and its progress.
        store: folder of cells, whose results are taken and to which new results are added; None for
            none.

    Raises:
        ArtefactError: if a different study runs in the folder, or a pack of the store is damaged.
        ConfigError: if ``store`` is a file.
        FullDiskError: if the disk is full.
        KeyboardInterrupt: after Ctrl-C; running trainings keep a checkpoint.
    """
    # A store that cannot be read is refused before the results folder is touched.
    cells = None if store is None else CellFiles(store)
    with own_results(root):
        write_plan(root, plan, command)
        engine = _Engine(plan, root, watch, cells)
        engine.state.taken = 0 if cells is None else exchange_cells(plan, root, cells)
        return engine.run(workers)


class _Engine:
    def __init__(self, plan: Plan, root: Path, watch: Watch | None, store: CellFiles | None):
        self.plan = plan
        self.root = root
        self.watch = watch
        self.store = store
        self.state = StudyProgress(len(plan.tasks))
        self._present: set[str] = set()
        self._waiting: dict[str, Task] = {}
        self._is_full = False

    def run(self, workers: TaskWorkers) -> StudyProgress:
        tasks = self.plan.tasks
        self._waiting = self._missing()
        self._present = tasks.keys() - self._waiting.keys()
        self.state.kept = len(self._present)
        # Graphs are made quickly, so no process has to start for them.
        graphs = [task for task in self._waiting.values() if task.kind == "graphs"]
        for task in graphs:
            make_graph(task, self.root, self.plan.books[task.address])
            del self._waiting[task.address]
            self._end(Outcome(task.address, "done"))
        if self._waiting:
            try:
                self._work(workers)
            except KeyboardInterrupt:  # a second Ctrl-C skips the checkpoints
                done = self.state.kept + self.state.done
                raise KeyboardInterrupt(
                    f"interrupted; {done:,} of {len(tasks):,} tasks are done, repeat the command "
                    "to perform the rest"
                ) from None
        self._show()
        return self.state

    def _missing(self) -> dict[str, Task]:
        """Return the tasks to perform: those without results, and their inputs that lack files."""
        missing: dict[str, Task] = {}
        for address, task in self.plan.tasks.items():
            if not self._is_present(task, is_done):
                missing[address] = task
        # Scorers first: a damaged scorer is trained again, and so needs a whole graph.
        for kind in ("scorers", "graphs"):
            for task in self._inputs_of(missing):
                if task.kind == kind and not self._is_present(task, check_whole):
                    shutil.rmtree(task.folder(self.root))
                    missing[task.address] = task
        return missing

    def _inputs_of(self, missing: dict[str, Task]) -> set[Task]:
        needed: set[str] = set()
        for task in missing.values():
            needed.update(task.needs)
        return {self.plan.tasks[address] for address in needed - missing.keys()}

    def _is_present(self, task: Task, check: Callable[[Task, Path], bool]) -> bool:
        try:
            return check(task, self.root)
        except ArtefactError as error:
            logging.getLogger(__name__).warning("%s The task is repeated now.", error)
            return False

    def _work(self, workers: TaskWorkers) -> None:
        # Closed in any case: running trainings then write a checkpoint.
        with closing(workers.outcomes(self._take)) as outcomes:
            for outcome in outcomes:
                if outcome is not None:
                    self._receive(outcome)
                self._show()
        if self._is_full:
            raise FullDiskError(
                f"the disk of '{self.root}' is full. All finished tasks are safe, and trainings "
                "have kept their last checkpoint; free some space, then repeat the command."
            )

    def _take(self) -> Task | None:
        """Return a task that a worker starts now; None if there is none now."""
        # Running tasks may still end well on a full disk; no new ones are started.
        task = None if self._is_full else self._next()
        if task is not None:
            forget_failure(self.root, task.address)  # from an earlier call
            self.state.running[task.address] = time.monotonic()
        return task

    def _receive(self, outcome: Outcome) -> None:
        self._is_full = self._is_full or outcome.disk_full
        del self.state.running[outcome.address]
        if outcome.termination == "interrupted":
            raise KeyboardInterrupt
        self._end(outcome)

    def _next(self) -> Task | None:
        """Return the first waiting task of the plan whose inputs are there.

        The result is None if there is none now.
        """
        for task in self._waiting.values():
            if self._present.issuperset(task.needs):
                return self._waiting.pop(task.address)
        return None

    def _end(self, outcome: Outcome) -> None:
        task = self.plan.tasks[outcome.address]
        if outcome.termination == "done":
            self._present.add(task.address)
            self.state.done += 1
            forget_failure(self.root, task.address)
            if self.store:
                keep_cell(task, self.root, self.store)
            return
        self._fail(task, outcome)
        # Only runs have inputs that can fail, so no task waits for one that is removed here.
        others = [other for other in self._waiting.values() if task.address in other.needs]
        why = f"{task.title} failed: {outcome.error}"
        # Named as failed, too: otherwise the study would seem to wait for them.
        for other in others:
            del self._waiting[other.address]
            self._fail(other, Outcome(other.address, "failed", why))

    def _fail(self, task: Task, outcome: Outcome) -> None:
        self.state.failed[task.address] = outcome
        try:
            note_failure(self.root, task, outcome)
        except OSError as error:  # the disk may be full
            logging.getLogger(__name__).warning(
                "why '%s' failed cannot be kept (%s).", task.title, error.strerror
            )

    def _show(self) -> None:
        if self.watch:
            self.watch(self.plan, self.state)


_STEPS_PER_SECOND = {
    "none": 55_000,
    "u,v": 42_000,
    "w": 26_000,
    "random": 20_000,
    "one-hot": 13_000,
}
"""By scorer sources or, without a scorer, by vectors above 50 dimensions.

Measured on one core, with 8 distractors.
"""
_SECONDS_OF_SCORER = {"train-complex": 70.0, "train-links": 120.0, "train-recipes": 50.0}
"""Duration with folds, for a book of 700 entities."""
_START = 3.0
"""Seconds for opening the graph and for the final evaluation."""


def estimated_hours(plan: Plan, root: Path, store: Path | None = None) -> float:
    """Estimate the hours of one core that a study still needs.

    The duration of finished tasks in ``root`` corrects the estimates for this machine and book: the
    median of their ratios to the usual duration, by kind of task.

    Args:
        plan: the study.
        root: results folder, which may be missing.
        store: folder of cells, which count as finished; None for none.

    Raises:
        ConfigError: if ``store`` is a file.
        ArtefactError: if a pack of the store is damaged.
    """
    cells = None if store is None else CellFiles(store)
    left: dict[str, Task] = {}
    measured = defaultdict(list)
    for task in plan.tasks.values():
        try:
            seconds = read_metrics(task.folder(root), METRICS[task.kind]).seconds
        except ArtefactError:
            # Graphs have no cells, but take no time either.
            if cells is None or task.kind == "graphs" or read_cell(task, cells) is None:
                left[task.address] = task
            continue
        # 0 for graphs and for results from a store.
        if seconds:
            measured[_sort(task)].append(seconds / _usual(task))
    # Results from a store have no files: a scorer that a missing agent needs is trained again.
    for task in list(left.values()):
        for address in task.needs:
            if not (root / address / RUN_FILE).exists():
                left[address] = plan.tasks[address]
    factors = {sort: median(ratios) for sort, ratios in measured.items()}
    seconds_left = 0.0
    for task in left.values():
        # A kind of which nothing was measured here takes its usual time.
        seconds_left += _usual(task) * factors.get(_sort(task), 1.0)
    return seconds_left / 3600


def _sort(task: Task) -> str:
    """Return the kind of a task as far as it decides the duration: a key of the tables above."""
    if task.kind == "scorers":
        return str(task.settings["command"])
    if task.kind == "graphs":
        return task.kind
    settings = task.settings["settings"]
    if len(task.needs) > 1:
        config = PolicyConfig(use=settings.get("use", PolicyConfig.use))
        return "w" if "w" in config.sources else "u,v"
    features = settings.get("features", PolicyConfig.features)
    return features if features in _STEPS_PER_SECOND else "none"


def _usual(task: Task) -> float:
    if task.kind == "runs":
        steps = task.settings["settings"].get("steps", ImpalaConfig.steps)
        return _START + steps / _STEPS_PER_SECOND[_sort(task)]
    return _SECONDS_OF_SCORER.get(_sort(task), 1.0)


def run_study(
    study: Study,
    out: str | Path,
    *,
    name: str = "study",
    jobs: int | None = None,
    keep_all: bool = True,
    watch: Watch | None = None,
    store: Path | None = None,
) -> StudyResults:
    """Perform the missing tasks in a study and return its results.

    Failed trainings are listed as missing.

    Args:
        study: from :func:`~wordcraft_kg.studies.study.read_study`, or made in Python.
        out: results folder; studies in the same folder share equal tasks.
        name: study name.
        jobs: number of parallel trainings, each in a process. Default: as many as the cores allow.
        keep_all: keep run weights and episodes, tens of megabytes each.
        watch: called regularly with the plan and its state.
        store: folder with cells (results of one training each) to read, and to extend with new
            results.

    Raises:
        ConfigError: for a study fault, or ``jobs`` out of range.
        RecipeFileError: if a recipe book is missing.
        ArtefactError: if another study runs in the folder, or a pack of the store is damaged.
        FullDiskError: if the disk is full.
        KeyboardInterrupt: after Ctrl-C; the same call resumes.

    Example:
        >>> settings = {"book": "kitchen", "steps": 256}
        >>> study = Study("A look", {"none": {}}, seeds=1, settings=settings)
        >>> results = run_study(study, "results", jobs=1)
        >>> [(run.variant, run.seed, run.steps) for run in results.runs]
        [('none', 0, 256)]
    """
    check_study(study)
    root = Path(out)
    plan = make_plan(study, name)
    number = plan.jobs(jobs)
    work = partial(perform, keep_all=keep_all)
    run_plan(plan, root, LocalWorkers(root, number, work, plan.threads), watch=watch, store=store)
    return collect_study(root, name)
