"""Similarity of two entities, the atom of all features.

See "Similar entities" in docs/explanation/recipe-scorer.md.
"""

from math import sqrt
from typing import Any

import numpy as np

from wordcraft_kg.models.scorers.neighbours.compiled import in_place, product_of_rows

Array = Any
"""Compiled loops read the types of their arguments, so these are untyped: arrays and numbers."""

WORDS_WEIGHT = np.float32(0.2)
"""Weight of squared word cosines in the similarity, ``kernel.TEXT``."""


@product_of_rows
def dot(vectors, one, other):  # type: ignore[no-untyped-def]
    """Return the product of two rows of a matrix.

    Args:
        vectors: shape (T, D).
        one: number of a row.
        other: number of the other row.
    """
    total = np.float32(0)
    for place in range(vectors.shape[1]):
        total += vectors[one, place] * vectors[other, place]
    return total


@product_of_rows
def product(left, right, one, other):  # type: ignore[no-untyped-def]
    """Return the product of a row of ``left`` and a row of ``right``.

    Args:
        left: shape (T, m).
        right: shape (T, m).
        one: row of ``left``.
        other: row of ``right``.
    """
    total = np.float32(0)
    for place in range(left.shape[1]):
        total += left[one, place] * right[other, place]
    return total


@in_place
def similarity(structure, words, norm, other_norm):  # type: ignore[no-untyped-def]
    """Return the similarity k of two different entities, float32, from 0 to 1.

    ``k = (structure + .2 max(0, words)²) / √(norm other_norm)``, clamped before the square, because
    the square of a negative cosine would count as similarity.

    Args:
        structure: cosine of their profiles, 0 if neither is in the other's list.
        words: cosine of their word vectors.
        norm: similarity of the first entity with itself: 1.2 with recipes, .2 without.
        other_norm: similarity of the second entity with itself.
    """
    positive = max(words, np.float32(0))
    # Rounding can lift the similarity of equal profiles above 1.
    value = (structure + WORDS_WEIGHT * positive * positive) / sqrt(norm * other_norm)
    return min(np.float32(value), np.float32(1))


@in_place
def fourth(words):  # type: ignore[no-untyped-def]
    """Return a positive word cosine to the power 4, so that only near synonyms count; else 0."""
    square = words * words if words > 0 else np.float32(0)
    return square * square


@in_place
def spread(lists, entity, structure):  # type: ignore[no-untyped-def]
    """Write an entity's profile cosines into an array of all entities, zeros before.

    Reading them costs nothing then, where each search in a list would miss a few branches. Where
    similarities of all entities are kept, nobody reads them.

    Args:
        lists: the lists.
        entity: entity id.
        structure: shape (T,): zeros before, the entity's profile cosines after.
    """
    if len(lists.kernels) > 0:
        return
    for place in range(lists.near_starts[entity], lists.near_starts[entity + 1]):
        structure[lists.near[place]] = lists.near_cosines[place]


@in_place
def clear(lists, entity, structure):  # type: ignore[no-untyped-def]
    """Write zeros where :func:`spread` wrote: far fewer places than all T.

    Args:
        lists: the lists.
        entity: the entity that was spread.
        structure: shape (T,): zeros after.
    """
    if len(lists.kernels) > 0:
        return
    for place in range(lists.near_starts[entity], lists.near_starts[entity + 1]):
        structure[lists.near[place]] = 0
