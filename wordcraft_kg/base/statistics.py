"""Confidence intervals for success rates, and comparisons of agents trained with several seeds.

Intervals have a nominal confidence of 95 % unless stated otherwise;
``benchmarks/interval_coverage.py`` simulates how often they hold the truth. ``draws`` is the number
of resamples, and ``seed`` fixes the resampling. Scores are finite numbers, at least one; only the
numbers of groups are checked, since wrong ones would give a wrong interval in silence.
"""

import math
from collections.abc import Callable, Sequence
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.progress import steps

Interval = tuple[float, float, float]
"""An estimate and its interval: value, lower bound, upper bound."""
Scores = NDArray[np.float64]
RESAMPLES = 2_000
"""Bootstrap resamples.

With seed 0 the same everywhere, so that a metric has the same interval in every report.
"""
Groups = NDArray[np.integer] | Sequence[int] | None
"""Number of each task's group, shape (K,); None if each task is a group of its own."""
FEWEST_GROUPS = 50
"""Fewest groups for a bootstrap.

Percentiles of fewer groups hold the truth too seldom: .79 to .94 for 12 to 40 groups.
"""
_DRAWN_AT_ONCE = 1 << 18
"""Most clusters that are drawn in one call of the generator, in 2 MiB."""
_LEAST_OF_TASKS = 0.5
"""Least half-width over splits, as a share of that over groups of tasks: with it, intervals of 3
splits cover .956 to .960 on average over scenarios (``benchmarks/interval_coverage.py``)."""
_LEVEL = 0.95
_Z = NormalDist().inv_cdf((1 + _LEVEL) / 2)
"""Half-width of a 95 % interval in standard errors, about 1.96."""


