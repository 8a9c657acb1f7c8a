"""Figures of finished tasks, and of whole studies: one record, small enough to be kept beside a page that shows it.

A task's ``figures.json`` is written last, so it also says that the task is done.
"""

import hashlib
import json
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
"""Points of (environment steps, success)."""


class RunResult(Record, frozen=True):
    """The figures of a training.

    Attributes:
        values: the grid's values, by setting.
        run: address of the run folder, and of its settings: equal ones have equal addresses.
        graph: number of the graph in :attr:`StudyResults.graphs`.
        success: share of episodes in which the greedy agent made the goal, by part (train, test).
        by_plan: share in which the last pair of a plan made it, by part.
        endings: share of episodes on test tasks by ending, see :data:`~wordcraft_kg.agents.evaluation.ENDINGS`.
        won: successes of each test task in the order of the tasks, a digit each: of ``draws`` draws of distractors.
        curve: success on test tasks during training.
        mrr: leak-free MRR of the scorer on test triples; None without a scorer, or if it has seen them.
        steps: environment steps.
        seconds: of the training.
        steps_per_second: of acting and learning alone.
    """

    variant: str
    values: Values
    seed: int
    run: str
    graph: int
    success: dict[str, Share]
    by_plan: dict[str, Share]
    endings: dict[str, Share]
    won: str
    draws: int
    curve: Curve
    mrr: Share | None
    steps: Count
    seconds: Annotated[float, msgspec.Meta(ge=0)]
    steps_per_second: Count

    @property
    def rates(self) -> NDArray[np.float64]:
        """Success rate of each test task, shape (K,)."""
        return np.array([int(digit) for digit in self.won]) / self.draws


class Missing(Record, frozen=True):
    """A training that has no figures, and why."""

    variant: str
    values: Values
    seed: int
    why: str


class StudyResults(Record, frozen=True):
    """A study and all its figures (``results.json``).

    Attributes:
        command: the command that makes it again.
        study: the study as it was run, with all that the command line changed.
        versions: of packages, with which the runs were made.
        runs: in the order of the study's cells.
        missing: trainings without figures.
        hours: of training, summed over runs and scorers.
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


def results_text(results: StudyResults) -> str:
    """Return results as JSON with a line for each run: small, and what changes can be seen."""
    values = as_values(results)
    runs = ",\n".join(json.dumps(run, ensure_ascii=False, separators=(",", ":")) for run in values.pop("runs"))
    return f'{json.dumps(values, ensure_ascii=False)[:-1]}, "runs": [\n{runs}\n]}}\n'


FIGURES_FILE = "figures.json"
F = TypeVar("F", bound="Figures")


class Figures(Record, frozen=True, kw_only=True):
    """Figures of any task.

    Attributes:
        seconds: how long the training took; 0 of a graph.
        versions: of packages.
    """

    seconds: float
    versions: dict[str, str]


class ScorerFigures(Figures, frozen=True, kw_only=True):
    """Figures of a scorer.

    Attributes:
        mrr: leak-free MRR on the test triples; None if it has seen them, or there are none.
        kg: graph that it was trained on.
    """

    mrr: Share | None
    kg: str


class RunFigures(Figures, frozen=True, kw_only=True):
    """Figures of an agent's run; see :class:`~wordcraft_kg.studies.results.RunResult`."""

    graph: PlayedGraph
    success: dict[str, Share]
    by_plan: dict[str, Share]
    endings: dict[str, Share]
    won: str
    draws: Count
    curve: Curve
    steps: Count
    steps_per_second: Count


def write_figures(folder: Path, figures: Figures) -> None:
    """Write ``figures.json``, which marks the task as done; a hash of its content comes first."""
    values = as_values(figures)
    write_atomically(folder / FIGURES_FILE, dump_json({"sha256": _hash(values), "figures": values}), durable=True)


def read_figures(folder: Path, kind: type[F]) -> F:
    """Read ``figures.json``.

    Raises:
        ArtefactError: if it is missing, damaged or was edited.
    """
    path = folder / FIGURES_FILE
    values = read_json(path)
    if not isinstance(values, dict) or values.keys() != {"sha256", "figures"}:
        raise ArtefactError(f"{path} is damaged: expected 'sha256' and 'figures'. The same command makes it again.")
    if _hash(values["figures"]) != values["sha256"]:
        raise ArtefactError(
            f"{path} is damaged or was changed: its hash does not fit. The same command makes it again."
        )
    return as_record(values["figures"], kind, path)


def _hash(values: Any) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True, ensure_ascii=False).encode()).hexdigest()
