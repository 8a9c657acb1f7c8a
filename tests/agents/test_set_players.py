"""Players and agents on books whose recipes have any number of ingredients."""

import numpy as np
import pytest
import torch

from wordcraft_kg.agents.config import AgentConfig, ImpalaConfig, TaskConfig
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.agents.explanation import Explainer
from wordcraft_kg.agents.players import knowledge_players, recipe_oracle
from wordcraft_kg.agents.states import states_of
from wordcraft_kg.agents.training import AgentTraining
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import open_graph
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.models.policies.folder import load_policy, make_policy, save_policy
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.baselines import SymbolicScorer

BOOK = "examples/kitchen-sets.csv"


@pytest.fixture(scope="module")
def world():
    return World.open(BOOK, WordCraftConfig(part="all", num_distractors=2))


@pytest.fixture(scope="module")
def policy(world):
    graph = world.graph
    scorer = SymbolicScorer(graph, graph.triples)
    config = PolicyConfig(use="u,v", self_edges="keep", sees_attempts=True, features="random")
    policy, _ = make_policy(config, graph, world.num_slots, scorer=scorer)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():  # zeros say nothing
        for parameter in policy.combine.parameters():
            parameter.normal_(generator=generator)
    return policy.eval()


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_the_oracle_makes_every_goal(world, depth):
    variant = world.variant(depth=depth, num_distractors=1)
    evaluation = Evaluator(variant, distractor_seeds=1)(recipe_oracle)
    assert evaluation.success.all()
    assert evaluation.by_plan.all()


def test_known_triples_make_the_goals_whose_sets_repeat_no_ingredient(world):
    players = knowledge_players(world.split)
    assert "full KG, best pair" not in players
    evaluation = Evaluator(world, distractor_seeds=2)(players["full KG, v"])
    is_made = evaluation.success.any(axis=1)
    assert is_made.mean() > 0.5
    for task in np.flatnonzero(is_made).tolist():
        plans = world.tasks[task].plans
        assert any(len(set(row.ingredients)) == len(row.ingredients) for (row,) in plans)


def test_the_order_of_selections_and_slots_changes_no_decision(world, policy):
    engine = BatchEngine(world, 64)
    state = engine.reset(0)
    rng = np.random.default_rng(0)
    for _ in range(30):
        state, _ = engine.step(state, state.random_actions(rng.random(64)))
    states = states_of(state)
    assert (states.num_selected(policy.num_entities) > 2).any()
    output = policy(states)
    picks = np.sort(states.selection.numpy(), axis=1)  # the padding stays behind
    assert (picks != states.selection.numpy()).any()
    turned = policy(states._replace(selection=torch.from_numpy(picks)))
    torch.testing.assert_close(turned.logits, output.logits)
    slots = np.append(rng.permutation(engine.num_slots - 1), engine.num_slots - 1)
    moved = policy(states._replace(table=states.table[:, slots]))
    torch.testing.assert_close(moved.logits, output.logits[:, slots])
    mask = torch.from_numpy(state.action_masks())
    assert ((output.logits > -torch.inf) == mask).all()


def test_u_is_the_mean_over_the_selected_entities(world, policy):
    source = policy.sources["u"]
    graph = world.graph
    table = torch.arange(8)[None]
    nothing = graph.num_entities
    goal = torch.tensor([0])
    pairs = [
        source(States(goal, torch.tensor([entity]), table)) for entity in (5, graph.id_of("flour"))
    ]
    selection = torch.tensor([[5, graph.id_of("flour"), nothing, nothing, nothing, nothing]])
    means = source(States(goal, selection, table))
    torch.testing.assert_close(means[:, :7], (pairs[0] + pairs[1])[:, :7] / 2)
    empty = source(States(goal, torch.full_like(selection, nothing), table))
    assert not empty.any()


def test_a_policy_for_sets_is_saved_and_acts_by_label(world, policy, tmp_path):
    loaded = load_policy(save_policy(tmp_path / "policy", policy))
    results = [
        Evaluator(world, distractor_seeds=1)(PolicyPlayer(player)).last
        for player in (policy, loaded)
    ]
    np.testing.assert_array_equal(*results)
    action = loaded.act("stew", ["carrot", "pork"], ["carrot", "pork"])
    assert action.entity in ("carrot", "pork", "")
    assert (action.entity == "") == (action.slot == 2)
    with pytest.raises(ConfigError, match="fewer than 6 entities"):
        loaded.act("stew", ["carrot"], 6 * ["carrot"])


def test_an_explanation_adds_up_and_names_the_action_to_combine(world, policy):
    explainer = Explainer(policy, world)
    for task in range(0, len(world.tasks), 10):
        shown = explainer.task(task)
        for step in shown.episode.steps:
            assert sum(slot.probability for slot in step.slots) == pytest.approx(1)
            assert ("" in [slot.entity for slot in step.slots]) == (step.selection is not None)
            for slot in step.slots:
                assert sum(slot.contributions.values()) == pytest.approx(slot.logit, abs=1e-9)
        played = Evaluator(world, distractor_seeds=1)(PolicyPlayer(policy))
        assert len(shown.episode.steps) == played.actions[task, 0]
    begun = explainer.table("stew", ["carrot", "pork", "potato"], ["carrot", "pork"])
    assert begun.episode.steps[0].selection == "carrot + pork"


@pytest.mark.parametrize("kind", ["pairs", "mlp"])
def test_policies_of_pairs_refuse_sets(world, kind):
    with pytest.raises(ConfigError, match="Choose `policy` attention"):
        make_policy(PolicyConfig(policy=kind, features="random"), world.graph, world.num_slots)


def test_a_training_on_sets_takes_attention_and_long_unrolls_by_itself(caplog):
    opened = open_graph(BOOK)
    config = AgentTraining.settled(AgentConfig(BOOK, tasks=TaskConfig(max_attempts=2)), opened)
    assert "attention in place of pairs" in caplog.text
    assert (config.policy.policy, config.trainer.unroll) == ("attention", 12)
    given = AgentConfig(BOOK, trainer=ImpalaConfig(unroll=3, batch_size=8))
    settled = AgentTraining.settled(given, opened)
    assert (settled.trainer.unroll, settled.trainer.batch_size) == (3, 8)
    pairs = AgentConfig("kitchen")
    assert AgentTraining.settled(pairs, open_graph("kitchen")) is pairs
