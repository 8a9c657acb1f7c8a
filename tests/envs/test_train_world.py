"""The world of the train part: a function of the train recipes, whatever is held out."""

import numpy as np
import pytest
from helpers import split_of, with_other_results

from wordcraft_kg import RecipeGraph, WordCraftConfig, World, open_graph
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.vector import WordCraftVectorEnv
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.graphs import OpenedGraph

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


@pytest.mark.parametrize("policy", ["no_shortcut", "no_train_shortcut"])
def test_distractor_policies_know_train_recipes_alone(graph, policy):
    opened = split_of(graph, "by-recipe")
    settings = WordCraftConfig(num_distractors=2, distractor_policy=policy, max_attempts=2)
    expected = batched(opened, settings, 40)
    assert batched(with_other_results(opened, 0), settings, 40) == expected


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
