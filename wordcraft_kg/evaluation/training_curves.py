"""Curves of trainings: success, figures and λ over steps, of one run or of several seeds; also of runs not yet done."""

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from wordcraft_kg.agents.agent_folder import AgentRun
from wordcraft_kg.base.records import Record
from wordcraft_kg.base.statistics import stratified_bootstrap
from wordcraft_kg.models.policies.sources import ALPHA, source_names

CURVE_POINTS = 100
"""About the most points of a curve of training figures."""
Figure = Literal["test_success", "return", "loss", "pg_loss", "baseline_loss", "entropy", "grad_norm"]
FIGURES: tuple[Figure, ...] = get_args(Figure)
"""Figures of the training that are shown for each seed."""


class CurvePoint(Record, array_like=True):
    """Success after a number of steps, and its interval over seeds."""

    step: int
    success: float
    low: float | None
    high: float | None


class LambdaCurve(Record):
    """A source's mean λ in training as (step, λ), for the first or the second pick."""

    source: str
    pick: Literal["first", "second"]
    points: tuple[tuple[int, float], ...]


class SeedCurve(Record):
    """A figure of one training as (step, value)."""

    seed: int
    points: tuple[tuple[int, float], ...]


def success_curves(members: Sequence[AgentRun]) -> dict[str, tuple[CurvePoint, ...]]:
    """Success over training by part: means over seeds, with the interval of the mean."""
    found = {}
    for part in ("test", "train"):
        rows = _shared_rows(members, f"{part}_success")
        points = [
            CurvePoint(step, float(np.mean(seeds)), *(stratified_bootstrap(seeds, np.mean) or (None, None)))
            for step, seeds in rows
        ]
        if points:
            found[part] = tuple(points)
    return found


def lambda_curves(members: Sequence[AgentRun]) -> list[LambdaCurve]:
    """λ over training, by source and pick, the mean over seeds, in about :data:`CURVE_POINTS` points."""
    found = []
    picks: tuple[Literal["first", "second"], ...] = ("first", "second")
    for source in (ALPHA.name, *source_names()):
        for pick in picks:
            rows = _shared_rows(members, f"lambda_{source}_{pick}")
            points = [(step, float(np.mean(seeds))) for step, seeds in rows[:: max(1, len(rows) // CURVE_POINTS)]]
            if points:
                found.append(LambdaCurve(source, pick, tuple(points)))
    return found


def training_figures(members: Sequence[AgentRun]) -> dict[Figure, tuple[SeedCurve, ...]]:
    """Figures of each training that has them, in about :data:`CURVE_POINTS` points.

    A trainer's figures are means since the line before; lines shortly after another are mostly noise and left out.
    """
    found: dict[Figure, tuple[SeedCurve, ...]] = {}
    for figure in FIGURES:
        curves = []
        for agent in members:
            lengths = np.diff([0, *(row.step for row in agent.metrics)])
            is_long = lengths * 2 >= np.median(lengths) if len(lengths) else lengths
            points = [
                (row.step, row.figures[figure])
                for row, long in zip(agent.metrics, is_long, strict=True)
                if figure in row.figures and (long or figure == "test_success")
            ]
            # Counted from the end, because the last point matters most.
            thinned = points[:: -max(1, len(points) // CURVE_POINTS)][::-1]
            if thinned:
                curves.append(SeedCurve(agent.config.trainer.seed, tuple(thinned)))
        if curves:
            found[figure] = tuple(curves)
    return found


def _shared_rows(members: Sequence[AgentRun], key: str) -> list[tuple[int, list[float]]]:
    """Return the steps at which all runs have a figure, and the figures."""
    rows = [{row.step: row.figures[key] for row in agent.metrics if key in row.figures} for agent in members]
    return [(step, [row[step] for row in rows]) for step in sorted(set.intersection(*map(set, rows)))]
