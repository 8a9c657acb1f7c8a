"""Test recipes that repeat a train recipe in other words: one ingredient replaced by a near-synonym.

A model that scores well on them may know synonyms rather than the world, so figures are shown with and without them.
"""

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.progress import stage
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.triples import is_in, recipe_triples
from wordcraft_kg.models.scorers.features import EntityFeatures

NEAR_SYNONYM = 0.7
"""Cosine from which two ingredients count as near-synonyms, for 50-d GloVe. It is generous: lake and river or bread and
cake are above it, but so are merely related pairs, such as day and night or chicken and egg."""


@stage("looking for near-synonyms")
def near_synonym_recipes(split: Split, features: EntityFeatures, threshold: float = NEAR_SYNONYM) -> NDArray[np.bool_]:
    """Return which test recipes repeat a train recipe but for one ingredient, a near-synonym: shape (num_recipes,).

    Test recipe {a, b} -> c counts if a train recipe {a', b} -> c exists with cos(a, a') >= ``threshold``, by the
    ``features`` of the graph's entities in id order.
    """
    graph = split.graph
    unit = features.unit_vectors
    is_train = split.is_in("train")
    found = np.zeros(graph.num_recipes, dtype=bool)
    for index in np.flatnonzero(split.is_in("test")).tolist():
        a, b, result = graph.recipes[index].tolist()
        made = graph.recipes_of(result)
        x, y = graph.recipes[made[is_train[made]], :2].T
        near_a, near_b = ((unit[[x, y]] @ unit[entity] >= threshold) for entity in (a, b))
        found[index] = np.any((x == a) & near_b[1] | (y == a) & near_b[0] | (x == b) & near_a[1] | (y == b) & near_a[0])
    return found


def near_synonym_triples(graph: RecipeGraph, recipes: NDArray[np.bool_], triples: Ids) -> NDArray[np.bool_]:
    """Return which triples come from one of the near-synonym recipes, shape (T,).

    A triple counts even if other test recipes give it too, so that the remaining triples have no such help at all.
    """
    return is_in(triples, recipe_triples(graph.recipes[recipes]), graph.num_entities)
