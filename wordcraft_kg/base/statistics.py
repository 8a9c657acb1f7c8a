"""Confidence intervals for success rates, and statistics that compare agents trained with several seeds.

Intervals have a confidence of 95 % unless stated otherwise; ``draws`` is the number of resamples, and ``seed`` fixes
the resampling. Every function raises a ConfigError for scores that are empty, not finite or misshapen.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.progress import steps
from wordcraft_kg.base.settings import one_of

Interval = tuple[float, float, float]
"""An estimate and its interval: value, lower bound, upper bound."""
Scores = NDArray[np.float64]
RESAMPLES = 2_000
"""Bootstrap resamples, and with seed 0 the same everywhere: a metric has the same interval in every report."""
CHUNK = 2**20  # values held at once while resampling, 8 MB
_LEVEL = 0.95
_Z = NormalDist().inv_cdf((1 + _LEVEL) / 2)


def bootstrap(values: Scores, clusters: NDArray[np.int64], *, resamples: int = RESAMPLES, seed: int = 0) -> Scores:
    """Return bootstrap means of ``values``, shape (resamples,), resampling whole clusters (such as a recipe's queries).

    ``values`` and ``clusters``, the cluster id of each value, have shape (N,).
    """
    names, index = np.unique(clusters, return_inverse=True)
    sums = np.bincount(index, weights=values)
    sizes = np.bincount(index).astype(float)
    rng = np.random.default_rng(seed)
    means = np.empty(resamples)
    for i in steps("resampling", range(resamples)):
        drawn = np.bincount(rng.integers(len(names), size=len(names)), minlength=len(names))
        means[i] = (drawn @ sums) / (drawn @ sizes)
    return means


def interval(means: Scores, level: float = _LEVEL) -> tuple[float, float]:
    """Return the percentile interval (lower and upper bound) at confidence ``level`` from bootstrap means."""
    low, high = np.quantile(means, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def finite(name: str, values: ArrayLike) -> Scores:
    """Return values as a float array; raise a ConfigError for an empty table, NaN or infinity."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ConfigError(f"{name}: expected a table of numbers with rows of the same length.") from None
    if not array.size:
        raise ConfigError(f"{name} of shape {array.shape}: expected at least one value.")
    if not np.isfinite(array).all():
        place = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ConfigError(f"{name}{place}: {array[tuple(place)]}, expected finite numbers only.")
    return array


def by_task(name: str, values: ArrayLike, axes: str) -> Scores:
    """Return scores as an array with two axes; otherwise a ConfigError names the input and the expected axes."""
    array = finite(name, values)
    if array.ndim != 2:
        raise ConfigError(f"{name} of shape {array.shape}: expected {axes}.")
    return array


def standardised(table: NDArray[np.floating], among: NDArray[np.integer] | None = None) -> Scores:
    """Return scores, shape (E, E), scaled to mean 0 and standard deviation 1 over pairs of different entities.

    Self scores (the diagonal) are scaled too but do not count for mean and deviation, because they are often outliers.
    With ``among`` (entity ids), only pairs of these entities count.
    """
    scores = np.asarray(table, dtype=np.float64)
    counted = scores if among is None else scores[np.ix_(among, among)]
    different = counted[~np.eye(len(counted), dtype=bool)]
    deviation = different.std()
    if deviation <= 1e-12 * np.abs(different).max(initial=0):  # equal up to rounding, which must not be amplified
        deviation = 1.0
    return np.asarray((scores - different.mean()) / deviation)


# --- success rates over tasks ----------------------------------------------------------------------------------------


def wilson_interval(successes: float, n: int) -> tuple[float, float]:
    """Return Wilson's score interval for a success probability: lower and upper bound.

    The interval contains the probabilities p that a two-sided normal test does not reject,
    ``|k/n - p| <= z * sqrt(p (1 - p) / n)``: ``(k + z²/2 ± z * sqrt(k (n - k) / n + z²/4)) / (n + z²)``. The bounds
    stay within 0 and 1, and the width is positive even for k = 0 and k = n.

    ``successes`` is k, from 0 to ``n``; a sum of rates need not be whole. ``n`` counts independent trials, from 1.

    Source: Wilson 1927, "Probable inference, the law of succession, and statistical inference".
    """
    if not 0 <= successes <= n or n < 1:
        raise ConfigError(f"{successes} successes of {n}: expected at least one trial, and 0 to {n} successes.")
    middle = successes + _Z**2 / 2
    half = _Z * math.sqrt(successes * (n - successes) / n + _Z**2 / 4)
    # The bounds at k = 0 and k = n are exact; rounding must not change these bounds.
    low = (middle - half) / (n + _Z**2) if successes else 0.0
    high = (middle + half) / (n + _Z**2) if successes < n else 1.0
    return low, high


def task_bootstrap(successes: ArrayLike, *, draws: int = RESAMPLES, seed: int = 0) -> tuple[float, float]:
    """Return a bootstrap interval for a mean success rate; ``successes`` has shape (N tasks, D attempts), 0 and 1.

    Attempts at one task are correlated, so whole tasks are resampled (cluster bootstrap): with a task's rate
    ``m_i = sum_d s_id / D``, the bounds are quantiles of ``1/N sum_i m_(r_i)``, r_i uniform over 1..N. How often each
    distinct rate is drawn is multinomial, so a draw's cost grows with the distinct rates, not the tasks.

    If all tasks have the same rate, resampling shows no variation; Wilson's interval for N trials is used instead.

    Source: Davison and Hinkley 1997, "Bootstrap methods and their application", section 3.8; Wilson 1927.
    """
    rng = np.random.default_rng(seed)
    table = by_task("successes", successes, "(tasks, attempts)")
    wrong = table[(table != 0) & (table != 1)]
    if wrong.size:
        raise ConfigError(f"successes: {wrong[0]:g} is neither 0 nor 1; expected single attempts, not rates.")
    totals, tasks = np.unique(table.sum(axis=1), return_counts=True)
    n, attempts = table.shape
    if len(totals) == 1:
        return wilson_interval(n * float(totals[0]) / attempts, n)
    return interval(rng.multinomial(n, tasks / n, size=draws) @ totals / (n * attempts))


def paired_difference(x: ArrayLike, y: ArrayLike, *, draws: int = RESAMPLES, seed: int = 0) -> Interval:
    """Return the mean difference between two players' success on the same tasks, and its bootstrap interval.

    With the rates ``a_i`` and ``b_i`` on task i, the difference is ``mean_i (a_i - b_i)``. Tasks are resampled in
    pairs, so a task that is hard for both players does not widen the interval.

    ``x`` and ``y`` are the players' successes, 0 and 1, shapes (N tasks, D attempts) and (N tasks, D' attempts).

    Source: Efron and Tibshirani 1993, "An introduction to the bootstrap", chapter 13.
    """
    rng, a, b = np.random.default_rng(seed), finite("x", x), finite("y", y)
    if a.ndim != 2 or b.ndim != 2 or len(a) != len(b):
        raise ConfigError(
            f"x of shape {a.shape} and y of shape {b.shape}: expected (tasks, attempts) of the same tasks."
        )
    values, tasks = np.unique(a.mean(axis=1) - b.mean(axis=1), return_counts=True)
    means = rng.multinomial(len(a), tasks / len(a), size=draws) @ values / len(a)
    return float(values @ tasks / len(a)), *interval(means)


def crossed_bootstrap(scores: ArrayLike, *, draws: int = RESAMPLES, seed: int = 0) -> tuple[float, float]:
    """Return the interval of a mean over seeds and tasks, ``scores`` of shape (S seeds, K tasks), resampling both.

    Every run plays the same tasks, so rows and columns are resampled whole and independently:
    ``m* = 1/(S K) sum_i sum_k s_(r_i)(c_k)``, r_i uniform over 1..S and c_k over 1..K. For scores that are differences
    between two agents, seed by seed and task by task, this is the interval of the mean difference.

    A single seed cannot be resampled: the interval then covers tasks only. With few seeds their contribution is too
    narrow, as in every bootstrap over few seeds. Equal scores have zero width.

    Source: Owen 2007, "The pigeonhole bootstrap".
    """
    rng = np.random.default_rng(seed)
    table = by_task("scores", scores, "(seeds, tasks)")
    size, number = table.shape
    means = np.empty(draws)
    chunk = max(1, CHUNK // number)
    for start in range(0, draws, chunk):
        count = min(chunk, draws - start)
        by_column = rng.multinomial(size, np.full(size, 1 / size), size=count) @ table
        drawn = np.take_along_axis(by_column, rng.integers(number, size=(count, number)), 1)
        means[start : start + count] = drawn.sum(1)
    return interval(means / (size * number))


# --- several seeds ---------------------------------------------------------------------------------------------------


FEWEST_PAIRS = 3
"""Fewest seeds for a p-value: two seeds say nothing about variation between seeds."""


def student_interval(scores: ArrayLike, *, within: tuple[float, float] = (0.0, 1.0)) -> tuple[float, float] | None:
    """Return Student's t interval for the mean score over seeds, shape (S,); None for a single seed.

    ``mean ± t_(S-1) s / sqrt(S)``, with the scores' sample deviation s, cut to the possible values ``within``. A
    bootstrap fails for few seeds: resampling 3 seeds gives [minimum, maximum], which covers the true mean with
    probability .68 instead of .95, and with 2 seeds .48.

    Source: Student 1908, "The probable error of a mean".
    """
    from scipy.stats import t

    values = finite("scores", scores).ravel()
    if len(values) == 1:
        return None
    mean, (lowest, highest) = float(values.mean()), within
    half = float(t.ppf((1 + _LEVEL) / 2, len(values) - 1) * values.std(ddof=1) / len(values) ** 0.5)
    return max(mean - half, lowest), min(mean + half, highest)


def resampled_means(scores: ArrayLike, *, draws: int = RESAMPLES, seed: int = 0) -> Scores:
    """Return bootstrap means over runs, shape (draws, K), for scores with shape (S runs, K), such as learning curves.

    Whole rows (runs) are drawn with replacement, so a run's K values stay together.
    """
    rng = np.random.default_rng(seed)
    table = by_task("scores", scores, "(runs, values)")
    size = len(table)
    return np.asarray(rng.multinomial(size, np.full(size, 1 / size), size=draws) @ table / size)


# --- comparisons and correlations ------------------------------------------------------------------------------------


_FEWEST = 3  # points: any two lie on a line


def interval_p_value(value: float, interval: tuple[float, float]) -> float:
    """Compute the two-sided p-value for "the true value is 0" from an estimate and its 95 % interval.

    An interval is ``2 z`` standard errors wide, so ``p = 2 (1 - Phi(|value| / (width / 2 z)))``. For a bootstrap
    interval this is Wald's test with the bootstrap's standard error: about .05 where a 95 % interval just reaches 0,
    and too small where the interval is too narrow, as with few seeds. An exact test over runs would not help: with 5
    seeds its p-value is at least .0079, which any correction for a dozen comparisons lifts above .05.

    Source: Efron and Tibshirani 1993, "An introduction to the bootstrap", section 12.
    """
    error = (interval[1] - interval[0]) / (2 * _Z)
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
    draws: int = RESAMPLES,
    seed: int = 0,
) -> Interval | None:
    """Compute the correlation of paired values x and y, both of shape (N,), and a bootstrap interval.

    Pearson's correlation measures how near the points (x_i, y_i) are to a line. Spearman's is Pearson's correlation of
    the ranks (ties share their mean rank). Whole points are resampled; a resample with all x or all y equal is dropped.
    Below about ten points the interval is rough.

    The result is None for fewer than 3 points, or if all x or all y are equal.

    Source: Efron and Tibshirani 1993, "An introduction to the bootstrap", section 6.5.
    """
    rng = np.random.default_rng(seed)
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
    return float(values[0]), *interval(values[1:] if len(values) > 1 else values)


def _pearson(x: Scores, y: Scores) -> Scores:
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    products = (x * y).sum(axis=1) / np.sqrt((x**2).sum(axis=1) * (y**2).sum(axis=1))
    return np.asarray(np.clip(products, -1, 1))
