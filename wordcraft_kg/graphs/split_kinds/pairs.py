"""Splits that hold out pairs, with all their results."""

import numpy as np

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import TRAIN, Draw, SplitConfig, part_of_units


def pairs(graph: RecipeGraph) -> Ids:
    """Return the pair of each recipe."""
    return graph.pair_of_recipe


def by_recipe_plain(graph: RecipeGraph, config: SplitConfig, rng: np.random.Generator) -> Draw:
    """Hold out whole pairs: all results of a pair stay on one side."""
    return Draw(part_of_units(graph.num_pairs, config, rng)[pairs(graph)])


def by_recipe(graph: RecipeGraph, config: SplitConfig, rng: np.random.Generator) -> Draw:
    """Hold out pairs; then, for each entity that train lacks, move a random pair of it, until train covers them all.

    Source: Jiang et al. 2020, section "Link Prediction Model": "a subgraph ... containing all nodes".
    """
    parts = by_recipe_plain(graph, config, rng).parts.copy()
    covered = np.zeros(graph.num_entities, dtype=bool)
    covered[graph.recipes[parts == TRAIN]] = True
    moved = 0
    for entity in np.flatnonzero(~covered).tolist():
        if covered[entity]:
            continue
        around = np.concatenate([graph.recipes_of(entity), graph.uses_of(entity)])
        if not len(around):
            continue  # in no recipe at all: nothing can cover it
        pair = graph.pair_of_recipe[rng.choice(around)]
        rows = slice(graph.pair_starts[pair], graph.pair_starts[pair + 1])
        parts[rows] = TRAIN
        covered[graph.recipes[rows]] = True
        moved += rows.stop - rows.start
    return Draw(parts, int(moved))
