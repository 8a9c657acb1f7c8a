"""The batched engine against the readable environment, step for step."""

import itertools
from itertools import product

import numpy as np
import pytest
import torch

from wordcraft_kg.agents.players import recipe_oracle
from wordcraft_kg.base.errors import ActionError, ConfigError, EpisodeError
from wordcraft_kg.envs.batch import OUTCOMES, BatchEngine
from wordcraft_kg.envs.config import REWARDS, RewardConfig, WordCraftConfig
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.envs.world import SHORTCUT_TRIES, World
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_graph
from wordcraft_kg.graphs.folder import OpenedGraph

SHAPED = RewardConfig(wrong_pair_penalty=0.25, irrelevant_penalty=0.5, intermediate_reward=2.0)


@pytest.fixture(scope="module")
def kitchen_opened():
    return open_graph("kitchen")


@pytest.fixture(scope="module")
def ambiguous():
    """Few entities, many pairs with two and three results, self pairs, several plans: everything happens often."""
    rng = np.random.default_rng(3)
    rows = [(f"e{a:02d}", f"e{b:02d}", f"e{c:02d}") for a, b, c in rng.integers(0, 24, size=(260, 3)).tolist()]
    rows += [(a, b, f"e{c:02d}") for (a, b, _), c in zip(rows[:90], rng.integers(0, 24, 90).tolist(), strict=True)]
    graph = RecipeGraph.from_recipes(rows)
    return OpenedGraph(graph, make_split(graph, SplitConfig()), "ambiguous")


class Twins:
    """A batched engine and a readable environment for each of its rows, kept in step."""

    def __init__(self, opened, num_envs, seed, device="cpu", **settings):
        world = World(opened, WordCraftConfig(**settings))
        self.engine = BatchEngine(world, num_envs, seed=seed, device=device)
        self.envs = [WordCraftEnv(world) for _ in range(num_envs)]
        self.observations = [self.begin(i) for i in range(num_envs)]

    def begin(self, i):
        """Pose the readable environment what the engine's row shows."""
        table = [entity for entity in self.row("table", i) if entity < self.engine.nothing]
        return self.envs[i].reset(options={"task": int(self.engine.task[i]), "table": table})[0]

    def row(self, name, i):
        return getattr(self.engine, name)[i].tolist()

    def compare(self, i, seen):
        assert seen["goal"] == self.row("goal", i)
        assert seen["table"].tolist() == self.row("table", i)
        assert seen["selection"] == self.row("selection", i)
        assert seen["attempts_left"] == self.row("attempts_left", i)
        assert seen["action_mask"].tolist() == self.engine.action_masks()[i].tolist()

    def run(self, steps, rng, legal=0.9):
        count = {"goal": 0, "over": 0, "illegal": 0, "other way": 0}
        for _ in range(steps):
            actions = rng.integers(self.engine.num_slots, size=len(self.envs))
            for i, seen in enumerate(self.observations):
                self.compare(i, seen)
                if rng.random() < legal:
                    actions[i] = self.wise(i, seen, rng)
            step = self.engine.step(self.engine.arrays.array(actions))
            for i, env in enumerate(self.envs):
                seen, reward, terminated, truncated, info = env.step(int(actions[i]))
                assert float(step.reward[i]) == pytest.approx(reward, abs=1e-6)
                assert bool(step.over[i]) == terminated
                assert not truncated
                assert OUTCOMES[int(step.outcome[i])] == info["outcome"]
                assert bool(step.by_plan[i]) == info["by_plan"]
                assert bool(step.illegal[i]) == info["illegal_action"]
                assert int(step.task[i]) == info["task"]
                count["goal"] += info["outcome"] == "goal"
                count["other way"] += info["outcome"] == "goal" and not info["by_plan"]
                count["illegal"] += info["illegal_action"]
                count["over"] += terminated
                self.observations[i] = self.begin(i) if terminated else seen
        return count

    def wise(self, i, seen, rng):
        """A legal slot, mostly the one that the first plan needs next."""
        there = np.flatnonzero(seen["action_mask"]).tolist()
        table = [int(seen["table"][slot]) for slot in there]
        plan = self.envs[i].tasks.plans[self.envs[i].state.task][0]
        rows = self.engine.world.graph.recipes[list(plan)].tolist()
        a, b, _ = next((row for row in rows if row[2] not in table), rows[-1])
        wanted = b if seen["selection"] == a else a
        return table.index(wanted) if wanted in table and rng.random() < 0.8 else int(rng.choice(there))


