"""Results of finished tasks and studies.

A task's ``figures.json`` is written last and marks the task as done.
"""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.artefacts import dump_json, read_json, write_atomically
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Count, Record, Share, as_record, as_values
from wordcraft_kg.evaluation.reference import PlayedGraph
from wordcraft_kg.studies.study import Study, Values

Curve = tuple[tuple[int, float], ...]
"""Points (environment steps, success)."""


def steps_to(curve: Iterable[tuple[int, float]], level: float) -> float:
    """Return the steps until a curve first reaches a level; infinity if it never does.

    Between two points, the curve is a line.

    Args:
        curve: points (environment steps, success) in ascending order of steps.
        level: the success to reach.
    """
    before = 0
    lower = level
    for step, value in curve:
        if value >= level:
            # The first point has no line before it.
            if lower >= level:
                return step
            # Back from the point, by the share of its line that lies above the level.
            length = step - before
            return step - length * (value - level) / (value - lower)
        before = step
        lower = value
    return math.inf


Won = Annotated[str, msgspec.Meta(pattern=r"^[0-9]+\Z")]
"""Number of successes on each test task, a digit each."""
_ROUNDING = 1e-6
"""Shares are stored with six digits."""


def check_played(figures: "RunResult | RunMetrics") -> None:
    """Check that success and the share of episodes that end with the goal follow from ``won``.

    Everything else needs the agent or its scorer, and cannot be computed again.

    Raises:
        ValueError: for results that contradict ``won``.
    """
    successes = [int(digit) for digit in figures.won]
    tables = figures.distractor_seeds
    if not tables or max(successes) > tables:
        raise ValueError(
            f"`won` has {max(successes)} successes of a task; expected at most `distractor_seeds` "
            f"{tables}"
        )
    # Each task has the same number of episodes, so the mean over tasks is that over episodes.
    episodes = len(successes) * tables
    rate = sum(successes) / episodes
    part = _part_of(figures.success)
    _check_rate(f"success.{part}", figures.success[part], rate)
    # Results may leave the reasons out, but not contradict `won` with them.
    if figures.terminations:
        _check_rate("terminations.goal", figures.terminations.get("goal", 0.0), rate)


def _check_rate(name: str, claimed: float, rate: float) -> None:
    if abs(claimed - rate) > _ROUNDING:
        raise ValueError(f"`{name}` is {claimed:g}, but `won` gives {rate:g}")


def _part_of(success: Mapping[str, float]) -> str:
    """Return the part of the tasks in ``won``: test, or train in a graph without test tasks."""
    part = "test" if "test" in success else "train"
    if part not in success:
        raise ValueError("`success` has neither test nor train tasks")
    return part


class RunResult(Record, frozen=True):
    """Results of one agent training in a study.

    Attributes:
        variant: name of the variant.
        values: the training's values for the grid settings.
        seed: seed of the agent.
        run: run folder in the results folder, named by a settings hash.
        graph: position in :attr:`StudyResults.graphs`.
        success: greedy success rate by split part.
        by_plan: success rate by one of the task's plans, by split part; at most ``success``.
        terminations: share of test episodes by the reason of their end.
        won: number of successes among ``distractor_seeds`` episodes, a digit for each test task.
        distractor_seeds: episodes of each test task, with other distractors each.
        curve: success on test tasks during training.
        mrr: the scorer's leak-free MRR on test triples; None without a scorer, or if the scorer has
            seen these triples.
        steps: environment steps of the training.
        seconds: training time.
        steps_per_second: environment steps per second of acting and learning, without evaluation.
        origin: position in :attr:`StudyResults.origins`.
        groups: position in :attr:`StudyResults.groups`; None in results of earlier versions.
    """

    variant: str
    values: Values
    seed: int
    run: str
    graph: int
    success: dict[str, Share]
    by_plan: dict[str, Share]
    terminations: dict[str, Share]
    won: Won
    distractor_seeds: Count
    curve: Curve
    mrr: Share | None
    steps: Count
    seconds: Annotated[float, msgspec.Meta(ge=0)]
    steps_per_second: Count
    origin: Count = 0
    groups: Count | None = None

    def __post_init__(self) -> None:
        check_played(self)
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
    origins: tuple[Origin, ...] = ()
    groups: tuple[tuple[Count, ...], ...] = ()

    def __post_init__(self) -> None:
        for run in self.runs:
            if run.graph >= len(self.graphs):
                raise ValueError(f"run {run.run} names a graph that is not listed")
            if run.groups is None:
                continue
            if run.groups >= len(self.groups):
                raise ValueError(f"run {run.run} names groups of tasks that are not listed")
            expected = len(self.groups[run.groups])
            if len(run.won) != expected:
                raise ValueError(
                    f"run {run.run} has {len(run.won)} tasks in `won`; expected {expected}"
                )

    def groups_of(self, run: RunResult) -> NDArray[np.int64] | None:
        """Return the group of each test task of a run, shape (K,); None if not recorded."""
        if run.groups is None:
            return None
        return np.array(self.groups[run.groups], dtype=np.int64)

    def tasks_of(self, run: RunResult) -> tuple[str, str, int, int]:
        """Return what identifies a run's test tasks: graph hash, split hash, tasks, tables."""
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
F = TypeVar("F", bound="TaskMetrics")


class TaskMetrics(Record, frozen=True, kw_only=True):
    """Results of a graph, a scorer or a run (``figures.json``).

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


class RunMetrics(TaskMetrics, frozen=True, kw_only=True):
    """Results of training an agent, as in :class:`RunResult`.

    Attributes:
        graph: graph and split that the agent was trained and evaluated on.
        success: greedy success rate by split part.
        by_plan: success rate by one of the task's plans, by split part.
        terminations: share of test episodes by the reason of their end.
        won: number of successes, a digit for each test task.
        distractor_seeds: episodes of each test task.
        curve: success on test tasks during training, with five digits.
        steps: environment steps.
        steps_per_second: environment steps per second of acting and learning.
    """

    graph: PlayedGraph
    success: dict[str, Share]
    by_plan: dict[str, Share]
    terminations: dict[str, Share]
    won: Won
    distractor_seeds: Count
    curve: Curve
    steps: Count
    steps_per_second: Count

    def __post_init__(self) -> None:
        check_played(self)


def write_metrics(folder: Path, figures: TaskMetrics) -> None:
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
    if not isinstance(values, dict) or values.keys() != {"sha256", "figures"}:
        raise ArtefactError(
            f"{path} is damaged: expected 'sha256' and 'figures'. Repeat the command to repair the "
            "file."
        )
    if hash_of(values["figures"]) != values["sha256"]:
        raise ArtefactError(
            f"{path} is damaged or was changed: the hash does not fit. Repeat the command to "
            "repair the file."
        )
    return as_record(values["figures"], kind, path)


def hash_of(values: Any) -> str:
    """Return the SHA-256 of JSON values."""
    # Sorted, so that the order of keys in an edited but equal file does not matter.
    text = json.dumps(values, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()
