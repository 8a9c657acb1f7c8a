"""Worlds: what their variants share, which changes nothing; and the world of train recipes."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from helpers import refuses, split_of, with_other_results

from wordcraft_kg import RecipeGraph, SplitConfig, WordCraftConfig, World, make_split, open_graph
from wordcraft_kg.base.errors import ConfigError, TaskError
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.wordcraft import WordCraftEnv, WordCraftVectorEnv
from wordcraft_kg.graphs import OpenedGraph
from wordcraft_kg.graphs.splits import groups_of

DRAWN = {"depth": 3, "num_tasks": 20}
CHANGES = [
    *(
        {"part": "test"},
        {"part": "all"},
        {"depth": 2},
        {"num_distractors": 3},
        {"reward": "official"},
    ),
    *(
        DRAWN,
        {**DRAWN, "task_seed": 1},
        {"distractor_weighting": "uniform"},
    ),
    *(
        {"max_attempts": 3},
        {"max_attempts": 2},
    ),
    {"max_attempts": 2, "part": "all"},
    {"pays_held_out": True},
]


@pytest.fixture(scope="module")
def opened():
    """A small graph in which some pairs make several things."""
    rows = np.random.default_rng(0).integers(0, 20, size=(90, 3)).tolist()
    graph = RecipeGraph.from_recipes([tuple(f"e{entity:02d}" for entity in row) for row in rows])
    return OpenedGraph(graph, make_split(graph, SplitConfig()), "small")


def content(world):
    arrays = ("distractor_weights", "usable")
    values = {name: getattr(world, name) for name in ("num_slots", "outcomes")}
    values["tasks"] = world.tasks.hash
    return values | {name: getattr(world, name).tolist() for name in arrays}


def test_variants_are_what_worlds_of_their_settings_are(opened):
    first = World(opened, WordCraftConfig())
    expected = [content(World(opened, WordCraftConfig(**changes))) for changes in CHANGES]
    for changes, values in zip(CHANGES, expected, strict=True):
        assert content(first.variant(**changes)) == values, changes
    # The changes tell the properties apart: each has several values.
    assert all(
        any(values[name] != expected[0][name] for values in expected) for name in expected[0]
    )


def test_variants_share_what_does_not_depend_on_their_settings(opened):
    world = World(opened, WordCraftConfig(part="train", num_distractors=1))
    more = world.variant(num_distractors=4)
    assert more.config == WordCraftConfig(part="train", num_distractors=4)
    for name in (
        "graph",
        "split",
        "search",
        "tasks",
        "outcomes",
        "distractor_weights",
        "usable",
    ):
        assert getattr(more, name) is getattr(world, name)
    test = more.variant(part="test")
    assert test.search is test.variant(part="all").search
    assert test.tasks.hash != world.tasks.hash
    assert test.variant(part="train").tasks is world.tasks


def test_a_variant_that_cannot_be_is_refused_and_the_world_stays(opened):
    world = World(opened, WordCraftConfig())
    with pytest.raises(ConfigError, match=r"'distractors'; .* Did you mean 'num_distractors'"):
        world.variant(distractors=3)
    with refuses("num_distractors"):
        world.variant(num_distractors=99)
    with pytest.raises(TaskError, match="no task of depth 1 in the valid part"):
        world.variant(part="valid")
    assert world.config == WordCraftConfig()


def test_environments_of_a_world_are_those_of_its_settings(opened):
    settings = {"part": "all", "num_distractors": 4}
    world = World(opened, WordCraftConfig(**settings))
    for env, other in (
        (WordCraftEnv(world), WordCraftEnv(opened, **settings)),
        (WordCraftVectorEnv(3, world), WordCraftVectorEnv(3, opened, **settings)),
    ):
        assert env.world is world
        seen, expected = env.reset(seed=5)[0], other.reset(seed=5)[0]
        for key in expected:
            np.testing.assert_array_equal(seen[key], expected[key])


@pytest.mark.parametrize(
    "make", [WordCraftEnv, lambda world, **settings: WordCraftVectorEnv(2, world, **settings)]
)
def test_settings_beside_a_world_are_refused(opened, make):
    world = World(opened, WordCraftConfig())
    with pytest.raises(ConfigError, match=r"world\.variant\(depth=2, part='test'\)"):
        make(world, depth=2, part="test")


def test_gymnasium_makes_environments_of_a_world(opened):
    world = World(opened, WordCraftConfig(num_distractors=2))
    env = gym.make("WordCraft-v0", graph=world)
    assert env.unwrapped.world is world
    assert gym.make(env.spec).unwrapped.world is world
    assert copy.deepcopy(env.spec) == env.spec
    envs = gym.make_vec("WordCraft-v0", num_envs=3, vectorization_mode="sync", graph=world)
    assert [single.unwrapped.world for single in envs.envs] == [world] * 3


def test_a_world_survives_pickling(opened):
    world = World(opened, WordCraftConfig(part="all", depth=2))
    again = pickle.loads(pickle.dumps(world))
    assert content(again) == content(world)
    assert again.variant(num_distractors=3).tasks is again.tasks


def test_entities_that_a_task_does_not_need_can_all_be_distractors():
    graph = RecipeGraph.from_recipes([("a", "b", "c"), ("c", "a", "d")])
    world = World.open(graph, WordCraftConfig(part="all", depth=2, num_distractors=0))
    assert sorted(world.tasks.starts[0].tolist())[:2] == [graph.id_of("a"), graph.id_of("b")]
    with pytest.raises(
        ConfigError, match="graph has 4 entities, of which a task needs up to 4; expected at most 0"
    ):
        world.variant(num_distractors=1)


@pytest.mark.parametrize("kind", ["by-recipe", "by-goal", "by-slot", "by-kind"])
@pytest.mark.parametrize("depth", [1, 2])
def test_tasks_that_the_split_holds_out_together_are_a_group(kind, depth):
    graph = open_graph("kitchen" if kind != "by-kind" else "everyday").graph
    if kind == "by-kind" and depth == 2:
        pytest.skip("seconds for a large book; the same code")
    split = make_split(graph, SplitConfig(kind))
    world = World(
        OpenedGraph(graph, split, graph.name),
        WordCraftConfig(part="test", depth=depth, num_distractors=0),
    )
    last = [plans[0][-1] for plans in world.tasks.plans]
    expected = {
        "by-recipe": graph.pair_of_recipe[last],
        "by-goal": world.tasks.goals,
        "by-slot": groups_of(graph, "by-slot")[last],
        "by-kind": [graph.kinds[row] for row in last] if graph.kinds else None,
    }[kind]
    pairs = {*zip(world.groups.tolist(), np.asarray(expected).tolist(), strict=True)}
    assert len(pairs) == len({group for group, _ in pairs}) == len({name for _, name in pairs})
    assert len(world.groups) == len(world.tasks)


KINDS = ("by-recipe", "by-goal", "by-slot")
DEPTHS = (1, 2, 3)
QUICK = {("by-recipe", 1, 40), ("by-goal", 2, 40), ("by-slot", 3, 40)}
CASES = [(kind, depth, episodes) for kind in KINDS for depth in DEPTHS for episodes in (40, 1_000)]


@pytest.fixture(scope="module")
def graph():
    """A graph in which many pairs make several things, so that splits by goal divide pairs."""
    rows = np.random.default_rng(0).integers(0, 50, size=(150, 3)).tolist()
    rows += [[a, b, (result + 1) % 50] for a, b, result in rows[:50]]
    return RecipeGraph.from_recipes([tuple(f"e{entity:02d}" for entity in row) for row in rows])


def batched(opened, settings, episodes):
    """All that an agent meets on random walks through many environments at once."""
    state = BatchEngine(World(opened, settings), episodes).reset(4)
    rng = np.random.default_rng(0)
    stream = []
    for _ in range(2 * settings.attempts):
        state, step = state.engine.step(state, state.random_actions(rng.random(episodes)))
        kept = (state.goal, state.table, state.selection, state.attempts_left, state.tried)
        stream += [np.array(values) for values in (*kept, *step)]
    return plain(stream)


def readable(opened, settings, episodes):
    env = WordCraftEnv(World(opened, settings))
    return walked(env, episodes, lambda rng: int(rng.integers(env.num_slots)))


def vectorised(opened, settings, episodes):
    env = WordCraftVectorEnv(10, World(opened, settings))
    return walked(env, episodes // 10, lambda rng: rng.integers(env.world.num_slots, size=10))


def walked(env, episodes, draw):
    """Observations, rewards and infos of random actions."""
    rng = np.random.default_rng(1)
    stream = [env.reset(seed=3)]
    for _ in range(2 * env.world.config.attempts * episodes):
        stream.append(env.step(draw(rng)))
        if stream[-1][2] is True:  # a single environment, whose episode is over
            stream.append(env.reset())
    return plain(stream)


def plain(value):
    """Nested lists, also of the objects that ended episodes are."""
    if isinstance(value, dict):
        return [(name, plain(each)) for name, each in value.items()]
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return [plain(each) for each in value] if isinstance(value, list | tuple) else value


def tasks_and_sizes(opened, settings):
    world = World(opened, settings)
    return [*world.tasks], world.num_slots, world.distractor_weights.tolist()


@pytest.mark.parametrize(
    ("kind", "depth", "episodes"),
    [pytest.param(*case, marks=[] if case in QUICK else pytest.mark.slow) for case in CASES],
)
def test_no_stream_of_the_train_part_depends_on_held_out_results(graph, kind, depth, episodes):
    opened = split_of(graph, kind)
    settings = WordCraftConfig(
        depth=depth, num_distractors=6, max_attempts=depth + 1, reward="official", num_tasks=200
    )
    changed = with_other_results(opened, 0)
    for other in (changed, with_other_results(opened, None)):
        assert tasks_and_sizes(other, settings) == tasks_and_sizes(opened, settings)
        for stream in (batched, readable, vectorised):
            expected = stream(opened, settings, episodes)
            assert stream(other, settings, episodes) == expected, stream.__name__
    # With all recipes, results are told apart.
    both = [World(one, settings.variant(pays_held_out=True)) for one in (opened, changed)]
    assert both[0].outcomes != both[1].outcomes


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("depth", [1, 2])
def test_the_world_of_the_train_part_is_that_of_a_book_of_its_recipes(graph, kind, depth):
    opened = split_of(graph, kind)
    recipes = opened.split.recipes("train")
    book = RecipeGraph(graph.entities, recipes, graph.base_ids)
    settings = WordCraftConfig(depth=depth)
    train = World(opened, settings)
    other = World(OpenedGraph(book, opened.split, "train"), settings.variant(part="all"))
    assert [*train.tasks] == [*other.tasks]
    assert (train.outcomes, train.num_slots) == (other.outcomes, other.num_slots)


def test_a_held_out_pair_makes_what_train_recipes_make_of_it(graph):
    opened = split_of(graph, "by-goal")
    is_train = opened.split.is_in("train")
    kinds_of_pairs = set()
    clean = WordCraftEnv(World(opened, WordCraftConfig()))
    paid = WordCraftEnv(World(opened, WordCraftConfig(pays_held_out=True)))
    for a, b in np.unique(graph.recipes[~is_train, :2], axis=0).tolist():
        rows = (graph.recipes[:, :2] == (a, b)).all(1)
        made = []
        for env, expected in ((clean, rows & is_train), (paid, rows)):
            env.reset(options={"task": 0, "table": [a] if a == b else [a, b]})
            env.step(0)
            seen = env.step(len(env.state.table) - 1)[0]
            results = set(graph.recipes[expected, 2].tolist())
            assert {*seen["table"].tolist()} - {graph.num_entities} == {a, b} | results
            made.append(bool(results))
        kinds_of_pairs.add(tuple(made))
    assert kinds_of_pairs == {(False, True), (True, True)}


def test_held_out_pairs_stand_on_train_tables_of_their_goal_as_on_others():
    """Kept off the tables of their goal, they would be the pairs that are never seen."""
    opened = split_of(open_graph("kitchen").graph, "by-recipe")
    world = World(opened, WordCraftConfig(num_distractors=8))
    held_out = ~opened.split.is_in("train")
    state = BatchEngine(world, 4_000).reset(0)
    goals = np.asarray(state.goal)
    tables = np.asarray(state.table)
    is_there = np.zeros((len(goals), world.nothing + 1), dtype=bool)
    np.put_along_axis(is_there, tables, True, axis=1)
    a, b, result = opened.graph.recipes[held_out].T
    together = is_there[:, a] & is_there[:, b]
    of_goal = result == goals[:, None]
    with_goal = (together & of_goal).sum() / of_goal.sum()
    without = (together & ~of_goal).sum() / (~of_goal).sum()
    assert with_goal > 0.5 * without