@pytest.mark.parametrize(
    ("depth", "ambiguity", "reward"), [*product((1, 2, 3), ("all", "last"), ("sparse", "official", SHAPED))]
)
def test_a_batch_does_step_for_step_what_the_readable_environment_does(ambiguous, depth, ambiguity, reward):
    settings = {"part": "all", "depth": depth, "ambiguity": ambiguity, "reward": reward, "num_tasks": 50}
    twins = Twins(ambiguous, 12, seed=depth, num_distractors=4, max_attempts=depth + 1, **settings)
    count = twins.run(120, np.random.default_rng(0))
    assert min(count["goal"], count["over"], count["illegal"]) > 3
    assert depth == 1 or ambiguity == "last" or count["other way"] > 0


@pytest.mark.parametrize("part", ["train", "test"])
def test_a_batch_on_the_kitchen_agrees_in_every_part(kitchen_opened, part):
    twins = Twins(kitchen_opened, 8, seed=5, part=part, depth=2, num_distractors=6, reward="official")
    assert twins.run(100, np.random.default_rng(1))["goal"] > 5


def test_torch_arrays_give_the_same_as_numpy_arrays(kitchen_opened):
    config = WordCraftConfig(depth=2, num_distractors=6, reward="official", task_weighting="goal")
    one = BatchEngine(World(kitchen_opened, config), 16, seed=3)
    other = BatchEngine(World(kitchen_opened, config), 16, seed=3, device="torch:cpu")
    rng = np.random.default_rng(0)
    goals = 0
    for turn in range(200):
        for name in ("goal", "table", "selection", "attempts_left", "task"):
            np.testing.assert_array_equal(getattr(other, name).numpy(), getattr(one, name))
        # The oracle, chance, and for a while nothing but empty slots, which end an episode a pick.
        oracle = recipe_oracle(one, rng)
        actions = np.where(rng.random(16) < 0.7, oracle, rng.integers(one.num_slots, size=16))
        if turn % 50 > 25:
            actions[:] = one.num_slots - 1
        a, b = one.step(actions), other.step(torch.from_numpy(actions))
        for name in ("reward", "over", "outcome", "by_plan", "illegal", "task"):
            np.testing.assert_allclose(getattr(b, name).numpy(), getattr(a, name), atol=1e-6)
        goals += int((a.outcome == 1).sum())
    assert goals > 50


def episodes(engine, steps, rng_of):
    """What each environment sees when its own actions are the same, whoever runs beside it."""
    seen = [[] for _ in range(engine.num_envs)]
    for _ in range(steps):
        actions = np.array([rng.integers(engine.num_slots) for rng in rng_of[: engine.num_envs]])
        step = engine.step(actions)
        for i in range(engine.num_envs):
            seen[i].append((engine.table[i].tolist(), int(engine.goal[i]), float(step.reward[i])))
    return seen


def test_results_do_not_depend_on_how_many_run_side_by_side(kitchen_opened):
    config = WordCraftConfig(num_distractors=5)
    few = BatchEngine(World(kitchen_opened, config), 3, seed=7)
    many = BatchEngine(World(kitchen_opened, config), 1_500, seed=7)
    rngs = [[np.random.default_rng(i) for i in range(1_500)] for _ in range(2)]
    assert episodes(few, 60, rngs[0]) == episodes(many, 60, rngs[1])[:3]


