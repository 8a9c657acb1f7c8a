"""Filtered ranking and its metrics against slow loops, enumeration and PyKEEN's evaluator."""

import itertools
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given, strategies as st
from link_helpers import random_graph, slow_clusters, slow_ranks
from pykeen.evaluation import RankBasedEvaluator
from pykeen.models import ComplEx
from small_scorers import table_scorer

from wordcraft_kg.base import ArtefactError, as_values
from wordcraft_kg.base.statistics import interval
from wordcraft_kg.graphs.splits import Split, SplitConfig
from wordcraft_kg.graphs.triples import RELATIONS, is_in, recipe_triples, triple_keys
from wordcraft_kg.models.links.builders import scorer_tensors
from wordcraft_kg.models.links.link_config import ComplExConfig
from wordcraft_kg.models.links.pykeen_bridge import triples_factory
from wordcraft_kg.models.scorers import ranking as link_prediction
from wordcraft_kg.models.scorers.baselines import FrequencyScorer
from wordcraft_kg.models.scorers.ranking import (
    RankingMetrics,
    random_metrics,
    rank_triples,
    ranking_metrics,
    sampled,
    slice_masks,
    triple_groups,
    with_interval,
)
from wordcraft_kg.models.scorers.scorer_folder import make_scorer

HITS = (1, 3, 10)


def constant_scorer(num_entities):
    return table_scorer(np.full((len(RELATIONS), num_entities, num_entities), 0.5))


