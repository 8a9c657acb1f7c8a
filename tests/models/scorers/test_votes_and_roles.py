"""The vote count of recipes and triples, and how alike entities are to a scorer, against loops."""

import math

import numpy as np
import pytest
import torch
from link_helpers import random_graph
from small_scorers import complex_scorer, cosine, normal, table_scorer

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, RELATIONS, RecipeGraph
from wordcraft_kg.models.scorers import score_limits
from wordcraft_kg.models.scorers.baselines import NeighbourScorer, VoteScorer
from wordcraft_kg.models.scorers.link_evidence import ROLES, EntityRoles, centred

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
    monkeypatch.setattr(score_limits, "TABLE_LIMIT", len(RELATIONS) * SIZE**2 * 4 - 1)
    scorer = VoteScorer(GRAPH, KNOWN)
    assert scorer.score_recipes(0, 1, EVERYTHING).shape == (SIZE,)
    with pytest.raises(ConfigError, match=f"a score table for {SIZE} entities"):
        scorer.table(COMBINES_WITH)


def slow_rows(scorer, relation, side):
    """Scores of each entity with all others, less the means by row and by column,
    plus that of all."""
    size = len(scorer.entities)
    scores = scorer.table(relation).tolist()
    everything = sum(map(sum, scores)) / size**2
    by_row = [sum(row) / size for row in scores]
    by_column = [sum(row[j] for row in scores) / size for j in range(size)]
    rows = [
        [scores[i][j] - by_row[i] - by_column[j] + everything for j in range(size)]
        for i in range(size)
    ]
    return rows if side == "head" else [list(column) for column in zip(*rows, strict=True)]


@pytest.mark.parametrize(
    "scorer",
    [table_scorer(normal(2, SIZE, SIZE)), complex_scorer(SIZE, 3)],
    ids=["table", "factors"],
)
def test_likeness_in_a_role_is_the_cosine_of_centred_scores(scorer):
    """In a role entities are alike by the cosine of their centred scores."""
    found = EntityRoles.of(scorer)
    for relation, side in ROLES:
        rows = slow_rows(scorer, relation, side)
        expected = [[cosine(one, other) for other in rows] for one in rows]
        alike = [found.alike(entity, relation, side) for entity in range(SIZE)]
        np.testing.assert_allclose(alike, expected, atol=1e-5)


def test_nearest_entities_have_the_highest_cosine(opened_kitchen):
    """The nearest entities have the highest cosine of standardised scores."""
    scorer = NeighbourScorer(opened_kitchen.graph, opened_kitchen.split.partial)
    tables = [centred(scorer.table(relation).double().numpy()) for relation in (0, 1)]
    profiles = np.concatenate(
        [part / table.std() for table in tables for part in (table, table.T)], axis=1
    )
    profiles /= np.maximum(np.linalg.norm(profiles, axis=1, keepdims=True), 1e-12)
    found = EntityRoles.of(scorer)
    for entity in range(0, opened_kitchen.graph.num_entities, 7):
        cosines = profiles @ profiles[entity]
        cosines[entity] = -np.inf
        nearest = found.nearest(entity, limit=4)
        for values in ([value for _, value in nearest], [cosines[other] for other, _ in nearest]):
            np.testing.assert_allclose(values, np.sort(cosines)[::-1][:4], atol=1e-4)


def test_an_entity_that_all_score_alike_is_like_none():
    scores = normal(2, SIZE, SIZE, seed=2)
    scores[:, 4] = scores[:, torch.arange(SIZE) != 4].mean(1)
    scores[:, :, 4] = scores[:, :, torch.arange(SIZE) != 4].mean(2)
    scores[:, 4, 4] = scores.mean((1, 2))
    found = EntityRoles.of(table_scorer(scores))
    assert not found.alike(4, 0, "head").any()
    assert all(value == 0 for _, value in found.nearest(4))
    constant = EntityRoles.of(table_scorer(torch.ones(2, SIZE, SIZE)))
    assert [value for _, value in constant.nearest(0, limit=3)] == [0, 0, 0]


def test_too_many_pairs_without_factors_are_refused(monkeypatch):
    monkeypatch.setattr(score_limits, "TABLE_LIMIT", 8 * SIZE**2 - 1)
    with pytest.raises(ConfigError, match="comparing entities by scores needs a score table"):
        EntityRoles.of(table_scorer(normal(2, SIZE, SIZE)))
    assert EntityRoles.of(complex_scorer(SIZE, 3)).lengths.shape == (SIZE, 4)
