"""Evaluation of players: against single episodes in the readable environment, and invariants."""

import copy
from collections import Counter

import numpy as np
import pytest
import torch

from wordcraft_kg import PolicyConfig, WordCraftConfig, World
from wordcraft_kg.agents import evaluation
from wordcraft_kg.agents.agent_records import TERMINATION_REASONS
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.agents.players import knowledge_player, random_entity, recipe_oracle
from wordcraft_kg.agents.states import states_of
from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.base.statistics import task_bootstrap
from wordcraft_kg.envs import draws
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.draws import EVALUATION_SEED
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.evaluation.agents import view_baselines
from wordcraft_kg.models.policies.policy_folder import make_policy
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.baselines import FrequencyScorer

RESULTS = ("success", "by_plan", "actions", "terminations")


def policy_for(opened, num_slots, scorer=None, **settings):
    small = {
        "features": "random",
        "key_size": 8,
        "value_size": 8,
        "self_edges": "keep",
    }
    return make_policy(
        PolicyConfig(**small, **settings), opened.graph, num_slots, scorer=scorer, seed=2
    )[0]


def scripted(state, rng):
    """Picks that depend on the state alone and lead to every ending: plans, other ways, loops,
    chance, empty slots."""
    number = 7 * state.goal + 5 * state.selection + 3 * state.attempts_left + state.table[:, 0]
    slots, again = (
        number % state.engine.num_slots,
        (state.table == state.selection[:, None]).argmax(1),
    )
    filled = slots % (state.table != state.nothing).sum(1)
    kind, other = state.goal % 5, other_ways(state)
    choices = [recipe_oracle(state, rng), other, again, slots]
    return np.select([kind == 0, other >= 0, kind == 1, kind == 2], choices, filled)


def other_ways(state):
    """The next pick of a pair on the table that makes the goal and ends no plan; -1 where there is
    none."""
    actions, graph = np.full(state.num_envs, -1), state.world.graph
    facts = list(zip(graph.recipes.tolist(), graph.pair_of_recipe.tolist(), strict=True))
    for row, (goal, selection, table) in enumerate(
        zip(state.goal, state.selection, state.table.tolist(), strict=True)
    ):
        finals = state.world.tasks.final_pairs[state.task[row]].tolist()
        for (one, other, result), pair in facts:
            if result == goal and {one, other} <= set(table) and pair not in finals:
                actions[row] = table.index(other if selection == one else one)
    return actions


def assert_equal(one, other):
    for name in RESULTS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize("part", ["train", "test"])
@pytest.mark.parametrize(("depth", "attempts"), [(1, None), (1, 3), (2, None), (2, 3)])
def test_a_perfect_player_scores_exactly_one_in_all_tasks_and_draws(opened, part, depth, attempts):
    """In the released code the rate can exceed 1; here a task counts once a draw, however long its
    episodes."""
    config = WordCraftConfig(part=part, depth=depth, num_distractors=4, max_attempts=attempts)
    evaluator = Evaluator(World(opened, config), distractor_seeds=3, limit=100)
    result = evaluator(recipe_oracle)
    assert result.success.shape == (len(evaluator.tasks), 3)
    assert result.success.all()
    assert result.by_plan.all()
    assert not result.terminations.any()
    assert result.metrics().mean == 1.0
    assert set(result.actions.ravel().tolist()) == {2 * depth}


