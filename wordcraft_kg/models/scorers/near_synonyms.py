"""Test recipes that reword a train recipe: an ingredient is replaced by a near-synonym.

A model may solve such recipes by synonyms alone, so reports show metrics with and without
near-synonyms.

The page docs/explanation/leaks.md says what such recipes mean for a split.
"""

from collections import defaultdict
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.progress import stage
from wordcraft_kg.graphs import Ids, RecipeGraph, Split, is_in
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

    A test recipe {a, b} -> c counts if a train recipe {a', b} -> c has cos(a, a') >= ``threshold``;
    in larger sets, all other ingredients are equal.

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
    recipes = graph.sets.tolist()
    # The ingredients that complete a train recipe, by the rest of it.
    completions: defaultdict[tuple[int, ...], list[int]] = defaultdict(list)
    for row in np.flatnonzero(is_train).tolist():
        for ingredient, recipe_rest in _without_each(recipes[row], graph.num_entities):
            completions[recipe_rest].append(ingredient)
    is_reworded = np.zeros(graph.num_recipes, dtype=bool)
    for row in np.flatnonzero(split.is_in("test")).tolist():
        for ingredient, recipe_rest in _without_each(recipes[row], graph.num_entities):
            cosines = unit[completions.get(recipe_rest, [])] @ unit[ingredient]
            is_reworded[row] |= bool((cosines >= threshold).any())
    return is_reworded


def _without_each(recipe: list[int], padding: int) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Yield each ingredient of a recipe of ids, and the recipe without it."""
    for place, ingredient in enumerate(recipe[:-1]):
        if ingredient != padding:
            yield ingredient, (*recipe[:place], *recipe[place + 1 :])


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
    recipe_triples = graph.triples_by_recipe(recipes)[1]
    return is_in(triples, recipe_triples, graph.num_entities)
