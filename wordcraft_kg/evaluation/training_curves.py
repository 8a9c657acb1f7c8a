"""Training curves of agents, also of unfinished runs: success, statistics and mixing weights λ."""

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from wordcraft_kg.agents.agent_folder import AgentRun
from wordcraft_kg.base.records import Record
from wordcraft_kg.base.statistics import student_interval
from wordcraft_kg.models.policies.sources import ALPHA, source_names

_CURVE_POINTS = 100
"""Approximate limit for points in a curve."""
TrainingMetric = Literal[
    "test_success", "return", "loss", "pg_loss", "baseline_loss", "entropy", "grad_norm"
]
METRICS: tuple[TrainingMetric, ...] = get_args(TrainingMetric)


class CurvePoint(Record, array_like=True):
    """Mean success over seeds at a point of the training.

    Attributes:
        step: environment steps so far.
        success: mean success rate.
        low, high: 95 % interval over seeds; None for a single seed.
    """

    step: int
    success: float
    low: float | None
    high: float | None


class LambdaCurve(Record):
    """Mean mixing weight λ of a source during training.

    Attributes:
        source: name of the score source.
        action: first or second action of an attempt.
        points: (environment step, λ).
    """

    source: str
    action: Literal["first", "second"]
    points: tuple[tuple[int, float], ...]


class SeedCurve(Record):
    """A logged training statistic of one run.

    Attributes:
        seed: training seed of the run.
        points: (environment step, value).
    """

    seed: int
    points: tuple[tuple[int, float], ...]


def success_curves(members: Sequence[AgentRun]) -> dict[str, tuple[CurvePoint, ...]]:
    """Return mean success curves by split part (test, train), with intervals over seeds."""
    curves = {}
    for part in ("test", "train"):
        rows = _shared_rows(members, f"{part}_success")
        points = []
        for step, seeds in rows:
            low, high = student_interval(seeds) or (None, None)
            points.append(CurvePoint(step, float(np.mean(seeds)), low, high))
        if points:
            curves[part] = tuple(points)
    return curves


def lambda_curves(members: Sequence[AgentRun]) -> list[LambdaCurve]:
    """Return mean mixing weights λ over seeds, by score source and action.

    A curve has about :data:`_CURVE_POINTS` points.
    """
    curves = []
    actions: tuple[Literal["first", "second"], ...] = ("first", "second")
    # A source that the agents do not have has no rows, and so no curve.
    for source in (ALPHA.name, *source_names()):
        for action in actions:
            rows = _shared_rows(members, f"lambda_{source}_{action}")
            every = max(1, len(rows) // _CURVE_POINTS)
            points = [(step, float(np.mean(seeds))) for step, seeds in rows[::every]]
            if points:
                curves.append(LambdaCurve(source, action, tuple(points)))
    return curves


def training_metrics(members: Sequence[AgentRun]) -> dict[TrainingMetric, tuple[SeedCurve, ...]]:
    """Return each run's logged statistics as curves, in about :data:`_CURVE_POINTS` points.

    The trainer's statistics are means since the line before. Where a line shortly follows another,
    as at a point of the learning curve, they cover a few updates and are mostly noise, so these
    points are left out. The success on test tasks is measured at the line itself and stays.
    """
    by_metric: dict[TrainingMetric, tuple[SeedCurve, ...]] = {}
    for figure in METRICS:
        curves = []
        for agent in members:
            # Steps since the line before, which a line's means cover.
            lengths = np.diff([0, *(row.step for row in agent.metrics)])
            # A run that has just begun has no lines, and no median.
            is_long = lengths * 2 >= np.median(lengths) if len(lengths) else lengths
            points = []
            for row, long in zip(agent.metrics, is_long, strict=True):
                is_mean = figure != "test_success"
                if figure in row.figures and (long or not is_mean):
                    points.append((row.step, row.figures[figure]))
            # Every n-th point counted from the end, because the last point matters most.
            every = max(1, len(points) // _CURVE_POINTS)
            thinned = points[::-every][::-1]
            if thinned:
                curves.append(SeedCurve(agent.config.trainer.seed, tuple(thinned)))
        if curves:
            by_metric[figure] = tuple(curves)
    return by_metric


def _shared_rows(members: Sequence[AgentRun], key: str) -> list[tuple[int, list[float]]]:
    by_run = []
    for agent in members:
        by_run.append({row.step: row.figures[key] for row in agent.metrics if key in row.figures})
    # Only steps that all runs have reached: a mean over fewer seeds would jump where a run ends.
    shared = sorted(set.intersection(*map(set, by_run)))
    rows = []
    for step in shared:
        rows.append((step, [values[step] for values in by_run]))
    return rows
