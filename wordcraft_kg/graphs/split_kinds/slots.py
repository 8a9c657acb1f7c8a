"""A split that holds out what a result is made of: no (ingredient, result) of a test recipe occurs in train.

In a split by recipe nine of ten test recipes differ from a train recipe in one ingredient, so that counting who else
makes the result with the other one goes a long way. Here it does not.

Most goals are one group of recipes that hang together, so this split is nearly one by goal: on the built-in everyday
book 34 % of the test goals have another group in train, on Little Alchemy 2 15 %. To hold out groups of goals with
several of them first raises that to 100 and 65 %, but was not taken. Such goals are few, so different seeds share half
of their test part; a goal with unlike ways of being made is an odd one, on which word vectors find less than on
whole new goals; and train keeps next to no goal with two groups, so that no part of it could be held out in the same
way, as choosing settings and cross-fitting do.
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
    """Hold out groups of recipes: every recipe is in the part of its group, see :func:`slots`."""
    group = slots(graph)
    return Draw(part_of_units(group.max(initial=-1) + 1, config, rng)[group])
