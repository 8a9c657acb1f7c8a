"""A results folder.

It holds graphs, scorers and agent runs in folders named by a settings hash, and their studies and
results.

| file or folder | content |
|---|---|
| ``graphs/``, ``scorers/``, ``runs/`` | a folder for each task, named by its address |
| ``studies/<name>.json`` | a study, its cells, and each cell's run address |
| ``failed/<address>.txt`` | a task's last failure |

Results that are collected fit their graphs: they are of its split, and of all its test tasks.
"""

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
from msgspec import structs

from wordcraft_kg.agents.config import TaskConfig
from wordcraft_kg.base.artefacts import (
    drop_temporary,
    dump_json,
    locked,
    made_folder,
    write_atomically,
)
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Record, as_values, read_record
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.envs.evaluation_tables import MOST_TASKS, distance_of
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation.reference import PlayedGraph
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.studies.plan import Outcome, Plan, Task
from wordcraft_kg.studies.results import (
    METRICS_FILE,
    Missing,
    Origin,
    RunMetrics,
    RunResult,
    ScorerMetrics,
    StudyResults,
    read_metrics,
)
from wordcraft_kg.studies.study import Study, StudyCell


class PlayedTasks:
    """The test tasks of a study's agents, found once for all agents that play the same."""

    def __init__(self, open_address: Callable[[str], OpenedGraph]):
        """Find tasks with a function that opens the graph of an address.

        An address is, for example, ``graphs/2f65aebd52224b51``.
        """
        self._open = open_address
        self._opened: dict[str, OpenedGraph] = {}
        self._groups: dict[tuple[str, int, str], Ids] = {}

    def groups(self, address: str, settings: Mapping[str, Any]) -> Ids:
        """Return the resampling group of each test task of an agent, shape (K,).

        Groups are numbered by first appearance.

        Args:
            address: address of the agent's graph.
            settings: settings of a cell or a task, of which only task settings matter.

        Raises:
            TaskError: if the graph has no test tasks with these settings.
            ConfigError: if a task setting is out of range.
            ArtefactError, RecipeFileError: if the graph cannot be opened.
        """
        of_tasks = {}
        for field in fields(TaskConfig):
            if field.name in settings:
                of_tasks[field.name] = settings[field.name]
        config = TaskConfig(**of_tasks).environment("test")
        key = address, config.depth, config.task_weighting
        if key not in self._groups:
            every = World(self._graph(address), config).groups
            # Of very many tasks, an even sample is played.
            step = distance_of(len(every), MOST_TASKS)
            played = every[::step]
            _, first, number = np.unique(played, return_index=True, return_inverse=True)
            # unique() numbers the groups by their values; the first appearance does not depend on
            # these. The place of a group in the order of first appearances is its new number.
            order = np.argsort(first)
            place = np.argsort(order)
            self._groups[key] = place[number]
        return self._groups[key]

    def check(
        self,
        figures: RunMetrics,
        address: str,
        settings: Mapping[str, Any],
        where: Path | str,
    ) -> None:
        """Check that an agent's results are of its graph, its split and its test tasks.

        Args:
            figures: results of the agent.
            address: address of the agent's graph.
            settings: settings of the agent's cell or task.
            where: file or folder with the results, perhaps in words, for the error.

        Raises:
            ArtefactError: if they are of another graph, split or set of tasks.
            TaskError, ConfigError, RecipeFileError: as :meth:`groups`.
        """
        expected = PlayedGraph.of(self._graph(address))
        if figures.graph != expected:
            raise ArtefactError(
                f"{where} has results of {figures.graph.in_words}; expected {expected.in_words}. "
                "Train again."
            )
        tasks = len(self.groups(address, settings))
        if len(figures.won) != tasks:
            raise ArtefactError(
                f"{where} is damaged: 'won' has {len(figures.won):,} tasks; expected {tasks:,}, "
                "all test tasks. Make it again, or restore a copy."
            )

    def _graph(self, address: str) -> OpenedGraph:
        if address not in self._opened:
            self._opened[address] = self._open(address)
        return self._opened[address]


_STUDIES = "studies"
_STOP = ".stop"
_FAILED = "failed"


