"""Tests of whether two agents differ, and what many of them at once are worth."""

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wordcraft_kg.errors import ConfigError
from wordcraft_kg.settings import MAX_SIZE, whole
from wordcraft_kg.statistics.samples import finite

MOST_EXACT = 20_000
"""Most ways to deal runs to two agents that are all tried; two times 8 seeds have 12,870."""


def permutation_p_value(x: ArrayLike, y: ArrayLike, *, draws: int = 20_000, seed: int = 0) -> float:
    """Return the two-sided p-value of a difference of means between the runs of two agents.

    If it did not matter which agent a run is of, all ways to deal the runs to the two would be equally likely. The
    p-value is the share of those whose difference of means is at least as large as the one seen:
    ``p = #{|mean(x*) - mean(y*)| >= |mean(x) - mean(y)|} / C(S + S', S)``. It is exact whatever the distribution, and
    needs no normality. If there are too many ways, ``draws`` random ones and the one seen stand for them.

    It asks about other trainings on the same tasks; seeds are not paired, since equal seeds of different agents share
    no randomness that would make their runs alike. The smallest value that it can have for two times S seeds is
    2 / C(2 S, S): .1 with 3 seeds, .029 with 4, .0079 with 5. With 3 seeds it can therefore never be below .05, and
    with 5 seeds never after correcting for more than 6 comparisons; see :func:`smallest_p_value`.

    Args:
        x: shape (S,), one score for each run.
        y: shape (S',).
        draws: random ways if not all are tried, from 1.
        seed: of the drawing.

    Raises:
        ConfigError: if scores are missing, not finite or of another shape, or a setting is out of range.

    Source: Pitman 1937, "Significance tests which may be applied to samples from any populations"; Phipson and Smyth
    2010, "Permutation p-values should never be zero", for the random ways.
    """
    draws, seed = whole("draws", draws, 1, MAX_SIZE), whole("seed", seed, 0)
    a, b = finite("x", x), finite("y", y)
    if a.ndim != 1 or b.ndim != 1:
        raise ConfigError(f"x of shape {a.shape} and y of shape {b.shape}: expected one score for each run.")
    everything = np.concatenate([a, b])
    seen = abs(a.mean() - b.mean())
    is_exact = math.comb(len(everything), len(a)) <= MOST_EXACT
    chosen: NDArray[np.int64]
    if is_exact:
        chosen = np.array(list(combinations(range(len(everything)), len(a))))
    else:
        rng = np.random.default_rng(seed)
        chosen = rng.permuted(np.tile(np.arange(len(everything)), (draws, 1)), axis=1)[:, : len(a)]
    sums = everything[chosen].sum(axis=1)
    differences = np.abs(sums / len(a) - (everything.sum() - sums) / len(b))
    # Equal differences must count as such whatever the order in which they were summed up.
    hits = int((differences >= seen - 1e-12 * max(1.0, float(np.abs(everything).max()))).sum())
    return hits / len(chosen) if is_exact else (hits + 1) / (draws + 1)


def smallest_p_value(size: int, other: int) -> float:
    """Return the smallest value of :func:`permutation_p_value` for so many runs of each agent."""
    return (2 if size == other else 1) / math.comb(size + other, size)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for their number: rejecting those below .05 errs at all in at most 5 % of all studies.

    With the m values in ascending order, ``p'_(i) = max_(j <= i) min(1, (m - j + 1) p_(j))``. It holds whatever the
    dependence between the comparisons, and rejects all that Bonferroni's correction rejects.

    Raises:
        ConfigError: if a value is not from 0 to 1.

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
