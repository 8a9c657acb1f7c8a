"""Weights of plans learned from play: labels against a slow reference, leaks, and the run folder."""

import itertools

import numpy as np
import pytest
import torch

from wordcraft_kg import (
    AgentConfig,
    ImpalaConfig,
    PolicyConfig,
    TaskConfig,
    WordCraftConfig,
    World,
    load_policy,
    make_sources,
    save_policy,
)
from wordcraft_kg.agents.agent_training import AgentTraining
from wordcraft_kg.agents.plan_weights import (
    _right_pairs,
    fit_plan_weights,
    planner_weights,
)
from wordcraft_kg.agents.states import states_of
from wordcraft_kg.base.errors import ConfigError, LeakError
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.models.policies.sources.source import ScoreView
from wordcraft_kg.planning.search import FEATURES, MAX_ATTEMPTS, NO_PLAN
from wordcraft_kg.planning.source import log_shares


@pytest.fixture(scope="module")
def train(opened):
    return World(opened, WordCraftConfig(part="train", depth=2, num_distractors=3))


@pytest.fixture
def plan(cross_fitted, train):
    (source,) = make_sources(["p"], cross_fitted, ScoreView(tasks=train.tasks))
    return source


def slow_success(goal, table, results, pairs):
    """Whether a sequence of pairs makes the goal."""
    table = set(table)
    for pair in pairs:
        if not set(pair) <= table:
            return False
        table |= set(results.get(tuple(sorted(pair)), ()))
    return goal in table


@pytest.mark.parametrize("attempts", [1, 2])
def test_right_pairs_are_those_that_begin_a_sequence_to_the_goal(train, attempts):
    results = train.outcomes
    right_ones = 0
    for number in range(0, len(train.tasks), 29):
        task = train.tasks[number]
        goal = train.graph.id_of(task.goal)
        distractors = [entity for entity in (3, 40) if entity != goal]
        table = [*map(train.graph.id_of, task.start), *distractors]
        right = _right_pairs(goal, table, results, attempts)
        for first in itertools.combinations_with_replacement(sorted(set(table)), 2):
            reach = sorted({*table, *results.get(first, ())})
            # A first pair that makes nothing new is not right: a later pair would do its work.
            is_new = set(reach) > set(table)
            rest = itertools.combinations_with_replacement(reach, 2) if attempts == 2 else [()]
            expected = is_new and any(
                slow_success(goal, table, results, [first, *([pair] if pair else [])])
                for pair in rest
            )
            assert (first in right) == expected
            right_ones += expected
    assert right_ones


def test_the_planners_weights_choose_the_planners_pairs(plan, train):
    states = states_of(BatchEngine(train, 12).pose(np.arange(12)))
    before = plan(states)
    model = plan.model_of(states)
    features = plan.features(states)
    values = plan.search.values(
        states.goal, states.table, model, states.attempts.left, plan._tried(*states[2::2])
    )
    is_empty = states.table == train.nothing
    has_empty = is_empty[:, :, None] | is_empty[:, None]
    of_values = features[..., FEATURES.index("value")].masked_fill(has_empty, -torch.inf)
    torch.testing.assert_close(of_values, values)
    plan.weigh(planner_weights())
    # Equal up to a constant for each state.
    after = plan(states)
    best = before.masked_fill(is_empty, -torch.inf).argmax(1)
    assert torch.equal(after.masked_fill(is_empty, -torch.inf).argmax(1), best)


def test_shares_are_a_softmax_over_unordered_pairs():
    generator = torch.Generator().manual_seed(0)
    features = torch.randn(3, 4, 4, len(FEATURES), generator=generator)
    features = features + features.transpose(1, 2)
    weights = torch.randn(MAX_ATTEMPTS, len(FEATURES), generator=generator) / 3
    is_empty = torch.tensor([[False] * 4, [False, True, False, False], [True] * 4])
    shares = log_shares(features, weights, torch.tensor([2, 1, 9]), is_empty)
    for row, n in ((0, 2), (1, 1)):
        slots = [slot for slot in range(4) if not is_empty[row, slot]]
        pairs = list(itertools.combinations_with_replacement(slots, 2))
        scores = torch.stack([features[row, a, b] @ weights[n - 1] for a, b in pairs])
        expected = torch.log_softmax(scores, 0).clamp(min=NO_PLAN)
        for (a, b), value in zip(pairs, expected, strict=True):
            torch.testing.assert_close(shares[row, a, b], value)
            torch.testing.assert_close(shares[row, b, a], value)
    assert (shares[1, 1] == -torch.inf).all()
    assert (shares[2] == -torch.inf).all()


