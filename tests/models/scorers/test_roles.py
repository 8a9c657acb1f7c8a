"""How alike entities are to a scorer, against loops over its scores."""

import numpy as np
import pytest
import torch
from link_helpers import random_graph
from small_scorers import complex_scorer, cosine, normal, table_scorer

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.models.scorers import config
from wordcraft_kg.models.scorers.baselines import NeighbourScorer
from wordcraft_kg.models.scorers.link_evidence import ROLES, EntityRoles, centred

GRAPH = random_graph(num_entities=9, num_recipes=30)
SIZE = GRAPH.num_entities


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
    monkeypatch.setattr(config, "TABLE_LIMIT", 8 * SIZE**2 - 1)
    with pytest.raises(ConfigError, match="comparing entities by scores needs a score table"):
        EntityRoles.of(table_scorer(normal(2, SIZE, SIZE)))
    assert EntityRoles.of(complex_scorer(SIZE, 3)).lengths.shape == (SIZE, 4)
