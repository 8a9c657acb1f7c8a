"""Integer id arrays, read-only or padded."""

import math
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
    if not len(rows):
        return np.ascontiguousarray(rows)
    # A row as one number, with a digit for each column: numbers are sorted several times faster
    # than rows.
    lowest = rows.min(axis=0)
    sizes = rows.max(axis=0) - lowest + 1
    if math.prod(sizes.tolist()) >= 2**63:
        return np.unique(rows[:, columns], axis=0)[:, np.argsort(columns)]
    keys = np.zeros(len(rows), dtype=np.int64)
    for column in columns:
        keys *= sizes[column]
        keys += rows[:, column] - lowest[column]
    keys.sort()
    is_new = np.ones(len(keys), dtype=bool)
    np.not_equal(keys[1:], keys[:-1], out=is_new[1:])
    keys = keys[is_new]
    distinct = np.empty((len(keys), rows.shape[1]), dtype=np.int64)
    # The least important digit comes off first.
    for column in reversed(columns):
        keys, digits = np.divmod(keys, sizes[column])
        distinct[:, column] = digits + lowest[column]
    return distinct


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
