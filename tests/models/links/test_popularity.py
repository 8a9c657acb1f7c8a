"""Popularity as six more dimensions of ComplEx: the scores are the old ones plus a multiple of the log counts."""

import math

import numpy as np
import pytest
import torch
from link_helpers import random_graph
from small_scorers import embeddings

from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.links.popularity import DIMS, log_counts, with_popularity
from wordcraft_kg.models.scorers.factors import ComplExScorer


def counted(triples, relation, entity, column):
    return sum(1 for triple in triples.tolist() if triple[1] == relation and triple[column] == entity)


def test_the_log_counts_are_those_of_a_loop():
    graph = random_graph()
    as_head, as_tail = log_counts(graph.triples, graph.num_entities)
    for found, column in ((as_head, 0), (as_tail, 2)):
        for relation in range(len(RELATIONS)):
            expected = [math.log1p(counted(graph.triples, relation, e, column)) for e in range(graph.num_entities)]
            assert found[relation].tolist() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("weight", [0.5, 16.0])
def test_scores_gain_the_weighted_log_counts_of_head_and_tail(weight):
    graph = random_graph(num_entities=12, num_recipes=40)
    assert np.any(counted(graph.triples, 1, 0, 0) != counted(graph.triples, 1, 0, 2))  # componentOf is not symmetric
    before = embeddings(graph.num_entities, 4, seed=1)
    after = with_popularity(before, graph.triples, weight)
    assert after["entity_real"].shape == (graph.num_entities, 4 + DIMS)
    as_head, as_tail = log_counts(graph.triples, graph.num_entities)
    for relation in range(len(RELATIONS)):
        old, new = (ComplExScorer(e, graph.entities, graph.hash).table(relation) for e in (before, after))
        gained = weight * (as_head[relation][:, None] + as_tail[relation][None, :])
        torch.testing.assert_close(new - old, gained, atol=2e-4, rtol=1e-5)


def test_without_popularity_the_embeddings_stay_as_they_are():
    graph = random_graph()
    before = embeddings(graph.num_entities, 4, seed=1)
    assert with_popularity(before, graph.triples, 0.0) is before
