"""The source of recipes (w) on books whose recipes have any number of ingredients."""

import itertools

import numpy as np
import pytest
import torch

from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.agents.players import BEST_SET, PLANNER, knowledge_player, scorer_players
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.graphs import (
    open_graph,
)
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.policies.policy_folder import load_policy, make_policy, save_policy
from wordcraft_kg.models.policies.sources.registry import make_sources
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.recipes import set_fitting
from wordcraft_kg.models.recipes.set_fitting import fit_sets
from wordcraft_kg.models.recipes.set_training import rows_of_sets
from wordcraft_kg.models.scorers.cross_fitting import folds_of, whole_of
from wordcraft_kg.models.scorers.sets.parts import Parts
from wordcraft_kg.models.scorers.sets.scorer import SetScorer, stored_names
from wordcraft_kg.planning.source import best_plans, known_recipes


@pytest.fixture(scope="module")
def world(letters_model):
    return World(letters_model.opened, WordCraftConfig(part="test", num_distractors=4))


def states_at(world, scorer, goal, labels, selected=(), size=3):
    nothing = world.nothing
    selection = [*scorer.entity_ids(list(selected)).tolist(), *[nothing] * size][:size]
    table = [*scorer.entity_ids(list(labels)).tolist(), nothing, nothing]
    return States(scorer.entity_ids([goal]), torch.tensor([selection]), torch.tensor([table]))


@pytest.mark.parametrize("selected", [(), ("bx",), ("bx", "bx"), ("bx", "hy")])
def test_w_is_the_score_of_the_best_set_that_completes_the_selection(
    letters_model, world, selected
):
    scorer = letters_model.scorer
    labels = ("hy", "ax", "bx", "dx")
    states = states_at(world, scorer, "Gbdh", labels, selected)
    (w,) = make_sources(["w"], scorer)
    goal = int(states.goal)

    def score(ids):
        row = np.full((1, 8), -1)
        row[0, : len(ids)] = ids
        return float(scorer.score_sets(row, np.array([goal]))[0])

    table = scorer.entity_ids(list(labels)).tolist()
    picks = scorer.entity_ids(list(selected)).tolist()
    for slot, entity in enumerate(table):
        sets = [
            (*picks, entity, *rest)
            for size in range(3 - len(picks))
            for rest in itertools.combinations_with_replacement(table, size)
        ]
        expected = max(max(score(sorted(ids)) for ids in sets), -30)
        assert float(w(states)[0, slot]) == pytest.approx(expected, abs=1e-5)
    assert float(w(states)[0, 4]) == 0  # an empty slot
    combined = max(score(sorted(picks)), -30) if picks else 0
    assert float(w(states)[0, -1]) == pytest.approx(combined, abs=1e-5)


def test_the_player_of_the_best_set_makes_most_unseen_goals(letters_model, world):
    players = scorer_players(world.graph, letters_model.scorer, letters_model.triples, plans=True)
    for name in (BEST_SET, PLANNER):
        assert Evaluator(world, distractor_seeds=1)(players[name]).success.mean() > 0.8


@pytest.mark.parametrize("use", ["w", "p"])
def test_a_policy_is_saved_with_its_scorers_of_sets(letters_model, world, use, tmp_path):
    config = PolicyConfig(use=use, features="random", kg_only=True, mixing="residual")
    train = world.variant(part="train", num_tasks=8)
    policy, _ = make_policy(
        config, world.graph, world.num_slots, scorer=letters_model.scorer, tasks=train.tasks
    )
    loaded = load_policy(save_policy(tmp_path / "policy", policy.eval()))
    for part in (train, world):
        first, second = (
            Evaluator(part, distractor_seeds=1)(PolicyPlayer(player)) for player in (policy, loaded)
        )
        assert first.success.mean() > 0.5
        np.testing.assert_array_equal(first.decisions, second.decisions)


def test_train_tasks_are_scored_by_the_model_that_has_not_seen_their_goals(letters_model, world):
    scorer = letters_model.scorer
    train = world.variant(part="train")
    (w,) = make_sources(["w"], scorer, tasks=train.tasks)
    folds = folds_of(scorer)
    assert folds.count == 5
    for task in (0, len(train.tasks) - 1):
        fold = int(w.model_of_task[task]) - 1
        left_out = folds.left_out(fold)
        goal = int(train.tasks.goals[task])
        assert goal not in left_out.knowledge.recipes[:, -1]
        label = scorer.entities[goal]
        states = states_at(train, scorer, label, ("hy", "ax", "bx", "dx"), ("bx",))
        (expected,) = make_sources(["w"], left_out)
        with_task = states._replace(task=torch.tensor([task]))
        assert torch.equal(w(with_task), expected(states))
        assert not torch.equal(w(with_task), w(states))
    # In-sample scores, for those who ask for them, are of the model of all folds.
    assert folds_of(whole_of(scorer)) is None
    (in_sample,) = make_sources(["w"], whole_of(scorer), tasks=train.tasks)
    assert torch.equal(in_sample(with_task), w(states))


@pytest.fixture(scope="module")
def kitchen():
    """A model that knows all recipes of the small book of sets."""
    graph = open_graph("examples/kitchen-sets.csv").graph
    rows = rows_of_sets(graph, np.ones(graph.num_recipes, dtype=bool))
    parts = Parts.nothing(graph.num_entities)
    words = np.random.default_rng(0).normal(size=(graph.num_entities, 8)).astype(np.float32)
    words /= np.linalg.norm(words, axis=1, keepdims=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(set_fitting, "_EPOCHS", 1)
        fitted = fit_sets(rows, parts.amounts, words, seed=0, folds=2)
    tensors = {
        "recipes": torch.from_numpy(rows),
        "amounts": torch.from_numpy(parts.amounts),
        "part_names": stored_names(parts.labels),
        "words": torch.from_numpy(words.astype(np.float16)),
        **fitted.tensors(),
    }
    return SetScorer(tensors, graph.entities, graph.hash)


@pytest.mark.parametrize("depth", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_a_planner_that_knows_all_sets_makes_goals_at_any_depth(kitchen, depth):
    settings = WordCraftConfig(part="all", depth=depth, num_distractors=1, num_tasks=12)
    world = World.open("examples/kitchen-sets.csv", settings)
    (p,) = make_sources(["p"], kitchen)
    evaluation = Evaluator(world, distractor_seeds=1)(knowledge_player([p]))
    assert evaluation.success.mean() > 0.8
    assert evaluation.by_plan.mean() > 0.8


def test_a_set_that_was_tried_begins_no_plan(kitchen):
    recipes = known_recipes(kitchen)
    goal = int(kitchen.knowledge.recipes[0, -1])
    (first, *_) = sorted(recipes[goal])
    sizes = range(1, 7)
    plans = best_plans(kitchen, recipes, goal, first, sizes, 1)
    assert max(plans, key=plans.get) == first
    again = best_plans(kitchen, recipes, goal, first, sizes, 1, {first})
    assert first not in again
    assert {**again, first: plans[first]} == plans
