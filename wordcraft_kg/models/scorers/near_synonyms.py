"""Test recipes that reword a train recipe: an ingredient is replaced by a near-synonym.

A model may solve such recipes by synonyms alone, so reports show metrics with and without near-synonyms.
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
"""Cosine threshold for 50-d GloVe; generous: lake and river pass, but so do merely related pairs (day, night)."""


@stage("looking for near-synonyms")
def near_synonym_recipes(
    split: Split, features: EntityFeatures, threshold: float = NEAR_SYNONYM
) -> NDArray[np.bool_]:
    """Mask test recipes {a, b} -> c with a train recipe {a', b} -> c and cos(a, a') >= ``threshold``."""
    graph = split.graph
    unit = features.unit_vectors
    is_train = split.is_in("train")
    is_reworded = np.zeros(graph.num_recipes, dtype=bool)
    for index in np.flatnonzero(split.is_in("test")).tolist():
        a, b, result = graph.recipes[index].tolist()
        made = graph.recipes_of(result)
        x, y = graph.recipes[made[is_train[made]], :2].T
        near_a, near_b = ((unit[[x, y]] @ unit[entity] >= threshold) for entity in (a, b))
        is_same = (
            (x == a) & near_b[1]
            | (y == a) & near_b[0]
            | (x == b) & near_a[1]
            | (y == b) & near_a[0]
        )
        is_reworded[index] = np.any(is_same)
    return is_reworded


def near_synonym_triples(
    graph: RecipeGraph, recipes: NDArray[np.bool_], triples: Ids
) -> NDArray[np.bool_]:
    """Return a mask, (T,), for triples (T, 3) that a recipe in :func:`near_synonym_recipes` gives."""
    return is_in(triples, recipe_triples(graph.recipes[recipes]), graph.num_entities)