@st.composite
def rankings(draw):
    """A table of few different scores, queries (known or not, repeated or not) and
    known triples."""
    size, levels = draw(st.integers(1, 6)), draw(st.integers(1, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    every = np.array(list(itertools.product(range(size), range(len(RELATIONS)), range(size))))
    known = every[rng.random(len(every)) < draw(st.sampled_from([0.0, 0.2, 0.6, 1.0]))]
    queries = every[rng.integers(len(every), size=draw(st.integers(1, 12)))]
    return rng.integers(-levels, levels, size=(len(RELATIONS), size, size)), queries, known


@given(rankings())
def test_ranks_equal_those_of_a_slow_loop(case):
    table, queries, known = case
    found = rank_triples(table_scorer(table), queries, known)
    expected = pd.DataFrame(slow_ranks(table, queries, known))
    columns = [name for name in expected if name != "tops"]
    pd.testing.assert_frame_equal(found[columns], expected[columns], check_dtype=False)
    assert all(top in tops for top, tops in zip(found["top"], expected["tops"], strict=True))


@given(rankings())
def test_ranks_do_not_depend_on_the_batches(case):
    table, queries, known = case
    with pytest.MonkeyPatch.context() as patch:
        whole = rank_triples(table_scorer(table), queries, known)
        patch.setattr(link_prediction, "BATCH", 2)
        pd.testing.assert_frame_equal(rank_triples(table_scorer(table), queries, known), whole)


@pytest.mark.parametrize("cells", [pytest.param(1, marks=pytest.mark.slow), 11, 40])
def test_of_many_entities_fewer_queries_are_scored_at_once(opened_kitchen, monkeypatch, cells):
    graph = opened_kitchen.graph
    scorer = FrequencyScorer(graph, opened_kitchen.split.partial)
    queries = opened_kitchen.split.held_out("test")
    expected = rank_triples(scorer, queries, graph.triples)
    blocks = []

    def score(heads, relations, tails, whole=scorer.score):
        found = whole(heads, relations, tails)
        blocks.append(len(found))
        return found

    monkeypatch.setattr(scorer, "score", score)
    monkeypatch.setattr(link_prediction, "CELLS", cells * graph.num_entities)
    pd.testing.assert_frame_equal(rank_triples(scorer, queries, graph.triples), expected)
    assert max(blocks) == cells


def test_a_sample_is_of_the_size_asked_for_in_order_and_of_its_seed(opened_kitchen):
    triples = opened_kitchen.graph.triples
    one, again, other = (sampled(triples, 40, seed) for seed in (0, 0, 1))
    assert len(one) == 40
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)
    keys = triple_keys(one, opened_kitchen.graph.num_entities)
    assert (np.diff(keys) > 0).all()
    assert is_in(one, triples, opened_kitchen.graph.num_entities).all()
    assert sampled(triples, len(triples)) is triples


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_scores_that_are_not_finite_are_an_artefact_error(value):
    table = np.zeros((2, 4, 4))
    table[1, 2, 3] = value
    triples = np.array([[2, 1, 0]])
    with pytest.raises(ArtefactError, match="not finite"):
        rank_triples(table_scorer(table), triples, triples)


def exact_model(opened):
    factory = triples_factory(opened.graph, opened.split.partial)
    model, generator = (
        ComplEx(triples_factory=factory, embedding_dim=4, random_seed=0),
        torch.Generator(),
    )
    with torch.no_grad():  # halves: scores are exact in single precision, with real ties
        for parameter in model.parameters():
            parameter.copy_(torch.randint(-2, 3, parameter.shape, generator=generator) / 2)
    return model.eval()


def pykeens_metrics(opened, model):
    return RankBasedEvaluator(filtered=True).evaluate(
        model,
        torch.from_numpy(opened.split.held_out("test").copy()),
        batch_size=64,
        additional_filter_triples=[torch.from_numpy(opened.graph.triples.copy())],
        use_tqdm=False,
    )


def test_ranks_and_metrics_agree_with_pykeens_evaluator(opened_kitchen):
    graph, split = opened_kitchen.graph, opened_kitchen.split
    model = exact_model(opened_kitchen)
    theirs = pykeens_metrics(opened_kitchen, model)
    scorer = make_scorer(
        *scorer_tensors(ComplExConfig(dim=4), model, graph.triples), graph.entities, graph.hash
    )
    ranks = rank_triples(scorer, split.held_out("test"), graph.triples)
    assert (ranks["optimistic"] < ranks["pessimistic"]).any()
    for kind, column in (
        ("realistic", "rank"),
        ("optimistic", "optimistic"),
        ("pessimistic", "pessimistic"),
    ):
        for side, part in (
            ("both", ranks),
            *((name, ranks[ranks["side"] == name]) for name in ("head", "tail")),
        ):
            ours = ranking_metrics(part, column)
            names = {"mrr": "inverse_harmonic_mean_rank", "mean_rank": "arithmetic_mean_rank"}
            names |= {name: name for name in ("hits_at_1", "hits_at_3", "hits_at_10")}
            if kind == "realistic":
                names["amri"] = "adjusted_arithmetic_mean_rank_index"
            for name, pykeens in names.items():
                expected = theirs.get_metric(f"{side}.{kind}.{pykeens}")
                assert getattr(ours, name) == pytest.approx(expected, rel=1e-6, abs=1e-6), name


def test_a_field_of_one_candidate_has_no_chance_to_beat():
    ranks = pd.DataFrame({"rank": [1.0, 1.0], "candidates": [1, 1]})
    assert ranking_metrics(ranks).amri == 0
    assert random_metrics(ranks).mrr == 1


def test_random_metrics_equal_the_mean_over_all_permutations():
    sizes = [1, 2, 4, 4, 5]
    orders = [list(itertools.permutations(range(size))) for size in sizes]
    ranks = [
        (1 + order.index(0), Fraction(1, len(some) * len(sizes)))
        for some in orders
        for order in some
    ]
    expected = {f"hits@{k}": float(sum(share for rank, share in ranks if rank <= k)) for k in HITS}
    expected |= {
        "mrr": float(sum(share / rank for rank, share in ranks)),
        "queries": len(sizes),
        "amri": 0,
    }
    expected["mean_rank"] = float(sum(share * rank for rank, share in ranks))
    assert as_values(random_metrics(pd.DataFrame({"candidates": sizes}))) == pytest.approx(expected)


def test_slices_part_the_queries_by_relation_and_side(opened_kitchen):
    graph = opened_kitchen.graph
    ranks = rank_triples(constant_scorer(graph.num_entities), graph.triples[::9], graph.triples)
    masks = slice_masks(ranks)
    assert masks["all"].all()
    for number, relation in enumerate(RELATIONS):
        assert set(ranks.loc[masks[relation], "relation"]) == {number}
        sides = {side: masks[f"{relation}, predict {side}"] for side in ("head", "tail")}
        assert {side: set(ranks.loc[mask, "side"]) for side, mask in sides.items()} == {
            s: {s} for s in sides
        }
        np.testing.assert_array_equal(sides["head"] ^ sides["tail"], masks[relation])
    np.testing.assert_array_equal(masks[RELATIONS[0]] ^ masks[RELATIONS[1]], masks["all"])


@given(st.integers(0, 10_000), st.integers(3, 9), st.integers(1, 25), st.floats(0.1, 1))
@pytest.mark.parametrize("kind", ["by-recipe", "by-goal", "by-slot"])
def test_groups_of_triples_are_the_first_groups_that_give_them(
    kind, seed, num_entities, num_recipes, share
):
    graph = random_graph(seed, num_entities, num_recipes)
    chosen = np.random.default_rng(seed).random(graph.num_recipes) < share
    chosen[0] = True
    triples = recipe_triples(graph.recipes[chosen])
    split = Split(graph, SplitConfig(kind), np.zeros(graph.num_recipes, dtype=np.int8))
    found = triple_groups(split, chosen, triples).tolist()
    groups = split.groups[chosen].tolist()
    for triple, group in zip(triples.tolist(), found, strict=True):
        giving = [
            number
            for number, recipe in zip(groups, graph.recipes[chosen], strict=True)
            if triple in recipe_triples(recipe[None]).tolist()
        ]
        assert group == min(giving)
    if kind == "by-recipe":
        assert found == slow_clusters(graph, chosen, triples)


def test_an_interval_leaves_out_half_the_rest_on_each_side():
    assert interval(np.arange(1001.0)) == pytest.approx((25, 975))
    assert interval(np.arange(1001.0), level=0.5) == pytest.approx((250, 750))


def test_no_queries_have_no_interval():
    empty = pd.DataFrame({"rank": [], "candidates": []})
    assert with_interval(empty, np.array([], dtype=np.int64)) == RankingMetrics(0)


@pytest.mark.parametrize("recipes", [1, 4, 5])
def test_an_mrr_over_fewer_than_five_recipes_has_no_interval(recipes):
    ranks = pd.DataFrame({"rank": [1.0, 2.0] * recipes, "candidates": 9})
    assert (with_interval(ranks, np.repeat(np.arange(recipes), 2)).mrr_ci is None) == (recipes < 5)


def test_ranking_needs_nothing_of_a_scorer_but_the_protocol():
    table = np.random.default_rng(0).integers(4, size=(2, 5, 5))
    inner = table_scorer(table)
    bare = SimpleNamespace(
        entities=inner.entities, graph_hash="hash", score=inner.score, table=inner.table
    )
    triples = np.array([[0, 0, 1], [2, 1, 4]])
    pd.testing.assert_frame_equal(
        rank_triples(bare, triples, triples), rank_triples(inner, triples, triples)
    )