def bootstrap(
    values: Scores, clusters: NDArray[np.int64], *, resamples: int = RESAMPLES, seed: int = 0
) -> Scores:
    """Return bootstrap means of values, resampling whole clusters, such as a recipe's queries.

    Values of a cluster resemble each other; resampling single values would give too narrow an
    interval.

    Args:
        values: shape (N,), float, at least one.
        clusters: cluster id of each value, shape (N,).
        resamples: number of resamples.
        seed: random seed.

    Returns:
        shape (resamples,), float: the mean of each resample.
    """
    # A mean of whole clusters needs only the sum and the size of each.
    names, index = np.unique(clusters, return_inverse=True)
    sums = np.bincount(index, weights=values)
    sizes = np.bincount(index).astype(float)
    rng = np.random.default_rng(seed)
    number = len(names)
    means = np.empty(resamples)
    # Resamples of few clusters are drawn together: single calls would cost more than the numbers.
    at_once = max(1, _DRAWN_AT_ONCE // number)
    for first in steps("resampling", range(0, resamples, at_once)):
        rows = min(at_once, resamples - first)
        places = rng.integers(number, size=(rows, number))
        # Each resample counts in a range of its own.
        places += number * np.arange(rows)[:, None]
        counts = np.bincount(places.ravel(), minlength=rows * number).reshape(rows, number)
        weights = counts.astype(float)
        # Row by row: a product with the whole matrix would add up in another order, and change the
        # last bit. Sizes are whole numbers, whose sums are exact.
        totals = [row @ sums for row in weights]
        means[first : first + rows] = totals / (weights @ sizes)
    return means


def interval(means: Scores, level: float = _LEVEL) -> tuple[float, float]:
    """Return the percentile interval from bootstrap means: lower and upper bound."""
    probabilities = [(1 - level) / 2, (1 + level) / 2]
    low, high = np.quantile(means, probabilities)
    return float(low), float(high)


def cluster_interval(
    values: Scores, clusters: NDArray[np.int64], means: Scores, *, level: float = _LEVEL
) -> tuple[float, float]:
    """Return the interval for the mean of values.

    The bounds are percentiles of resampled means, or those of Student's t over few clusters.

    Args:
        values: numbers from -1 to 1, such as reciprocal ranks or their differences, shape (N,).
        clusters: cluster id of each value, shape (N,).
        means: resampled means of ``values``, from :func:`bootstrap`.
        level: confidence.

    Returns:
        lower and upper bound; below :data:`FEWEST_GROUPS` clusters those of
        :func:`crossed_difference`.
    """
    if len(np.unique(clusters)) >= FEWEST_GROUPS:
        return interval(means, level)
    # A single row: no seeds, so only clusters vary.
    estimate, _ = crossed_difference(values[None], clusters, level=level)
    _, low, high = estimate
    return low, high


def standardised(table: NDArray[np.floating]) -> Scores:
    """Return scores scaled to mean 0 and standard deviation 1 over pairs of different entities.

    Self scores (the diagonal) are scaled too but do not count for mean and deviation, because they
    are often outliers.

    Args:
        table: scores of all pairs, shape (E, E).

    Returns:
        shape (E, E), float. If all counted scores are equal, only the mean is subtracted.
    """
    scores = np.asarray(table, dtype=np.float64)
    is_same = np.eye(len(scores), dtype=bool)
    different = scores[~is_same]
    deviation = different.std()
    # Scores that are equal up to rounding: dividing would amplify the rounding.
    if deviation <= 1e-12 * np.abs(different).max(initial=0):
        deviation = 1.0
    return np.asarray((scores - different.mean()) / deviation)


# --- success rates over tasks ---------------------------------------------------------------------


def wilson_interval(successes: float, n: int) -> tuple[float, float]:
    """Return Wilson's score interval for a success probability: lower and upper bound.

    The interval contains the probabilities p that a two-sided normal test does not reject,
    ``|k/n - p| <= z * sqrt(p (1 - p) / n)``:
    ``(k + z²/2 ± z * sqrt(k (n - k) / n + z²/4)) / (n + z²)``. The bounds stay within 0 and 1, and
    the width is positive even for k = 0 and k = n.

    Args:
        successes: k, from 0 to ``n``; a sum of rates need not be whole.
        n: number of independent trials, from 1.

    Source: Wilson 1927, "Probable inference, the law of succession, and statistical inference".
    """
    middle = successes + _Z**2 / 2
    variance = successes * (n - successes) / n
    half = _Z * math.sqrt(variance + _Z**2 / 4)
    widened = n + _Z**2
    # The bounds at k = 0 and k = n are exact; rounding must not change these bounds.
    low = (middle - half) / widened if successes else 0.0
    high = (middle + half) / widened if successes < n else 1.0
    return low, high


def task_bootstrap(
    successes: ArrayLike, groups: Groups, *, draws: int = RESAMPLES, seed: int = 0
) -> tuple[float, float]:
    """Return a bootstrap interval for a mean success rate, resampling whole groups of tasks.

    Attempts at one task are correlated, and so are tasks that a split holds out together, such as
    all tasks of a goal: whole groups are resampled with all tasks and attempts (cluster bootstrap).
    With a group's sum of rates ``s_g`` and its ``n_g`` tasks, the bounds are quantiles of ``sum_g
    c_g s_g / sum_g c_g n_g``, where the counts c are multinomial with G draws from G groups. Equal
    groups are drawn together, so a draw's cost grows with the distinct groups.

    If all groups have the same rate, resampling shows no variation; Wilson's interval for G trials
    is used instead. Below :data:`FEWEST_GROUPS` groups resampling shows too little of it;
    :func:`rate_interval` is used instead.

    Args:
        successes: shape (N tasks, D attempts), 0 and 1.
        groups: number of each task's group, shape (N,); None if each task is a group of its own.
        draws: number of resamples.
        seed: random seed.

    Returns:
        lower and upper bound, within 0 and 1.

    Raises:
        ConfigError: unless there is one group for each task.

    Source: Davison and Hinkley 1997, "Bootstrap methods and their application", section 3.8; Wilson
    1927.
    """
    rng = np.random.default_rng(seed)
    table = np.asarray(successes, dtype=np.float64)
    attempts = table.shape[1]
    # Whole numbers, so that equal groups are equal to the bit.
    solved, sizes = _group_sums(table.sum(axis=1), groups)
    if np.ptp(solved / sizes) == 0:
        rate = float(solved[0] / sizes[0]) / attempts
        return wilson_interval(rate * len(sizes), len(sizes))
    if len(sizes) < FEWEST_GROUPS:
        return rate_interval(table.mean(axis=1)[None], groups)
    # Divided at the end only, since the sums had to be whole.
    return interval(_resampled_ratios(solved, sizes, draws, rng) / attempts)


def paired_difference(
    x: ArrayLike, y: ArrayLike, groups: Groups, *, draws: int = RESAMPLES, seed: int = 0
) -> Interval:
    """Return the mean difference between two players' success on the same tasks, and its interval.

    With the rates ``a_i`` and ``b_i`` on task i, the difference is ``mean_i (a_i - b_i)``. Whole
    groups of tasks are resampled, as in :func:`task_bootstrap`, in pairs: a task that is hard for
    both players does not widen the interval. Below :data:`FEWEST_GROUPS` groups, the interval is
    that of :func:`crossed_difference`.

    Args:
        x: successes of the first player, 0 and 1, shape (N tasks, D attempts).
        y: successes of the second player, 0 and 1, shape (N tasks, D' attempts).
        groups: number of each task's group, shape (N,); None if each task is a group of its own.
        draws: number of resamples.
        seed: random seed.

    Returns:
        the difference with its lower and upper bound.

    Raises:
        ConfigError: unless there is one group for each task.

    Source: Efron and Tibshirani 1993, "An introduction to the bootstrap", chapter 13.
    """
    rng = np.random.default_rng(seed)
    rates = [np.asarray(table, dtype=np.float64).mean(axis=1) for table in (x, y)]
    difference = rates[0] - rates[1]
    sums, sizes = _group_sums(difference, groups)
    if len(sizes) < FEWEST_GROUPS:
        return crossed_difference(difference[None], groups)[0]
    low, high = interval(_resampled_ratios(sums, sizes, draws, rng))
    return float(difference.mean()), low, high


def _resampled_ratios(sums: Scores, sizes: Scores, draws: int, rng: np.random.Generator) -> Scores:
    """Return ratios of resampled sums and sizes over G groups.

    Args:
        sums: sum of each group, shape (G,).
        sizes: number of tasks of each group, shape (G,).
        draws: number of resamples.
        rng: random generator.

    Returns:
        shape (draws,), float.
    """
    # How often each kind of equal groups is drawn is multinomial, too, with their shares.
    kinds = np.column_stack([sums, sizes])
    equal, times = np.unique(kinds, axis=0, return_counts=True)
    multiplicities = rng.multinomial(len(sizes), times / len(sizes), size=draws)
    drawn_sums = multiplicities @ equal[:, 0]
    drawn_sizes = multiplicities @ equal[:, 1]
    return np.asarray(drawn_sums / drawn_sizes)


def _group_sums(values: Scores, groups: Groups) -> tuple[Scores, Scores]:
    """Return sums over groups of tasks, and the groups' sizes.

    Args:
        values: shape (..., K tasks).
        groups: number of each task's group, shape (K,); None if each task is a group of its own.

    Returns:
        sums, shape (..., G), in the order of the group numbers, and sizes, shape (G,).

    Raises:
        ConfigError: unless there is one group number for each task.
    """
    tasks = values.shape[-1]
    if groups is None:
        return values, np.ones(tasks)
    numbers = np.asarray(groups)
    if numbers.shape != (tasks,):
        raise ConfigError(
            f"groups of shape {numbers.shape}: expected one for each of {tasks} tasks."
        )
    # Sorted by group, so that the tasks of a group follow each other; stable, so that the order of
    # additions, and with it the last bits, does not depend on the machine.
    order = np.argsort(numbers, kind="stable")
    _, starts, sizes = np.unique(numbers[order], return_index=True, return_counts=True)
    sums = np.add.reduceat(values[..., order], starts, axis=-1)
    return sums, sizes.astype(float)


def rate_interval(scores: ArrayLike, groups: Groups, splits: Groups = None) -> tuple[float, float]:
    """Return the interval for a mean success rate over seeds and tasks, or over splits.

    Wilson's interval with the half-width h of :func:`crossed_difference` at the rate p: with
    ``q = h² / p (1 - p)`` the bounds are ``(p + q/2 ± sqrt(q p (1 - p) + q²/4)) / (1 + q)``, within
    0 and 1 and skewed near them. If all groups have the same rate, q grows by ``z² / G``. A single
    seed shows no variation between seeds: the interval then covers tasks only.

    Args:
        scores: success rates, shape (S seeds, K tasks).
        groups: number of each task's group, shape (K,); None if each task is a group of its own.
        splits: number of each task's split, shape (K,); None if all are of one split.

    Returns:
        lower and upper bound; over several splits for the mean of the splits' means.

    Raises:
        ConfigError: unless there is one group and one split for each task.

    Source: Wilson 1927, with the variance of random effects in place of the binomial one.
    """
    table = np.asarray(scores, dtype=np.float64)
    rate, half_width, floor = _crossed(table, groups, splits)
    spread = rate * (1 - rate)
    width = half_width(1 - _LEVEL)
    # Without spread the rate is 0 or 1, and only the floor gives the interval a width.
    q = width**2 / spread if spread else 0.0
    q += _Z**2 * floor
    half = math.sqrt(q * spread + q**2 / 4)
    low = (rate + q / 2 - half) / (1 + q)
    high = (rate + q / 2 + half) / (1 + q)
    return max(low, 0.0), min(high, 1.0)


def crossed_difference(
    scores: ArrayLike, groups: Groups, splits: Groups = None, *, level: float = _LEVEL
) -> tuple[Interval, float]:
    """Return a mean difference between two agents over seeds and tasks, and its interval.

    Of one split, the interval is for new trainings and new tasks like its tasks:
    ``h² = t²_(S-1) max(v_seeds - v_rest, 0) + t²_(H-1) v_groups`` adds the variance of the mean by
    seeds, without the noise of single trainings on single groups, and by groups of tasks that a
    split holds out together: ``v_groups`` and ``v_rest`` are jackknife variances over groups. Few
    seeds and few groups get Student's t; ``H = K² / sum_g n_g²`` groups of equal size say as much
    as G groups with n_g tasks. With groups of one task these are the mean squares of a two-way
    table.

    The p-value is the level at which the interval reaches 0. If all groups have the same
    difference, their part is ``z² / G`` in place of 0, as for a rate of 0 or 1. One task leaves the
    part of the seeds; one group of several tasks says nothing of other groups.

    Of M splits, the interval is for the mean over trainings on random splits of the same book: the
    value is the mean of the splits' means, and ``h = max(t_(M-1) s / sqrt(M), t_(H-1)
    sqrt(v_groups) / 2)`` with their sample deviation s, which holds the variation of trainings and
    of tasks as well. Few means may be alike by chance; so h is at least half of what the tasks
    alone would give.
    ``benchmarks/interval_coverage.py`` simulates the coverage.

    Args:
        scores: differences of rates, paired by seed and task, shape (S seeds, K tasks).
        groups: number of each task's group, shape (K,); None if each task is a group of its own.
            Groups of different splits are different groups.
        splits: number of each task's split, shape (K,); None if all are of one split.
        level: confidence.

    Returns:
        the difference with its lower and upper bound, from -1 to 1, and the p-value of "no
        difference".

    Raises:
        ConfigError: unless there is one group and one split for each task.

    Source: Howe 1974, "Approximate confidence limits on the mean of X + Y where X and Y are two
    tabled independent random variables"; Cameron and Miller 2015, "A practitioner's guide to
    cluster-robust inference", section VI, for the jackknife over groups and for Student's t with
    fewer groups than there are; Student 1908, "The probable error of a mean", over splits.
    """
    from scipy.special import ndtri

    table = np.asarray(scores, dtype=np.float64)
    value, width, floor = _crossed(table, groups, splits)
    smallest_p = 1e-100  # p-values below print as 0; the search needs a positive bound
    floor = floor if table.shape[1] > 1 else 0.0

    def half_width(p: float) -> float:
        quantile = ndtri(p / 2)
        return math.hypot(width(p), floor * quantile**2)

    # The half-width grows as p falls. If even the widest interval leaves 0 out, nothing varies.
    if half_width(smallest_p) <= abs(value):
        p_value = 0.0 if value else 1.0
    else:
        from scipy.optimize import brentq

        p_value = float(brentq(lambda p: half_width(p) - abs(value), smallest_p, 1.0))
    half = half_width(1 - level)
    # A difference of rates lies between -1 and 1.
    low = max(value - half, -1.0)
    high = min(value + half, 1.0)
    return (value, low, high), p_value


def _crossed(
    table: Scores, groups: Groups, splits: Groups = None
) -> tuple[float, Callable[[float], float], float]:
    """Return what varies in a table of rates by seeds, groups of tasks and splits.

    Args:
        table: shape (S seeds, K tasks).
        groups: number of each task's group, shape (K,); None if each task is a group of its own.
        splits: number of each task's split, shape (K,); None if all are of one split.

    Returns:
        the mean over seeds and tasks, of several splits the mean of their means; its half-width;
        and 1 / G if all G groups have the same mean, which does not say that all groups are alike,
        else 0.
    """
    seeds, tasks = table.shape
    mean = table.mean()
    by_seed = table.mean(axis=1)
    by_column = table.mean(axis=0)
    by_split = mean[None]
    if splits is not None:
        sums, sizes = _group_sums(by_column, splits)
        by_split = sums / sizes
    if splits is not None and groups is not None:
        # Groups of different splits are different groups.
        pairs = np.column_stack([splits, groups])
        groups = np.unique(pairs, axis=0, return_inverse=True)[1]
    deviations, sizes = _group_sums(by_column - mean, groups)
    number = len(sizes)
    # Standard errors of the mean: by groups of tasks with the noise of single trainings on single
    # groups, by seeds without it.
    group_error = 0.0
    seed_error = 0.0
    if number > 1:
        # Leaving out group g moves the mean by its summed deviation / (K - n_g): the jackknife over
        # groups.
        num_left = tasks - sizes
        widened = (number - 1) / number
        squares = ((deviations / num_left) ** 2).sum()
        group_error = math.sqrt(widened * squares)
    if seeds > 1:
        seed_error = by_seed.var(ddof=1) / seeds
        if number > 1:
            # Residuals of the two-way table: the noise of single trainings on single groups, which
            # the variance between seeds contains as well.
            residuals = table - by_seed[:, None] - by_column + mean
            residual_sums, _ = _group_sums(residuals, groups)
            squares = ((residual_sums / num_left) ** 2).sum()
            seed_error -= widened * squares / (seeds - 1) / seeds
        # An estimate of a variance as a difference may be negative by chance.
        seed_error = math.sqrt(max(seed_error, 0.0))
    # Groups of equal size that say as much as these groups.
    num_equal = tasks**2 / float((sizes**2).sum())
    num_splits = len(by_split)

    def half_width(p: float) -> float:
        from scipy.special import stdtrit

        # Quantiles below one half are negative; hypot squares the sign away. A single seed or
        # group has no variance, so its degrees of freedom do not count.
        by_groups = group_error * stdtrit(max(num_equal - 1, 1), p / 2)
        if num_splits > 1:
            # With all noise, of trainings and of tasks.
            split_error = float(by_split.std(ddof=1)) / math.sqrt(num_splits)
            by_splits = split_error * stdtrit(num_splits - 1, p / 2)
            return -float(min(by_splits, _LEAST_OF_TASKS * by_groups))
        return math.hypot(seed_error * stdtrit(max(seeds - 1, 1), p / 2), by_groups)

    is_alike = np.abs(deviations / sizes).max() < 1e-9  # up to rounding
    return float(by_split.mean()), half_width, 1 / number if is_alike else 0.0


# --- several seeds --------------------------------------------------------------------------------


FEWEST_PAIRS = 3
"""Fewest seeds for a p-value and a firm verdict.

Two seeds say little about the variation between seeds.
"""


def student_interval(
    scores: ArrayLike, *, within: tuple[float, float] = (0.0, 1.0)
) -> tuple[float, float] | None:
    """Return Student's t interval for the mean score over seeds; None for a single seed.

    ``mean ± t_(S-1) s / sqrt(S)``, with the scores' sample deviation s, cut to the possible values.
    A bootstrap fails for few seeds: resampling 3 seeds gives [minimum, maximum], which covers the
    true mean with probability .68 instead of .95, and with 2 seeds .48.

    Args:
        scores: a score for each seed, shape (S,).
        within: lowest and highest possible value, to which the interval is cut.

    Returns:
        lower and upper bound; None for a single seed, which does not show how seeds vary.

    Source: Student 1908, "The probable error of a mean".
    """
    from scipy.stats import t

    values = np.asarray(scores, dtype=np.float64)
    if len(values) == 1:
        return None
    mean = float(values.mean())
    lowest, highest = within
    number = len(values)
    quantile = t.ppf((1 + _LEVEL) / 2, number - 1)
    half = float(quantile * values.std(ddof=1) / number**0.5)
    return max(mean - half, lowest), min(mean + half, highest)


# --- several comparisons --------------------------------------------------------------------------


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for multiple tests by Holm's method.

    The method controls the family-wise error rate. With the m values in ascending order,
    ``p'_(i) = max_(j <= i) min(1, (m - j + 1) p_(j))``. Rejecting below .05 errs anywhere in at
    most 5 % of all studies, under any dependence between the comparisons; Holm's method never
    rejects less than Bonferroni's correction.

    Args:
        p_values: one for each comparison, from 0 to 1.

    Returns:
        corrected p-values, in the order of ``p_values``.

    Source: Holm 1979, "A simple sequentially rejective multiple test procedure".
    """
    ascending = np.argsort(p_values, kind="stable")
    multiplied = np.arange(len(p_values), 0, -1) * np.asarray(p_values)[ascending]
    corrected = np.empty(len(p_values))
    # Never below that of a smaller p-value, so that the order of the comparisons stays.
    corrected[ascending] = np.maximum.accumulate(multiplied.clip(max=1))
    values: list[float] = corrected.tolist()
    return values