class PlannedStudy(Record, frozen=True):
    """A study's record in ``studies/<name>.json``.

    Attributes:
        format: name and version of the file format.
        study: the study, with the changes of the command line.
        command: the command that ran the study.
        cells: its trainings.
        runs: address of each cell's run.
        scorers: address of each cell's scorer, or None.
        graphs: address of each cell's graph.
    """

    format: Literal["wordcraft-kg study 1"]
    study: Study
    command: str
    cells: tuple[StudyCell, ...]
    runs: tuple[str, ...]
    scorers: tuple[str | None, ...]
    graphs: tuple[str, ...]


@contextmanager
def own_results(root: Path) -> Iterator[None]:
    """Lock a results folder for one study, and remove temporary files that a kill left.

    The folder is created if necessary.

    Raises:
        ArtefactError: if another study runs in the folder, or ``root`` is a file.
    """
    if root.is_file():
        raise ArtefactError(f"'{root}' is a file; expected a results folder. Choose another `out`.")
    # A study that fails before its first file leaves no folder.
    with made_folder(root / _STUDIES), locked(root / _STUDIES, "used for a study"):
        for folder in filter(Path.is_dir, root.iterdir()):
            drop_temporary(folder)
        yield


def stop_file(root: Path) -> Path:
    """Return the path of the file that asks all workers to save a checkpoint and stop."""
    return root / _STUDIES / _STOP


def write_plan(root: Path, plan: Plan, command: str) -> None:
    """Record a study in a results folder before any training.

    Args:
        root: results folder, with the folder of studies.
        plan: the study with its trainings; another study of the same name is replaced with a
            warning.
        command: command line, for the record.
    """
    needs = [plan.tasks[run].needs for run in plan.runs]
    record = PlannedStudy(
        format="wordcraft-kg study 1",
        study=plan.study,
        command=command,
        cells=plan.cells,
        runs=plan.runs,
        # A task needs its graph, then perhaps its scorer.
        scorers=tuple(need[1] if len(need) > 1 else None for need in needs),
        graphs=tuple(need[0] for need in needs),
    )
    path = root / _STUDIES / f"{plan.name}.json"
    # A missing or damaged record is simply written anew.
    with suppress(ArtefactError):
        before = read_record(path, PlannedStudy).study
        # More seeds continue a study; any other change makes another one.
        if structs.replace(before, seeds=plan.study.seeds) != plan.study:
            logging.getLogger(__name__).warning(
                "the study '%s' of '%s' was another one; its runs stay, but its record and its "
                "report are replaced.",
                plan.name,
                root,
            )
    write_atomically(path, dump_json(as_values(record)))


def studies_of(root: Path) -> list[str]:
    """Return all study names in a results folder, sorted.

    Raises:
        ArtefactError: if ``root`` is not a results folder.
    """
    if not (root / _STUDIES).is_dir():
        raise ArtefactError(
            f"'{root}' is not a results folder: it lacks the folder '{_STUDIES}'. Create one: "
            "wordcraft-kg reproduce STUDY; wordcraft-kg reproduce --list names the studies."
        )
    return sorted(path.stem for path in (root / _STUDIES).glob("*.json"))


def read_plan(root: Path, name: str) -> PlannedStudy:
    """Read the record of a planned study.

    Raises:
        ArtefactError: if ``root`` is not a results folder, or the record is missing or damaged.
    """
    known = studies_of(root)
    if name not in known:
        raise ArtefactError(
            f"'{root}' has no study '{name}'; expected "
            f"{', '.join(known) or 'none'}.{nearest(name, known)}"
        )
    return read_record(root / _STUDIES / f"{name}.json", PlannedStudy)


def _failure_file(root: Path, address: str) -> Path:
    return root / _FAILED / f"{address.replace('/', '-')}.txt"


def note_failure(root: Path, task: Task, outcome: Outcome) -> None:
    """Record why a task failed, for later reports.

    Args:
        root: results folder.
        task: the failed task.
        outcome: its error, and the traceback of an error that is not the user's.
    """
    path = _failure_file(root, task.address)
    path.parent.mkdir(exist_ok=True)
    write_atomically(path, f"{task.title}\n{outcome.error}\n{outcome.detail}")


def forget_failure(root: Path, address: str) -> None:
    """Remove a task's recorded failure."""
    _failure_file(root, address).unlink(missing_ok=True)


