"""The recipe scorer as others use it: scores of recipes and of links, and the recipes that speak
for one."""

import numpy as np
import pytest
import torch

from wordcraft_kg.base.errors import UnknownEntityError
from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, Recipe
from wordcraft_kg.graphs.folds import make_folds
from wordcraft_kg.models.scorers import probabilities, recipes
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.protocol import RecipeScores
from wordcraft_kg.models.scorers.recipes import RecipeScorer


@pytest.fixture(scope="module")
def scorer(cross_fitted):
    found = whole_of(cross_fitted)
    assert isinstance(found, RecipeScores)
    assert whole_of(found) is found
    return found


def test_a_recipe_has_one_score_however_it_is_asked(scorer):
    size = len(scorer.entities)
    rng = np.random.default_rng(0)
    a, b, results = (torch.from_numpy(rng.integers(size, size=50)) for _ in range(3))
    b[:5] = a[:5]
    scores = scorer.score_recipes(a, b, results)
    assert (scores.shape, scores.dtype) == ((50,), torch.float32)
    torch.testing.assert_close(scorer.score_recipes(b, a, results), scores, rtol=0, atol=0)
    for row in range(0, 50, 7):
        labels = [scorer.entities[int(ids[row])] for ids in (a, b, results)]
        torch.testing.assert_close(scorer.score_recipes(*labels), scores[row], rtol=1e-4, atol=1e-4)
    everything = torch.arange(size)
    grid = scorer.score_recipes(a[:3, None], b[:3, None], everything)
    assert grid.shape == (3, size)
    torch.testing.assert_close(grid[torch.arange(3), results[:3]], scores[:3], rtol=1e-4, atol=1e-4)
    assert scorer.score_recipes([], [], []).shape == (0,)
    with pytest.raises(UnknownEntityError, match="no entity 'waater' in kitchen-recipes"):
        scorer.score_recipes("waater", "flour", "dough")


def test_a_loaded_cross_fitted_scorer_scores_as_its_whole(cross_fitted, scorer):
    """A loaded cross fitted scorer scores recipes as the scorer of all recipes."""
    assert isinstance(cross_fitted, RecipeScores)
    recipe = "flour", "water", "dough"
    assert torch.equal(cross_fitted.score_recipes(*recipe), scorer.score_recipes(*recipe))
    assert cross_fitted.supporting_recipes(*recipe) == scorer.supporting_recipes(*recipe)
    assert torch.equal(cross_fitted.recipes, scorer.recipes)


def test_scores_of_links_are_those_of_the_link_ranker(scorer, cross_fitted):
    everything = torch.arange(len(scorer.entities))
    for relation in (COMBINES_WITH, COMPONENT_OF):
        table = scorer.table(relation)
        torch.testing.assert_close(
            table, scorer.score(everything[:, None], relation, everything), rtol=0, atol=0
        )
        torch.testing.assert_close(cross_fitted.table(relation), table, rtol=0, atol=0)
    pairs = scorer.table(COMBINES_WITH)
    torch.testing.assert_close(pairs, pairs.T, rtol=2e-3, atol=1e-4)
    assert not torch.equal(pairs, scorer.table(COMPONENT_OF))


@pytest.mark.parametrize("has_table", [True, False])
def test_queries_of_both_relations_have_the_scores_of_each(scorer, has_table, monkeypatch):
    everything = torch.arange(len(scorer.entities))
    relations = torch.tensor([COMBINES_WITH, COMPONENT_OF, COMPONENT_OF, COMBINES_WITH])[:, None]
    some = torch.tensor([3, 3, 7, 0])[:, None]
    expected = [scorer.table(relation)[row] for relation, row in zip(relations, some, strict=True)]
    reversed_ = [
        scorer.table(relation)[:, row].T for relation, row in zip(relations, some, strict=True)
    ]
    monkeypatch.setattr(scorer, "_has_table", lambda *_: has_table)
    tails = scorer.score(some, relations, everything[None])
    torch.testing.assert_close(tails, torch.cat(expected), rtol=1e-4, atol=1e-4)
    heads = scorer.score(everything[None], relations, some)
    torch.testing.assert_close(heads, torch.cat(reversed_), rtol=2e-3, atol=1e-3)


