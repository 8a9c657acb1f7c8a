"""Integer id arrays, read-only or padded."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Ids = NDArray[np.int64]
"""Ids of entities, relations, recipes or pairs."""


def frozen(array: Ids) -> Ids:
    """Make an array read-only and return the same array.

    Graphs and splits hand out their own arrays; nobody can change them by accident.
    """
    array.flags.writeable = False
    return array


def sorted_unique(rows: Ids, columns: Sequence[int]) -> Ids:
    """Return the distinct rows, sorted.

    Args:
        rows: shape (n, k).
        columns: columns to sort by, the most important first; all k of them.

    Returns:
        Shape (m, k), contiguous.
    """
    # lexsort takes the most important key last.
    keys = [rows[:, column] for column in reversed(columns)]
    rows = rows[np.lexsort(keys)]
    # Before the first row stands a row that differs, so that the first row is new.
    before_first = rows[:1] - 1
    changes = np.diff(rows, axis=0, prepend=before_first)
    is_new = np.any(changes != 0, axis=1)
    return np.ascontiguousarray(rows[is_new])


def padded(rows: Sequence[Sequence[int]], padding: int, width: int = 0) -> Ids:
    """Stack rows with different lengths into an array.

    Args:
        rows: N rows of ids.
        padding: value after the end of a row; no legal id.
        width: smallest number of columns; more if a row is longer.

    Returns:
        Shape (N, columns).
    """
    columns = max([width, *map(len, rows)])
    array = np.full((len(rows), columns), padding, dtype=np.int64)
    for index, row in enumerate(rows):
        array[index, : len(row)] = row
    return array
