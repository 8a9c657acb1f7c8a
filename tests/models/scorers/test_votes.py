"""The vote count: recipes by its formula, triples by summing recipes, both against loops over
labels."""

import math

import numpy as np
import pytest
import torch
from link_helpers import random_graph

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, RELATIONS, RecipeGraph
from wordcraft_kg.models.scorers import config
from wordcraft_kg.models.scorers.baselines import VoteScorer

GRAPH = random_graph(num_entities=9, num_recipes=30)
SIZE = GRAPH.num_entities
KNOWN = GRAPH.recipes[::2]
EVERYTHING = torch.arange(SIZE)


def slow_weight(one, other, result, unseen):
    """exp score(one + other -> result) by the formula of the docstring, counted
    recipe by recipe."""
    votes = [
        sum(entity in recipe[:2] and recipe[2] == result for recipe in KNOWN.tolist())
        for entity in (one, other)
    ]
    if one == other:
        votes[1] = 0
    made = sum(recipe[2] == result for recipe in KNOWN.tolist())
    return (votes[0] + unseen) * (votes[1] + unseen) / (made + 1)


@pytest.mark.parametrize("unseen", [0.01, 0.5])
def test_recipes_and_triples_are_scored_by_the_formulas(unseen):
    assert np.any(KNOWN[:, 0] == KNOWN[:, 1])
    scorer = VoteScorer(GRAPH, KNOWN, unseen=unseen)
    weights = np.array(
        [
            [[slow_weight(a, b, c, unseen) for c in range(SIZE)] for b in range(SIZE)]
            for a in range(SIZE)
        ]
    )
    scores = scorer.score_recipes(EVERYTHING[:, None, None], EVERYTHING[None, :, None], EVERYTHING)
    np.testing.assert_allclose(scores.numpy(), np.log(weights), rtol=1e-5)
    pairs = weights.sum(2)
    np.testing.assert_allclose(scorer.table(COMBINES_WITH).numpy(), np.log(pairs), rtol=1e-5)
    parts = [
        [math.log(sum(pairs[x, b] * weights[x, b, c] for b in range(SIZE))) for c in range(SIZE)]
        for x in range(SIZE)
    ]
    np.testing.assert_allclose(scorer.table(COMPONENT_OF).numpy(), parts, rtol=1e-5)


def test_made_with_both_comes_before_made_often_with_one():
    """Who has made it with both comes before who has made it often with one."""
    rows = [
        ("river", "wood", "raft"),
        ("sea", "rope", "raft"),
        *[("sea", other, "fish") for other in ("net", "rod")],
    ]
    graph = RecipeGraph.from_recipes([*rows, ("wood", "axe", "log")])
    scorer = VoteScorer(graph, graph.recipes)
    scores = scorer.score_recipes("sea", "wood", graph.entities)
    order = [
        graph.entities[i] for i in torch.argsort(scores, descending=True, stable=True)[:3].tolist()
    ]
    assert order == ["raft", "fish", "log"]
    assert scorer.score_recipes("sea", "sea", "raft") < scorer.score_recipes("sea", "wood", "raft")
    assert scorer.votes("sea", ["raft", "fish", "log"]).tolist() == [1, 2, 0]


def test_without_recipes_nothing_is_preferred():
    scorer = VoteScorer(GRAPH, GRAPH.recipes[:0])
    assert len(scorer.score_recipes(EVERYTHING[:, None], EVERYTHING, 3).unique()) == 1
    assert all(len(scorer.table(relation).unique()) == 1 for relation in RELATIONS)


def test_recipes_are_scored_without_a_table_of_all_pairs(monkeypatch):
    """Recipes are scored where the scores of all pairs would be too many."""
    monkeypatch.setattr(config, "TABLE_LIMIT", len(RELATIONS) * SIZE**2 * 4 - 1)
    scorer = VoteScorer(GRAPH, KNOWN)
    assert scorer.score_recipes(0, 1, EVERYTHING).shape == (SIZE,)
    with pytest.raises(ConfigError, match=f"a score table for {SIZE} entities"):
        scorer.table(COMBINES_WITH)