def test_single_links_have_the_scores_of_the_table(scorer):
    generator = torch.Generator().manual_seed(4)
    heads, tails = torch.randint(len(scorer.entities), (2, 60), generator=generator)
    for relation in (COMBINES_WITH, COMPONENT_OF):
        single = scorer.knowledge.link_scores(relation, tails, heads[:, None], heads=True)[:, 0]
        expected = scorer.table(relation)[heads, tails]
        torch.testing.assert_close(single, expected, rtol=2e-3, atol=1e-3)


def test_a_sample_of_a_fold_stands_for_all_its_recipes(cross_fitted, opened_kitchen, monkeypatch):
    folds = make_folds(opened_kitchen.split, cross_fitted.count)
    left_out = cross_fitted.left_out(0)
    everything = probabilities.recipe_histogram(left_out, folds, 0)[:, 1]
    assert everything.sum() == len(folds.recipes_of(0)) > 10
    monkeypatch.setattr(probabilities, "MOST_OF_FOLD", 10)
    sample = probabilities.recipe_histogram(left_out, folds, 0)[:, 1]
    assert sample.sum() == pytest.approx(everything.sum())
    assert 0 < np.count_nonzero(sample) <= 10


def test_a_large_book_proposes_results_of_neighbours(scorer, cross_fitted, monkeypatch):
    """Neighbours make them, their order is that of recipe scores, and shares are over them."""
    a, b = scorer.entity_ids(["flour", "milk"]), scorer.entity_ids(["water", "tomato"])
    assert not scorer.proposes_results
    monkeypatch.setattr(recipes, "ALL_RESULTS", 5)
    assert scorer.proposes_results
    size = len(scorer.entities)
    ids, scores = scorer.best_results(a, b)
    everything = scorer.score_recipes(a[:, None], b[:, None], torch.arange(size))
    for row in range(2):
        proposed = ids[row][ids[row] < size]
        assert 0 < len(proposed) < size
        assert len(proposed.unique()) == len(proposed)
        of_proposed = scores[row, : len(proposed)]
        torch.testing.assert_close(of_proposed, everything[row, proposed], rtol=1e-4, atol=1e-4)
        assert torch.equal(of_proposed, of_proposed.sort(descending=True).values)
        assert torch.isneginf(scores[row, len(proposed) :]).all()
    assert scorer.entities.index("dough") in ids[0].tolist()
    shares = cross_fitted.result_probabilities(a, b)
    is_proposed = torch.zeros(2, size + 1, dtype=torch.bool).scatter_(1, ids, True)[:, :size]
    assert torch.equal(shares > 0, is_proposed)
    torch.testing.assert_close(shares.sum(1), torch.ones(2))


def test_a_scorer_made_from_its_tensors_scores_the_same(scorer):
    again = RecipeScorer(scorer.tensors(), scorer.entities, scorer.graph_hash)
    a, b, results = torch.randint(
        len(scorer.entities), (3, 200), generator=torch.Generator().manual_seed(0)
    )
    torch.testing.assert_close(
        again.score_recipes(a, b, results), scorer.score_recipes(a, b, results), rtol=0, atol=0
    )
    assert again.supporting_recipes("flour", "water", "dough") == scorer.supporting_recipes(
        "flour", "water", "dough"
    )


def test_a_known_recipe_is_its_own_evidence(scorer, cross_fitted, kitchen):
    """A known recipe speaks for itself and the scorer without it names others."""
    known = {Recipe.of(*kitchen.labels(row)) for row in scorer.recipes.tolist()}
    row = next(row for row, fold in enumerate(cross_fitted.of_recipe) if fold == 1)
    a, b, result = kitchen.labels(kitchen.recipes[row])
    first, *others = scorer.supporting_recipes(a, b, result)
    assert (first.recipe, first.weight) == ((a, b, result), 1)
    for is_for_result in (True, False):
        shares = [one.share for one in others if (one.recipe.result == result) == is_for_result]
        assert shares == sorted(shares, reverse=True)
    assert scorer.supporting_recipes(b, a, result) == [first, *others]
    found = cross_fitted.left_out(1).supporting_recipes(a, b, result, limit=100)
    assert found
    assert {one.recipe for one in found} <= known - {Recipe.of(a, b, result)}
    assert all(0 < one.weight <= 1 and 0 < one.share <= 1 for one in found)
    # Shares and strengths tell the same, beside all evidence or beside the strongest.
    assert max(one.strength for one in found) == 1
    ratios = [one.share / one.strength for one in found]
    assert ratios == pytest.approx([ratios[0]] * len(ratios))
    with pytest.raises(UnknownEntityError, match="waater"):
        scorer.supporting_recipes("waater", b, result)
