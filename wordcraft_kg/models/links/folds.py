"""Holding out a part of the train recipes, to choose settings on; the other parts of the split are never looked at."""

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import Split, SplitConfig, make_split


def split_of_train(split: Split, held_out: float, seed: int, recipes: Ids | None = None) -> Split:
    """Split the train recipes once more, in the way that the whole graph was split.

    Args:
        split: the split whose train recipes are taken.
        held_out: share of their pairs, or goals, to hold out as the test part of the result.
        seed: seed of the draw.
        recipes: those to split instead of all train recipes, shape (n, 3).

    Returns:
        a split of a graph that has these recipes and, with the same ids, all entities.

    Raises:
        SplitError: if a part is empty because there are too few train recipes.
    """
    recipes = split.recipes("train") if recipes is None else recipes
    graph = RecipeGraph(split.graph.entities, recipes, split.graph.base_ids, split.graph.name)
    return make_split(graph, SplitConfig(split.config.kind, train_ratio=1 - held_out, seed=seed))
