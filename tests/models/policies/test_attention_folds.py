"""Attention networks by fold: none is judged on the tasks that it learns from, and mixing weights learn from others."""

import numpy as np
import pytest
import torch
from refusals import refuses

from wordcraft_kg.agents.config import ImpalaConfig
from wordcraft_kg.agents.impala import Impala
from wordcraft_kg.base.errors import GraphMismatchError, LeakError
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.triples import recipe_triples
from wordcraft_kg.models.policies.attention_folds import AttentionFolds
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.models.policies.folder import load_policy, make_policy, save_policy
from wordcraft_kg.models.scorers.baselines import FrequencyScorer
from wordcraft_kg.models.scorers.cross_fitting import cross_fit

FOLDS = 3
SMALL = {"features": "random", "key_size": 4, "value_size": 5}


@pytest.fixture(scope="module")
def scorer(opened):
    return cross_fit(opened.split, lambda ids: FrequencyScorer(opened.graph, recipe_triples(ids)), folds=FOLDS)


def world_of(opened, depth=1, part="train"):
    return World(opened, WordCraftConfig(part=part, depth=depth, num_distractors=3, num_tasks=60))


@pytest.fixture(params=[{}, {"kg_only": True}, {"value_readout": "logits", "mixing": "softmax"}])
def policy(request, opened, scorer):
    return made(opened, scorer, **request.param)


def made(opened, scorer, depth=1, **settings):
    world, config = world_of(opened, depth), PolicyConfig(**{**SMALL, "fold_attention": True, **settings})
    partial = opened.split.partial
    return make_policy(config, opened.graph, world.num_slots, scorer=scorer, observed=partial, tasks=world.tasks)[0]


def states_of(world, seed=0):
    """Goal, selection, table and task of all tasks, with something in hand."""
    state = BatchEngine(world, len(world.tasks)).pose(np.arange(len(world.tasks)), seed=seed)
    held, _ = state.engine.step_once(state, np.zeros(len(world.tasks), dtype=np.int64))
    return [torch.as_tensor(part.copy()) for part in (held.goal, held.selection, held.table, held.task)]


def folds_by_loops(scorer, world):
    return [{int(scorer.of_recipe[row]) for plan in plans for row in plan} - {-1} for plans in world.tasks.plans]


def slow_alpha(policy, goal, selection, table, networks):
    """Mean α over networks, slot by slot."""
    vectors = torch.cat([policy.vectors.vectors, torch.zeros(1, policy.vectors.dim)])
    query, key, size = policy.attention.query, policy.attention.key, policy.config.key_size
    found = []
    for number in networks:
        mine = slice(number * size, (number + 1) * size)
        question = query.weight[mine] @ torch.cat([vectors[goal], vectors[selection]]) + query.bias[mine]
        found.append(torch.stack([question @ (key.weight[mine] @ vectors[entity]) / size**0.5 for entity in table]))
    return torch.stack(found).mean(0)


@pytest.mark.parametrize(("part", "depth"), [("train", 1), ("train", 2), ("all", 1), ("test", 1)])
def test_attention_on_a_task_is_that_of_networks_that_never_learn_from_it(opened, scorer, part, depth):
    policy, world = made(opened, scorer), world_of(opened, depth, part)
    policy.bind(world.tasks)
    goal, selection, table, task = states_of(world)
    output = policy(goal, selection, table, task=None if part == "test" else task)
    kinds = set()
    for row, folds in enumerate(folds_by_loops(scorer, world)):
        kinds.add(len(folds))
        ids = goal[row], selection[row], [entity for entity in table[row].tolist() if entity < policy.num_entities]
        expected = slow_alpha(policy, *ids, folds or set(range(FOLDS)))
        torch.testing.assert_close(output.sources[row, 0, : len(expected)], expected, atol=1e-5, rtol=1e-4)
    assert (
        kinds == {("train", 1): {1, 2}, ("train", 2): {1, 2, 3}, ("all", 1): {0, 1, 2}, ("test", 1): {0}}[part, depth]
    )
    alone = policy(goal, selection, table, task=torch.full_like(task, len(world.tasks)))
    torch.testing.assert_close(alone.sources[:, 0], policy(goal, selection, table).sources[:, 0])


