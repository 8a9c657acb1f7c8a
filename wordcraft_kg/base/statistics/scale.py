"""Scores of all pairs on a common scale."""

import numpy as np
from numpy.typing import NDArray


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
