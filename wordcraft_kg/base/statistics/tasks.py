"""What tasks that were tried several times say of a success rate, and of the difference of two."""

import math
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.base.statistics import samples
from wordcraft_kg.base.statistics.samples import Interval, check_level, finite


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
    check_level(level)
    z = NormalDist().inv_cdf((1 + level) / 2)
    middle = successes + z**2 / 2
    half = z * math.sqrt(successes * (n - successes) / n + z**2 / 4)
    # The bounds at k = 0 and k = n are exact; rounding must not move them.
    low = (middle - half) / (n + z**2) if successes else 0.0
    high = (middle + half) / (n + z**2) if successes < n else 1.0
    return low, high


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
    check_level(level)
    draws = whole("draws", draws, 1, MAX_SIZE)
    seed = whole("seed", seed, 0)
    table = finite("successes", successes)
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
    check_level(level)
    draws = whole("draws", draws, 1, MAX_SIZE)
    seed = whole("seed", seed, 0)
    a, b = finite("x", x), finite("y", y)
    if a.ndim != 2 or b.ndim != 2 or len(a) != len(b):
        raise ConfigError(
            f"x of shape {a.shape} and y of shape {b.shape}: expected (tasks, attempts) of the same tasks."
        )
    values, tasks = np.unique(a.mean(axis=1) - b.mean(axis=1), return_counts=True)
    drawn = np.random.default_rng(seed).multinomial(len(a), tasks / len(a), size=draws)
    low, high = np.quantile(drawn @ values / len(a), [(1 - level) / 2, (1 + level) / 2])
    return float(values @ tasks / len(a)), float(low), float(high)


def crossed_bootstrap(
    scores: ArrayLike, *, level: float = 0.95, draws: int = 2000, seed: int = 0
) -> tuple[float, float]:
    """Return the interval of a mean over seeds and tasks, resampling both: of other seeds, and of other such tasks.

    Every run plays the same tasks, so rows and columns are resampled whole and independently of each other:
    ``m* = 1/(S K) sum_i sum_k s_(r_i)(c_k)``, r_i uniform over 1..S and c_k over 1..K. The bounds are the quantiles of
    m* over the draws. For scores that are differences of two agents, seed by seed and task by task, it is the interval
    of the mean difference.

    A single seed cannot be resampled: the interval is then one over tasks. With few seeds the part that they
    contribute is too narrow, as in :func:`~wordcraft_kg.base.statistics.stratified_bootstrap`. Where all scores are
    equal, the width is zero.

    Args:
        scores: shape (S seeds, K tasks): the success rate of each run on each task.
        level: of confidence, between 0 and 1.
        draws: resamples, from 1.
        seed: of the resampling.

    Raises:
        ConfigError: if scores are missing, not finite or of another shape, or a setting is out of range.

    Source: Owen 2007, "The pigeonhole bootstrap".
    """
    check_level(level)
    draws, seed = whole("draws", draws, 1, MAX_SIZE), whole("seed", seed, 0)
    table = finite("scores", scores)
    if table.ndim != 2:
        raise ConfigError(f"scores of shape {table.shape}: expected (seeds, tasks).")
    rng = np.random.default_rng(seed)
    size, number = table.shape
    means = np.empty(draws)
    chunk = max(1, samples.CHUNK // number)
    for start in range(0, draws, chunk):
        count = min(chunk, draws - start)
        by_task = rng.multinomial(size, np.full(size, 1 / size), size=count) @ table
        means[start : start + count] = np.take_along_axis(by_task, rng.integers(number, size=(count, number)), 1).sum(1)
    low, high = np.quantile(means / (size * number), [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)
