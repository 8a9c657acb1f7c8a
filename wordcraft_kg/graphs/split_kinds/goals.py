"""Splits that hold out goals, with all their recipes."""

import numpy as np

from wordcraft_kg.base.errors import SplitError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import TEST, TRAIN, VALID, Draw, SplitConfig, part_of_units


def goals(graph: RecipeGraph) -> Ids:
    """Return the goal that each recipe makes."""
    return graph.recipes[:, 2]


def by_goal(graph: RecipeGraph, config: SplitConfig, rng: np.random.Generator) -> Draw:
    """Hold out goals: every recipe is in the part of its result."""
    made = np.unique(goals(graph))
    part_of = np.full(graph.num_entities, TRAIN, dtype=np.int8)
    part_of[made] = part_of_units(len(made), config, rng)
    return Draw(part_of[goals(graph)])


def by_goal_terminals(graph: RecipeGraph, config: SplitConfig, rng: np.random.Generator) -> Draw:
    """Hold out goals that are ingredients of something; terminal entities stay in train.

    The ratios count all goals, so the held-out parts are as large as those of by-goal.
    """
    made = np.unique(goals(graph))
    inner = made[graph.use_counts[made] > 0]
    num_held_out = len(made) - round(config.train_ratio * len(made))
    num_valid = round(config.valid_ratio * len(made))
    if num_held_out > len(inner):
        raise SplitError(
            f"{num_held_out} goals are to be held out but only {len(inner)} are not terminal; raise `train_ratio`."
        )
    held_out = rng.permutation(inner)[:num_held_out]
    part_of = np.full(graph.num_entities, TRAIN, dtype=np.int8)
    part_of[held_out[:num_valid]] = VALID
    part_of[held_out[num_valid:]] = TEST
    return Draw(part_of[goals(graph)])
