"""Cross-fitting of scorers of one's own."""

import numpy as np
import pytest
import torch

from wordcraft_kg import load_scorer, save_scorer
from wordcraft_kg.base.errors import ConfigError, LeakError
from wordcraft_kg.graphs.triples import recipe_triples
from wordcraft_kg.models.scorers.baselines import SymbolicScorer
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted, cross_fit
from wordcraft_kg.models.scorers.kernel import KernelScorer


def test_each_model_is_made_from_the_recipes_outside_its_fold_and_nothing_else(opened):
    given = []

    def make(recipes):
        given.append(recipes)
        return SymbolicScorer(opened.graph, recipe_triples(recipes))

    scorer = cross_fit(opened.split, make, folds=3)
    for fold in range(3):
        triples = scorer.trained_on(fold, opened.graph)
        assert scorer.left_out(fold).score(*triples.T).min() == 1
        np.testing.assert_array_equal(recipe_triples(given[-1]), triples)
    np.testing.assert_array_equal(given[0], opened.split.recipes("train"))
    assert len(given) == 4


def test_a_saved_scorer_keeps_its_folds_and_says_how_well_they_predict(opened, tmp_path):
    scorer = cross_fit(opened.split, lambda recipes: KernelScorer(opened.graph, recipes), folds=3)
    loaded = load_scorer(save_scorer(tmp_path / "mine", scorer, opened, kg="partial"))
    assert isinstance(loaded, CrossFitted)
    for relation in (0, 1):
        torch.testing.assert_close(loaded.table(relation), scorer.table(relation))
        for fold in range(3):
            torch.testing.assert_close(loaded.left_out(fold).table(relation), scorer.left_out(fold).table(relation))
    assert loaded.record.mrr < loaded.record.in_sample_mrr


def test_folds_that_have_seen_something_else_are_not_saved(opened, tmp_path):
    scorer = cross_fit(opened.split, lambda recipes: KernelScorer(opened.graph, recipes), folds=3)
    first, second, *rest = scorer.record.folds
    record = type(scorer.record)(seed=scorer.record.seed, hash=scorer.record.hash, folds=(second, first, *rest))
    spoilt = CrossFitted(
        scorer.whole, [lambda fold=fold: scorer.left_out(fold) for fold in range(3)], scorer.of_recipe, record
    )
    with pytest.raises(LeakError):
        save_scorer(tmp_path / "mine", spoilt, opened, kg="partial")
    assert not (tmp_path / "mine").exists()


@pytest.mark.parametrize("folds", [1, 1_000])
def test_a_number_of_folds_that_cannot_be_is_refused(opened, folds):
    with pytest.raises(ConfigError, match="folds"):
        cross_fit(opened.split, lambda recipes: KernelScorer(opened.graph, recipes), folds=folds)
