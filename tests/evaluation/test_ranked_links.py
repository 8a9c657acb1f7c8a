"""Comparing models by a paired bootstrap over recipes."""

import numpy as np
import pytest
import torch
from msgspec.structs import asdict

from wordcraft_kg.base.errors import ConfigError, GraphMismatchError, SplitError
from wordcraft_kg.evaluation import ranked_links
from wordcraft_kg.evaluation.ranked_links import Contender, compare, rank_links
from wordcraft_kg.graphs import OpenedGraph, RecipeGraph, SplitConfig, make_split, open_graph
from wordcraft_kg.models.links.link_config import ComplExConfig, LinksConfig
from wordcraft_kg.models.model import History, Model
from wordcraft_kg.models.scorers.baselines import FrequencyScorer, SymbolicScorer
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.ranking import (
    RankingMetrics,
    rank_triples,
    ranking_metrics,
    triple_groups,
    with_interval,
)


def model(scorer, data, **settings):
    return Model(scorer, data, None, History(LinksConfig("kitchen", ComplExConfig(**settings))))


def noise(data, seed):
    size = data.graph.num_entities
    scores = torch.rand(2, size, size, generator=torch.Generator().manual_seed(seed))
    return TableScorer(scores, data.graph.entities, data.graph.hash, name=f"noise-{seed}")


def compared(*models):
    """Compare models of one run each."""
    return compare([Contender(one.scorer.name, [one]) for one in models])


def second(*models):
    """The figures of the second of two models."""
    return compared(*models).models[1]


@pytest.fixture
def noises(opened_kitchen):
    """Four models of random scores."""
    return [model(noise(opened_kitchen, seed), opened_kitchen) for seed in range(4)]


@pytest.fixture
def frequency(opened_kitchen):
    return model(
        FrequencyScorer(opened_kitchen.graph, opened_kitchen.split.partial), opened_kitchen
    )


@pytest.fixture
def facts(opened_kitchen):
    return model(SymbolicScorer(opened_kitchen.graph, opened_kitchen.graph.triples), opened_kitchen)


def test_a_model_that_knows_the_answers_is_significantly_better(facts, frequency):
    values = compared(frequency, facts)
    assert values.models[1].difference_ci[0] > 0
    assert values.models[1].mrr == 1
    assert (values.best, values.not_significant) == (facts.scorer.name, ())


def test_the_difference_is_that_of_the_mean_reciprocal_ranks(facts, frequency, opened_kitchen):
    queries = opened_kitchen.split.held_out("test")
    ranks = [
        rank_triples(one.scorer, queries, opened_kitchen.graph.triples)
        for one in (facts, frequency)
    ]
    metrics = [ranking_metrics(one) for one in ranks]
    values = compared(facts, frequency)
    other = values.models[1]
    assert values.queries == metrics[0].queries == 2 * len(queries) == 2 * values.triples
    assert other.difference == pytest.approx(metrics[1].mrr - metrics[0].mrr)
    found = {name: getattr(other, name) for name in RankingMetrics.__struct_fields__}
    clusters = np.tile(
        triple_groups(opened_kitchen.split, opened_kitchen.split.is_in("test"), queries), 2
    )
    assert found == asdict(with_interval(ranks[1], clusters))
    assert other.difference_ci[0] <= other.difference <= other.difference_ci[1]


def test_of_very_many_queries_a_sample_is_ranked_and_said_to_be_one(
    frequency, opened_kitchen, monkeypatch
):
    everything = len(opened_kitchen.split.held_out("test"))
    assert compared(frequency, frequency).sampled_from is None
    monkeypatch.setattr(ranked_links, "MAX_QUERIES", 80)
    found = compared(frequency, frequency)
    assert (found.triples, found.queries, found.sampled_from) == (40, 80, everything)


def test_more_models_widen_intervals_of_differences_only(noises):
    """More models widen the intervals of differences but not those of models."""
    two, four = compared(*noises[:2]), compared(*noises)
    assert (two.pairs, four.pairs) == (1, 6)
    assert two.models[0] == four.models[0]
    one, other = two.models[1], four.models[1]
    assert (one.difference, one.mrr_ci) == (other.difference, other.mrr_ci)
    assert (
        other.difference_ci[0]
        < one.difference_ci[0]
        < one.difference_ci[1]
        < other.difference_ci[1]
    )


def test_the_best_is_the_one_with_the_highest_mrr_and_says_who_is_as_good(facts, noises):
    _, one, two, _ = noises
    values = compared(one, facts, two, facts)
    assert values.best == facts.scorer.name
    assert values.not_significant == (facts.scorer.name,)
    values = compared(one, two)
    mrr = {found.name: found.mrr for found in values.models}
    assert values.best == max(mrr, key=mrr.__getitem__)
    assert values.not_significant == (min(mrr, key=mrr.__getitem__),)


def test_a_model_of_the_full_graph_is_marked_and_is_never_the_best(
    frequency, facts, opened_kitchen
):
    full = model(facts.scorer, opened_kitchen, kg="full")
    values = compared(full, frequency)
    assert [found.has_seen_the_test_recipes for found in values.models] == [True, False]
    assert values.best == frequency.scorer.name
    assert values.not_significant == ()
    assert compared(full, full).best is None


def test_seeds_are_averaged_query_by_query(frequency, opened_kitchen):
    runs = [model(noise(opened_kitchen, seed), opened_kitchen, seed=seed) for seed in (5, 6)]
    singles = [second(frequency, run) for run in runs]
    other = compare([Contender("frequency", [frequency]), Contender("noise", runs)]).models[1]
    assert (other.name, other.seeds) == ("noise", (5, 6))
    assert other.mrr_of_seeds == tuple(single.mrr for single in singles)
    for name in ("mrr", "hits_at_10", "mean_rank", "difference"):
        assert getattr(other, name) == pytest.approx(
            np.mean([getattr(single, name) for single in singles])
        )
    widths = [single.mrr_ci[1] - single.mrr_ci[0] for single in singles]
    assert other.mrr_ci[1] - other.mrr_ci[0] < max(widths)


def test_seeds_with_other_settings_are_refused(frequency, opened_kitchen):
    runs = [model(noise(opened_kitchen, 1), opened_kitchen, dim=dim) for dim in (8, 9)]
    with pytest.raises(
        ConfigError, match="the seeds of 'noise' were trained with different settings"
    ):
        compare([Contender("frequency", [frequency]), Contender("noise", runs)])


@pytest.mark.parametrize(
    "other", [("kitchen", SplitConfig(seed=1)), ("paper-examples",)], ids=["split", "graph"]
)
def test_models_of_different_graphs_or_splits_are_refused(frequency, other):
    opened = open_graph(*other)
    with pytest.raises(GraphMismatchError):
        compared(frequency, model(FrequencyScorer(opened.graph, opened.graph.triples), opened))


def test_a_split_without_unseen_triples_is_refused(opened_kitchen):
    graph = opened_kitchen.graph
    data = OpenedGraph(graph, make_split(graph, SplitConfig(kind="none")), "unsplit")
    opened = model(FrequencyScorer(graph, graph.triples), data)
    with pytest.raises(SplitError, match=r"only .* unseen test triples"):
        compared(opened, opened)
    few = RecipeGraph(["a", "b", "c"], [[0, 1, 2]], [])
    tiny = OpenedGraph(few, make_split(few, SplitConfig(kind="none")), "tiny")
    with pytest.raises(SplitError, match=r"in the whole graph; .* Use a [a-z ]* recipes\.$"):
        rank_links(FrequencyScorer(few, few.triples), tiny, kg="full")
