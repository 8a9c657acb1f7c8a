"""Intervals for success rates over tasks that were tried several times."""

import math
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.statistics import samples
from wordcraft_kg.base.statistics.samples import RESAMPLES, Interval, by_task, check_level, finite, generator, interval


def wilson_interval(successes: float, n: int, level: float = 0.95) -> tuple[float, float]:
    """Return Wilson's score interval for a success probability: lower and upper bound.

    The interval contains the probabilities p that a two-sided normal test does not reject,
    ``|k/n - p| <= z * sqrt(p (1 - p) / n)``: ``(k + z²/2 ± z * sqrt(k (n - k) / n + z²/4)) / (n + z²)``. The bounds
    stay within 0 and 1, and the width is positive even for k = 0 and k = n.

    Args:
        successes: k, from 0 to ``n``; a sum of rates need not be whole.
        n: number of independent trials, from 1.
        level: confidence.

    Source: Wilson 1927, "Probable inference, the law of succession, and statistical inference".
    """
    if not 0 <= successes <= n or n < 1:
        raise ConfigError(f"{successes} successes of {n}: expected at least one trial, and 0 to {n} successes.")
    check_level(level)
    z = NormalDist().inv_cdf((1 + level) / 2)
    middle = successes + z**2 / 2
    half = z * math.sqrt(successes * (n - successes) / n + z**2 / 4)
    # The bounds at k = 0 and k = n are exact; rounding must not change these bounds.
    low = (middle - half) / (n + z**2) if successes else 0.0
    high = (middle + half) / (n + z**2) if successes < n else 1.0
    return low, high


def task_bootstrap(
    successes: ArrayLike, *, level: float = 0.95, draws: int = RESAMPLES, seed: int = 0
) -> tuple[float, float]:
    """Return a bootstrap interval for a mean success rate; ``successes`` has shape (N tasks, D attempts), 0 and 1.

    Attempts at one task are correlated, so whole tasks are resampled (cluster bootstrap): with a task's rate
    ``m_i = sum_d s_id / D``, the bounds are quantiles of ``1/N sum_i m_(r_i)``, r_i uniform over 1..N. How often each
    distinct rate is drawn is multinomial, so a draw's cost grows with the distinct rates, not the tasks.

    If all tasks have the same rate, resampling shows no variation; Wilson's interval for N trials is used instead.

    Source: Davison and Hinkley 1997, "Bootstrap methods and their application", section 3.8; Wilson 1927.
    """
    draws, rng = generator(level, draws, seed)
    table = by_task("successes", successes, "(tasks, attempts)")
    wrong = table[(table != 0) & (table != 1)]
    if wrong.size:
        raise ConfigError(f"successes: {wrong[0]:g} is neither 0 nor 1; expected single attempts, not rates.")
    totals, tasks = np.unique(table.sum(axis=1), return_counts=True)
    n, attempts = table.shape
    if len(totals) == 1:
        return wilson_interval(n * float(totals[0]) / attempts, n, level)
    return interval(rng.multinomial(n, tasks / n, size=draws) @ totals / (n * attempts), level)


def paired_difference(
    x: ArrayLike, y: ArrayLike, *, level: float = 0.95, draws: int = RESAMPLES, seed: int = 0
) -> Interval:
    """Return the mean difference between two players' success on the same tasks, and its bootstrap interval.

    With the rates ``a_i`` and ``b_i`` on task i, the difference is ``mean_i (a_i - b_i)``. Tasks are resampled in
    pairs, so a task that is hard for both players does not widen the interval.

    Args:
        x: a player's successes, shape (N tasks, D attempts), 0 and 1.
        y: the other player's successes, shape (N tasks, D' attempts), 0 and 1.
        level: confidence.
        draws: number of resamples.
        seed: random seed.

    Returns:
        Difference, lower and upper bound.

    Source: Efron and Tibshirani 1993, "An introduction to the bootstrap", chapter 13.
    """
    draws, rng = generator(level, draws, seed)
    a, b = finite("x", x), finite("y", y)
    if a.ndim != 2 or b.ndim != 2 or len(a) != len(b):
        raise ConfigError(
            f"x of shape {a.shape} and y of shape {b.shape}: expected (tasks, attempts) of the same tasks."
        )
    values, tasks = np.unique(a.mean(axis=1) - b.mean(axis=1), return_counts=True)
    means = rng.multinomial(len(a), tasks / len(a), size=draws) @ values / len(a)
    return float(values @ tasks / len(a)), *interval(means, level)


def crossed_bootstrap(
    scores: ArrayLike, *, level: float = 0.95, draws: int = RESAMPLES, seed: int = 0
) -> tuple[float, float]:
    """Return the interval of a mean over seeds and tasks, ``scores`` of shape (S seeds, K tasks), resampling both.

    Every run plays the same tasks, so rows and columns are resampled whole and independently:
    ``m* = 1/(S K) sum_i sum_k s_(r_i)(c_k)``, r_i uniform over 1..S and c_k over 1..K. For scores that are differences
    between two agents, seed by seed and task by task, this is the interval of the mean difference.

    A single seed cannot be resampled: the interval then covers tasks only. With few seeds their contribution is too
    narrow, as in every bootstrap over few seeds. Equal scores have zero width.

    Source: Owen 2007, "The pigeonhole bootstrap".
    """
    draws, rng = generator(level, draws, seed)
    table = by_task("scores", scores, "(seeds, tasks)")
    size, number = table.shape
    means = np.empty(draws)
    chunk = max(1, samples.CHUNK // number)
    for start in range(0, draws, chunk):
        count = min(chunk, draws - start)
        by_column = rng.multinomial(size, np.full(size, 1 / size), size=count) @ table
        drawn = np.take_along_axis(by_column, rng.integers(number, size=(count, number)), 1)
        means[start : start + count] = drawn.sum(1)
    return interval(means / (size * number), level)
