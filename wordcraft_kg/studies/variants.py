"""Results of a variant at a grid point: means, intervals, differences to the reference, and success by scorer MRR."""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.base.statistics import (
    FEWEST_PAIRS,
    correlation,
    crossed_difference,
    rate_interval,
    student_interval,
)
from wordcraft_kg.evaluation.reference import PlayedGraph
from wordcraft_kg.evaluation.training_curves import CurvePoint
from wordcraft_kg.studies.results import RunResult, StudyResults, steps_to
from wordcraft_kg.studies.study import SCORER, Values

Interval = tuple[float, float]
_ROUNDING = 1e-12


class Comparison(Record):
    """A variant compared with the study's reference variant under the same grid settings.

    ``difference`` of mean success on test tasks, with the 95 % interval over seeds and groups of tasks, over ``pairs``
    common seeds. The p-value needs three pairs, else None; ``p_corrected`` has Holm's correction for all comparisons
    in the study.
    """

    difference: Annotated[float, msgspec.Meta(ge=-1, le=1)]
    interval: Interval
    pairs: Annotated[int, msgspec.Meta(ge=1)]
    p_value: Share | None
    p_corrected: Share | None


class VariantFigures(Record):
    """Results of a variant under fixed grid settings; all intervals are 95 % intervals.

    Attributes:
        seed_interval: interval for ``mean`` over seeds, by Student's t; None for a single seed.
        interval: interval for ``mean`` over seeds and groups of tasks, such as goals; over tasks for a single seed.
        train: mean success on train tasks; None if not measured.
        mrr: mean MRR of the agents' scorers on test triples outside training, or None.
        comparison: difference to the reference; None for the reference and without common seeds.
        reached: steps until the mean learning curve reaches the reference's final success; None for never.
        reached_interval: interval for ``reached``, with None for never; None below two common seeds.
    """

    variant: str
    seeds: tuple[int, ...]
    success: Annotated[tuple[Share, ...], msgspec.Meta(min_length=1)]
    mean: Share
    seed_interval: Interval | None
    interval: Interval
    by_plan: Share
    train: Share | None
    mrr: Share | None
    mrr_range: Interval | None
    comparison: Comparison | None
    reached: Count | None
    reached_interval: tuple[Count | None, Count | None] | None
    curve: tuple[CurvePoint, ...]
    runs: tuple[str, ...]
    seconds: float
    steps: Count


class PointFigures(Record):
    """Results for all variants at a grid point, with ``title`` in words; usually the runs share a single graph."""

    values: Values
    title: str
    graphs: tuple[PlayedGraph, ...]
    tasks: Count
    distractor_seeds: Count
    variants: tuple[VariantFigures, ...]


def figures_of(
    results: StudyResults, variant: str, members: list[RunResult], base: list[RunResult]
) -> VariantFigures:
    """Summarise the runs ``members`` of a variant, and compare with the runs ``base`` of the reference variant."""
    success = [run.success["test"] for run in members]
    train = [run.success["train"] for run in members if "train" in run.success]
    mrr = [run.mrr for run in members if run.mrr is not None]
    reached, reached_interval = _reached(members, base)
    return VariantFigures(
        variant=variant,
        seeds=tuple(run.seed for run in members),
        success=tuple(success),
        mean=mean_of(success),
        seed_interval=student_interval(success),
        interval=rate_interval(_table(members), results.groups_of(members[0])),
        by_plan=mean_of([run.by_plan["test"] for run in members]),
        train=mean_of(train) if len(train) == len(members) else None,
        mrr=mean_of(mrr) if mrr else None,
        mrr_range=(min(mrr), max(mrr)) if mrr else None,
        comparison=_comparison(results, members, base),
        reached=reached,
        reached_interval=reached_interval,
        curve=_curve(members),
        runs=tuple(run.run for run in members),
        seconds=mean_of([run.seconds for run in members]),
        steps=members[0].steps,
    )


def mean_of(values: Sequence[float]) -> float:
    """Return the mean, exactly rounded."""
    return math.fsum(values) / len(values)


def _table(members: Sequence[RunResult]) -> NDArray[np.float64]:
    return np.array([run.rates for run in members])


def _comparison(
    results: StudyResults, members: list[RunResult], base: list[RunResult]
) -> Comparison | None:
    by_seed = {run.seed: run for run in base}
    pairs = [(run, by_seed[run.seed]) for run in members if run.seed in by_seed]
    if members is base or not pairs or results.tasks_of(members[0]) != results.tasks_of(base[0]):
        return None
    differences = _table([run for run, _ in pairs]) - _table([run for _, run in pairs])
    (difference, *ends), exact = crossed_difference(differences, results.groups_of(base[0]))
    p_value = exact if len(pairs) >= FEWEST_PAIRS else None
    return Comparison(difference, (ends[0], ends[1]), len(pairs), p_value, p_corrected=p_value)


def _curves(members: Sequence[RunResult]) -> tuple[list[int], NDArray[np.float64]]:
    rows = [dict(run.curve) for run in members]
    steps = sorted(set.intersection(*map(set, rows)))
    return steps, np.array([[row[step] for step in steps] for row in rows])


