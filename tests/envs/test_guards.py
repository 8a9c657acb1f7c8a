"""Guarded recipes against sets and loops."""

import tracemalloc
from functools import cache, partial

import numpy as np
import pytest

from wordcraft_kg import RecipeGraph, SplitConfig, WordCraftConfig, World, make_split, open_book
from wordcraft_kg.envs.arrays import arrays_of
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.guards import BITS, Guards
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.graphs import OpenedGraph


@pytest.fixture(scope="module", params=["train", "no_shortcut", "no_train_shortcut"])
def world(request):
    """Goals with more recipes than one table of marks holds, and self pairs among them."""
    rows = np.random.default_rng(1).integers(0, [40, 40, 10], size=(520, 3)).tolist()
    graph = RecipeGraph.from_recipes([tuple(f"e{entity:02d}" for entity in row) for row in rows])
    split = SplitConfig(
        "by-recipe-plain", train_ratio=0.8 if request.param == "no_train_shortcut" else 0.3
    )
    opened = OpenedGraph(graph, make_split(graph, split), "dense")
    if request.param == "train":
        return World(opened, WordCraftConfig(part="train"))
    return World(opened, WordCraftConfig(part="all", distractor_policy=request.param))


def guarded(world, task):
    """The guarded recipes of a task's goal, and what is there or can be made
    without distractors."""
    recipes = world.graph.recipes[world.guarded_recipes]
    pairs = recipes[recipes[:, 2] == world.tasks.goals[task], :2].tolist()
    near = {*world.tasks.starts[task].tolist(), *world.makeable[task].tolist()} - {world.nothing}
    return pairs, near


def completes(pairs, entity, there):
    """Whether an entity is part of a pair whose other part is there, or the entity itself."""
    there = there | {entity}
    return any(entity in pair and there.issuperset(pair) for pair in pairs)


@pytest.mark.parametrize("device", ["cpu", "torch:cpu"])
def test_candidates_are_refused_that_complete_a_guarded_recipe(world, device):
    arrays = arrays_of(device)
    guards, rng = Guards(world, arrays), np.random.default_rng(0)
    tasks = rng.integers(len(world.tasks), size=300)
    candidates = np.stack([rng.permutation(world.nothing)[:4] for _ in tasks], axis=1)
    allowed = rng.random(candidates.shape) < 0.8
    risk = arrays.numpy(guards.at_risk(arrays.array(candidates), arrays.array(tasks)))
    found = arrays.numpy(
        guards.refuse(arrays.array(candidates), arrays.array(allowed.copy()), arrays.array(tasks))
    )
    assert guards
    refused = safe = most = 0
    for column, task in enumerate(tasks.tolist()):
        pairs, there = guarded(world, task)
        most = max(most, len(pairs))
        drawn = candidates[:, column].tolist()
        at_risk = any(completes(pairs, entity, there | set(drawn)) for entity in drawn)
        assert risk[column] or not at_risk
        safe += not risk[column]
        for i, entity in enumerate(drawn):
            closes = completes(pairs, entity, there)
            assert found[i, column] == (allowed[i, column] and not closes)
            refused += closes
            if found[i, column]:
                there = there | {entity}
    assert most > BITS
    assert min(refused, safe) > 10


@pytest.fixture(
    scope="module",
    params=[
        "random",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("everyday", "little alchemy 2")),
    ],
)
def train(request):
    """Train tasks of a book; in the random one, one attempt or two make nearly everything."""
    rows = np.random.default_rng(2).integers(0, 60, size=(500, 3)).tolist()
    if request.param == "random":
        graph = RecipeGraph.from_recipes(
            [tuple(f"e{entity:02d}" for entity in row) for row in rows]
        )
    elif request.param == "everyday":
        graph = RecipeGraph.from_book(open_book("everyday"))
    else:
        graph = request.getfixturevalue("alchemy")
    return World(graph, WordCraftConfig(part="train", num_distractors=6, num_tasks=200))


QUICK = {("batched", 1, 1), ("batched", 2, 3), ("batched", 3, 3), ("readable", 1, 2)}


@pytest.mark.parametrize(
    ("engine", "depth", "attempts"),
    [
        pytest.param(
            engine, *amounts, marks=[] if (engine, *amounts) in QUICK else pytest.mark.slow
        )
        for engine in ("batched", "readable")
        for amounts in ((1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3))
    ],
)
def test_no_distractor_completes_a_held_out_recipe_of_the_goal(train, depth, attempts, engine):
    world = train.variant(depth=depth, max_attempts=attempts)
    of_task, closest = cache(partial(guarded, world)), 0
    for task, table in tables(world, engine, 200 if engine == "readable" else 1_500):
        pairs, near = of_task(task)
        distractors = set(table) - set(world.tasks.starts[task].tolist()) - {world.nothing}
        there = near | distractors
        closest += any(a in there or b in there for a, b in pairs)
        if any(
            there.issuperset(pair) for pair in pairs
        ):  # what the start alone completes, nobody can prevent
            assert not any(completes(pairs, entity, there) for entity in distractors), (task, table)
    assert closest > 10


def tables(world, engine, count):
    """Task and table at the beginning of many episodes."""
    if engine == "batched":
        batch = BatchEngine(world, count).reset()
        return zip(batch.task.tolist(), batch.table.tolist(), strict=True)
    env = WordCraftEnv(world)
    return [
        (env.state.task, list(env.state.table)) for seed in range(count) if env.reset(seed=seed)
    ]


@pytest.mark.parametrize("attempts", [1, 2, 3])
def test_what_a_start_can_make_leaves_the_last_attempt_out(train, attempts):
    world = train.variant(max_attempts=attempts)
    for task in range(0, len(world.tasks), 97):
        _, near = guarded(world, task)
        there = set(world.tasks.starts[task].tolist()) - {world.nothing}
        for _ in range(attempts - 1):
            there |= {c for a, b, c in world.graph.recipes.tolist() if a in there and b in there}
        assert near == there


def test_nothing_is_at_risk_where_nothing_is_guarded(world):
    free = world.variant(part="all", distractor_policy="any")
    guards = Guards(free, arrays_of("cpu"))
    assert not guards
    assert not guards.at_risk(np.arange(6)[:, None], np.zeros(1, dtype=np.int64)).any()


@pytest.mark.slow
def test_guards_need_memory_for_recipes_only():
    """The memory of guards grows with recipes not with goals times entities."""
    rows = np.random.default_rng(0).integers(0, 3_000, size=(15_000, 3)).tolist()
    graph = RecipeGraph.from_recipes([tuple(f"e{entity:04d}" for entity in row) for row in rows])
    world = World(
        OpenedGraph(graph, make_split(graph, SplitConfig()), "wide"), WordCraftConfig(part="train")
    )
    world.makeable  # noqa: B018 - computed here, because it is not the guards' own
    tracemalloc.start()
    guards = Guards(world, arrays_of("cpu"))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    guarded_goals = len(np.unique(graph.recipes[world.guarded_recipes, 2]))
    assert guards
    assert (
        peak < 5_000_000 < guarded_goals * graph.num_entities
    )  # bytes, and cells of a square table