def test_two_engines_of_a_half_each_see_what_a_whole_one_sees(kitchen_opened):
    world = World(kitchen_opened, WordCraftConfig(num_distractors=5))
    whole, low, high = (BatchEngine(world, n, seed=7, first_env=first) for n, first in ((7, 0), (3, 0), (4, 3)))
    rngs = [[np.random.default_rng(i) for i in range(7)] for _ in range(2)]
    assert episodes(whole, 60, rngs[0]) == episodes(low, 60, rngs[1]) + episodes(high, 60, rngs[1][3:])
    for engine, tasks in ((whole, np.arange(7)), (low, np.arange(3)), (high, np.arange(3, 7))):
        engine.pose(tasks, 2)
    np.testing.assert_array_equal(whole.table, np.concatenate([low.table, high.table]))
    with pytest.raises(ConfigError, match=r"`first_env` -1: expected a whole number, 0 or more"):
        BatchEngine(world, 4, first_env=-1)


def test_environments_draw_different_tasks_and_the_seed_decides_them(kitchen_opened):
    config = WordCraftConfig(num_distractors=2)
    one, same, other = (BatchEngine(World(kitchen_opened, config), 64, seed=seed) for seed in (1, 1, 2))
    assert len(set(one.task.tolist())) > 40
    np.testing.assert_array_equal(one.table, same.table)
    assert (one.table != other.table).any()
    first = one.table.copy()
    one.step(np.zeros(64, dtype=np.int64))
    one.reset(1)
    np.testing.assert_array_equal(one.table, first)


def test_global_random_states_are_left_alone(kitchen_opened):
    np.random.seed(0)  # noqa: NPY002 - the state that must not change
    torch.manual_seed(0)
    before = np.random.get_state()[1].copy(), torch.get_rng_state().clone()  # noqa: NPY002
    engine = BatchEngine(World(kitchen_opened, WordCraftConfig(num_distractors=3)), 8, seed=1)
    engine.step(np.zeros(8, dtype=np.int64))
    np.testing.assert_array_equal(np.random.get_state()[1], before[0])  # noqa: NPY002
    assert torch.equal(torch.get_rng_state(), before[1])


# --- what is drawn ---------------------------------------------------------------------------------------------------


