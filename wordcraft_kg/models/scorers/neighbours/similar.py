"""Similarity of two entities, the atom of all features.

Compiled loops read the types of their arguments, so these are untyped: arrays and numbers.
See "Similar entities" in docs/explanation/recipe-scorer.md.
"""

from math import sqrt

import numpy as np

from wordcraft_kg.models.scorers.neighbours.compiled import in_place, product_of_rows

WORDS_WEIGHT = np.float32(0.2)
"""Weight of squared word cosines in the similarity, ``kernel.TEXT``."""


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
def alike_of(lists, entity, others, structure, kernels, cosines):  # type: ignore[no-untyped-def]
    """Write the similarities k and word cosines of an entity and others.

    Args:
        lists: the lists.
        entity: entity id.
        others: entity ids, shape (n,); negative for none.
        structure: work space, shape (T,): zeros before and after.
        kernels: receives the similarities, shape (n,); 0 for none.
        cosines: receives the word cosines, likewise.
    """
    # The branch is outside of the loop: within, numba would count references for each entity.
    if len(lists.kernels) > 0:
        for number in range(len(others)):
            candidate = others[number]
            kernels[number] = lists.kernels[entity, candidate] if candidate >= 0 else 0
            cosines[number] = lists.cosines[entity, candidate] if candidate >= 0 else 0
        return
    # Profile cosines in an array of all entities: reading them costs nothing then, where each
    # search in a list would miss a few branches.
    begin = lists.near.starts[entity]
    end = lists.near.starts[entity + 1]
    for place in range(begin, end):
        structure[lists.near.columns[place]] = lists.near.values[place]
    for number in range(len(others)):
        candidate = others[number]
        kernel = np.float32(0)
        cosine = np.float32(0)
        if candidate == entity:
            kernel = np.float32(1)
            cosine = np.float32(1)
        elif candidate >= 0:
            cosine = product(lists.vectors, lists.vectors, entity, candidate)
            norms = lists.norms[entity], lists.norms[candidate]
            kernel = similarity(structure[candidate], cosine, *norms)
        kernels[number] = kernel
        cosines[number] = cosine
    # Cleared where it was written: far fewer places than all T.
    for place in range(begin, end):
        structure[lists.near.columns[place]] = 0
