"""Slices, named groups of values or goals: ranges of integers, and goals by another book.

A goal without a train recipe is unseen in its own book, but the other book may make it. Success on
such goals says nothing about goals that no book makes, so metrics show both groups.
"""

from collections.abc import Collection, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph

# Above any rank or count, and far below the limit of int64.
OPEN_END = 10**9
Bounds = Sequence[tuple[int, int]]


def binned(
    values: Ids, bounds: Bounds, *, more: str = "+"
) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Sort values into bins.

    Args:
        values: integers, shape (N,).
        bounds: lowest and highest value of each bin, both included; :data:`OPEN_END` for no upper
            bound.
        more: text after the lowest value in the name of a bin without an upper bound.

    Yields:
        The name of each bin, such as ``3–4`` or ``9+``, and a mask, shape (N,).
    """
    for low, high in bounds:
        if low == high:
            name = str(low)
        elif high == OPEN_END:
            name = f"{low}{more}"
        else:
            name = f"{low}–{high}"
        yield name, (values >= low) & (values <= high)


MADE = "goals that the other book makes"
NOT_MADE = "goals that the other book does not make"


def goal_groups(
    graph: RecipeGraph, goals: Ids, made: Collection[str] | None
) -> dict[str, NDArray[np.bool_]]:
    """Group goals by whether another book makes them.

    Args:
        graph: the recipe graph.
        goals: ids of the goals, shape (N,); a goal may occur several times.
        made: labels that the other book makes, see
            :attr:`~wordcraft_kg.models.model.History.made_by_other_books`; None without another
            book.

    Returns:
        A mask over ``goals`` for each group, shape (N,), by the group's name; empty if ``made`` is
        None.
    """
    if made is None:
        return {}
    # By label: the other book has ids of its own, and entities that this graph lacks.
    is_made = np.array([label in made for label in graph.labels(goals)], dtype=bool)
    return {MADE: is_made, NOT_MADE: ~is_made}
