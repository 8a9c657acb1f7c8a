"""No split at all."""

import numpy as np

from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import TRAIN, Draw, SplitConfig


def none(graph: RecipeGraph, config: SplitConfig, rng: np.random.Generator) -> Draw:
    """Keep everything in train: for the full knowledge graph only."""
    return Draw(np.full(graph.num_recipes, TRAIN, dtype=np.int8))
