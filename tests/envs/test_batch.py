"""The batched engine against a slow reference of the rules, step for step."""

from itertools import product

import numpy as np
import pytest
import torch
from helpers import refuses
from reference_env import ReferenceEnv

from wordcraft_kg.agents.players import recipe_oracle
from wordcraft_kg.base.errors import ActionError, ConfigError, EpisodeError
from wordcraft_kg.envs.batch import OUTCOMES, BatchEngine
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import REWARDS, RewardConfig, WordCraftConfig
from wordcraft_kg.graphs import OpenedGraph, RecipeGraph, SplitConfig, make_split, open_graph

DEVICES = ("cpu", "torch:cpu")
SEEN = ("goal", "task", "selection", "attempts_left", "table")
GIVEN = ("reward", "over", "outcome", "by_plan", "illegal", "task")
QUICK_CASES = ((1, "sparse"), (2, "shaped"), (3, "official"))
"""Each depth and reward; `make slow` has all combinations."""
QUICK_RESTORED = (
    ("cpu", "cpu", 16),
    ("cpu", "torch:cpu", 16),
    ("torch:cpu", "cpu", 16),
)


@pytest.fixture(scope="module", autouse=True)
def shaped():
    """A reward with a value of its own for each part."""
    REWARDS["shaped"] = RewardConfig(0.25, 0.5, 2.0)
    yield
    del REWARDS["shaped"]


@pytest.fixture(scope="module")
def ambiguous():
    """Few entities, many pairs with two and three results, self pairs, several plans: everything
    happens often."""
    rng = np.random.default_rng(3)
    rows = [
        (f"e{a:02d}", f"e{b:02d}", f"e{c:02d}")
        for a, b, c in rng.integers(0, 24, size=(260, 3)).tolist()
    ]
    rows += [
        (a, b, f"e{c:02d}")
        for (a, b, _), c in zip(rows[:90], rng.integers(0, 24, 90).tolist(), strict=True)
    ]
    graph = RecipeGraph.from_recipes(rows)
    return OpenedGraph(graph, make_split(graph, SplitConfig()), "ambiguous")


@pytest.fixture(scope="module")
def sets():
    """Few entities, sets of one to four ingredients with repetitions, some with two results."""
    rng = np.random.default_rng(3)
    rows = [
        [f"e{entity:02d}" for entity in rng.integers(0, 24, size=rng.integers(2, 6))]
        for _ in range(200)
    ]
    rows += [[*ingredients, f"e{rng.integers(24):02d}"] for *ingredients, _ in rows[:60]]
    graph = RecipeGraph.from_recipes(rows)
    return OpenedGraph(graph, make_split(graph, SplitConfig()), "sets")


@pytest.fixture(scope="module")
def opened_sets():
    return open_graph("examples/kitchen-sets.csv")


def batch(opened, num_envs, seed=0, *, device="cpu", **settings):
    """The first state of a batch of environments."""
    world = opened if isinstance(opened, World) else World(opened, WordCraftConfig(**settings))
    return BatchEngine(world, num_envs, device=device).reset(seed)


def empty_slots(state):
    return state.engine.arrays.array(np.full(state.num_envs, state.engine.num_slots - 1))