def failure_of(root: Path, address: str) -> str | None:
    """Return the recorded error of the training ``address``; None if it has not failed."""
    path = _failure_file(root, address)
    if not path.exists():
        return None
    lines = path.read_text(encoding="utf-8").splitlines()
    return lines[1] if len(lines) > 1 else "the reason is unknown"


_KEPT = ("won", "distractor_seeds", "curve", "steps", "seconds", "steps_per_second")


def collect_study(root: Path, name: str) -> StudyResults:
    """Return the results that a study in a results folder has so far.

    A training with missing or damaged results is listed as missing, with the reason.

    Args:
        root: results folder.
        name: name of the study.

    Raises:
        ArtefactError: for an unknown study, or a damaged record of it.
    """
    plan = read_plan(root, name)
    return _results(root, name, plan)


def _results(root: Path, name: str, plan: PlannedStudy) -> StudyResults:
    played = PlayedTasks(lambda address: open_graph(str(root / address)))
    groups: dict[tuple[int, ...], int] = {}
    graphs: dict[PlayedGraph, int] = {}
    versions: dict[str, str] = {}
    scorers: dict[str, ScorerMetrics] = {}
    origins: dict[str, tuple[int, Origin]] = {}
    runs: list[RunResult] = []
    missing: list[Missing] = []
    # By address, so that a training that several cells share counts once.
    seconds: dict[str, float] = {}
    for cell, address, scorer, graph in zip(
        plan.cells, plan.runs, plan.scorers, plan.graphs, strict=True
    ):
        try:
            figures = _run_metrics(root, address)
            # The tasks are unknown if the graph's folder was removed.
            is_known = (root / graph).exists()
            if is_known:
                played.check(figures, graph, cell.settings, root / address)
            if scorer is not None and scorer not in scorers:
                scorers[scorer] = read_metrics(root / scorer, ScorerMetrics)
        except ArtefactError as error:
            missing.append(Missing(cell.variant, cell.values, cell.seed, str(error)))
            continue
        number = None
        if is_known:
            of_tasks = tuple(played.groups(graph, cell.settings).tolist())
            number = groups.setdefault(of_tasks, len(groups))
        versions |= figures.versions
        seconds[address] = figures.seconds
        runs.append(
            RunResult(
                variant=cell.variant,
                values=cell.values,
                seed=cell.seed,
                run=address,
                graph=graphs.setdefault(figures.graph, len(graphs)),
                origin=_origin(origins, figures),
                mrr=scorers[scorer].mrr if scorer is not None else None,
                success=_rounded(figures.success),
                by_plan=_rounded(figures.by_plan),
                terminations=_rounded(figures.terminations),
                groups=number,
                **{name: getattr(figures, name) for name in _KEPT},
            )
        )
        if scorer is not None:
            seconds[scorer] = scorers[scorer].seconds
    return StudyResults(
        format="wordcraft-kg results 1",
        name=name,
        command=plan.command,
        study=plan.study,
        graphs=tuple(graphs),
        versions=versions,
        runs=tuple(runs),
        missing=tuple(missing),
        hours=round(sum(seconds.values()) / 3600, 4),
        origins=tuple(origin for _, origin in origins.values()),
        groups=tuple(groups),
    )


def _origin(origins: dict[str, tuple[int, Origin]], figures: RunMetrics) -> int:
    """Count a run at its origin, and return the number of the origin."""
    key = repr((figures.platform, figures.versions))
    if key not in origins:
        new = Origin(figures.platform, figures.versions, runs=0)
        origins[key] = (len(origins), new)
    number, origin = origins[key]
    origins[key] = (number, structs.replace(origin, runs=origin.runs + 1))
    return number


def _run_metrics(root: Path, address: str) -> RunMetrics:
    if not (root / address / METRICS_FILE).exists():
        raise ArtefactError(failure_of(root, address) or "not trained yet")
    figures = read_metrics(root / address, RunMetrics)
    if "test" not in figures.success:
        raise ArtefactError("the split has no test tasks of this kind")
    return figures


def _rounded(shares: Mapping[str, float]) -> dict[str, float]:
    return {name: round(share, 6) for name, share in shares.items()}
