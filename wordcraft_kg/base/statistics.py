"""Confidence intervals for success rates, and statistics that compare agents trained with several seeds.

Intervals have a confidence of 95 % unless stated otherwise; ``draws`` is the number of resamples, and ``seed`` fixes
the resampling. Every function raises a ConfigError for scores that are empty, not finite or misshapen.
"""

import math
from collections.abc import Callable, Sequence
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
_LEVEL = 0.95
_Z = NormalDist().inv_cdf((1 + _LEVEL) / 2)


def bootstrap(
    values: Scores, clusters: NDArray[np.int64], *, resamples: int = RESAMPLES, seed: int = 0
) -> Scores:
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
        raise ConfigError(
            f"{name}: expected a table of numbers with rows of the same length."
        ) from None
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
    if deviation <= 1e-12 * np.abs(different).max(
        initial=0
    ):  # equal up to rounding, which must not be amplified
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
        raise ConfigError(
            f"{successes} successes of {n}: expected at least one trial, and 0 to {n} successes."
        )
    middle = successes + _Z**2 / 2
    half = _Z * math.sqrt(successes * (n - successes) / n + _Z**2 / 4)
    # The bounds at k = 0 and k = n are exact; rounding must not change these bounds.
    low = (middle - half) / (n + _Z**2) if successes else 0.0
    high = (middle + half) / (n + _Z**2) if successes < n else 1.0
    return low, high


def task_bootstrap(
    successes: ArrayLike, *, draws: int = RESAMPLES, seed: int = 0
) -> tuple[float, float]:
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
        raise ConfigError(
            f"successes: {wrong[0]:g} is neither 0 nor 1; expected single attempts, not rates."
        )
    totals, tasks = np.unique(table.sum(axis=1), return_counts=True)
    n, attempts = table.shape
    if len(totals) == 1:
        return wilson_interval(n * float(totals[0]) / attempts, n)
    return interval(rng.multinomial(n, tasks / n, size=draws) @ totals / (n * attempts))


def paired_difference(
    x: ArrayLike, y: ArrayLike, *, draws: int = RESAMPLES, seed: int = 0
) -> Interval:
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


def rate_interval(scores: ArrayLike) -> tuple[float, float]:
    """Return the interval for a mean success rate over seeds and tasks; ``scores`` has shape (S seeds, K tasks).

    Wilson's interval with the half-width h of :func:`crossed_difference` at the rate p: with ``q = h² / p (1 - p)`` the
    bounds are ``(p + q/2 ± sqrt(q p (1 - p) + q²/4)) / (1 + q)``, within 0 and 1 and skewed near them. If all tasks
    have the same rate, q grows by ``z² / K``. A single seed shows no variation between seeds: the interval then covers
    tasks only.

    Source: Wilson 1927, with the variance of two random effects in place of the binomial one.
    """
    table = by_task("scores", scores, "(seeds, tasks)")
    rate, spread = float(table.mean()), float(table.mean() * (1 - table.mean()))
    q = (_half_width(table)(1 - _LEVEL) ** 2 / spread if spread else 0.0) + _Z**2 * _floor(table)
    half = math.sqrt(q * spread + q**2 / 4)
    return max((rate + q / 2 - half) / (1 + q), 0.0), min((rate + q / 2 + half) / (1 + q), 1.0)


def crossed_difference(scores: ArrayLike) -> tuple[Interval, float]:
    """Return a mean difference between two agents over seeds and tasks, its interval, and the p-value of "none".

    ``scores``, shape (S seeds, K tasks), are differences of rates, paired by seed and task. With the mean squares of
    seeds, tasks and rest of the two-way table, ``h² = (t²_(S-1) max(MS_seeds - MS_rest, 0) + z² MS_tasks) / (S K)``:
    the few seeds get Student's t, tasks the normal quantile. The p-value is the level at which the interval reaches 0.
    If all tasks have the same difference, their part is ``z² / K`` in place of 0, as for a rate of 0 or 1. One task
    leaves the part of the seeds. ``benchmarks/interval_coverage.py`` simulates the coverage.

    Source: Howe 1974, "Approximate confidence limits on the mean of X + Y where X and Y are two tabled independent
    random variables".
    """
    from scipy.special import ndtri

    table, least = by_task("scores", scores, "(seeds, tasks)"), 1e-100
    value, varied = float(table.mean()), _half_width(table)
    floor = _floor(table) if table.shape[1] > 1 else 0.0

    def half_width(p: float) -> float:
        return math.hypot(varied(p), floor * ndtri(p / 2) ** 2)

    if half_width(least) <= abs(value):
        p_value = 0.0 if value else 1.0
    else:
        from scipy.optimize import brentq

        p_value = float(brentq(lambda p: half_width(p) - abs(value), least, 1.0))
    half = half_width(1 - _LEVEL)
    return (value, max(value - half, -1.0), min(value + half, 1.0)), p_value


