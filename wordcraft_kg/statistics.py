"""Confidence intervals of success rates, and statistics that compare agents trained with several seeds."""

import math
from collections.abc import Callable
from statistics import NormalDist
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wordcraft_kg.errors import ConfigError
from wordcraft_kg.progress import steps
from wordcraft_kg.settings import MAX_SIZE, refuse, whole

Interval = tuple[float, float, float]
"""A value, its lower and its upper bound."""
Scores = NDArray[np.float64]
# Values held at once while resampling: 8 MB of them, whatever the number of draws.
CHUNK = 2**20


def wilson_interval(successes: float, n: int, level: float = 0.95) -> tuple[float, float]:
    """Return the score interval of a success probability.

    The probabilities p that a two-sided normal test does not reject, ``|k/n - p| <= z * sqrt(p (1 - p) / n)``:
    ``(k + z²/2 ± z * sqrt(k (n - k) / n + z²/4)) / (n + z²)``. It stays within 0 and 1, and its width is not zero
    even for k = 0 and k = n.

    Args:
        successes: k, from 0 to ``n``; not whole where it is a sum of rates.
        n: number of independent trials, from 1.
        level: of confidence, between 0 and 1.

    Raises:
        ConfigError: for a value out of range.

    Source: Wilson 1927, "Probable inference, the law of succession, and statistical inference".
    """
    if not 0 <= successes <= n or n < 1:
        raise ConfigError(f"{successes} successes of {n}: expected at least one trial, and 0 to {n} successes.")
    _check_level(level)
    z = NormalDist().inv_cdf((1 + level) / 2)
    middle = successes + z**2 / 2
    half = z * math.sqrt(successes * (n - successes) / n + z**2 / 4)
    # The bounds at k = 0 and k = n are exact; rounding must not move them.
    low = (middle - half) / (n + z**2) if successes else 0.0
    high = (middle + half) / (n + z**2) if successes < n else 1.0
    return low, high


@overload
def interquartile_mean(scores: ArrayLike) -> float: ...
@overload
def interquartile_mean(scores: ArrayLike, axis: tuple[int, ...]) -> Scores: ...
def interquartile_mean(scores: ArrayLike, axis: tuple[int, ...] | None = None) -> float | Scores:
    """Return the mean of the middle half of all scores, runs and tasks together.

    With the n scores in ascending order and ``g = floor(n / 4)``: ``IQM = sum(s_(g+1), ..., s_(n-g)) / (n - 2 g)``. For
    n not divisible by 4 that keeps a little more than half (the 25 % trimmed mean; no score is counted partially), and
    for n up to 3 it is the plain mean.

    Args:
        scores: of any shape, usually (S seeds, K tasks).
        axis: axes to average over, all of them by default.

    Raises:
        ConfigError: if there is no score, or one is not finite.

    Source: Agarwal et al. 2021, "Deep reinforcement learning at the edge of the statistical precipice", section 4.3.
    """
    values = _finite("scores", scores)
    if axis is not None:
        values = np.moveaxis(values, axis, range(-len(axis), 0))
        values = values.reshape(*values.shape[: -len(axis)], -1)
    else:
        values = values.ravel()
    cut = values.shape[-1] // 4
    means = np.sort(values, axis=-1)[..., cut : values.shape[-1] - cut].mean(axis=-1)
    return float(means) if axis is None else means


def stratified_bootstrap(
    scores: ArrayLike, statistic: Callable[..., Any], *, level: float = 0.95, draws: int = 2000, seed: int = 0
) -> tuple[float, float] | None:
    """Return the percentile interval of a statistic, resampling seeds within each stratum.

    A draw replaces each column by as many of its own scores, drawn with replacement and independently of the other
    columns: ``s*_ik = s_(r_ik)k`` with ``r_ik`` uniform over 1..S. The bounds are the ``(1 - level) / 2`` and
    ``(1 + level) / 2`` quantiles of the statistic over the draws. With a single stratum it is the plain bootstrap.

    The interval covers the variation from seed to seed, not that from task to task. With few seeds and one stratum it
    is too narrow: the mean of 5 normal scores lies within its "95 %" in about 84 % of all cases. Its width is
    zero where all seeds of a stratum agree.

    Args:
        scores: shape (S seeds, K strata), or (S,) for one stratum. Strata are kinds of tasks, such as depths.
        statistic: reduces the axes that its keyword ``axis`` names, such as ``np.mean``, ``np.median``, or
            :func:`interquartile_mean`; it is called with shape (draws, S, K) and ``axis=(-2, -1)``.
        level: of confidence, between 0 and 1.
        draws: resamples, from 1.
        seed: of the resampling.

    Returns:
        Lower and upper bound; None for a single seed, which says nothing about others.

    Raises:
        ConfigError: if scores are missing, not finite or of another shape, a setting is out of range, or the
            statistic does not give one number per draw.

    Source: Agarwal et al. 2021, section 4.1.
    """
    values = _by_seed("scores", scores)
    return _percentiles([values], lambda drawn: statistic(drawn, axis=(-2, -1)), values.size, level, draws, seed)