def play_singly(opened, config, player, distractor_seeds, tasks):
    """Play each task and draw alone in the readable environment, on the tables of a batch of the
    same seed."""
    engine = BatchEngine(World(opened, config), len(tasks))
    settings = {
        name: getattr(config, name)
        for name in ("part", "depth", "num_distractors", "max_attempts", "reward")
    }
    env = WordCraftEnv(opened, **settings)
    one = BatchEngine(World(opened, config), 1)  # shows the player what the environment shows
    recipes = opened.graph.recipes.tolist()
    results = {name: np.zeros((len(tasks), distractor_seeds), dtype=int) for name in RESULTS}
    for distractor_seed in range(distractor_seeds):
        posed = engine.pose(tasks, distractor_seed, seed=EVALUATION_SEED)
        for row, task in enumerate(tasks.tolist()):
            table = [entity for entity in posed.table[row].tolist() if entity < engine.nothing]
            seen, _ = env.reset(options={"task": task, "table": table})
            state = one.pose(np.array([task]))
            over, pair = False, []
            while not over:
                shown = {
                    name: np.array([seen[name]]) for name in ("goal", "selection", "attempts_left")
                }
                state = state._replace(
                    wide=np.append(seen["table"], engine.nothing)[None, :], **shown
                )
                slot = int(player(state, None)[0])
                entity = int(seen["table"][slot])
                pair = [*pair, entity] if len(pair) == 1 else [entity]
                seen, _, over, _, info = env.step(slot)
                if info["illegal_action"] and not over:
                    pair = []
                results["actions"][row, distractor_seed] += 1
            results["success"][row, distractor_seed] = info["outcome"] == "goal"
            results["by_plan"][row, distractor_seed] = info["by_plan"]
            results["terminations"][row, distractor_seed] = TERMINATION_REASONS.index(
                termination(env, info, pair, recipes)
            )
    return results


def termination(env, info, pair, recipes):
    """Say in words how an episode ended, from its last pair; one pick of it may have been an empty
    slot."""
    if info["outcome"] == "goal":
        return "goal"
    names = env.world.graph.entities
    labels = [names[entity] if entity < len(names) else None for entity in pair]
    if len(labels) == 2 and labels[0] is not None and labels[0] == labels[1]:
        return "same_twice"
    right = {part for plan in env.tasks[env.state.task].plans for part in plan[-1][:2]}
    if any(label in right for label in labels):
        return "one_right_part"
    if any(sorted(pair) == sorted(recipe[:2]) for recipe in recipes):
        return "no_right_part"
    return "no_recipe"


@pytest.mark.parametrize(
    ("depth", "attempts"),
    [
        (1, None),
        (1, 2),
        pytest.param(2, 2, marks=pytest.mark.slow),
        pytest.param(2, 3, marks=pytest.mark.slow),
    ],
)
def test_a_batch_is_evaluated_like_single_episodes(opened, depth, attempts):
    rules = {"max_attempts": attempts, "reward": "official" if depth == 2 else "sparse"}
    config = WordCraftConfig(part="test", depth=depth, num_distractors=8, **rules)
    evaluator = Evaluator(World(opened, config), distractor_seeds=2, limit=70)
    result = evaluator(scripted)
    expected = play_singly(opened, config, scripted, 2, evaluator.tasks)
    for name in RESULTS:
        np.testing.assert_array_equal(
            getattr(result, name).astype(int), expected[name], err_msg=name
        )
    assert set(result.terminations.ravel().tolist()) == set(range(len(TERMINATION_REASONS)))
    assert len(set(result.actions.ravel().tolist())) > 1
    assert (result.success & ~result.by_plan).any()


@pytest.mark.parametrize(
    ("kind", "guided"),
    [pytest.param("attention", False, marks=pytest.mark.slow), ("attention", True), ("mlp", False)],
)
def test_a_policy_plays_its_best_action_of_each_state(opened, monkeypatch, kind, guided):
    config = WordCraftConfig(part="test", depth=2, num_distractors=3)
    evaluator = Evaluator(World(opened, config), distractor_seeds=2, limit=30)
    scorer = FrequencyScorer(opened.graph, opened.split.partial) if guided else None
    policy = policy_for(opened, evaluator.engine.num_slots, scorer, policy=kind)

    def alone(state, rng):
        slots = []
        for row in zip(
            state.goal.tolist(), state.selection.tolist(), state.table.tolist(), strict=True
        ):
            logits = policy(States(*(torch.tensor([ids]) for ids in row))).logits[0]
            there = [slot for slot, entity in enumerate(row[2]) if entity != state.nothing]
            slots.append(max(there, key=logits.tolist().__getitem__))
        return np.array(slots)

    expected = evaluator(alone)
    assert_equal(evaluator(PolicyPlayer(policy)), expected)
    monkeypatch.setattr(evaluation, "ROWS", 7)  # not a divisor of the number of tasks
    assert_equal(evaluator(PolicyPlayer(policy)), expected)
    assert len(evaluator.tasks) % 7 != 0
    assert len(set(expected.terminations.ravel().tolist())) > 2