def _floor(table: Scores) -> float:
    """Return 1 / K if the K tasks have the same mean, which does not say that all tasks are alike; else 0."""
    return 1 / table.shape[1] if np.ptp(table.mean(axis=0)) < 1e-9 else 0.0  # up to rounding


def _half_width(table: Scores) -> Callable[[float], float]:
    """Return the half-width of a mean's interval as a function of 1 - confidence."""
    from scipy.special import ndtri, stdtrit

    size, number = table.shape
    by_seed, by_column = table.mean(axis=1), table.mean(axis=0)
    of_tasks = by_column.var(ddof=1) / number if number > 1 else 0.0
    of_seeds = 0.0
    if size > 1:
        rest = table - by_seed[:, None] - by_column + table.mean()
        noise = (rest**2).sum() / max((size - 1) * (number - 1), 1) / table.size
        of_seeds = max(by_seed.var(ddof=1) / size - noise, 0.0)
    ends = math.sqrt(of_seeds), math.sqrt(of_tasks)
    return lambda p: math.hypot(ends[0] * stdtrit(max(size - 1, 1), p / 2), ends[1] * ndtri(p / 2))


# --- several seeds ---------------------------------------------------------------------------------------------------


FEWEST_PAIRS = 3
"""Fewest seeds for a p-value and a firm verdict: two seeds say little about variation between seeds."""


def student_interval(
    scores: ArrayLike, *, within: tuple[float, float] = (0.0, 1.0)
) -> tuple[float, float] | None:
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


# --- comparisons and correlations ------------------------------------------------------------------------------------


_FEWEST = 3  # points: any two lie on a line
_CERTAIN = 1 - 1e-12  # artanh of 1 is infinite


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
    x: ArrayLike, y: ArrayLike, kind: Literal["pearson", "spearman"] = "pearson"
) -> Interval | None:
    """Compute the correlation of paired values x and y, both of shape (N,), and its interval.

    Pearson's correlation measures how near the points (x_i, y_i) are to a line. Spearman's is Pearson's correlation of
    the ranks (ties share their mean rank). The interval is ``tanh(artanh r ± z sqrt(c / (N - 3)))``, with c = 1 for
    Pearson's and ``1 + r²/2`` for Spearman's correlation; of 3 points it is -1 to 1.

    The result is None for fewer than 3 points, or if all x or all y are equal.

    Source: Fisher 1921; Bonett and Wright 2000, "Sample size requirements for estimating Pearson, Kendall and Spearman
    correlations".
    """
    one_of("kind", kind, ("pearson", "spearman"))
    a, b = finite("x", x), finite("y", y)
    if a.ndim != 1 or a.shape != b.shape:
        raise ConfigError(
            f"x of shape {a.shape} and y of shape {b.shape}: expected one number for each cell."
        )
    if len(a) < _FEWEST or np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    if kind == "spearman":
        from scipy.stats import rankdata

        a, b = rankdata(a), rankdata(b)
    value = float(np.clip(np.corrcoef(a, b)[0, 1], -1, 1))
    variance = (
        (1 + value**2 / 2 if kind == "spearman" else 1) / (len(a) - 3)
        if len(a) > _FEWEST
        else math.inf
    )
    middle = math.atanh(min(max(value, -_CERTAIN), _CERTAIN))
    return (
        value,
        math.tanh(middle - _Z * math.sqrt(variance)),
        math.tanh(middle + _Z * math.sqrt(variance)),
    )
