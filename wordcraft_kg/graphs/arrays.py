"""Integer id arrays, read-only or padded."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain

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
    ordered_columns = rows[:, columns]
    # Numbers are sorted several times faster than rows.
    keys = row_keys(ordered_columns - ordered_columns.min(axis=0))
    _, first_rows = np.unique(keys, return_index=True)
    return np.ascontiguousarray(rows[first_rows])


def row_keys(rows: Ids) -> Ids:
    """Number rows of ids: equal rows have equal numbers, and numbers sort like the rows.

    Numbers of different calls cannot be compared.

    Args:
        rows: shape (n, k), with k columns of ids from 0, the most important first.

    Returns:
        Shape (n,).
    """
    keys = np.zeros(len(rows), dtype=np.int64)
    num_keys = 1  # in Python's integers, which do not overflow
    for column in rows.T:
        size = int(column.max(initial=0)) + 1
        if num_keys * size >= 2**63:
            # Ranks keep the order, and take fewer digits.
            _, keys = np.unique(keys, return_inverse=True)
            num_keys = int(keys.max(initial=0)) + 1
        keys = keys * size + column
        num_keys *= size
    return keys


def stacked(ids: Ids, lengths: Sequence[int], padding: int) -> Ids:
    """Stack recipes of different lengths into rows (ingredients, padding, result).

    Args:
        ids: the ids of all recipes, one behind the other; the last of each is the result.
        lengths: number of ids of each recipe, at least 2.
        padding: value after the last ingredient; no legal id.

    Returns:
        Shape (len(lengths), columns), with three columns at least.
    """
    if lengths.count(3) == len(lengths):
        return ids.reshape(-1, 3)
    num_ids = np.array(lengths, dtype=np.int64)
    rows = np.arange(len(num_ids))
    table = np.full((len(num_ids), max(int(num_ids.max()), 3)), padding, dtype=np.int64)
    ends = np.cumsum(num_ids)
    columns = np.arange(len(ids)) - np.repeat(ends - num_ids, num_ids)
    table[np.repeat(rows, num_ids), columns] = ids
    # The result moves from behind the last ingredient to the last column.
    table[rows, num_ids - 1] = padding
    table[:, -1] = ids[ends - 1]
    return table


def without_empty_columns(recipes: Ids, padding: int) -> Ids:
    """Return recipes without columns of padding alone; two columns of ingredients stay.

    Args:
        recipes: shape (n, columns), rows (ingredients, padding, result).
        padding: value after the last ingredient.
    """
    while recipes.shape[1] > 3 and bool(np.all(recipes[:, -2] == padding)):
        recipes = np.delete(recipes, -2, axis=1)
    return recipes


def different_ingredients(recipes: Ids, padding: int) -> tuple[Ids, Ids]:
    """Return the different ingredients of recipes: row numbers, and an ingredient for each.

    Args:
        recipes: shape (n, columns), rows (ingredients, padding, result), ingredients ascending.
        padding: value after the last ingredient.

    Returns:
        Two arrays of one length, by column and then by row.
    """
    first, *later_columns = recipes[:, :-1].T
    rows = [np.arange(len(recipes))]
    entities = [first]
    before = first
    for column in later_columns:
        # Equal ingredients are neighbours, as they are sorted.
        is_new = (column != before) & (column != padding)
        rows.append(rows[0][is_new])
        entities.append(column[is_new])
        before = column
    return np.concatenate(rows), np.concatenate(entities)


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
    array = np.full((len(rows), max(width, longest)), padding, dtype=np.int64)
    for index, row in enumerate(rows):
        array[index, : len(row)] = row
    return array


_PIECE = 2**13  # rows in a piece of text: its arrays fit into a processor's cache


def row_text(rows: Ids, columns: Sequence[Iterable[str]]) -> Iterator[str]:
    r"""Yield the text of rows in pieces of many rows.

    Args:
        rows: shape (n, k), ids.
        columns: k times the text of each id, with delimiters and line ends.

    Example:
        >>> labels = ["earth", "mud", "water"]
        >>> columns = [f"{label}," for label in labels], [f"{label}\n" for label in labels]
        >>> "".join(row_text(np.array([[0, 1], [2, 1]]), columns))
        'earth,mud\nwater,mud\n'
    """
    tables = [list(column) for column in columns]
    for first in range(0, len(rows), _PIECE):
        ids = rows[first : first + _PIECE].T.tolist()
        cells = [map(texts.__getitem__, column) for texts, column in zip(tables, ids, strict=True)]
        yield "".join(chain.from_iterable(zip(*cells, strict=True)))


def json_recipes(recipes: Ids, texts: Sequence[str]) -> Iterator[str]:
    """Yield the lines of a JSON array of recipes, with a comma between two of them.

    Args:
        recipes: shape (n, columns), rows (ingredients, padding, result) of ids; the padding after
            the last ingredient is the number of texts.
        texts: each entity's label as JSON.
    """
    if not len(recipes):
        return
    first = [f"[{text}, " for text in texts]
    middle_texts = [*(f"{text}, " for text in texts), ""]
    last = [f"{text}],\n" for text in texts]
    columns = [first, *[middle_texts] * (recipes.shape[1] - 2), last]
    yield from row_text(recipes[:-1], columns)
    labels = [texts[entity] for entity in recipes[-1].tolist() if entity < len(texts)]
    yield f"[{', '.join(labels)}]\n"
