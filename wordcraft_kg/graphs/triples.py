"""A recipe graph's two relations, and triples (head, relation, tail) as id arrays."""

import hashlib
from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.graphs.arrays import Ids, sorted_unique

COMBINES_WITH = 0
"""Id of the relation ``combinesWith``: head and tail are the ingredients of a recipe; symmetric."""
COMPONENT_OF = 1
"""Id of the relation ``componentOf``: the head is an ingredient of a recipe with the tail as result."""
Relation = Literal["combinesWith", "componentOf"]
RELATIONS: tuple[Relation, Relation] = ("combinesWith", "componentOf")
"""Labels of the relations, in id order."""


def recipe_triples(recipes: Ids) -> Ids:
    """Convert recipes, ids of shape (N, 3), to unique triples, shape (T, 3), sorted by relation, head, tail.

    ``{a, b} -> c`` gives (a, combinesWith, b), (b, combinesWith, a), (a, componentOf, c) and (b, componentOf, c).

    Source: Jiang et al. 2020, section "Link Prediction Model"; the fourth triple there is misprinted as
    (b, componentOf, b).
    """
    a, b, result = recipes.T
    heads = np.concatenate([a, b, a, b])
    tails = np.concatenate([b, a, result, result])
    relations = np.repeat([COMBINES_WITH, COMPONENT_OF], 2 * len(recipes))
    return sorted_unique(np.column_stack([heads, relations, tails]), (1, 0, 2))


def triple_keys(triples: Ids, num_entities: int) -> Ids:
    """Encode each triple as a unique int64 that sorts like (relation, head, tail), shape (T,)."""
    head, relation, tail = triples.T
    return (relation * num_entities + head) * num_entities + tail


def triples_hash(triples: Ids) -> str:
    """Return the SHA-256 hash of triples in the given order, in hexadecimal."""
    return hashlib.sha256(np.ascontiguousarray(triples, dtype="<i8").tobytes()).hexdigest()


def is_in(triples: Ids, others: Ids, num_entities: int) -> NDArray[np.bool_]:
    """Mark the triples that ``others`` contains; bool, shape (T,)."""
    if not len(others):
        return np.zeros(len(triples), dtype=bool)
    # Binary search in sorted keys: several times faster here than np.isin, which hashes.
    keys, known = triple_keys(triples, num_entities), np.sort(triple_keys(others, num_entities))
    return known[np.minimum(np.searchsorted(known, keys), len(known) - 1)] == keys


def triple_lines(triples: Ids, entities: Sequence[str]) -> Iterator[str]:
    """Yield a line ``head<TAB>relation<TAB>tail`` with labels for each triple."""
    columns = (column.tolist() for column in triples.T)
    return (
        f"{entities[head]}\t{RELATIONS[relation]}\t{entities[tail]}\n"
        for head, relation, tail in zip(*columns, strict=True)
    )
