"""Bringing the scores of different scorers and relations to a common scale."""

import numpy as np
from numpy.typing import NDArray


def standardised(table: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return scores of all pairs, shape (E, E), with mean 0 and standard deviation 1 over pairs of different entities.

    An entity's score with itself is scaled too but has no say: self scores are often far off the others.
    """
    scores = np.asarray(table, dtype=np.float64)
    different = scores[~np.eye(len(scores), dtype=bool)]
    return np.asarray((scores - different.mean()) / (different.std() or 1.0))
