"""How the results of single trainings are spread: the shares of runs above each level."""

import numpy as np
from numpy.typing import ArrayLike

from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.base.statistics.samples import Scores, by_seed, check_level, finite


def performance_profile(scores: ArrayLike, taus: ArrayLike) -> Scores:
    """Return the share of runs whose score is above each tau, the mean over strata.

    ``F(tau) = 1/K sum_k 1/S sum_i [s_ik > tau]``. It shows what a mean hides, such as runs that failed; the area under
    it is the mean, for scores from 0 to 1 and all taus between.

    Args:
        scores: shape (S seeds, K strata), or (S,) for one stratum: one training each.
        taus: shape (T,).

    Returns:
        shape (T,), float, not increasing with tau.

    Raises:
        ConfigError: if scores or taus are missing, not finite or of another shape.

    Source: Agarwal et al. 2021, section 4.2 (their score distributions).
    """
    above = by_seed("scores", scores)[..., None] > finite("taus", taus).ravel()
    return np.asarray(above.mean(axis=(0, 1)))


def performance_profile_band(
    scores: ArrayLike, taus: ArrayLike, *, level: float = 0.95, draws: int = 2000, seed: int = 0
) -> Scores | None:
    """Return the bounds of :func:`performance_profile` at each tau, resampling seeds within each stratum.

    The band holds at each tau on its own, not for all of them at once. How many of a stratum's S resampled scores are
    above tau is binomial, so it is drawn as such.

    Args:
        scores: shape (S seeds, K strata), or (S,) for one stratum.
        taus: shape (T,).
        level: of confidence, between 0 and 1.
        draws: resamples, from 1.
        seed: of the resampling.

    Returns:
        shape (2, T): lower and upper bounds; None for a single seed.

    Raises:
        ConfigError: as :func:`performance_profile`, and for a setting out of range.
    """
    check_level(level)
    draws, seed = whole("draws", draws, 1, MAX_SIZE), whole("seed", seed, 0)
    values, levels = by_seed("scores", scores), finite("taus", taus).ravel()
    if len(values) == 1:
        return None
    rng = np.random.default_rng(seed)
    shares = (values[..., None] > levels).mean(axis=0)
    # One tau after the other, so that the memory does not grow with their number; neighbours mostly agree.
    bounds = np.empty((2, len(levels)))
    for t in range(len(levels)):
        if t and np.array_equal(shares[:, t], shares[:, t - 1]):
            bounds[:, t] = bounds[:, t - 1]
        else:
            above = rng.binomial(len(values), shares[:, t], size=(draws, values.shape[1])).sum(axis=1)
            bounds[:, t] = np.quantile(above / values.size, [(1 - level) / 2, (1 + level) / 2])
    return bounds
