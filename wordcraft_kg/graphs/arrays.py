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


def distinct(numbers: Ids) -> Ids:
    """Return the distinct numbers in ascending order, as ``np.unique`` does, shape (m,).

    Sorting takes a tenth of the time of the hash table that NumPy uses since version 2.3.

    Args:
        numbers: shape (n,).
    """
    ordered = np.sort(numbers)
    is_new = np.ones(len(ordered), dtype=bool)
    np.not_equal(ordered[1:], ordered[:-1], out=is_new[1:])
    return ordered[is_new]


def absent(ids: Ids, size: int) -> Ids:
    """Return the ids below ``size`` that are not among the given ones, ascending.

    Counting is many times faster than ``np.setdiff1d``, which hashes or sorts.

    Args:
        ids: shape (n,), ids from 0 to ``size`` - 1 in any order, perhaps repeated.
        size: number of all ids.
    """
    return np.flatnonzero(np.bincount(ids, minlength=size) == 0)


def are_among(numbers: Ids, known: Ids) -> NDArray[np.bool_]:
    """Return which numbers are among the known ones, with the shape of ``numbers``.

    Binary search is several times faster here than ``np.isin``, which hashes.

    Args:
        numbers: any shape.
        known: shape (n,), in ascending order.
    """
    if not len(known):
        return np.zeros(numbers.shape, dtype=bool)
    place = np.searchsorted(known, numbers)
    # A number above all others has a place behind the end; the last one differs from it.
    place = np.minimum(place, len(known) - 1)
    return np.asarray(known[place] == numbers)


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
    # In Python's integers, which do not overflow.
    num_keys = math.prod(sizes.tolist())
    if num_keys >= 2**63:
        by_columns = np.unique(rows[:, columns], axis=0)
        # Back to the order of columns in which the rows came.
        own_order = np.argsort(columns)
        return np.ascontiguousarray(by_columns[:, own_order])
    keys = np.zeros(len(rows), dtype=np.int64)
    for column in columns:
        keys *= sizes[column]
        keys += rows[:, column] - lowest[column]
    keys = distinct(keys)
    unique = np.empty((len(keys), rows.shape[1]), dtype=np.int64)
    # The least important digit comes off first.
    for column in reversed(columns):
        keys, digits = np.divmod(keys, sizes[column])
        unique[:, column] = digits + lowest[column]
    return unique


def recipe_keys(a: Ids, b: Ids, result: Ids, *, num_entities: int) -> Ids:
    """Encode recipes as numbers, whatever the order of their ingredients.

    Numbers sort like rows with the smaller ingredient first; they are exact up to 2 million
    entities.

    Args:
        a: ids of an ingredient.
        b: ids of the other one.
        result: ids of what they make; the three arrays broadcast.
        num_entities: number of entities in the graph.

    Returns:
        The broadcast shape.
    """
    smaller = np.minimum(a, b)
    larger = np.maximum(a, b)
    return np.asarray((smaller * num_entities + larger) * num_entities + result)


def padded(rows: Sequence[Sequence[int]], padding: int, width: int = 0) -> Ids:
    """Stack rows with different lengths into an array.

    Args:
        rows: N rows of ids.
        padding: value after the end of a row; no legal id.
        width: smallest number of columns; more if a row is longer.

    Returns:
        Shape (N, columns).
    """
    longest = max(map(len, rows), default=0)
    shape = (len(rows), max(width, longest))
    array = np.full(shape, padding, dtype=np.int64)
    for index, row in enumerate(rows):
        array[index, : len(row)] = row
    return array
