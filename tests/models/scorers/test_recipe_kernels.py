"""The recipe kernel against slow references, and what holds for any recipes."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from kernel_oracles import explicit_ridge, slow_completion, slow_profiles, slow_similarity
from refusals import refuses

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.statistics import standardised
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_book, recipe_triples
from wordcraft_kg.models.scorers.baselines import NeighbourScorer
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.kernel import (
    KernelScorer,
    completion,
    cosines,
    kernel_regression,
    link_matrices,
    normalised,
    profiles,
    similarity,
)
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
def test_the_similarity_is_that_of_profiles_and_words(recipes):
    vectors = drawn_vectors(0)
    found = similarity(recipes, cosines(torch.tensor(vectors)))
    np.testing.assert_allclose(found.numpy(), slow_similarity(recipes.tolist(), vectors), atol=1e-6)


@given(seed=st.integers(0, 10_000), count=st.integers(3, 40))
def test_similarity_without_words_is_positive_semi_definite(seed, count):
    """The similarity without words is positive semi definite and follows a renaming."""
    recipes, nothing = drawn_recipes(seed, count), torch.zeros(SIZE, SIZE)
    kernel = similarity(recipes, nothing)
    assert torch.linalg.eigvalsh(kernel.double())[0] > -1e-6
    renaming = np.random.default_rng(seed).permutation(SIZE)
    renamed = similarity(renaming[recipes], nothing)
    torch.testing.assert_close(renamed[np.ix_(renaming, renaming)], kernel)


def test_an_indefinite_similarity_leaves_the_words_out():
    """Words of few dimensions can make the similarity indefinite and the regression does without."""
    angles = np.random.default_rng(0).random(60) * 2 * np.pi
    vectors = torch.tensor(np.stack([np.cos(angles), np.sin(angles)], axis=1))
    kernel = similarity(np.zeros((0, 3), dtype=np.int64), cosines(vectors))
    values, vectors = torch.linalg.eigh(kernel.double())
    assert values[0] < -0.01
    cut, links = ((vectors * values.clamp(min=0)) @ vectors.T).float(), torch.eye(60)
    found, expected = (kernel_regression(one, links)[0] for one in (kernel, cut))
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=0)


def test_self_similarity_is_highest_and_unused_entities_have_none():
    """An entity is as similar to itself as can be and one of no recipe to nothing."""
    alike = normalised(similarity(drawn_recipes(0), torch.zeros(SIZE, SIZE)))
    torch.testing.assert_close(alike.diagonal()[:-1], torch.ones(SIZE - 1))
    assert alike.max() <= 1 + 1e-6
    assert not alike[-1].any()
    assert not alike[:, -1].any()


@given(seed=st.integers(0, 10_000), ridge=st.sampled_from([0.1, 1.0, 7.0]))
def test_kernel_regression_is_the_explicit_ridge_on_all_pairs(seed, ridge):
    rng = np.random.default_rng(seed)
    parts, links = rng.standard_normal((5, 7)), (rng.random((5, 5)) < 0.4).astype(float)
    kernel = parts @ parts.T / 7
    found = kernel_regression(torch.from_numpy(kernel), torch.from_numpy(links), ridge=ridge)[0]
    np.testing.assert_allclose(found.numpy(), explicit_ridge(kernel, links, ridge), atol=1e-5)


@any_recipes
def test_completion_counts_paths_of_three_pairs_of_the_same_result(recipes):
    np.testing.assert_allclose(
        completion(recipes, SIZE).numpy(), slow_completion(recipes.tolist(), SIZE), atol=1e-6
    )


@any_recipes
def test_link_matrices_hold_the_triples(recipes):
    tables = torch.stack(link_matrices(recipes, SIZE))
    expected = {(r, h, t) for h, r, t in recipe_triples(recipes).tolist()}
    assert {tuple(cell) for cell in torch.nonzero(tables).tolist()} == expected


def test_the_kernel_scorer_is_the_sum_of_standardised_parts():
    recipes, vectors = drawn_recipes(1, 40), drawn_vectors(0)
    graph = graph_of(recipes)
    scorer = KernelScorer(graph, recipes, vectors)
    kernel = similarity(recipes, cosines(torch.tensor(vectors)))
    combines, component = (
        standardised(kernel_regression(kernel, links)[0].numpy())
        for links in link_matrices(recipes, SIZE)
    )
    combines = combines + 0.5 * standardised(completion(recipes, SIZE).numpy())
    np.testing.assert_allclose(scorer.table("combinesWith").numpy(), combines, atol=1e-4)
    np.testing.assert_allclose(scorer.table("componentOf").numpy(), component, atol=1e-4)
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
