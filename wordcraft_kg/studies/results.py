"""Results of finished tasks and studies, in a results folder.

The folder holds graphs, scorers and agent runs in folders named by a settings hash, and their
studies. A task's ``figures.json`` is written last and marks the task as done.

| file or folder | content |
|---|---|
| ``graphs/``, ``scorers/``, ``runs/`` | a folder for each task, named by its address |
| ``studies/<name>.json`` | a study, its cells, and each cell's run address |
"""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base import (
    ArtefactError,
    Count,
    Record,
    Share,
    WordCraftKGError,
    as_record,
    as_values,
    drop_temporary,
    dump_json,
    made_folder,
    nearest,
    read_json,
    read_record,
    write_atomically,
)
from wordcraft_kg.base.artefacts import locked
from wordcraft_kg.envs.draws import MOST_TASKS, distance_of
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.graphs import PlayedGraph, open_graph
from wordcraft_kg.studies.plan import Plan, hash_of
from wordcraft_kg.studies.study import Study, StudyCell, Values

Curve = tuple[tuple[int, float], ...]
"""Points (environment steps, success)."""
Won = Annotated[str, msgspec.Meta(pattern=r"^[0-9]+\Z")]
"""Number of successes on each test task, a digit each."""
_ROUNDING = 1e-6
"""Shares are stored with six digits."""


class Performance(Record, frozen=True, kw_only=True):
    """Success of an agent or a player, and the effort of its training.

    Attributes:
        success: greedy success rate by split part.
        by_plan: success rate by one of the task's plans, by split part; at most ``success``.
        terminations: share of test episodes by the reason of their end.
        won: number of successes among ``distractor_seeds`` episodes, a digit for each test task.
        distractor_seeds: episodes of each test task, with other distractors each.
        curve: success on test tasks during training, with five digits.
        steps: environment steps of the training.
        seconds: training time.
        steps_per_second: environment steps per second of acting and learning, without evaluation.
    """

    success: dict[str, Share]
    by_plan: dict[str, Share]
    terminations: dict[str, Share]
    won: Won
    distractor_seeds: Annotated[int, msgspec.Meta(ge=1)]
    curve: Curve
    steps: Count
    seconds: Annotated[float, msgspec.Meta(ge=0)]
    steps_per_second: Count

    def __post_init__(self) -> None:
        """Check that success follows from ``won``.

        Everything else needs the agent or its scorer, and cannot be computed again.
        """
        part = "test" if "test" in self.success else "train"
        # Each task has the same number of episodes, so the mean over tasks is that over episodes.
        rate = sum(map(int, self.won)) / (len(self.won) * self.distractor_seeds)
        if abs(self.success.get(part, -1) - rate) > _ROUNDING:
            raise ValueError(f"`success` is {self.success}, but `won` gives {rate:g} for {part}")


class RunResult(Performance, frozen=True):
    """Results of one agent training in a study.

    Attributes:
        variant: name of the variant.
        values: the training's values for the grid settings.
        seed: seed of the agent.
        run: run folder in the results folder, named by a settings hash.
        graph: position in :attr:`StudyResults.graphs`.
        mrr: the scorer's leak-free MRR on test triples; None without a scorer, or if the scorer has
            seen these triples.
        origin: position in :attr:`StudyResults.origins`.
        groups: position in :attr:`StudyResults.groups`.
    """

    variant: str
    values: Values
    seed: int
    run: str
    graph: int
    mrr: Share | None
    origin: Count
    groups: Count

    def __post_init__(self) -> None:
        super().__post_init__()
        if "test" not in self.success or "test" not in self.by_plan:
            raise ValueError("`success` and `by_plan` lack test tasks")

    @property
    def rates(self) -> NDArray[np.float64]:
        """Success rate on each test task, shape (K,)."""
        successes = np.array([int(digit) for digit in self.won])
        return successes / self.distractor_seeds


class Missing(Record, frozen=True):
    """A training in a study that has no results.

    Attributes:
        variant: name of the variant.
        values: the training's values for the grid settings.
        seed: seed of the agent.
        why: the reason.
    """

    variant: str
    values: Values
    seed: int
    why: str


class Origin(Record, frozen=True):
    """Where agents were trained.

    Attributes:
        platform: system, machine, and instruction set or GPU.
        versions: package versions.
        runs: number of agents.
    """

    platform: str
    versions: dict[str, str]
    runs: Count


TaskIdentity = tuple[str, str, int, int]
"""Graph hash, split hash, number of test tasks, and of tables of each."""


class PlayedRates(NamedTuple):
    """Success rates of runs, by task.

    Attributes:
        scores: shape (S runs, K tasks); of runs on one split each, all tasks in a row, shape (1,
            sum of K).
        groups: resampling group of each task, in a row, of other splits other groups; None for
            measures with one value per run.
        splits: number of each task's split, in a row; None if all runs played the same tasks.
    """

    scores: NDArray[np.float64]
    groups: NDArray[np.int64] | None
    splits: NDArray[np.int64] | None

    @property
    def mean(self) -> float:
        """Mean over runs and tasks; of several splits, the mean of their means."""
        if self.splits is None:
            return float(self.scores.mean())
        by_split = np.bincount(self.splits, self.scores[0]) / np.bincount(self.splits)
        return float(by_split.mean())