def test_every_player_meets_the_same_tables_every_time(opened):
    config = WordCraftConfig(part="test", num_distractors=4, max_attempts=2)
    evaluator = Evaluator(World(opened, config), distractor_seeds=3)
    seen = []

    def watched(player):
        def look(state, rng):
            if (state.attempts_left == 2).all() and (state.selection == state.nothing).all():
                seen.append(np.column_stack([state.task, state.goal, state.table]))
            return player(state, rng)

        return look

    players = [recipe_oracle, random_entity, scripted, random_entity]
    results = [evaluator(watched(player)) for player in players]
    results.append(Evaluator(World(opened, config), distractor_seeds=3)(watched(random_entity)))
    assert len(seen) == 3 * len(results)
    for distractor_seed in range(3):
        for tables in seen[distractor_seed::3]:
            np.testing.assert_array_equal(tables, seen[distractor_seed])
    assert (seen[0] != seen[1]).any()
    assert (seen[0] != seen[2]).any()
    np.testing.assert_array_equal(seen[0][:, 0], evaluator.tasks)
    assert_equal(results[1], results[3])  # chance is the same chance each time
    assert_equal(results[1], results[4])


def test_an_evaluation_changes_neither_the_policy_nor_global_random_states(opened):
    np.random.seed(3)  # noqa: NPY002 - the state that must not change
    torch.manual_seed(3)
    evaluator = Evaluator(
        World(opened, WordCraftConfig(part="test", num_distractors=2)), distractor_seeds=2
    )
    policy = policy_for(opened, evaluator.engine.num_slots)
    before, graphs = (copy.deepcopy(policy.state_dict()), policy.training), []
    policy.register_forward_pre_hook(lambda *_: graphs.append(torch.is_grad_enabled()))
    states = np.random.get_state()[1].copy(), torch.get_rng_state()  # noqa: NPY002
    evaluator(PolicyPlayer(policy))
    evaluator(random_entity).metrics()
    assert policy.training == before[1]
    assert all(torch.equal(tensor, before[0][name]) for name, tensor in policy.state_dict().items())
    assert set(graphs) == {False}
    np.testing.assert_array_equal(np.random.get_state()[1], states[0])  # noqa: NPY002
    assert torch.equal(torch.get_rng_state(), states[1])


@pytest.mark.parametrize("limit", [1, 7, 50, 62, 63, 64, 1_000])
def test_a_limit_takes_evenly_spaced_tasks(opened, limit):
    world, step = World(opened, WordCraftConfig(part="test")), 1
    while len(range(0, 63, step)) > limit:
        step += 1
    assert len(world.tasks) == 63
    assert Evaluator(world, distractor_seeds=1, limit=limit).tasks.tolist() == list(
        range(0, 63, step)
    )


@pytest.mark.parametrize("slot", [-1, 99])
def test_a_number_that_is_no_slot_is_an_action_error(opened, slot):
    def wrong(state, rng):
        return np.full(len(state.goal), slot)

    world = World(opened, WordCraftConfig(part="test"))
    with pytest.raises(ActionError, match=str(slot)):
        Evaluator(world, distractor_seeds=1, limit=5)(wrong)


def test_figures_are_means_over_tasks_and_draws(opened):
    world = World(opened, WordCraftConfig(part="test", num_distractors=3, max_attempts=2))
    result = Evaluator(world, distractor_seeds=4)(scripted)
    figures = result.metrics()
    sums = [array.sum() / (63 * 4) for array in (result.success, result.by_plan, result.actions)]
    assert [figures.mean, figures.by_plan, figures.actions] == pytest.approx(sums)
    assert (figures.tasks, figures.distractor_seeds) == (63, 4)
    assert (figures.ci_low, figures.ci_high) == task_bootstrap(result.success, world.groups)
    assert figures.ci_low < figures.mean < figures.ci_high
    shares = result.shares()
    assert tuple(shares) == TERMINATION_REASONS
    assert sum(shares.values()) == pytest.approx(1)
    assert shares["goal"] == pytest.approx(figures.mean)
    counts = Counter(result.terminations.ravel().tolist())
    assert shares == {
        name: pytest.approx(counts[code] / (63 * 4))
        for code, name in enumerate(TERMINATION_REASONS)
    }


