"""Statistics over several training runs with different seeds for one agent, and comparisons between two agents."""

from collections.abc import Callable
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.statistics.samples import (
    RESAMPLES,
    Scores,
    by_seed,
    check_level,
    finite,
    generator,
    percentiles,
)

FEWEST_PAIRS = 3
"""Fewest seeds for a p-value or a probability of improvement: two seeds say nothing about variation between seeds."""


@overload
def interquartile_mean(scores: ArrayLike) -> float: ...
@overload
def interquartile_mean(scores: ArrayLike, axis: tuple[int, ...]) -> Scores: ...
def interquartile_mean(scores: ArrayLike, axis: tuple[int, ...] | None = None) -> float | Scores:
    """Return the interquartile mean: the mean over the middle half of all scores, or of the scores along ``axis``.

    With the n scores in ascending order and ``g = floor(n / 4)``: ``IQM = sum(s_(g+1), ..., s_(n-g)) / (n - 2 g)``, the
    25 % trimmed mean. For n not divisible by 4 this keeps a little more than half; for n up to 3 it is the plain mean.

    Source: Agarwal et al. 2021, "Deep reinforcement learning at the edge of the statistical precipice", section 4.3.
    """
    values = finite("scores", scores)
    if axis is not None:
        values = np.moveaxis(values, axis, range(-len(axis), 0))
        values = values.reshape(*values.shape[: -len(axis)], -1)
    else:
        values = values.ravel()
    cut = values.shape[-1] // 4
    means = np.sort(values, axis=-1)[..., cut : values.shape[-1] - cut].mean(axis=-1)
    return float(means) if axis is None else means


def student_interval(
    scores: ArrayLike, *, level: float = 0.95, within: tuple[float, float] = (0.0, 1.0)
) -> tuple[float, float] | None:
    """Return Student's t interval for the mean score over seeds, shape (S,); None for a single seed.

    ``mean ± t_(S-1) s / sqrt(S)``, with the scores' sample deviation s, cut to the possible values ``within``. A
    bootstrap fails for few seeds: resampling 3 seeds gives [minimum, maximum], which covers the true mean with
    probability .68 instead of .95, and with 2 seeds .48.

    Source: Student 1908, "The probable error of a mean".
    """
    from scipy.stats import t

    check_level(level)
    values = finite("scores", scores).ravel()
    if len(values) == 1:
        return None
    mean, (lowest, highest) = float(values.mean()), within
    half = float(t.ppf((1 + level) / 2, len(values) - 1) * values.std(ddof=1) / len(values) ** 0.5)
    return max(mean - half, lowest), min(mean + half, highest)


def stratified_bootstrap(
    scores: ArrayLike, statistic: Callable[..., Any], *, level: float = 0.95, draws: int = RESAMPLES, seed: int = 0
) -> tuple[float, float] | None:
    """Return a percentile bootstrap interval for a statistic, resampling seeds within each stratum.

    A draw replaces the S scores in each column (stratum) by S scores from the same column, drawn with replacement and
    independently for each column: ``s*_ik = s_(r_ik)k`` with ``r_ik`` uniform over 1..S. The bounds are the
    ``(1 - level) / 2`` and ``(1 + level) / 2`` quantiles of the statistic over the draws.

    The interval covers variation between seeds, not between tasks, and is too narrow for few seeds and one stratum: a
    "95 %" interval for the mean of 5 normal scores covers about 84 %; for a mean use :func:`student_interval`. Equal
    seeds give zero width.

    Args:
        scores: shape (S seeds, K strata), or (S,) for one stratum. Strata are kinds of tasks, such as depths.
        statistic: reduces the axes named by its keyword ``axis``, such as ``np.mean`` or :func:`interquartile_mean`;
            called with shape (draws, S, K) and ``axis=(-2, -1)``.
        level: confidence.
        draws: number of resamples.
        seed: random seed.

    Returns:
        Lower and upper bound; None for a single seed.

    Source: Agarwal et al. 2021, section 4.1.
    """
    values = by_seed("scores", scores)
    return percentiles([values], lambda drawn: statistic(drawn, axis=(-2, -1)), values.size, level, draws, seed)


def probability_of_improvement(x: ArrayLike, y: ArrayLike) -> float:
    """Return the probability that a random run of x scores higher than a random run of y.

    ``P(X > Y) = 1/K sum_k 1/(S S') sum_i sum_j h(x_ik, y_jk)``, h = 1 where ``x_ik > y_jk``, 1/2 at ties, otherwise 0.
    In one stratum this is the Mann-Whitney U statistic over S S'. The size of the difference does not count.

    Args:
        x: an agent's scores, shape (S seeds, K strata), or (S,) for one stratum.
        y: the other agent's scores, shape (S' seeds, K strata), or (S',).

    Source: Agarwal et al. 2021, section 4.3; Mann and Whitney 1947.
    """
    return float(_win_rate(*_pair(x, y)))


def probability_of_improvement_interval(
    x: ArrayLike, y: ArrayLike, *, level: float = 0.95, draws: int = RESAMPLES, seed: int = 0
) -> tuple[float, float] | None:
    """Return the stratified-bootstrap interval of :func:`probability_of_improvement`; None if x or y has one seed.

    Seeds of x and y are resampled independently. Where every run of x beats every run of y, the width is zero.
    """
    a, b = _pair(x, y)
    return percentiles([a, b], _win_rate, a.size * len(b), level, draws, seed)


def _pair(x: ArrayLike, y: ArrayLike) -> tuple[Scores, Scores]:
    a, b = by_seed("x", x), by_seed("y", y)
    if a.shape[1] != b.shape[1]:
        raise ConfigError(f"x has {a.shape[1]} strata and y {b.shape[1]}: expected the same strata in the same order.")
    return a, b


def _win_rate(x: Scores, y: Scores) -> Scores:
    """Return the share of pairs that x wins, ties half: shapes (..., S, K) and (..., S', K) to (...)."""
    # Signs are 1, 0, -1 for won, tied, lost.
    signs = np.sign(x[..., :, None, :] - y[..., None, :, :])
    return np.asarray((1 + signs.mean(axis=(-3, -2, -1))) / 2)


def resampled_means(scores: ArrayLike, *, draws: int = RESAMPLES, seed: int = 0) -> Scores:
    """Return bootstrap means over runs, shape (draws, K), for scores with shape (S runs, K), such as learning curves.

    Whole rows (runs) are drawn with replacement, so a run's K values stay together.
    """
    draws, rng = generator(0.95, draws, seed)
    table = by_seed("scores", scores)
    size = len(table)
    return np.asarray(rng.multinomial(size, np.full(size, 1 / size), size=draws) @ table / size)
