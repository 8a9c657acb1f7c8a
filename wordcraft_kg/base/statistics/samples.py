"""Validation, resampling and scaling for tables of scores."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.progress import steps
from wordcraft_kg.base.settings import MAX_SIZE, refuse, whole

Interval = tuple[float, float, float]
"""An estimate and its interval: value, lower bound, upper bound."""
Scores = NDArray[np.float64]
RESAMPLES = 2_000
"""Bootstrap resamples, and with seed 0 the same everywhere: a metric has the same interval in every report."""
CHUNK = 2**20  # values held at once while resampling, 8 MB


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


def interval(means: Scores, level: float = 0.95) -> tuple[float, float]:
    """Return the percentile interval (lower and upper bound) at confidence ``level`` from bootstrap means."""
    low, high = np.quantile(means, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def generator(level: float, draws: int, seed: int) -> tuple[int, np.random.Generator]:
    """Check the settings for a bootstrap; return the number of draws and a random generator for the seed."""
    check_level(level)
    return whole("draws", draws, 1, MAX_SIZE), np.random.default_rng(whole("seed", seed, 0))


def check_level(level: float) -> None:
    """Raise a ConfigError unless the confidence level is above 0 and below 1."""
    if not 0 < level < 1:
        raise refuse("level", level, "more than 0 and less than 1, such as 0.95")


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