class StudyResults(Record, frozen=True):
    """A study with all command line changes, and the results of its trainings (``results.json``).

    Attributes:
        format: name and version of the file format.
        name: name of the study in its results folder.
        command: the command that ran the study.
        study: the study's file, with the changes.
        graphs: graphs and splits of the runs.
        versions: package versions of the trainings; the last one's, if several were used.
        runs: results by grid point, variant and seed.
        missing: trainings without results.
        hours: training time in this results folder; a training that several cells share counts
            once.
        origins: platforms and package versions of the trainings.
        groups: resampling group of each test task, see :attr:`World.groups`, numbered by first
            appearance; equal groups of several runs are listed once.
    """

    format: Literal["wordcraft-kg results 1"]
    name: str
    command: str
    study: Study
    graphs: tuple[PlayedGraph, ...]
    versions: dict[str, str]
    runs: tuple[RunResult, ...]
    missing: tuple[Missing, ...]
    hours: Annotated[float, msgspec.Meta(ge=0)]
    origins: tuple[Origin, ...]
    groups: tuple[tuple[Count, ...], ...]

    def __post_init__(self) -> None:
        for run in self.runs:
            if run.graph >= len(self.graphs):
                raise ValueError(f"run {run.run} names a graph that is not listed")
            if run.groups >= len(self.groups):
                raise ValueError(f"run {run.run} names groups of tasks that are not listed")
            expected = len(self.groups[run.groups])
            if len(run.won) != expected:
                raise ValueError(
                    f"run {run.run} has {len(run.won)} tasks in `won`; expected {expected}"
                )

    def rates_of(self, runs: Sequence[RunResult]) -> PlayedRates:
        """Return the success rates of runs that played the same tasks, or a split each."""
        rates = [run.rates for run in runs]
        groups = [np.array(self.groups[run.groups], dtype=np.int64) for run in runs]
        if len({self.tasks_of(run) for run in runs}) == 1:
            return PlayedRates(np.array(rates), groups[0], None)
        splits = np.repeat(np.arange(len(runs)), [len(row) for row in rates])
        # Each split numbers its groups from 0.
        past = np.cumsum([0, *(numbers.max() + 1 for numbers in groups[:-1])])
        joined = np.concatenate(groups) + past[splits]
        return PlayedRates(np.concatenate(rates)[None], joined, splits)

    def tasks_of(self, run: RunResult) -> TaskIdentity:
        """Return what identifies a run's test tasks."""
        graph = self.graphs[run.graph]
        return graph.hash, graph.split, len(run.won), run.distractor_seeds


def results_text(results: StudyResults) -> str:
    """Return a study's results as JSON text with a line for each training, for readable diffs."""
    dump = json.JSONEncoder(ensure_ascii=False, separators=(",", ":")).encode
    values = as_values(results)
    runs = ",\n".join(map(dump, values.pop("runs")))
    # The groups of tasks are thousands of numbers, so blanks would be a third of the text.
    return f'{dump(values)[:-1]},"runs":[\n{runs}\n]}}\n'


METRICS_FILE = "figures.json"
REMAKE = "In a results folder, remove the damaged task's folder and repeat the command."
"""What to do about a damaged task; with damaged metrics alone it is repeated unasked."""
F = TypeVar("F", bound=Record)


class TaskMetrics(Record, frozen=True, kw_only=True):
    """Results of a graph or a scorer (``figures.json``).

    Attributes:
        seconds: duration; 0 for a graph.
        versions: package versions.
        platform: system, machine, and instruction set or GPU; empty for a graph.
    """

    seconds: float
    versions: dict[str, str]
    platform: str = ""


class ScorerMetrics(TaskMetrics, frozen=True, kw_only=True):
    """Results of training a scorer.

    Attributes:
        mrr: MRR on test triples outside training; None if the scorer has seen them, or there are
            none.
        kg: graph that the scorer was trained on, full or partial.
    """

    mrr: Share | None
    kg: str


class RunMetrics(Performance, frozen=True, kw_only=True):
    """Results of training an agent.

    Attributes:
        versions: package versions.
        platform: system, machine, and instruction set or GPU.
        graph: graph and split that the agent was trained and evaluated on.
    """

    versions: dict[str, str]
    platform: str = ""
    graph: PlayedGraph


def write_metrics(folder: Path, figures: TaskMetrics | RunMetrics) -> None:
    """Write a task's results with a hash to ``figures.json`` in the task's folder.

    The file marks the task as done.

    Args:
        folder: the task's folder, which exists.
        figures: the results.

    Raises:
        OSError: if the file cannot be written, as on a full disk.
    """
    values = as_values(figures)
    write_atomically(
        folder / METRICS_FILE,
        dump_json({"sha256": hash_of(values), "figures": values}),
        durable=True,
    )


