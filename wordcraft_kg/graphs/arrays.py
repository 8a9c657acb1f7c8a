"""Id arrays."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Ids = NDArray[np.int64]


def frozen(array: Ids) -> Ids:
    """Make an array read-only and return it."""
    array.flags.writeable = False
    return array


def padded(rows: Sequence[Sequence[int]], padding: int, width: int = 0) -> Ids:
    """Return rows with different lengths as one array, at least ``width`` wide."""
    width = max([width, *map(len, rows)])
    array = np.full((len(rows), width), padding, dtype=np.int64)
    for index, row in enumerate(rows):
        array[index, : len(row)] = row
    return array