def probability_of_improvement(x: ArrayLike, y: ArrayLike) -> float:
    """Return how likely a run of x scores higher than a run of y, both drawn at random.

    ``P(X > Y) = 1/K sum_k 1/(S S') sum_i sum_j h(x_ik, y_jk)``, h = 1 where ``x_ik > y_jk``, 1/2 where they are equal,
    otherwise 0. In one stratum it is the Mann-Whitney U statistic over S S'. It does not say by how much.

    Args:
        x: shape (S seeds, K strata), or (S,) for one stratum.
        y: shape (S' seeds, K strata), or (S',).

    Raises:
        ConfigError: if scores are missing, not finite or of another shape, or x and y differ in strata.

    Source: Agarwal et al. 2021, section 4.3; Mann and Whitney 1947.
    """
    return float(_win_rate(*_pair(x, y)))


def probability_of_improvement_interval(
    x: ArrayLike, y: ArrayLike, *, level: float = 0.95, draws: int = 2000, seed: int = 0
) -> tuple[float, float] | None:
    """Return the stratified-bootstrap interval of :func:`probability_of_improvement`.

    Seeds of x and of y are resampled independently of each other, as in :func:`stratified_bootstrap`. The interval has
    zero width where every run of one beats every run of the other, since every resample then agrees.

    Args:
        x: shape (S seeds, K strata), or (S,) for one stratum.
        y: shape (S' seeds, K strata), or (S',).
        level: of confidence, between 0 and 1.
        draws: resamples, from 1.
        seed: of the resampling.

    Returns:
        Lower and upper bound; None if x or y has one seed only.

    Raises:
        ConfigError: as :func:`probability_of_improvement`, and for a setting out of range.

    Source: Agarwal et al. 2021, section 4.3.
    """
    a, b = _pair(x, y)
    return _percentiles([a, b], _win_rate, a.size * len(b), level, draws, seed)


