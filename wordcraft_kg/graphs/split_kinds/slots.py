"""A split that holds out what a result is made of: no (ingredient, result) of a test recipe occurs in train.

In a split by recipe nine of ten test recipes differ from a train recipe in one ingredient, so that counting who else
makes the result with the other one goes a long way. Here it does not.
"""

import numpy as np

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import Draw, SplitConfig, part_of_units


def slots(graph: RecipeGraph) -> Ids:
    """Return the group of each recipe: recipes that share an ingredient and the result are in one, and so on.

    They are the connected components of the recipes, two of which are linked if they share an (ingredient, result).
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    recipes = np.arange(graph.num_recipes)
    ingredient_a, ingredient_b, result = graph.recipes.T
    keys = np.concatenate([ingredient_a, ingredient_b]) * graph.num_entities + np.tile(result, 2)
    used, slot = np.unique(keys, return_inverse=True)
    size = graph.num_recipes + len(used)
    links = coo_array((np.ones(len(keys)), (np.tile(recipes, 2), graph.num_recipes + slot)), shape=(size, size))
    _, group = connected_components(links, directed=False)
    return np.unique(group[recipes], return_inverse=True)[1].astype(np.int64)


def by_slot(graph: RecipeGraph, config: SplitConfig, rng: np.random.Generator) -> Draw:
    """Hold out groups of recipes between which no result has an ingredient in common."""
    group = slots(graph)
    return Draw(part_of_units(group.max(initial=-1) + 1, config, rng)[group])