def drawn_tables(world, tables, at_once=500):
    engine = BatchEngine(world, at_once, seed=11)
    for episode in range(tables // at_once):
        tasks = np.arange(episode * at_once, (episode + 1) * at_once) % len(world.tasks)
        engine.pose(tasks, episode)
        for task, row in zip(tasks.tolist(), engine.table.tolist(), strict=True):
            yield task, [entity for entity in row if entity < world.nothing]


@pytest.mark.parametrize("part", ["train", "test", "all"])
@pytest.mark.parametrize("depth", [1, 2])
def test_tables_hold_the_start_and_distractors_that_may_lie_there(kitchen_opened, part, depth):
    graph, split = kitchen_opened.graph, kitchen_opened.split
    held_out = {}
    for a, b, result in split.recipes("test").tolist():
        held_out.setdefault(result, []).append((a, b))
    world = World(kitchen_opened, WordCraftConfig(part=part, depth=depth, num_distractors=7))
    for task, table in drawn_tables(world, 2_000):
        start = {entity for entity in world.tasks.starts[task].tolist() if entity < graph.num_entities}
        made = {entity for entity in world.tasks.intermediates[task].tolist() if entity < graph.num_entities}
        goal = int(world.tasks.goals[task])
        assert len(table) == len(set(table)) == len(start) + 7
        assert start <= set(table)
        distractors = set(table) - start
        assert not distractors & (made | {goal})
        if part == "train":
            closure = set(start)
            for _ in range(depth - 1):
                pairs = itertools.combinations_with_replacement(sorted(closure), 2)
                closure |= {result for pair in pairs for result in world.outcomes.get(pair, ())}
            near = set(table) | closure
            for a, b in held_out.get(goal, []):
                assert not ({a, b} <= near and {a, b} & distractors)


@pytest.mark.parametrize("tables", [50, pytest.param(500, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("depth", "attempts"), [(1, 1), (1, 2), (2, 2)])
def test_without_shortcuts_only_the_plans_make_the_goal(ambiguous, kitchen_opened, depth, attempts, tables):
    # The ambiguous graph is so dense that at depth 2 some goals have a shortcut with any distractors.
    opened = ambiguous if attempts == 1 else kitchen_opened
    settings = {"num_distractors": 3, "distractor_policy": "no_shortcut", "max_attempts": attempts}
    world = World(opened, WordCraftConfig(part="all", depth=depth, **settings))
    for task, table in drawn_tables(world, tables, at_once=tables):
        start = world.tasks.starts[task].tolist()
        assert not world.has_shortcut(task, [entity for entity in table if entity not in start])
    env = WordCraftEnv(world)
    for seed in range(tables // 5):
        env.reset(seed=seed)
        start = env.tasks.starts[env.state.task].tolist()
        assert not world.has_shortcut(env.state.task, [entity for entity in env.state.table if entity not in start])


@pytest.mark.parametrize("weighting", ["use", "uniform"])
def test_both_engines_draw_distractors_from_the_same_distribution(kitchen_opened, weighting):
    """First two distractors drawn, as a set: exact probabilities of drawing without replacement, by a chi-square."""
    from scipy.stats import chisquare

    settings = {"part": "test", "num_distractors": 2, "distractor_weighting": weighting}
    env = WordCraftEnv(kitchen_opened, **settings)
    weights = env.world.distractor_weights.astype(float)
    start = set(env.tasks.starts[0].tolist()) - {env.world.nothing}
    weights[[*start, env.tasks.goals[0]]] = 0
    share = weights / weights.sum()
    expected = share + sum(share[first] * share / (1 - share[first]) for first in range(len(share)))
    expected -= share**2 / (1 - share)  # the second is not the first
    engine = BatchEngine(World(kitchen_opened, WordCraftConfig(**settings)), 4_000, seed=0)
    engine.pose(np.zeros(4_000, dtype=np.int64))
    batched = np.bincount(engine.table.ravel(), minlength=len(share) + 1)[:-1]
    single = np.zeros_like(batched)
    for seed in range(4_000):
        observation, _ = env.reset(seed=seed, options={"task": 0})
        single += np.bincount(observation["table"], minlength=len(share) + 1)[:-1]
    for counts in (batched, single):
        there = expected > 0
        there[list(start)] = False
        counts = counts[there]
        assert counts.sum() == 8_000
        frequencies = expected[there] / expected[there].sum() * counts.sum()
        # Both members of a set are counted, so the statistic is a little too small: the test is on the safe side.
        assert chisquare(counts, frequencies).pvalue > 1e-3


def test_the_place_on_the_table_says_nothing(kitchen_opened):
    engine = BatchEngine(World(kitchen_opened, WordCraftConfig(part="all", num_distractors=4)), 6_000, seed=2)
    goal = int(np.argmax([len(set(row)) == 2 for row in engine.world.tasks.starts.tolist()]))
    engine.pose(np.full(6_000, goal))
    first = engine.world.tasks.starts[goal, 0]
    places = np.bincount((engine.table == first).argmax(1), minlength=6)
    np.testing.assert_allclose(places / 6_000, 1 / 6, atol=0.02)


@pytest.mark.parametrize("weighting", ["task", "goal"])
def test_tasks_are_drawn_by_their_weights(kitchen_opened, weighting):
    config = WordCraftConfig(part="test", task_weighting=weighting)
    engine = BatchEngine(World(kitchen_opened, config), 20_000, seed=4)
    counts = np.bincount(engine.task, minlength=len(engine.world.tasks))
    expected = engine.world.tasks.weights(weighting) * 20_000
    assert np.abs(counts - expected).max() < 5 * np.sqrt(expected.max())
    assert weighting == "task" or expected.std() > 0


# --- going on later --------------------------------------------------------------------------------------------------

DEVICES = ("cpu", "torch:cpu")
SEEN = ("goal", "task", "selection", "attempts_left", "table")
GIVEN = ("reward", "over", "outcome", "by_plan", "illegal", "task")


def played(engine, rng, steps):
    """What an engine shows and gives over steps of which many end an episode at once."""
    rows = []
    for _ in range(steps):
        legal = np.asarray(engine.random_actions(engine.arrays.array(rng.random(engine.num_envs))))
        actions = np.where(rng.random(engine.num_envs) < 0.4, engine.num_slots - 1, legal)
        step = engine.step(engine.arrays.array(actions))
        values = [getattr(engine, name) for name in SEEN] + [getattr(step, name) for name in GIVEN]
        rows.append([value.tolist() for value in values])
    return rows


@pytest.mark.parametrize(("device", "after"), [*product(DEVICES, DEVICES)])
@pytest.mark.parametrize("steps", [0, 1, 16, 40])
def test_a_restored_engine_goes_on_with_the_same_episodes(kitchen_opened, device, after, steps):
    config = WordCraftConfig(depth=2, num_distractors=4, reward="official", task_weighting="goal")
    engine = BatchEngine(World(kitchen_opened, config), 6, seed=3, device=device)
    played(engine, np.random.default_rng(0), steps)
    state = engine.state()
    other = BatchEngine(World(kitchen_opened, config), 6, seed=3, device=after)
    played(other, np.random.default_rng(5), 7)
    other.restore(state)
    for name, array in other.state().items():
        np.testing.assert_array_equal(array, state[name])
    # Each environment uses up more episodes than are prepared at a time.
    assert played(other, np.random.default_rng(1), 60) == played(engine, np.random.default_rng(1), 60)
    assert (engine.state()["episode"] - state["episode"]).min() > engine._ahead.size
    for name, array in other.state().items():
        np.testing.assert_array_equal(array, engine.state()[name])


@pytest.mark.parametrize("device", DEVICES)
def test_environments_that_all_end_at_once_go_on_the_same_across_what_is_prepared(kitchen_opened, device):
    world = World(kitchen_opened, WordCraftConfig(num_distractors=3))
    for ended in range(14, 19):
        one, other = (BatchEngine(world, 4, seed=1, device=device) for _ in range(2))
        empty = one.arrays.array(np.full(4, one.num_slots - 1))
        for _ in range(ended):
            one.step(empty)
        other.restore(one.state())
        for _ in range(40):
            one.step(empty)
            other.step(empty)
            assert one.table.tolist() == other.table.tolist()
            assert one.task.tolist() == other.task.tolist()


@pytest.mark.parametrize("device", DEVICES)
def test_a_posed_episode_can_be_restored_too(kitchen_opened, device):
    config = WordCraftConfig(part="test", num_distractors=3)
    one, other = (BatchEngine(World(kitchen_opened, config), 5, seed=2, device=device) for _ in range(2))
    one.pose(np.arange(5), 4)
    one.step(one.arrays.array(np.zeros(5, dtype=np.int64)))
    other.restore(one.state())
    np.testing.assert_array_equal(np.asarray(other.task), np.arange(5))
    assert played(one, np.random.default_rng(0), 30) == played(other, np.random.default_rng(0), 30)


@pytest.mark.parametrize("device", DEVICES)
def test_a_state_is_a_copy_when_taken_and_when_restored(kitchen_opened, device):
    config = WordCraftConfig(depth=2, num_distractors=3, reward="official")
    engine, other = (BatchEngine(World(kitchen_opened, config), 6, seed=3, device=device) for _ in range(2))
    played(engine, np.random.default_rng(0), 9)
    state = engine.state()
    kept = {name: array.copy() for name, array in state.items()}
    other.restore(state)
    played(engine, np.random.default_rng(1), 9)
    played(other, np.random.default_rng(1), 9)
    for name, array in state.items():
        assert isinstance(array, np.ndarray)
        np.testing.assert_array_equal(array, kept[name])
    before = other.state()
    for array in state.values():
        array += 1
    for array in engine.state().values():
        array += 1
    for name, array in other.state().items():
        np.testing.assert_array_equal(array, before[name])
        np.testing.assert_array_equal(array, engine.state()[name])


@pytest.mark.parametrize("device", DEVICES)
def test_a_state_of_another_engine_is_refused_and_changes_nothing(kitchen_opened, device):
    config = WordCraftConfig(num_distractors=3)
    engine = BatchEngine(World(kitchen_opened, config), 4, device=device)
    before = engine.state()
    more = BatchEngine(World(kitchen_opened, config), 5, seed=1).state()
    wider = BatchEngine(World(kitchen_opened, WordCraftConfig(num_distractors=4)), 4, seed=1).state()
    wrong = {"goal": (more, r"\(4,\)"), "wide": (wider, rf"\(4, {engine.num_slots + 1}\)")}
    for name, (state, shape) in wrong.items():
        with pytest.raises(ConfigError, match=f"state of another engine: '{name}' should have shape {shape}"):
            engine.restore(state)
    own = BatchEngine(World(kitchen_opened, config), 4, seed=1).state()
    for name in own:
        with pytest.raises(ConfigError, match=f"of another engine: '{name}'"):
            engine.restore({other: array for other, array in own.items() if other != name})
        with pytest.raises(ConfigError, match=f"of another engine: '{name}'"):
            engine.restore({**own, name: own[name][:1]})
    assert (own["task"] != before["task"]).any()
    for name, array in engine.state().items():
        np.testing.assert_array_equal(array, before[name])


# --- posing and bad input --------------------------------------------------------------------------------------------


def test_a_posed_episode_ends_and_stays(kitchen_opened):
    engine = BatchEngine(World(kitchen_opened, WordCraftConfig(part="test", num_distractors=3)), 50, seed=0)
    tasks = np.arange(50) % len(engine.world.tasks)
    engine.pose(tasks)
    starts = engine.world.tasks.starts[tasks]
    results = []
    for pick in (0, -1):
        entity = np.where(starts[:, pick] < engine.nothing, starts[:, pick], starts[:, 0])
        results.append(engine.step_once((engine.table == entity[:, None]).argmax(1)))
    assert results[1].over.all()
    assert (results[1].outcome == 1).all()
    assert results[1].by_plan.all()
    np.testing.assert_array_equal(engine.task, tasks)
    assert not (engine.attempts_left > 0).any()
    with pytest.raises(EpisodeError, match="all episodes are over"):
        engine.step_once(np.zeros(50, dtype=np.int64))


def test_an_episode_that_is_over_stays_while_others_go_on(kitchen_opened):
    engine = BatchEngine(World(kitchen_opened, WordCraftConfig(part="all", depth=2, num_distractors=3)), 2, seed=0)
    engine.pose(np.array([0, 1]))
    empty = engine.num_slots - 1
    for _ in range(2):  # the first environment loses both attempts, the second picks and picks
        engine.step_once(np.array([empty, 0]))
    assert (engine.attempts_left > 0).tolist() == [False, True]
    before = engine.table[0].copy()
    step = engine.step_once(np.array([0, 0]))
    np.testing.assert_array_equal(engine.table[0], before)
    assert not step.over[0]
    assert not step.illegal[0]
    assert engine.attempts_left[0] == 0


@pytest.mark.parametrize("device", ["cpu", "torch:cpu"])
def test_drawn_episodes_follow_posed_ones(kitchen_opened, device):
    engine = BatchEngine(World(kitchen_opened, WordCraftConfig(num_distractors=3)), 20, seed=0, device=device)
    engine.pose(np.arange(20))
    empty = engine.arrays.array(np.full(20, engine.num_slots - 1))
    for _ in range(40):
        assert bool(engine.step(empty).over.all())
        for row, task in zip(np.asarray(engine.table).tolist(), engine.task.tolist(), strict=True):
            entities = [entity for entity in row if entity < engine.nothing]
            start = set(engine.world.tasks.starts[task].tolist()) - {engine.nothing}
            assert start <= set(entities)
            assert len(entities) == len(set(entities)) == len(start) + 3


def test_a_reset_without_a_seed_goes_on(kitchen_opened):
    one, other = (BatchEngine(World(kitchen_opened, WordCraftConfig(num_distractors=3)), 30, seed=4) for _ in range(2))
    first = one.table.copy()
    one.reset()
    assert (one.table != first).any()
    other.step(np.full(30, other.num_slots - 1))  # ends the first episode of each
    np.testing.assert_array_equal(one.table, other.table)
    one.reset(4)
    np.testing.assert_array_equal(one.table, first)


def test_what_is_on_a_table_stands_first_however_many_are_drawn(kitchen_opened):
    engine = BatchEngine(World(kitchen_opened, WordCraftConfig(part="all", num_distractors=4)), 20_000, seed=0)
    task = int(np.argmax(engine.world.tasks.starts[:, 1] == engine.nothing))
    for episode in range(10):
        engine.pose(np.full(20_000, task), episode)
        there = engine.action_masks()
        assert (there.sum(1) == 5).all()
        assert there[:, :5].all()


def test_large_tables_hold_each_entity_once():
    rows = [(f"e{i:04d}", f"e{i + 1:04d}", f"e{i + 2:04d}") for i in range(1_300)]
    opened = OpenedGraph(RecipeGraph.from_recipes(rows), None, "chain")
    opened = OpenedGraph(opened.graph, make_split(opened.graph, SplitConfig()), "chain")
    engine = BatchEngine(World(opened, WordCraftConfig(part="all", num_distractors=1_100)), 2, seed=0)
    for row in engine.table.tolist():
        entities = [entity for entity in row if entity < engine.nothing]
        assert len(entities) == len(set(entities)) == 1_102


@pytest.mark.parametrize(
    ("actions", "says"),
    [
        (np.array([0, 99]), "action 99 of environment 1: expected 0 to"),
        (np.array([-1, 0]), "action -1 of environment 0"),
        (np.array([0.5, 0]), "float64: expected \\(2,\\), whole numbers"),
        (np.array([0]), "shape \\(1,\\)"),
    ],
)
def test_actions_outside_the_space_are_refused_and_change_nothing(kitchen_opened, actions, says):
    engine = BatchEngine(World(kitchen_opened, WordCraftConfig()), 2)
    before = engine.selection.copy()
    with pytest.raises(ActionError, match=says):
        engine.step(actions)
    np.testing.assert_array_equal(engine.selection, before)


def test_an_empty_slot_raises_where_asked(kitchen_opened):
    engine = BatchEngine(World(kitchen_opened, WordCraftConfig(num_distractors=1, illegal_action="raise")), 2)
    with pytest.raises(
        ActionError, match=r"action 4 of environment 1: the slot is empty; slots 0 to [12] hold entities"
    ):
        engine.step(np.array([0, 4]))


def test_no_environments_and_missing_devices_are_refused(kitchen_opened):
    for wrong in (0, -1, 1.5, "2", None, True):
        with pytest.raises(
            ConfigError, match=f"`num_envs` {wrong!r}: expected a whole number, 1 (or more|to 16777216)"
        ):
            BatchEngine(World(kitchen_opened, WordCraftConfig()), wrong)
    with pytest.raises(ConfigError, match="`seed` -1: expected a whole number, 0 or more"):
        BatchEngine(World(kitchen_opened, WordCraftConfig()), 1, seed=-1)
    if not torch.cuda.is_available():
        with pytest.raises(ConfigError, match="no CUDA device"):
            BatchEngine(World(kitchen_opened, WordCraftConfig()), 1, device="cuda")


def test_all_rewards_of_the_presets_are_magnitudes():
    assert REWARDS["sparse"] == RewardConfig()
    assert REWARDS["official"] == RewardConfig(0.1, 0.1, 1.0)


@pytest.mark.parametrize("tries", [30, pytest.param(SHORTCUT_TRIES, marks=pytest.mark.slow)])
def test_a_table_without_shortcuts_that_cannot_be_is_given_up(ambiguous, monkeypatch, tries):
    monkeypatch.setattr("wordcraft_kg.envs.world.SHORTCUT_TRIES", tries)
    settings = {"part": "all", "depth": 2, "num_distractors": 8, "distractor_policy": "no_shortcut"}
    world = World(ambiguous, WordCraftConfig(**settings))
    expected = rf"`num_distractors` 8: found no distractors without a shortcut to 'e.*' in {tries} tries"
    with pytest.raises(ConfigError, match=expected):
        BatchEngine(world, 1)
    with pytest.raises(ConfigError, match=expected):
        WordCraftEnv(world).reset(seed=0)
