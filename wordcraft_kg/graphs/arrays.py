"""Integer id arrays, read-only or padded."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Ids = NDArray[np.int64]


def frozen(array: Ids) -> Ids:
    """Make an array read-only and return the same array."""
    array.flags.writeable = False
    return array


def sorted_unique(rows: Ids, columns: Sequence[int]) -> Ids:
    """Return the distinct rows, shape (n, k), sorted by the given columns, the most important first."""
    rows = rows[np.lexsort([rows[:, column] for column in reversed(columns)])]
    is_new = np.any(np.diff(rows, axis=0, prepend=rows[:1] - 1) != 0, axis=1)
    return np.ascontiguousarray(rows[is_new])


def padded(rows: Sequence[Sequence[int]], padding: int, width: int = 0) -> Ids:
    """Stack rows with different lengths into an array, padded with ``padding`` to at least ``width`` columns."""
    width = max([width, *map(len, rows)])
    array = np.full((len(rows), width), padding, dtype=np.int64)
    for index, row in enumerate(rows):
        array[index, : len(row)] = row
    return array