def test_decisions_are_equal_where_pairs_and_order_are(opened):
    """Decisions are equal exactly where the same pairs are combined in the same order."""
    evaluator = Evaluator(
        World(opened, WordCraftConfig(part="test", num_distractors=1, max_attempts=2)),
        distractor_seeds=1,
    )

    def play(choose):
        played = [[] for _ in evaluator.tasks]

        def player(state, _):
            slots = choose(state)
            for row in np.flatnonzero(state.attempts_left > 0):
                played[row].append(int(state.table[row, slots[row]]))
            return slots

        found = evaluator(player).decisions[:, 0]
        return found, [
            [sorted(picks[i : i + 2]) for i in range(0, len(picks), 2)] for picks in played
        ]

    rng = np.random.default_rng(4)
    chance = [rng.random(len(evaluator.tasks)) for _ in range(3)]
    (one, pairs), (other, others), (swapped, _) = (
        play(choose)
        for choose in (
            lambda state: state.random_actions(
                chance[0] if (state.selection == state.nothing).all() else chance[1]
            ),
            lambda state: state.random_actions(
                chance[0] if (state.selection == state.nothing).all() else chance[2]
            ),
            lambda state: state.random_actions(
                chance[1] if (state.selection == state.nothing).all() else chance[0]
            ),
        )
    )
    assert (one == other).tolist() == [
        mine == yours for mine, yours in zip(pairs, others, strict=True)
    ]
    assert 0 < (one == other).sum() < len(one)
    np.testing.assert_array_equal(one, swapped)


@pytest.mark.parametrize("use", ["u", "v", "u,v"])
def test_the_scorer_alone_picks_the_best_sum_of_its_scores(opened, use):
    config = WordCraftConfig(part="all", num_distractors=6)
    state = BatchEngine(World(opened, config), 300).reset(1)
    policy = policy_for(
        opened, state.engine.num_slots, FrequencyScorer(opened.graph, opened.split.partial), use=use
    )
    player, rng = knowledge_player(list(policy.sources.values())), np.random.default_rng(0)
    for _ in range(2):
        slots = player(state, rng)
        scores = (
            sum(source(states_of(state)) for source in policy.sources.values()).double().numpy()
        )
        scores[state.table == state.nothing] = -np.inf
        chosen = scores[np.arange(300), slots]
        np.testing.assert_allclose(chosen, scores.max(1), atol=1e-5)
        if use != "u" or (state.selection != state.nothing).all():
            assert (scores.max(1) > scores[:, 0]).sum() > 100
        state, _ = state.engine.step_once(state, slots)


def test_of_very_many_tasks_a_sample_is_evaluated_with_a_warning(opened, monkeypatch, caplog):
    monkeypatch.setattr(draws, "MOST_TASKS", 20)
    world = World(opened, WordCraftConfig(num_distractors=2))
    amount = len(world.tasks)
    evaluator = Evaluator(world, distractor_seeds=1, limit=20)
    assert 10 <= len(evaluator.tasks) <= 20 < amount
    assert (
        f"{amount:,} train tasks are too many: evaluating a sample of {len(evaluator.tasks)} tasks"
        in caplog.text
    )
    assert evaluator(random_entity).metrics().tasks == len(evaluator.tasks)
    assert len(Evaluator(world, limit=10**6).tasks) == amount


def test_very_many_tasks_are_played_on_the_first_of_their_tables(opened, monkeypatch):
    world = World(opened, WordCraftConfig(part="test", num_distractors=3))
    few = Evaluator(world)(scripted)
    monkeypatch.setattr(draws, "MANY_TASKS", len(world.tasks) - 1)
    many = Evaluator(world)(scripted)
    assert (few.success.shape, many.success.shape) == ((63, 5), (63, 1))
    np.testing.assert_array_equal(many.decisions, few.decisions[:, :1])
    view = view_baselines(opened, "kitchen", world.config, [3])
    assert (view.distractor_seeds, {row.episodes for row in view.rows}) == (1, {63})
