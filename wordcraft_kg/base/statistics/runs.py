"""What several seeds say of an agent, and of one agent against another."""

from collections.abc import Callable
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.base.statistics.samples import Scores, by_seed, finite, pair, percentiles


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
    values = finite("scores", scores)
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
    values = by_seed("scores", scores)
    return percentiles([values], lambda drawn: statistic(drawn, axis=(-2, -1)), values.size, level, draws, seed)


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
    return float(_win_rate(*pair(x, y)))


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
    a, b = pair(x, y)
    return percentiles([a, b], _win_rate, a.size * len(b), level, draws, seed)


def _win_rate(x: Scores, y: Scores) -> Scores:
    """Return the share of pairs that x wins, ties half: shapes (..., S, K) and (..., S', K) to (...)."""
    # Signs are 1, 0, -1 for won, tied, lost.
    signs = np.sign(x[..., :, None, :] - y[..., None, :, :])
    return np.asarray((1 + signs.mean(axis=(-3, -2, -1))) / 2)


def resampled_means(scores: ArrayLike, *, draws: int = 2000, seed: int = 0) -> Scores:
    """Return means over resampled runs: whole rows are drawn, so that what belongs to a run stays together.

    Args:
        scores: shape (S runs, K), such as the points of their learning curves.
        draws: resamples, from 1.
        seed: of the resampling.

    Returns:
        shape (draws, K), float.

    Raises:
        ConfigError: if scores are missing, not finite or of another shape, or a setting is out of range.
    """
    draws, seed = whole("draws", draws, 1, MAX_SIZE), whole("seed", seed, 0)
    table = by_seed("scores", scores)
    size = len(table)
    chosen = np.random.default_rng(seed).multinomial(size, np.full(size, 1 / size), size=draws)
    return np.asarray(chosen @ table / size)
