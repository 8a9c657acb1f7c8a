"""P-values, their correction for multiple tests, and correlations."""

from collections.abc import Sequence
from statistics import NormalDist
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import one_of
from wordcraft_kg.base.statistics.samples import RESAMPLES, Interval, Scores, check_level, finite, generator, interval

_FEWEST = 3  # points: any two lie on a line


def interval_p_value(value: float, interval: tuple[float, float], *, level: float = 0.95) -> float:
    """Compute the two-sided p-value for "the true value is 0" from an estimate and its interval.

    An interval is ``2 z`` standard errors wide, so ``p = 2 (1 - Phi(|value| / (width / 2 z)))``. For a bootstrap
    interval this is Wald's test with the bootstrap's standard error: about .05 where a 95 % interval just reaches 0,
    and too small where the interval is too narrow, as with few seeds. An exact test over runs would not help: with 5
    seeds its p-value is at least .0079, which any correction for a dozen comparisons lifts above .05.

    Source: Efron and Tibshirani 1993, "An introduction to the bootstrap", section 12.
    """
    check_level(level)
    z = NormalDist().inv_cdf((1 + level) / 2)
    error = (interval[1] - interval[0]) / (2 * z)
    if error == 0:
        return 1.0 if value == 0 else 0.0
    return 2 * NormalDist().cdf(-abs(value) / error)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for multiple tests by Holm's method, which controls the family-wise error rate.

    With the m values in ascending order, ``p'_(i) = max_(j <= i) min(1, (m - j + 1) p_(j))``. Rejecting below .05 errs
    anywhere in at most 5 % of all studies, under any dependence between the comparisons; Holm's method never rejects
    less than Bonferroni's correction.

    Source: Holm 1979, "A simple sequentially rejective multiple test procedure".
    """
    for value in p_values:
        if not 0 <= value <= 1:
            raise ConfigError(f"p-value {value}: expected a number from 0 to 1.")
    corrected, highest = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        highest = max(highest, min(1.0, (len(p_values) - rank) * p_values[i]))
        corrected[i] = highest
    return corrected


def correlation(
    x: ArrayLike,
    y: ArrayLike,
    kind: Literal["pearson", "spearman"] = "pearson",
    *,
    level: float = 0.95,
    draws: int = RESAMPLES,
    seed: int = 0,
) -> Interval | None:
    """Compute the correlation of paired values x and y, both of shape (N,), and a bootstrap interval.

    Pearson's correlation measures how near the points (x_i, y_i) are to a line. Spearman's is Pearson's correlation of
    the ranks (ties share their mean rank). Whole points are resampled; a resample with all x or all y equal is dropped.
    Below about ten points the interval is rough.

    Returns:
        Correlation, lower and upper bound; None for fewer than 3 points, or if all x or all y are equal.

    Source: Efron and Tibshirani 1993, "An introduction to the bootstrap", section 6.5.
    """
    draws, rng = generator(level, draws, seed)
    one_of("kind", kind, ("pearson", "spearman"))
    a, b = finite("x", x), finite("y", y)
    if a.ndim != 1 or a.shape != b.shape:
        raise ConfigError(f"x of shape {a.shape} and y of shape {b.shape}: expected one number for each cell.")
    if len(a) < _FEWEST or np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    rows = np.vstack([np.arange(len(a)), rng.integers(len(a), size=(draws, len(a)))])
    drawn_a, drawn_b = a[rows], b[rows]
    if kind == "spearman":
        from scipy.stats import rankdata

        drawn_a, drawn_b = rankdata(drawn_a, axis=1), rankdata(drawn_b, axis=1)
    varied = (np.ptp(drawn_a, axis=1) > 0) & (np.ptp(drawn_b, axis=1) > 0)
    values = _pearson(drawn_a[varied], drawn_b[varied])
    return float(values[0]), *interval(values[1:] if len(values) > 1 else values, level)


def _pearson(x: Scores, y: Scores) -> Scores:
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    products = (x * y).sum(axis=1) / np.sqrt((x**2).sum(axis=1) * (y**2).sum(axis=1))
    return np.asarray(np.clip(products, -1, 1))