def task_bootstrap(
    successes: ArrayLike, *, level: float = 0.95, draws: int = 2000, seed: int = 0
) -> tuple[float, float]:
    """Return the interval of a mean success rate over tasks that were each tried several times.

    Attempts at one task resemble each other, so whole tasks are resampled (cluster bootstrap): with the rate of a task
    ``m_i = sum_d s_id / D``, the interval holds the quantiles of ``1/N sum_i m_(r_i)``, r_i uniform over 1..N. How
    often each distinct rate is drawn is multinomial, so a draw's cost grows with the distinct rates, not the tasks.

    Where all tasks have the same rate, 0 and 1 in particular, resampling shows no variation; the interval is then
    Wilson's for N trials, which is as wide as N independent tasks with this mean allow.

    Args:
        successes: shape (N tasks, D attempts), of 0 and 1.
        level: of confidence, between 0 and 1.
        draws: resamples, from 1.
        seed: of the resampling.

    Raises:
        ConfigError: if the table is empty, of another shape, holds anything but 0 and 1, or a setting is out of range.

    Source: Davison and Hinkley 1997, "Bootstrap methods and their application", section 3.8; Wilson 1927.
    """
    _check_level(level)
    draws = whole("draws", draws, 1, MAX_SIZE)
    seed = whole("seed", seed, 0)
    table = _finite("successes", successes)
    if table.ndim != 2:
        raise ConfigError(f"successes of shape {table.shape}: expected (tasks, attempts).")
    wrong = table[(table != 0) & (table != 1)]
    if wrong.size:
        raise ConfigError(f"successes: {wrong[0]:g} is neither 0 nor 1; expected single attempts, not rates.")
    totals, tasks = np.unique(table.sum(axis=1), return_counts=True)
    n, attempts = table.shape
    if len(totals) == 1:
        return wilson_interval(n * float(totals[0]) / attempts, n, level)
    drawn = np.random.default_rng(seed).multinomial(n, tasks / n, size=draws)
    low, high = np.quantile(drawn @ totals / (n * attempts), [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def paired_difference(x: ArrayLike, y: ArrayLike, *, level: float = 0.95, draws: int = 2000, seed: int = 0) -> Interval:
    """Return the mean difference of two players' success over the same tasks, and its bootstrap interval over tasks.

    With the rates ``a_i`` and ``b_i`` of task i, the difference is ``mean_i (a_i - b_i)``; tasks are resampled as
    pairs, so what makes a task hard for both does not widen the interval.

    Args:
        x: shape (N tasks, D attempts), of 0 and 1.
        y: shape (N tasks, D' attempts), of the same tasks.
        level: of confidence, between 0 and 1.
        draws: resamples, from 1.
        seed: of the resampling.

    Returns:
        Difference, lower and upper bound.

    Raises:
        ConfigError: if the tables are empty, of different tasks or another shape, or a setting is out of range.

    Source: Efron and Tibshirani 1993, "An introduction to the bootstrap", chapter 13.
    """
    _check_level(level)
    draws = whole("draws", draws, 1, MAX_SIZE)
    seed = whole("seed", seed, 0)
    a, b = _finite("x", x), _finite("y", y)
    if a.ndim != 2 or b.ndim != 2 or len(a) != len(b):
        raise ConfigError(
            f"x of shape {a.shape} and y of shape {b.shape}: expected (tasks, attempts) of the same tasks."
        )
    values, tasks = np.unique(a.mean(axis=1) - b.mean(axis=1), return_counts=True)
    drawn = np.random.default_rng(seed).multinomial(len(a), tasks / len(a), size=draws)
    low, high = np.quantile(drawn @ values / len(a), [(1 - level) / 2, (1 + level) / 2])
    return float(values @ tasks / len(a)), float(low), float(high)


def _percentiles(
    samples: list[Scores], statistic: Callable[..., Any], cost: int, level: float, draws: int, seed: int
) -> tuple[float, float] | None:
    """Return percentile bounds of a statistic of resampled samples, each (draws, S, K); ``cost``: values per draw."""
    _check_level(level)
    draws = whole("draws", draws, 1, MAX_SIZE)
    rng = np.random.default_rng(whole("seed", seed, 0))
    if any(len(sample) == 1 for sample in samples):
        return None
    chunk = max(1, CHUNK // cost)
    values = np.empty(draws)
    for start in range(0, draws, chunk):
        count = min(chunk, draws - start)
        rows = [rng.integers(len(sample), size=(count, *sample.shape)) for sample in samples]
        drawn = [np.take_along_axis(s[None], row, axis=1) for s, row in zip(samples, rows, strict=True)]
        result = np.asarray(statistic(*drawn))
        if result.shape != (count,):
            raise ConfigError(
                f"the statistic gave shape {result.shape} for {count} draws: expected one number per draw, as np.mean "
                "gives over the axes passed to it."
            )
        values[start : start + count] = result
    low, high = np.quantile(values, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def _win_rate(x: Scores, y: Scores) -> Scores:
    """Return the share of pairs that x wins, ties half: shapes (..., S, K) and (..., S', K) to (...)."""
    # Signs are 1, 0, -1 for won, tied, lost.
    signs = np.sign(x[..., :, None, :] - y[..., None, :, :])
    return np.asarray((1 + signs.mean(axis=(-3, -2, -1))) / 2)


def _check_level(level: float) -> None:
    if not 0 < level < 1:
        raise refuse("level", level, "more than 0 and less than 1, such as 0.95")


def _finite(name: str, values: ArrayLike) -> Scores:
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


def _by_seed(name: str, values: ArrayLike) -> Scores:
    array = _finite(name, values)
    if array.ndim not in (1, 2):
        raise ConfigError(f"{name} of shape {array.shape}: expected (seeds, strata), or (seeds,) for one stratum.")
    return array if array.ndim == 2 else array[:, None]


def _pair(x: ArrayLike, y: ArrayLike) -> tuple[Scores, Scores]:
    a, b = _by_seed("x", x), _by_seed("y", y)
    if a.shape[1] != b.shape[1]:
        raise ConfigError(f"x has {a.shape[1]} strata and y {b.shape[1]}: expected the same strata in the same order.")
    return a, b


def bootstrap(
    values: NDArray[np.float64], clusters: NDArray[np.int64], *, resamples: int = 1_000, seed: int = 0
) -> NDArray[np.float64]:
    """Return means of ``values`` over resamples of whole clusters, shape (resamples,)."""
    names, index = np.unique(clusters, return_inverse=True)
    sums = np.bincount(index, weights=values)
    sizes = np.bincount(index).astype(float)
    rng = np.random.default_rng(seed)
    means = np.empty(resamples)
    for i in steps("resampling", range(resamples)):
        drawn = np.bincount(rng.integers(len(names), size=len(names)), minlength=len(names))
        means[i] = (drawn @ sums) / (drawn @ sizes)
    return means


def interval(means: NDArray[np.float64], level: float = 0.95) -> tuple[float, float]:
    """Return the percentile interval of bootstrap means."""
    low, high = np.quantile(means, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def standardised(table: NDArray[np.floating], among: NDArray[np.integer] | None = None) -> NDArray[np.float64]:
    """Return scores of all pairs, shape (E, E), with mean 0 and standard deviation 1 over pairs of different entities.

    Scores of entities with themselves are scaled as well but do not count, because they are often far from the others;
    nor do, if only some entities count, pairs that are not ``among`` them.
    """
    scores = np.asarray(table, dtype=np.float64)
    counted = scores if among is None else scores[np.ix_(among, among)]
    different = counted[~np.eye(len(counted), dtype=bool)]
    deviation = different.std()
    if deviation <= 1e-12 * np.abs(different).max(initial=0):  # equal up to rounding, which must not be amplified
        deviation = 1.0
    return np.asarray((scores - different.mean()) / deviation)