def test_learned_weights_make_right_pairs_of_train_tasks_likelier(plan, train):
    weights = fit_plan_weights(plan, train, tasks=60)
    again = fit_plan_weights(plan, train, tasks=60)
    assert torch.equal(weights, again)
    first = planner_weights()
    assert not torch.equal(weights[:2], first[:2])
    # Tasks of depth 2 have no third attempt.
    assert torch.equal(weights[2:], first[2:])
    # The tables from which they are learned, without tasks whose plans every model has seen.
    played = np.sort(np.random.default_rng([0, 1]).permutation(len(train.tasks))[:60])
    played = played[(plan.model_of_task[played] < plan.knowledge.num_models).numpy()]
    states = states_of(BatchEngine(train, len(played)).pose(played))
    results = train.outcomes
    features = plan.features(states)
    is_empty = states.table == train.nothing

    def likelihood(chosen):
        shares = log_shares(features, chosen, states.attempts.left, is_empty)
        total = 0.0
        for row, (goal, table) in enumerate(
            zip(states.goal.tolist(), states.table.tolist(), strict=True)
        ):
            at_hand = [entity for entity in table if entity != train.nothing]
            right = _right_pairs(goal, at_hand, results, 2)
            if right:
                places = [(table.index(a), table.index(b)) for a, b in right]
                of_right = torch.stack([shares[row, a, b] for a, b in places])
                total += float(of_right.logsumexp(0))
        return total

    assert likelihood(weights) > likelihood(first)


def test_weights_that_are_not_learned_stay_the_planners(plan, train):
    weights = fit_plan_weights(plan, train, tasks=30, features=("itself",))
    others = [name != "itself" for name in FEATURES]
    assert torch.equal(weights[:, others], planner_weights()[:, others])
    assert weights[1, FEATURES.index("itself")] != 0


def test_test_tasks_and_scorers_without_folds_are_refused(plan, train, cross_fitted):
    with pytest.raises(LeakError, match="found part 'test'"):
        fit_plan_weights(plan, train.variant(part="test"))
    (without,) = make_sources(["p"], cross_fitted)
    with pytest.raises(LeakError, match="without folds"):
        fit_plan_weights(without, train)


def config_of(scorer, **settings):
    trainer = ImpalaConfig(steps=64, batch_size=8, eval_every=0, **settings)
    tasks = TaskConfig(depth=2, distractors=3)
    return AgentConfig("kitchen", str(scorer), tasks, PolicyConfig(use="p"), trainer)


@pytest.mark.slow
def test_an_agent_learns_weights_before_it_trains_and_keeps_them(
    recipes_folder, opened, tmp_path, monkeypatch
):
    config = config_of(recipes_folder)
    assert config.policy.weigh_plans
    learned = []

    def fitted(*args, **options):
        learned.append(fit_plan_weights(*args, **options, tasks=40))
        return learned[-1]

    monkeypatch.setattr("wordcraft_kg.agents.agent_training.fit_plan_weights", fitted)
    training = AgentTraining(config, opened)
    training.prepare()
    save_policy(tmp_path / "policy", training.policy)
    restored = load_policy(tmp_path / "policy").sources["p"]
    assert len(learned) == 1
    assert torch.equal(restored.weights, learned[0])
    states = states_of(BatchEngine(training.envs.world, 20).pose(np.arange(20)))
    restored.bind(training.envs.world.tasks)
    assert torch.equal(restored(states), training.policy.sources["p"](states))

    monkeypatch.setattr("wordcraft_kg.agents.agent_training.fit_plan_weights", None)
    paper = AgentTraining(config_of(recipes_folder, preset="paper"), opened)
    paper.prepare()
    assert not hasattr(paper.policy.sources["p"], "weights")


@pytest.mark.parametrize(
    ("tasks", "use", "preset", "expected"),
    [
        (TaskConfig(depth=2), "u,p", "recommended", True),
        (TaskConfig(depth=3), "p", "recommended", False),
        (TaskConfig(), "p", "recommended", False),
        (TaskConfig(depth=2, max_attempts=4), "p", "recommended", False),
        (TaskConfig(depth=2), "u,v,w", "recommended", False),
        (TaskConfig(depth=2), "p", "paper", False),
    ],
)
def test_plans_are_weighed_where_this_was_measured(tasks, use, preset, expected):
    policy = PolicyConfig(use=use)
    config = AgentConfig("kitchen", "models/x", tasks, policy, ImpalaConfig(preset))
    assert config.policy.weigh_plans is expected
    assert "weigh_plans" not in config.differing()


def test_weights_without_plans_are_refused():
    with pytest.raises(ConfigError, match="`weigh_plans` needs the source plan"):
        PolicyConfig(use="u,v", weigh_plans=True)
    with pytest.raises(ConfigError, match="`weigh_plans` 'yes': expected true or false"):
        PolicyConfig(use="p", weigh_plans="yes")


def test_damaged_weights_are_refused(plan):
    plan.weigh(planner_weights()[:, :-1])
    with pytest.raises(ValueError, match="weights has type"):
        type(plan).restored(plan.num_entities, plan.state_dict())
