"""The recipe kernel against slow references, and what holds for any recipes."""

import numpy as np
import pytest
import torch
from kernel_oracles import (
    explicit_ridge,
    link_tables,
    slow_completion,
    slow_profiles,
    slow_similarity,
)
from refusals import refuses

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.statistics import standardised
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_book, recipe_triples
from wordcraft_kg.models.scorers.baselines import KernelScorer, NeighbourScorer
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.kernel import completion, profiles
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples

SIZE = 9
"""Entities; the last one is in no recipe."""


def drawn_recipes(seed, count=14):
    rng = np.random.default_rng(seed)
    rows = rng.integers(SIZE - 1, size=(count, 3))
    rows[0, 1] = rows[0, 0]  # a recipe of one entity twice
    rows[1] = rows[2]  # and one that is there twice
    return rows


def drawn_vectors(seed):
    vectors = np.random.default_rng([seed, 1]).standard_normal((SIZE, 4)).astype(np.float32)
    vectors[3] = 0  # a word without a vector
    return vectors


CASES = [
    pytest.param(drawn_recipes(0), id="drawn"),
    pytest.param(drawn_recipes(1, 40), id="many"),
    pytest.param(np.array([[2, 2, 2]]), id="one entity makes itself"),
    pytest.param(np.zeros((0, 3), dtype=np.int64), id="none"),
]
any_recipes = pytest.mark.parametrize("recipes", CASES)


def graph_of(recipes):
    """A graph whose ids are those of the rows, with every entity in it."""
    rows = np.concatenate([recipes, [[i, i, i] for i in range(SIZE)]])
    return RecipeGraph.from_recipes([tuple(f"e{i}" for i in row) for row in rows], name="drawn")


@any_recipes
def test_profiles_are_the_damped_rows_of_links_and_contexts(recipes):
    found = profiles(recipes, SIZE)
    expected = slow_profiles(recipes.tolist(), SIZE)
    gram = [
        [sum(v * other.get(c, 0) for c, v in row.items()) for other in expected] for row in expected
    ]
    np.testing.assert_allclose((found @ found.T).toarray(), gram, atol=1e-12)
    # The contexts, and with them all that has no counterpart elsewhere, have the right lengths too.
    lengths = sorted(round(v, 9) for row in expected for v in row.values())
    np.testing.assert_allclose(sorted(found.data), lengths, atol=1e-8)


@any_recipes
def test_completion_counts_paths_of_three_pairs_of_the_same_result(recipes):
    np.testing.assert_allclose(
        completion(recipes, SIZE).numpy(), slow_completion(recipes.tolist(), SIZE), atol=1e-6
    )


def test_the_kernel_scorer_is_the_sum_of_standardised_parts():
    recipes, vectors = drawn_recipes(1, 40), drawn_vectors(0)
    graph = graph_of(recipes)
    scorer = KernelScorer(graph, recipes, vectors)
    kernel = slow_similarity(recipes.tolist(), vectors)
    combines, component = (
        standardised(explicit_ridge(kernel, links, np.unique(recipes)))
        for links in link_tables(recipe_triples(recipes), SIZE)
    )
    combines = combines + 0.5 * standardised(slow_completion(recipes.tolist(), SIZE))
    np.testing.assert_allclose(scorer.table("combinesWith").numpy(), combines, atol=1e-3)
    np.testing.assert_allclose(scorer.table("componentOf").numpy(), component, atol=1e-3)
    assert (scorer.name, scorer.graph_hash) == ("recipe kernel", graph.hash)


@any_recipes
def test_scorers_of_any_recipes_are_finite_and_the_same_again(recipes):
    graph = graph_of(recipes)
    for vectors in (None, drawn_vectors(0)):
        tables = [
            torch.stack([KernelScorer(graph, recipes, vectors).table(r) for r in (0, 1)])
            for _ in range(2)
        ]
        assert torch.isfinite(tables[0]).all()
        assert torch.equal(*tables)


def test_large_tables_and_foreign_vectors_are_refused(kitchen, monkeypatch):
    """A table that is too large and vectors of another graph are refused."""
    with refuses("vectors"):
        KernelScorer(kitchen, kitchen.recipes, np.zeros((3, 4)))
    monkeypatch.setattr("wordcraft_kg.models.scorers.config.TABLE_LIMIT", 1_000)
    with pytest.raises(ConfigError, match="the recipe kernel needs"):
        KernelScorer(kitchen, kitchen.recipes)


def validation_mrrs(graph, seed):
    """Validation MRR of the recipe kernel and of the neighbour rule."""
    split = make_split(graph, SplitConfig(seed=seed, valid_ratio=0.1))
    vectors = glove_features(graph.entities).vectors
    scorers = (
        KernelScorer(graph, split.recipes("train"), vectors),
        NeighbourScorer(graph, split.partial),
    )
    ranks = [rank_triples(scorer, split.held_out("valid"), graph.triples) for scorer in scorers]
    return mean_reciprocal_rank(ranks[0]), mean_reciprocal_rank(ranks[1])


@pytest.mark.slow
def test_the_kernel_beats_neighbours_on_everyday_1():
    """The kernel predicts unseen links of everyday 1 better than neighbours."""
    found = validation_mrrs(RecipeGraph.from_book(open_book("everyday-1")), seed=10)
    assert found == pytest.approx((0.247, 0.163), abs=0.003)


@pytest.mark.slow
def test_the_kernel_predicts_unseen_links_of_little_alchemy(alchemy):
    assert validation_mrrs(alchemy, seed=11) == pytest.approx((0.349, 0.216), abs=0.003)
