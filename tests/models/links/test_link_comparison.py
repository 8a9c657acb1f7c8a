"""Comparing two models by a paired bootstrap over recipes."""

import numpy as np
import pytest
import torch
from msgspec.structs import asdict

from wordcraft_kg.errors import ConfigError, GraphMismatchError, SplitError
from wordcraft_kg.graphs import SplitConfig, make_split
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.links.comparison import compare
from wordcraft_kg.models.links.config import ComplExConfig
from wordcraft_kg.models.links.folder import OpenedModel
from wordcraft_kg.models.scorers.facts import FrequencyScorer, SymbolicScorer
from wordcraft_kg.models.scorers.ranking import RankingMetrics, rank_triples, ranking_metrics
from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.models.scorers.tables import TableScorer


def model(scorer: Scorer, data: OpenedGraph, kg: str = "partial") -> OpenedModel:
    return OpenedModel(scorer, data, ComplExConfig(kg=kg), run=None, metrics=None, trace=[])


def noise(data: OpenedGraph, seed: int) -> Scorer:
    size = data.graph.num_entities
    scores = torch.rand(2, size, size, generator=torch.Generator().manual_seed(seed))
    return TableScorer(scores, data.graph.entities, data.graph.hash, name=f"noise-{seed}")


@pytest.fixture
def frequency(opened_kitchen: OpenedGraph) -> OpenedModel:
    return model(FrequencyScorer(opened_kitchen.graph, opened_kitchen.split.partial), opened_kitchen)


@pytest.fixture
def facts(opened_kitchen: OpenedGraph) -> OpenedModel:
    return model(SymbolicScorer(opened_kitchen.graph, opened_kitchen.graph.triples), opened_kitchen)


def test_a_model_does_not_differ_from_itself(frequency: OpenedModel):
    values = compare(frequency, frequency)
    assert (values.difference, values.difference_ci, values.probability_a_better) == (0, (0, 0), 0.5)
    assert values.a == values.b


def test_a_model_that_knows_the_answers_is_surely_better(facts: OpenedModel, frequency: OpenedModel):
    values = compare(facts, frequency)
    assert values.probability_a_better == 1
    assert values.difference_ci[0] > 0
    assert values.a.mrr == 1


def test_the_difference_is_that_of_the_mean_reciprocal_ranks(
    facts: OpenedModel, frequency: OpenedModel, opened_kitchen: OpenedGraph
):
    queries = opened_kitchen.split.held_out("test")
    metrics = [
        ranking_metrics(rank_triples(opened.scorer, queries, opened_kitchen.graph.triples))
        for opened in (facts, frequency)
    ]
    values = compare(facts, frequency)
    assert values.queries == metrics[0].queries == 2 * len(queries)
    assert values.difference == pytest.approx(metrics[0].mrr - metrics[1].mrr)
    assert {name: getattr(values.b, name) for name in RankingMetrics.__struct_fields__} == asdict(metrics[1])
    assert values.difference_ci[0] <= values.difference <= values.difference_ci[1]


def test_swapping_the_models_turns_the_signs(opened_kitchen: OpenedGraph):
    one, two = (model(noise(opened_kitchen, seed), opened_kitchen) for seed in (1, 2))
    there, back = compare(one, two), compare(two, one)
    assert there.difference == pytest.approx(-back.difference)
    assert there.difference_ci == pytest.approx([-back.difference_ci[1], -back.difference_ci[0]])
    assert 0 < there.probability_a_better < 1
    assert there.probability_a_better == pytest.approx(1 - back.probability_a_better)


def test_a_paired_interval_is_narrower_than_the_separate_ones(opened_kitchen: OpenedGraph):
    from wordcraft_kg.models.scorers.ranking import recipe_clusters, with_interval

    table = noise(opened_kitchen, 1).table("combinesWith")
    nudged = torch.stack([table, table]) + 1e-3 * torch.stack([noise(opened_kitchen, 2).table(r) for r in (0, 1)])
    graph, split = opened_kitchen.graph, opened_kitchen.split
    scorers = [TableScorer(scores, graph.entities, graph.hash) for scores in (torch.stack([table, table]), nudged)]
    values = compare(*(model(scorer, opened_kitchen) for scorer in scorers))
    queries = split.held_out("test")
    clusters = np.tile(recipe_clusters(graph, split.is_in("test"), queries), 2)
    low, high = with_interval(rank_triples(scorers[0], queries, graph.triples), clusters).mrr_ci
    assert values.difference_ci[1] - values.difference_ci[0] < (high - low) / 2


def test_the_comparison_is_determined_by_its_seed(opened_kitchen: OpenedGraph):
    one, two = (model(noise(opened_kitchen, seed), opened_kitchen) for seed in (1, 2))
    assert compare(one, two, seed=3) == compare(one, two, seed=3)
    assert compare(one, two, seed=3).difference_ci != compare(one, two, seed=4).difference_ci


def test_a_model_of_the_full_graph_is_marked_as_having_seen_the_queries(
    frequency: OpenedModel, facts: OpenedModel, opened_kitchen: OpenedGraph
):
    values = compare(model(facts.scorer, opened_kitchen, kg="full"), frequency)
    assert [side.has_seen_the_test_recipes for side in (values.a, values.b)] == [True, False]


def test_models_of_different_splits_are_refused(frequency: OpenedModel, opened_kitchen: OpenedGraph):
    graph = opened_kitchen.graph
    other = OpenedGraph(graph, make_split(graph, SplitConfig(seed=1)), "other")
    with pytest.raises(GraphMismatchError, match="different splits"):
        compare(frequency, model(FrequencyScorer(graph, other.split.partial), other))


def test_models_of_different_graphs_are_refused(frequency: OpenedModel):
    from link_helpers import random_graph

    graph = random_graph(num_entities=12, num_recipes=60)
    other = OpenedGraph(graph, make_split(graph, SplitConfig()), "other")
    with pytest.raises(GraphMismatchError, match="different graphs"):
        compare(frequency, model(FrequencyScorer(graph, graph.triples), other))


def test_a_split_without_unseen_triples_is_refused(opened_kitchen: OpenedGraph):
    graph = opened_kitchen.graph
    data = OpenedGraph(graph, make_split(graph, SplitConfig(kind="none")), "unsplit")
    opened = model(FrequencyScorer(graph, graph.triples), data)
    with pytest.raises(SplitError, match="unseen test triples to compare on"):
        compare(opened, opened)


@pytest.mark.parametrize("resamples", [0, -5])
def test_no_resamples_are_refused(frequency: OpenedModel, resamples: int):
    with pytest.raises(ConfigError, match=f"`resamples` {resamples}"):
        compare(frequency, frequency, resamples=resamples)
