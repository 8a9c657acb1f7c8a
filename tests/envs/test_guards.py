"""Guarded recipes against sets and loops."""

import numpy as np
import pytest

from wordcraft_kg.envs.arrays import arrays_of
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.guards import BITS, Guards
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split
from wordcraft_kg.graphs.folder import OpenedGraph


@pytest.fixture(scope="module", params=["train", "no_shortcut"])
def world(request):
    """Goals with more recipes than one table of marks holds, and self pairs among them."""
    rows = np.random.default_rng(1).integers(0, [30, 30, 24], size=(440, 3)).tolist()
    graph = RecipeGraph.from_recipes([tuple(f"e{entity:02d}" for entity in row) for row in rows])
    opened = OpenedGraph(graph, make_split(graph, SplitConfig("by-recipe-plain", train_ratio=0.4)), "dense")
    if request.param == "train":
        return World(opened, WordCraftConfig(part="train"))
    return World(opened, WordCraftConfig(part="all", distractor_policy="no_shortcut"))


def guarded(world, task):
    """The guarded recipes of a task's goal, and what is there or can be made without distractors."""
    recipes = world.graph.recipes[world.guarded_recipes]
    pairs = recipes[recipes[:, 2] == world.tasks.goals[task], :2].tolist()
    near = {*world.tasks.starts[task].tolist(), *world.makeable[task].tolist()} - {world.nothing}
    return pairs, near


def complete(pairs, entities):
    return {(a, b) for a, b in pairs if a in entities and b in entities}


@pytest.mark.parametrize("device", ["cpu", "torch:cpu"])
def test_candidates_are_refused_that_complete_a_guarded_recipe(world, device):
    arrays = arrays_of(device)
    guards, rng = Guards(world, arrays), np.random.default_rng(0)
    tasks = rng.integers(len(world.tasks), size=300)
    candidates = np.stack([rng.permutation(world.nothing)[:4] for _ in tasks], axis=1)
    allowed = rng.random(candidates.shape) < 0.8
    risk = arrays.numpy(guards.at_risk(arrays.array(candidates), arrays.array(tasks)))
    found = arrays.numpy(guards.refuse(arrays.array(candidates), arrays.array(allowed.copy()), arrays.array(tasks)))
    assert guards
    refused = safe = exact = most = 0
    for column, task in enumerate(tasks.tolist()):
        pairs, there = guarded(world, task)
        most = max(most, len(pairs))
        drawn = candidates[:, column].tolist()
        if complete(pairs, there | set(drawn)) - complete(pairs, there):
            assert risk[column]
        safe += not risk[column]
        for i, entity in enumerate(drawn):
            closes = bool(complete(pairs, there | {entity}) - complete(pairs, there))
            if len(pairs) <= BITS:
                assert found[i, column] == (allowed[i, column] and not closes)
            else:  # several tables of marks may refuse too many, never too few
                assert not found[i, column] or (allowed[i, column] and not closes)
            exact += len(pairs) <= BITS
            refused += closes
            if found[i, column]:
                there = there | {entity}
    assert most > BITS
    assert min(refused, safe, exact) > 10


def test_nothing_is_at_risk_where_nothing_is_guarded(world):
    free = world.variant(part="all", distractor_policy="any")
    guards = Guards(free, arrays_of("cpu"))
    assert not guards
    assert not guards.at_risk(np.arange(6)[:, None], np.zeros(1, dtype=np.int64)).any()