def _curve(members: Sequence[RunResult]) -> tuple[CurvePoint, ...]:
    steps, table = _curves(members)
    if not steps:
        return ()
    return tuple(
        CurvePoint(step, float(column.mean()), *(student_interval(column) or (None, None)))
        for step, column in zip(steps, table.T, strict=True)
    )


def _reached(
    members: list[RunResult], base: list[RunResult]
) -> tuple[int | None, tuple[int | None, int | None] | None]:
    if not base:
        return None, None
    steps, table = _curves(members)
    goal_steps, goal = _curves(base)
    if not steps or not goal_steps:
        return None, None

    def first(curve: NDArray[np.float64]) -> int | None:
        reached = steps_to(zip(steps, curve, strict=True), -_ROUNDING)
        return round(reached) if math.isfinite(reached) else None

    ends = {run.seed: end for run, end in zip(base, goal[:, -1], strict=True)}
    ahead = np.array(
        [row - ends[run.seed] for run, row in zip(members, table, strict=True) if run.seed in ends]
    )
    reached = first(table.mean(axis=0) - goal[:, -1].mean())
    if len(ahead) < 2:
        return reached, None
    bounds = np.array([student_interval(column, within=(-1, 1)) for column in ahead.T])
    return reached, (first(bounds[:, 1]), first(bounds[:, 0]))


_EVERYTHING: Values = {"train_fraction": 1, "label_noise": 0}
"""Settings for a scorer trained on all recipes without noise."""


class Correlation(Record, array_like=True):
    """A correlation coefficient, with its 95 % interval over the points."""

    value: float
    low: float
    high: float


class ScatterPoint(Record):
    """Success of an agent (a variant of the study) and MRR of its scorer, as in :class:`VariantFigures`."""

    label: str
    variant: str
    mrr: Share
    mrr_range: Interval
    success: Share
    interval: Interval
    reached: Count | None


class ScorerScatter(Record):
    """Agents' success against their scorers' MRR, with all further settings (``values``) equal.

    Attributes:
        in_sample: whether train tasks have scores from a scorer trained on the same recipes.
        points: a point for each agent and scorer setting, by ascending MRR; correlations need three.
        steps_spearman: rank correlation of MRR and the steps to the reference's success; "not reached" is latest.
        without: success of the reference agent, if it has no scorer.
    """

    values: Values
    in_sample: bool
    points: tuple[ScatterPoint, ...]
    pearson: Correlation | None
    spearman: Correlation | None
    steps_spearman: Correlation | None
    without: Share | None


def scatters_of(
    results: StudyResults, points: Sequence[PointFigures], reference: str
) -> Iterator[ScorerScatter]:
    """Yield a plot for each combination of settings other than the scorer's, with in-sample scores apart."""
    groups: dict[bytes, list[tuple[PointFigures, VariantFigures]]] = {}
    for point in points:
        for entry in point.variants:
            if entry.mrr is not None:
                key = msgspec.json.encode(
                    (_others(point), _is_in_sample(results, point, entry)), order="sorted"
                )
                groups.setdefault(key, []).append((point, entry))
    for members in groups.values():
        rows = [_scatter_point(point, entry) for point, entry in members]
        bare = [
            at.mean
            for point, _ in members
            for at in point.variants
            if at.variant == reference and at.mrr is None
        ]
        mrr, success = [at.mrr for at in rows], [at.success for at in rows]
        latest = 1 + max(at.reached or 0 for at in rows)
        yield ScorerScatter(
            values=_others(members[0][0]),
            in_sample=_is_in_sample(results, *members[0]),
            points=tuple(sorted(rows, key=lambda at: (at.mrr, at.label))),
            pearson=_correlation(mrr, success, "pearson"),
            spearman=_correlation(mrr, success, "spearman"),
            steps_spearman=_correlation(
                mrr, [latest if at.reached is None else at.reached for at in rows], "spearman"
            ),
            without=mean_of(bare) if bare else None,
        )


def _others(point: PointFigures) -> Values:
    return {
        name: value for name, value in point.values.items() if not name.startswith(f"{SCORER}.")
    }


def _is_in_sample(results: StudyResults, point: PointFigures, entry: VariantFigures) -> bool:
    settings = {
        **results.study.settings,
        **point.values,
        **results.study.variants.get(entry.variant, {}),
    }
    return settings.get("in_sample") is True


def _scatter_point(point: PointFigures, at: VariantFigures) -> ScatterPoint:
    assert at.mrr is not None
    assert at.mrr_range is not None
    return ScatterPoint(
        _label(point, at.variant),
        at.variant,
        at.mrr,
        at.mrr_range,
        at.mean,
        at.interval,
        at.reached,
    )


def _correlation(
    x: Sequence[float], y: Sequence[float], kind: Literal["pearson", "spearman"]
) -> Correlation | None:
    estimate = correlation(x, y, kind)
    return Correlation(*estimate) if estimate else None


def _label(point: PointFigures, variant: str) -> str:
    prefix = f"{SCORER}."
    values = {
        name.removeprefix(prefix): value
        for name, value in point.values.items()
        if name.startswith(prefix)
    }
    differing = {name: value for name, value in values.items() if value != _EVERYTHING.get(name)}
    named = differing or dict(list(values.items())[:1])
    shown = [
        f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in named.items()
    ]
    return ", ".join(shown) or variant