def read_metrics(folder: Path, kind: type[F]) -> F:
    """Read a task's results of the type ``kind`` from its folder.

    Raises:
        ArtefactError: if the file is missing, damaged or edited, or holds results of another type.
    """
    path = folder / METRICS_FILE
    values = read_json(path)
    is_pair = isinstance(values, dict) and values.keys() == {"sha256", "figures"}
    if not is_pair or hash_of(values["figures"]) != values["sha256"]:
        raise ArtefactError(
            f"{path} is damaged or was changed: the hash does not fit. Repeat the command to "
            "repair the file."
        )
    return as_record(values["figures"], kind, path)


_STUDIES = "studies"
_STOP = ".stop"


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
        plan: the study with its trainings; another study of the same name is replaced.
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
    write_atomically(root / _STUDIES / f"{plan.name}.json", dump_json(as_values(record)))


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


def collect_study(root: Path, name: str) -> StudyResults:
    """Return the results that a study in a results folder has so far.

    A training with missing or damaged results is listed as missing, with the reason.

    Args:
        root: results folder.
        name: name of the study.

    Raises:
        ArtefactError: if ``root`` is not a results folder, or for an unknown study, or a damaged
            record of it.
    """
    names = studies_of(root)
    if name not in names:
        raise ArtefactError(
            f"'{root}' has no study '{name}'; expected "
            f"{', '.join(names) or 'none'}.{nearest(name, names)}"
        )
    plan = read_record(root / _STUDIES / f"{name}.json", PlannedStudy)

    # Opening a graph and finding its tasks takes seconds, and most runs share them.
    @cache
    def groups_at(graph: str, depth: int) -> tuple[int, ...]:
        """Return the resampling group of each played task, numbered by first appearance."""
        try:
            opened = open_graph(str(root / graph))
        except WordCraftKGError as error:
            raise ArtefactError(f"{error} {REMAKE}") from error
        # A small book may lack room for the default number of distractors.
        every = World(opened, WordCraftConfig("test", depth, num_distractors=0)).groups
        # Of very many tasks, an even sample is played.
        played = every[:: distance_of(len(every), MOST_TASKS)].tolist()
        numbers = {group: number for number, group in enumerate(dict.fromkeys(played))}
        return tuple(numbers[group] for group in played)

    groups: dict[tuple[int, ...], int] = {}
    graphs: dict[PlayedGraph, int] = {}
    versions: dict[str, str] = {}
    scorers: dict[str, ScorerMetrics] = {}
    origins: dict[tuple[str, tuple[tuple[str, str], ...]], int] = {}
    runs: list[RunResult] = []
    missing: list[Missing] = []
    # By address, so that a training that several cells share counts once.
    seconds: dict[str, float] = {}
    for cell, address, scorer, graph in zip(
        plan.cells, plan.runs, plan.scorers, plan.graphs, strict=True
    ):
        try:
            figures = _run_metrics(root / address)
            depth: Any = cell.settings.get("depth", WordCraftConfig.depth)
            group_of_task = groups_at(graph, depth)
            if len(figures.won) != len(group_of_task):
                raise ArtefactError(
                    f"{root / address} has results of {len(figures.won):,} tasks; expected "
                    f"{len(group_of_task):,}, all test tasks of {root / graph}. {REMAKE}"
                )
            if scorer is not None and scorer not in scorers:
                scorers[scorer] = read_metrics(root / scorer, ScorerMetrics)
        except ArtefactError as error:
            missing.append(Missing(cell.variant, cell.values, cell.seed, str(error)))
            continue
        versions |= figures.versions
        seconds[address] = figures.seconds
        if scorer is not None:
            seconds[scorer] = scorers[scorer].seconds
        origin = (figures.platform, tuple(figures.versions.items()))
        runs.append(
            RunResult(
                variant=cell.variant,
                values=cell.values,
                seed=cell.seed,
                run=address,
                graph=graphs.setdefault(figures.graph, len(graphs)),
                origin=origins.setdefault(origin, len(origins)),
                mrr=scorers[scorer].mrr if scorer is not None else None,
                groups=groups.setdefault(group_of_task, len(groups)),
                **_rounded(figures),
            )
        )
    run_counts = Counter(run.origin for run in runs)
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
        origins=tuple(
            Origin(platform, dict(packages), run_counts[number])
            for (platform, packages), number in origins.items()
        ),
        groups=tuple(groups),
    )


def _run_metrics(folder: Path) -> RunMetrics:
    if not (folder / METRICS_FILE).exists():
        raise ArtefactError("not trained yet, or the training failed")
    figures = read_metrics(folder, RunMetrics)
    if "test" not in figures.success:
        raise ArtefactError("the split has no test tasks of this kind")
    return figures


def _rounded(figures: RunMetrics) -> dict[str, Any]:
    """Return a run's performance by field, with six digits for shares by name."""
    values = {name: getattr(figures, name) for name in Performance.__struct_fields__}
    for field in ("success", "by_plan", "terminations"):
        values[field] = {name: round(share, 6) for name, share in values[field].items()}
    return values
