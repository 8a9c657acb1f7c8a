"""A recipe graph's two relations, and triples (head, relation, tail) as id arrays."""

import hashlib
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.graphs.arrays import Ids, are_among, row_text, sorted_unique

COMBINES_WITH = 0
"""Id of the relation ``combinesWith``: head and tail are ingredients of one recipe; symmetric."""
COMPONENT_OF = 1
"""Id of the relation ``componentOf``: the head is an ingredient of a recipe for the tail."""
Relation = Literal["combinesWith", "componentOf"]
"""Label of a relation, as in files."""
RELATIONS: tuple[Relation, Relation] = ("combinesWith", "componentOf")
"""Labels of the relations, in id order."""


def recipe_triples(recipes: Ids, padding: int | None = None) -> Ids:
    """Convert recipes to triples, four for a recipe of two ingredients, with duplicates merged.

    ``{a, b} -> c`` gives (a, combinesWith, b), (b, combinesWith, a), (a, componentOf, c) and
    (b, componentOf, c). In a larger set each pair of ingredients is combined; a set of one has
    nothing to combine.

    Args:
        recipes: shape (N, columns), rows (ingredients, padding, result) of entity ids.
        padding: value after the last ingredient; None if all recipes have as many ingredients.

    Returns:
        Shape (T, 3), rows (head, relation, tail), sorted by relation, head, tail.

    Source: Jiang et al. 2020, section "Link Prediction Model"; the fourth triple there is
    misprinted as (b, componentOf, b).
    """
    return sorted_unique(triples_by_recipe(recipes, padding)[1], (1, 0, 2))


def triples_by_recipe(recipes: Ids, padding: int | None = None) -> tuple[Ids, Ids]:
    """Return the triples of each recipe, in no fixed order.

    Args:
        recipes: as in :func:`recipe_triples`.
        padding: as in :func:`recipe_triples`.

    Returns:
        Row numbers of recipes, shape (M,), and a triple for each, shape (M, 3), some repeatedly.
    """
    *ingredients, result = recipes.T
    every_row = np.arange(len(recipes))
    links = [(COMPONENT_OF, first_ingredient, result) for first_ingredient in ingredients]
    for first_ingredient, second_ingredient in combinations(ingredients, 2):
        links += [
            (COMBINES_WITH, first_ingredient, second_ingredient),
            (COMBINES_WITH, second_ingredient, first_ingredient),
        ]
    rows = []
    triples = []
    for relation, heads, tails in links:
        triple = np.column_stack([heads, np.full_like(heads, relation), tails])
        # A table of pairs alone has no padding, and needs no copy without it.
        is_real = np.True_ if padding is None else (heads != padding) & (tails != padding)
        has_padding = not np.all(is_real)
        rows.append(every_row[is_real] if has_padding else every_row)
        triples.append(triple[is_real] if has_padding else triple)
    return np.concatenate(rows), np.concatenate(triples)


def triple_keys(triples: Ids, num_entities: int) -> Ids:
    """Encode each triple as a unique int64 that sorts like (relation, head, tail).

    Args:
        triples: shape (T, 3).
        num_entities: number of entities in the graph.

    Returns:
        Shape (T,).
    """
    # Digits to the base num_entities: no overflow below 2 billion entities.
    head, relation, tail = triples.T
    return (relation * num_entities + head) * num_entities + tail


def triples_hash(triples: Ids) -> str:
    """Return the SHA-256 hash of triples in the given order, in hexadecimal."""
    # Little-endian integers of eight bytes on any machine.
    return hashlib.sha256(np.ascontiguousarray(triples, dtype="<i8").tobytes()).hexdigest()


def is_in(
    triples: Ids,
    others: Ids,
    num_entities: int,
) -> NDArray[np.bool_]:
    """Mark the triples that are among others.

    Args:
        triples: shape (T, 3).
        others: shape (S, 3).
        num_entities: number of entities in the graph.

    Returns:
        Bool, shape (T,).
    """
    sorted_keys = np.sort(triple_keys(others, num_entities))
    return are_among(triple_keys(triples, num_entities), sorted_keys)


def triple_lines(triples: Ids, entities: Sequence[str]) -> Iterator[str]:
    """Yield the lines ``head<TAB>relation<TAB>tail`` of triples, with labels, in pieces.

    Args:
        triples: shape (T, 3).
        entities: labels by id.
    """
    # The cells before the tail: each head with one relation, then each head with the other.
    beginnings: list[str] = []
    for name in RELATIONS:
        beginnings += [f"{label}\t{name}\t" for label in entities]
    ends = [f"{label}\n" for label in entities]
    head, relation, tail = triples.T
    # Places of a triple's two cells, shape (T, 2).
    beginning = relation * len(entities) + head
    rows = np.column_stack([beginning, tail])
    yield from row_text(rows, (beginnings, ends))