def gradients(policy, loss):
    policy.zero_grad()
    loss.backward()
    return {name: parameter.grad for name, parameter in policy.named_parameters() if parameter.grad is not None}


def test_a_state_teaches_the_networks_that_may_learn_it_or_the_mixing_weights(opened, scorer, policy):
    world = world_of(opened)
    folds, roles = folds_by_loops(scorer, world), set()
    for seed in range(2):
        goal, selection, table, task = states_of(world, seed)
        for row in range(0, len(goal), 3):
            one = slice(row, row + 1)
            output = policy(goal[one], selection[one], table[one], task=task[one], is_learning=True)
            slots = table[row] < policy.num_entities
            loss = torch.log_softmax(output.logits[0, slots], 0)[0] + output.value.sum()
            found = gradients(policy, loss)
            query = found["attention.query.weight"].unflatten(0, (FOLDS, -1))
            taught = {number for number in range(FOLDS) if query[number].any()}
            is_mixing = any(part.any() for name, part in found.items() if name.startswith("mixture"))
            is_even = int(table[row].sum()) % 2 == 0
            assert taught == (set() if is_even else {0, 1, 2} - folds[row])
            assert is_mixing == (is_even and (len(folds[row]) == 1 or not policy.config.kg_only))
            assert found["value.2.weight"].any()
            roles.add(is_even)
    assert roles == {True, False}


def test_a_network_is_never_changed_by_the_tasks_of_its_fold_and_all_others_are(opened, scorer):
    """A training whose tasks are all in fold 1: its network stays as it was made, to the bit."""
    policy, world = made(opened, scorer), world_of(opened)
    before = {name: parameter.detach().clone() for name, parameter in policy.named_parameters()}
    shares = torch.tensor([[0.0, 1.0, 0.0], [0.5, 0.0, 0.5]])  # of those that never learn, of those that may
    policy.attention_folds.model_of_task[:] = shares
    impala = Impala(policy, BatchEngine(world, 32).reset(), ImpalaConfig(steps=64 * 20, batch_size=32))
    for _ in range(20):
        impala.update()
    for name in ("attention.query.weight", "attention.query.bias", "attention.key.weight"):
        change = policy.get_parameter(name).detach() - before[name]
        assert change.unflatten(0, (FOLDS, -1)).flatten(1).any(1).tolist() == [True, False, True]
    assert not torch.equal(policy.mixture[2].weight, before["mixture.2.weight"])


def test_a_saved_policy_knows_its_folds_and_asks_for_the_tasks(opened, scorer, tmp_path):
    policy, world = made(opened, scorer), world_of(opened)
    goal, selection, table, task = states_of(world)
    saved = load_policy(save_policy(tmp_path / "policy", policy))
    assert torch.equal(saved(goal, selection, table).logits, policy(goal, selection, table).logits)
    scores = policy.external_scores(goal, selection, table, task)
    with refuses("bind", LeakError):
        saved(goal, selection, table, task=task, external_scores=scores)
    saved.bind(world.tasks)
    assert torch.equal(
        saved(goal, selection, table, task=task).logits, policy(goal, selection, table, task=task).logits
    )
    with pytest.raises(GraphMismatchError):
        AttentionFolds(torch.tensor([0, 1])).bind(world.tasks)


@pytest.mark.parametrize("settings", [{"in_sample": True}, {"fold_attention": False}])
def test_in_sample_agents_have_one_network(opened, scorer, settings):
    policy = made(opened, scorer, **settings)
    assert policy.attention_folds is None
    assert policy.attention.query.weight.shape[0] == SMALL["key_size"]
