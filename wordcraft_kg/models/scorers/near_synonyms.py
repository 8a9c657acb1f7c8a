"""Test recipes that reword a train recipe: an ingredient is replaced by a near-synonym.

A model may solve such recipes by synonyms alone, so reports show metrics with and without
near-synonyms.

The page docs/explanation/leaks.md says what such recipes mean for a split.
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
"""Cosine threshold for 50-d GloVe.

Generous: lake and river pass, but so do merely related pairs such as day and night.
"""


@stage("looking for near-synonyms")
def near_synonym_recipes(
    split: Split,
    features: EntityFeatures,
    threshold: float = NEAR_SYNONYM,
) -> NDArray[np.bool_]:
    """Return which test recipes differ from a train recipe in one ingredient alone, a near-synonym.

    A test recipe {a, b} -> c counts if a train recipe {a', b} -> c has cos(a, a') >= ``threshold``.

    Args:
        split: split whose test and train recipes are compared.
        features: features of the graph's entities, in id order.
        threshold: cosine from which two ingredients are near-synonyms.

    Returns:
        shape (num_recipes,), bool, in the graph's order; False outside the test part.
    """
    graph = split.graph
    unit = features.unit_vectors
    is_train = split.is_in("train")
    is_reworded = np.zeros(graph.num_recipes, dtype=bool)
    for index in np.flatnonzero(split.is_in("test")).tolist():
        a, b, result = graph.recipes[index].tolist()
        # Ingredients x and y of the train recipes with the same result.
        made = graph.recipes_of(result)
        x, y = graph.recipes[made[is_train[made]], :2].T
        # Row 0: whether x is near; row 1: whether y is.
        near_a = unit[[x, y]] @ unit[a] >= threshold
        near_b = unit[[x, y]] @ unit[b] >= threshold
        # One ingredient is kept, in either place, and the other one is near.
        is_same = (
            (x == a) & near_b[1]
            | (y == a) & near_b[0]
            | (x == b) & near_a[1]
            | (y == b) & near_a[0]
        )
        is_reworded[index] = np.any(is_same)
    return is_reworded


def near_synonym_triples(
    graph: RecipeGraph,
    recipes: NDArray[np.bool_],
    triples: Ids,
) -> NDArray[np.bool_]:
    """Return which triples come from a near-synonym recipe.

    A triple counts even if other test recipes give it too, so that the remaining triples have no
    such help at all.

    Args:
        graph: the graph that the ids belong to.
        recipes: shape (num_recipes,), bool, from :func:`near_synonym_recipes`.
        triples: ids of shape (T, 3).

    Returns:
        shape (T,), bool.
    """
    return is_in(triples, recipe_triples(graph.recipes[recipes]), graph.num_entities)