class Twins:
    """A batch and a reference for each of its rows, kept in step."""

    def __init__(self, opened, num_envs, seed, **settings):
        self.state = batch(opened, num_envs, seed, **settings)
        self.envs = [self.begin(i) for i in range(num_envs)]

    def begin(self, i):
        """Return a reference with what the batch's row shows."""
        table = [entity for entity in self.row("table", i) if entity < self.state.nothing]
        return ReferenceEnv(self.state.world, int(self.state.task[i]), table)

    def row(self, name, i):
        return getattr(self.state, name)[i].tolist()

    def compare(self, i, seen):
        assert seen["goal"] == self.row("goal", i)
        assert seen["table"].tolist() == self.row("table", i)
        assert seen["selection"] == self.row("selection", i)
        assert seen["attempts_left"] == self.row("attempts_left", i)
        assert seen["action_mask"].tolist() == self.state.action_masks()[i].tolist()

    def run(self, steps, rng, legal=0.9):
        count = {"goal": 0, "over": 0, "illegal": 0, "other way": 0}
        for _ in range(steps):
            actions = rng.integers(self.state.engine.num_slots, size=len(self.envs))
            for i, env in enumerate(self.envs):
                seen = env.seen()
                self.compare(i, seen)
                if rng.random() < legal:
                    actions[i] = self.wise(i, seen, rng)
            self.state, step = self.state.engine.step(self.state, actions)
            for i, env in enumerate(self.envs):
                reward, by_plan, is_illegal = env.step(int(actions[i]))
                is_over = env.outcome != "in_progress"
                assert float(step.reward[i]) == pytest.approx(reward, abs=1e-6)
                assert bool(step.over[i]) == is_over
                assert OUTCOMES[int(step.outcome[i])] == env.outcome
                assert (bool(step.by_plan[i]), bool(step.illegal[i])) == (by_plan, is_illegal)
                assert int(step.task[i]) == env.task
                count["goal"] += env.outcome == "goal"
                count["other way"] += env.outcome == "goal" and not by_plan
                count["illegal"] += is_illegal
                count["over"] += is_over
                if is_over:
                    self.envs[i] = self.begin(i)
        return count

    def wise(self, i, seen, rng):
        """A legal action, mostly the one that the first plan needs next."""
        slots = np.flatnonzero(seen["action_mask"]).tolist()
        table = seen["table"].tolist()
        env = self.envs[i]
        graph = self.state.world.graph
        plan = self.state.world.tasks[env.task].plans[0]
        recipe = next((row for row in plan if graph.id_of(row.result) not in table), plan[-1])
        missing = [graph.id_of(label) for label in recipe.ingredients]
        for pick in env.picks:
            if pick in missing:
                missing.remove(pick)
        if not missing and env.combine in slots and rng.random() < 0.8:
            return env.combine
        if missing and missing[-1] in table and rng.random() < 0.9:
            return table.index(missing[-1])
        return int(rng.choice(slots))


@pytest.fixture(params=DEVICES)
def device(request):
    return request.param


@pytest.mark.parametrize("part", [pytest.param("train", marks=pytest.mark.slow), "test"])
def test_a_batch_on_the_kitchen_agrees_in_every_part(opened_kitchen, part):
    twins = Twins(
        opened_kitchen, 8, seed=5, part=part, depth=2, num_distractors=6, reward="official"
    )
    assert twins.run(100, np.random.default_rng(1))["goal"] > 5


@pytest.mark.parametrize(
    ("depth", "reward"),
    [
        pytest.param(*case, marks=[] if case in QUICK_CASES else pytest.mark.slow)
        for case in product((1, 2, 3), ("sparse", "official", "shaped"))
    ],
)
def test_a_batch_does_step_for_step_what_the_reference_does(ambiguous, depth, reward):
    settings = {"part": "all", "depth": depth, "reward": reward, "num_tasks": 50}
    twins = Twins(ambiguous, 12, seed=depth, num_distractors=4, max_attempts=depth + 1, **settings)
    count = twins.run(60, np.random.default_rng(0))
    assert min(count["goal"], count["over"], count["illegal"]) > 3
    assert depth == 1 or count["other way"] > 0


