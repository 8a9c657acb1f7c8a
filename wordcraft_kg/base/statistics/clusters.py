"""The bootstrap of whole clusters, such as the queries of one recipe."""

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.progress import steps


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
