"""Figures for finished tasks and studies. ``figures.json`` is written last and marks a task as done."""

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
"""Points (environment steps, success)."""


class RunResult(Record, frozen=True):
    """Training figures.

    Attributes:
        values: grid values by setting.
        run: run folder address, a settings hash.
        graph: graph index in :attr:`StudyResults.graphs`.
        success: greedy success rate, by part (train, test).
        by_plan: success rate by the last pair in a plan, by part.
        terminations: share by termination reason, see :data:`~wordcraft_kg.agents.outcomes.TERMINATION_REASONS`.
        won: each test task's successes among ``distractor_seeds`` episodes, a digit for each task.
        curve: success on test tasks during training.
        mrr: the scorer's leak-free MRR on test triples; None without a scorer, or if the scorer has seen these triples.
        steps: environment steps.
        seconds: training time.
        steps_per_second: speed for acting and learning alone.
    """

    variant: str
    values: Values
    seed: int
    run: str
    graph: int
    success: dict[str, Share]
    by_plan: dict[str, Share]
    terminations: dict[str, Share]
    won: str
    distractor_seeds: int
    curve: Curve
    mrr: Share | None
    steps: Count
    seconds: Annotated[float, msgspec.Meta(ge=0)]
    steps_per_second: Count

    @property
    def rates(self) -> NDArray[np.float64]:
        """Success rate on each test task, shape (K,)."""
        return np.array([int(digit) for digit in self.won]) / self.distractor_seeds


class Missing(Record, frozen=True):
    """A training without figures, and the reason."""

    variant: str
    values: Values
    seed: int
    why: str


class StudyResults(Record, frozen=True):
    """A study and all its figures (``results.json``).

    Attributes:
        command: the command that runs the study again.
        study: the study with all command line changes.
        versions: run package versions.
        runs: in the order of the study's cells.
        hours: total training time.
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
    """Return results as JSON with a line for each run, for readable diffs."""
    values = as_values(results)
    runs = ",\n".join(json.dumps(run, ensure_ascii=False, separators=(",", ":")) for run in values.pop("runs"))
    return f'{json.dumps(values, ensure_ascii=False)[:-1]}, "runs": [\n{runs}\n]}}\n'


FIGURES_FILE = "figures.json"
F = TypeVar("F", bound="Figures")


class Figures(Record, frozen=True, kw_only=True):
    """Figures for any task: duration (0 for a graph) and package versions."""

    seconds: float
    versions: dict[str, str]


class ScorerFigures(Figures, frozen=True, kw_only=True):
    """A scorer's training graph, and leak-free MRR on unseen test triples, or None."""

    mrr: Share | None
    kg: str


class RunFigures(Figures, frozen=True, kw_only=True):
    """Figures for an agent's run, see :class:`RunResult`."""

    graph: PlayedGraph
    success: dict[str, Share]
    by_plan: dict[str, Share]
    terminations: dict[str, Share]
    won: str
    distractor_seeds: Count
    curve: Curve
    steps: Count
    steps_per_second: Count


def write_figures(folder: Path, figures: Figures) -> None:
    """Write ``figures.json`` with a hash over the figures; the file marks the task as done."""
    values = as_values(figures)
    write_atomically(folder / FIGURES_FILE, dump_json({"sha256": _hash(values), "figures": values}), durable=True)


def read_figures(folder: Path, kind: type[F]) -> F:
    """Read ``figures.json``.

    Raises:
        ArtefactError: for a missing, damaged or edited file.
    """
    path = folder / FIGURES_FILE
    values = read_json(path)
    if not isinstance(values, dict) or values.keys() != {"sha256", "figures"}:
        raise ArtefactError(
            f"{path} is damaged: expected 'sha256' and 'figures'. Repeat the command to repair the file."
        )
    if _hash(values["figures"]) != values["sha256"]:
        raise ArtefactError(
            f"{path} is damaged or was changed: the hash does not fit. Repeat the command to repair the file."
        )
    return as_record(values["figures"], kind, path)


def _hash(values: Any) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True, ensure_ascii=False).encode()).hexdigest()