@pytest.mark.parametrize("depth", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_a_batch_of_sets_does_step_for_step_what_the_reference_does(sets, depth):
    settings = {"part": "all", "depth": depth, "num_tasks": 50, "reward": "shaped"}
    twins = Twins(sets, 12, seed=depth, num_distractors=2, max_attempts=depth + 1, **settings)
    count = twins.run(100, np.random.default_rng(0), legal=0.97)
    assert min(count["goal"], count["over"], count["illegal"]) > 3


@pytest.mark.parametrize("part", ["train", "test"])
def test_only_a_complete_set_in_any_order_makes_the_goal(opened_sets, part):
    world = World(opened_sets, WordCraftConfig(part=part, num_distractors=1, max_attempts=3))
    env = WordCraftEnv(world)
    combine = env.num_slots - 1
    rng = np.random.default_rng(0)
    for task in range(len(world.tasks)):
        ingredients = world.tasks[task].plans[0][0].ingredients
        for is_complete in (False, True):
            observation, _ = env.reset(seed=task, options={"task": task})
            assert not observation["action_mask"][combine]
            picks = rng.permutation(ingredients if is_complete else ingredients[1:])
            table = list(world.graph.labels(env.state.table))
            rewards = [env.step(table.index(label))[1] for label in picks]
            if len(picks) < world.graph.most_ingredients:
                assert env.action_masks()[combine] == bool(len(picks))
                rewards.append(env.step(combine)[1])
            assert rewards[:-1] == [0] * (len(rewards) - 1)
            assert (rewards[-1] == 1) == is_complete


def test_a_set_knows_how_often_an_entity_was_picked(sets):
    lookup = BatchEngine(World(sets, WordCraftConfig(part="all", num_distractors=0)), 1).pairs
    graph = sets.graph
    rng = np.random.default_rng(0)
    picks = rng.integers(0, graph.num_entities + 1, (20_000, graph.most_ingredients))
    picks[: graph.num_recipes] = rng.permuted(graph.sets[:, :-1], axis=1)
    expected = [
        graph.outcomes.get(tuple(sorted(pick for pick in row if pick < graph.num_entities)), ())
        for row in picks.tolist()
    ]
    results = lookup.results[lookup(picks)].tolist()
    assert [tuple(x for x in row if x < graph.num_entities) for row in results] == expected


@pytest.mark.parametrize(("book", "fewest_goals"), [("opened_kitchen", 25), ("opened_sets", 2)])
def test_torch_arrays_give_the_same_as_numpy_arrays(request, book, fewest_goals):
    settings = {"depth": 2, "num_distractors": 6, "reward": "official"}
    opened = request.getfixturevalue(book)
    one, other = (batch(opened, 16, 3, device=device, **settings) for device in DEVICES)
    rng = np.random.default_rng(0)
    goals = 0
    for turn in range(100):
        for name in SEEN:
            np.testing.assert_array_equal(getattr(other, name).numpy(), getattr(one, name))
        # The oracle, chance, and for a while nothing but empty slots, which end an episode a pick.
        oracle = recipe_oracle(one, rng)
        actions = np.where(
            rng.random(16) < 0.7, oracle, rng.integers(one.engine.num_slots, size=16)
        )
        if turn % 50 > 25:
            actions[:] = one.engine.num_slots - 1
        (one, a), (other, b) = (
            one.engine.step(one, actions),
            other.engine.step(other, torch.from_numpy(actions)),
        )
        for name in GIVEN:
            np.testing.assert_allclose(getattr(b, name).numpy(), getattr(a, name), atol=1e-6)
        goals += int((a.outcome == 1).sum())
    assert goals > fewest_goals


def episodes(state, steps, rng_of):
    """What each environment sees when its own actions are the same, whoever runs beside it."""
    seen = [[] for _ in range(state.num_envs)]
    for _ in range(steps):
        actions = np.array(
            [rng.integers(state.engine.num_slots) for rng in rng_of[: state.num_envs]]
        )
        state, step = state.engine.step(state, actions)
        for i in range(state.num_envs):
            seen[i].append((state.table[i].tolist(), int(state.goal[i]), float(step.reward[i])))
    return seen


def test_an_environment_sees_the_same_beside_any_number_of_others(opened_kitchen):
    world = World(opened_kitchen, WordCraftConfig(num_distractors=5))
    many, few = batch(world, 100, 7), batch(world, 3, 7)
    rngs = [[np.random.default_rng(i) for i in range(100)] for _ in range(2)]
    assert episodes(many, 30, rngs[0])[:3] == episodes(few, 30, rngs[1])
    tasks = np.arange(100) % len(world.tasks)
    posed = [
        state.engine.pose(tasks[: state.num_envs], 2, seed=7).table[:3] for state in (many, few)
    ]
    np.testing.assert_array_equal(*posed)


def test_the_seed_decides_tasks_without_global_randomness(opened_kitchen):
    """The seed decides the tasks and global random states are left alone."""
    np.random.seed(0)  # noqa: NPY002 - the state that must not change
    torch.manual_seed(0)
    before = np.random.get_state()[1].copy(), torch.get_rng_state().clone()  # noqa: NPY002
    one, same, other = (batch(opened_kitchen, 64, seed, num_distractors=2) for seed in (1, 1, 2))
    assert len(set(one.task.tolist())) > 40
    np.testing.assert_array_equal(one.table, same.table)
    assert (one.table != other.table).any()
    one.engine.step(one, np.zeros(64, dtype=np.int64))
    np.testing.assert_array_equal(one.engine.reset(1).table, one.table)
    np.testing.assert_array_equal(np.random.get_state()[1], before[0])  # noqa: NPY002
    assert torch.equal(torch.get_rng_state(), before[1])


def drawn_tables(world, tables, at_once=500):
    engine = BatchEngine(world, at_once)
    for episode in range(tables // at_once):
        tasks = np.arange(episode * at_once, (episode + 1) * at_once) % len(world.tasks)
        posed = engine.pose(tasks, episode, seed=11)
        for task, row in zip(tasks.tolist(), posed.table.tolist(), strict=True):
            yield task, [entity for entity in row if entity < world.nothing]


@pytest.mark.parametrize("part", ["train", "test", "all"])
@pytest.mark.parametrize("depth", [1, 2])
def test_tables_hold_the_start_and_distractors_that_may_lie_there(opened_kitchen, part, depth):
    graph = opened_kitchen.graph
    world = World(opened_kitchen, WordCraftConfig(part=part, depth=depth, num_distractors=7))
    for task, table in drawn_tables(world, 2_000):
        start = {
            entity for entity in world.tasks.starts[task].tolist() if entity < graph.num_entities
        }
        made = {
            entity
            for entity in world.tasks.intermediates[task].tolist()
            if entity < graph.num_entities
        }
        goal = int(world.tasks.goals[task])
        assert len(table) == len(set(table)) == depth + 8
        assert start <= set(table)
        distractors = set(table) - start
        assert not distractors & (made | {goal})


def test_the_place_on_the_table_says_nothing(opened_kitchen):
    world = World(opened_kitchen, WordCraftConfig(part="all", num_distractors=4))
    goal = int(np.argmax([len(set(row)) == 2 for row in world.tasks.starts.tolist()]))
    posed = BatchEngine(world, 6_000).pose(np.full(6_000, goal), seed=2)
    places = np.bincount((posed.table == world.tasks.starts[goal, 0]).argmax(1), minlength=6)
    np.testing.assert_allclose(places / 6_000, 1 / 6, atol=0.02)


def test_all_tasks_are_drawn_alike(opened_kitchen):
    state = batch(opened_kitchen, 20_000, 4, part="test")
    counts = np.bincount(state.task, minlength=len(state.world.tasks))
    expected = 20_000 / len(counts)
    assert np.abs(counts - expected).max() < 5 * np.sqrt(expected)


def played(state, rng, steps):
    """The last state, and what a batch shows and gives over steps of which many end an episode at
    once."""
    engine, rows = state.engine, []
    for _ in range(steps):
        legal = np.asarray(state.random_actions(engine.arrays.array(rng.random(state.num_envs))))
        actions = np.where(rng.random(state.num_envs) < 0.4, engine.num_slots - 1, legal)
        state, step = engine.step(state, engine.arrays.array(actions))
        values = [getattr(state, name) for name in SEEN] + [getattr(step, name) for name in GIVEN]
        rows.append([value.tolist() for value in values])
    return state, rows


def test_a_step_changes_no_earlier_and_no_later_state(opened_kitchen, device):
    """A step changes neither the state that it begins with nor a later step from there."""
    settings = {"num_distractors": 4, "reward": "official", "max_attempts": 1}
    state = batch(opened_kitchen, 6, 3, device=device, **settings)
    kept, states = [], []
    for turn in range(40):  # each environment uses up more episodes than are prepared at a time
        states.append(state)
        kept.append(state.saved())
        state, _ = played(state, np.random.default_rng(turn), 1)
    assert (states[-1].saved()["episode"] - kept[0]["episode"]).min() > state.ahead.size
    for before, expected, (turn, after) in zip(
        states, kept, enumerate([*states[1:], state]), strict=True
    ):
        np.testing.assert_equal(before.saved(), expected)
        np.testing.assert_equal(
            played(before, np.random.default_rng(turn), 1)[0].saved(), after.saved()
        )


@pytest.mark.parametrize(
    ("device", "after", "steps"),
    [
        pytest.param(*case, marks=[] if case in QUICK_RESTORED else pytest.mark.slow)
        for case in product(DEVICES, DEVICES, (0, 1, 16, 40))
    ],
)
def test_a_restored_state_goes_on_with_the_same_episodes(opened_kitchen, device, after, steps):
    settings = {"depth": 2, "num_distractors": 4, "reward": "official"}
    state, _ = played(
        batch(opened_kitchen, 6, 3, device=device, **settings), np.random.default_rng(0), steps
    )
    other, _ = played(
        batch(opened_kitchen, 6, 3, device=after, **settings), np.random.default_rng(5), 7
    )
    other = other.restored(state.saved())
    np.testing.assert_equal(other.saved(), state.saved())
    (one, rows), (other, same) = (
        played(each, np.random.default_rng(1), 60) for each in (state, other)
    )
    assert rows == same
    np.testing.assert_equal(other.saved(), one.saved())


def test_a_state_of_another_engine_is_refused(opened_kitchen, device):
    state = batch(opened_kitchen, 4, device=device, num_distractors=3)
    more = batch(opened_kitchen, 5, 1, num_distractors=3).saved()
    wider = batch(opened_kitchen, 4, 1, num_distractors=4).saved()
    wrong = {"goal": (more, r"\(4,\)"), "wide": (wider, rf"\(4, {state.engine.num_slots + 1}\)")}
    for name, (saved, shape) in wrong.items():
        with pytest.raises(
            ConfigError, match=f"state of another engine: '{name}' should have shape {shape}"
        ):
            state.restored(saved)
    own = state.saved()
    for name in own:
        with pytest.raises(ConfigError, match=f"of another engine: '{name}'"):
            state.restored({other: array for other, array in own.items() if other != name})
        with pytest.raises(ConfigError, match=f"of another engine: '{name}'"):
            state.restored({**own, name: own[name][:1]})


def test_a_posed_episode_ends_and_stays(opened_kitchen):
    engine = batch(opened_kitchen, 50, part="test", num_distractors=3).engine
    tasks = np.arange(50) % len(engine.world.tasks)
    state = engine.pose(tasks)
    starts = engine.world.tasks.starts[tasks]
    results = []
    for place in (0, -1):
        entity = np.where(starts[:, place] < state.nothing, starts[:, place], starts[:, 0])
        state, step = engine.step_once(state, (state.table == entity[:, None]).argmax(1))
        results.append(step)
    assert (results[1].over & (results[1].outcome == 1) & results[1].by_plan).all()
    np.testing.assert_array_equal(state.task, tasks)
    assert not (state.attempts_left > 0).any()
    with pytest.raises(EpisodeError):
        engine.step_once(state, np.zeros(50, dtype=np.int64))


def test_drawn_episodes_follow_posed_ones(opened_kitchen, device):
    engine = batch(opened_kitchen, 20, device=device, num_distractors=3).engine
    state = engine.pose(np.arange(20))
    for _ in range(40):
        state, step = engine.step(state, empty_slots(state))
        assert bool(step.over.all())
        for row, task in zip(np.asarray(state.table).tolist(), state.task.tolist(), strict=True):
            entities = [entity for entity in row if entity < state.nothing]
            start = set(state.world.tasks.starts[task].tolist()) - {state.nothing}
            assert start <= set(entities)
            assert len(entities) == len(set(entities)) == 5


def test_with_repeat_the_first_episodes_come_again(opened_kitchen, device):
    world = batch(opened_kitchen, 1, 0, num_distractors=3).world

    def begun(repeat, number):
        """Return tasks and tables of the first episodes, in the order of play."""
        state = BatchEngine(world, 30, device=device, repeat=repeat).reset(4)
        episodes = []
        everywhere = state.engine.arrays.array(np.ones(30, dtype=bool))
        for _ in range(number):
            episodes.append((state.task.tolist(), state.table.tolist()))
            state = state.engine.begin_where(state, everywhere)
        return episodes

    all_new = begun(0, 8)
    assert len({str(episode) for episode in all_new}) == 8
    assert begun(8, 8) == all_new
    assert begun(3, 8) == [all_new[number % 3] for number in range(8)]
    with pytest.raises(ConfigError, match="repeat"):
        BatchEngine(world, 30, repeat=-1)


def test_what_is_on_a_table_stands_first_however_many_are_drawn(opened_kitchen):
    engine = batch(opened_kitchen, 20_000, part="all", num_distractors=4).engine
    task = int(np.argmax(engine.world.tasks.starts[:, 1] == engine.nothing))
    for episode in range(10):
        masks = engine.pose(np.full(20_000, task), episode).action_masks()
        np.testing.assert_array_equal(masks, np.arange(masks.shape[1]) < np.full((20_000, 1), 6))


@pytest.mark.parametrize(
    ("actions", "says"),
    [
        ([0, 99], "action 99 of environment 1: expected 0 to"),
        ([-1, 0], "action -1 of environment 0"),
        ([0.5, 0], r"float64: expected \(2,\), whole numbers"),
        ([0], r"shape \(1,\)"),
    ],
)
def test_actions_outside_the_space_are_refused(opened_kitchen, actions, says):
    state = batch(opened_kitchen, 2, num_distractors=1)
    with pytest.raises(ActionError, match=says):
        state.engine.step(state, np.array(actions))


def test_no_environments_and_missing_devices_are_refused(opened_kitchen):
    for wrong in (0, -1, 1.5, "2", None, True):
        with refuses("num_envs"):
            batch(opened_kitchen, wrong)
    with refuses("seed"):
        batch(opened_kitchen, 1, -1)
    if not torch.cuda.is_available():
        with pytest.raises(ConfigError, match="no CUDA device"):
            batch(opened_kitchen, 1, device="cuda")


def test_a_posed_state_does_not_change_with_the_array_of_its_tasks():
    engine, tasks = BatchEngine(World.open("kitchen", WordCraftConfig()), 3), np.arange(3)
    state = engine.pose(tasks)
    tasks += 1
    assert state.task.tolist() == [0, 1, 2]
