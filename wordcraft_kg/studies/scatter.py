"""Success of agents against the MRR of their scorers, with all further settings equal."""

from collections.abc import Iterator, Sequence
from typing import Literal

import msgspec

from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.base.statistics import correlation
from wordcraft_kg.studies.results import StudyResults
from wordcraft_kg.studies.study import SCORER, Values
from wordcraft_kg.studies.variants import Interval, PointFigures, VariantFigures, mean_of

_EVERYTHING: Values = {"train_fraction": 1, "label_noise": 0}
"""Settings for a scorer trained on all recipes without noise."""


class Correlation(Record, array_like=True):
    """A correlation coefficient, with the 95 % interval by resampling the points."""

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


def scatters_of(results: StudyResults, points: Sequence[PointFigures], reference: str) -> Iterator[ScorerScatter]:
    """Yield a plot for each combination of settings other than the scorer's, with in-sample scores apart.

    ``points`` has the figures of ``results`` at each grid point, ``reference`` is a variant.
    """
    groups: dict[bytes, list[tuple[PointFigures, VariantFigures]]] = {}
    for point in points:
        for entry in point.variants:
            if entry.mrr is not None:
                key = msgspec.json.encode((_others(point), _is_in_sample(results, point, entry)), order="sorted")
                groups.setdefault(key, []).append((point, entry))
    for members in groups.values():
        rows = [_scatter_point(point, entry) for point, entry in members]
        bare = [at.mean for point, _ in members for at in point.variants if at.variant == reference and at.mrr is None]
        mrr, success = [at.mrr for at in rows], [at.success for at in rows]
        yield ScorerScatter(
            values=_others(members[0][0]),
            in_sample=_is_in_sample(results, *members[0]),
            points=tuple(sorted(rows, key=lambda at: (at.mrr, at.label))),
            pearson=_correlation(mrr, success, "pearson"),
            spearman=_correlation(mrr, success, "spearman"),
            steps_spearman=_correlation(mrr, _latest_if_never(rows), "spearman"),
            without=mean_of(bare) if bare else None,
        )


def _latest_if_never(rows: Sequence[ScatterPoint]) -> list[int]:
    latest = 1 + max(at.reached or 0 for at in rows)
    return [latest if at.reached is None else at.reached for at in rows]


def _others(point: PointFigures) -> Values:
    return {name: value for name, value in point.values.items() if not name.startswith(f"{SCORER}.")}


def _is_in_sample(results: StudyResults, point: PointFigures, entry: VariantFigures) -> bool:
    settings = {**results.study.settings, **point.values, **results.study.variants.get(entry.variant, {})}
    return settings.get("in_sample") is True


def _scatter_point(point: PointFigures, at: VariantFigures) -> ScatterPoint:
    assert at.mrr is not None
    assert at.mrr_range is not None
    return ScatterPoint(_label(point, at.variant), at.variant, at.mrr, at.mrr_range, at.mean, at.interval, at.reached)


def _correlation(x: Sequence[float], y: Sequence[float], kind: Literal["pearson", "spearman"]) -> Correlation | None:
    estimate = correlation(x, y, kind)
    return Correlation(*estimate) if estimate else None


def _label(point: PointFigures, variant: str) -> str:
    prefix = f"{SCORER}."
    values = {name.removeprefix(prefix): value for name, value in point.values.items() if name.startswith(prefix)}
    differing = {name: value for name, value in values.items() if value != _EVERYTHING.get(name)}
    named = differing or dict(list(values.items())[:1])
    shown = [f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}" for name, value in named.items()]
    return ", ".join(shown) or variant
