"""Doses of knowledge: which recipes are taught, with which results, and what they must not tell."""

from itertools import pairwise

import numpy as np
import pytest
from refusals import refuses

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_graph
from wordcraft_kg.graphs.doses import Dose, dose_words, make_dose
from wordcraft_kg.graphs.folds import make_folds
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.triples import COMPONENT_OF, is_in, recipe_triples

KINDS = ("by-recipe", "by-goal", "by-slot")


def split_of(kind: str = "by-recipe") -> Split:
    return make_split(open_graph("kitchen").graph, SplitConfig(kind))


def test_everything_as_it_is_is_the_train_part():
    split = split_of()
    dose = make_dose(split, seed=7)
    np.testing.assert_array_equal(dose.recipes, split.recipes("train"))
    np.testing.assert_array_equal(dose.triples, split.partial)
    assert not dose.is_wrong.any()
    assert dose.hash == Dose.of(split.graph, split.is_in("train")).hash


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [0, 1])
def test_a_smaller_share_is_part_of_a_larger_one(kind: str, seed: int):
    split = split_of(kind)
    shares = (0.1, 0.3, 0.5, 1.0)
    doses = [make_dose(split, share, seed=seed).is_taught for share in shares]
    for share, dose, more in zip(shares, doses, [*doses[1:], split.is_in("train")], strict=True):
        assert dose.sum() == round(share * split.is_in("train").sum())
        assert (more | ~dose).all()
    assert (doses[0] != make_dose(split, 0.1, seed=seed + 1).is_taught).any()


def test_what_is_wrong_with_less_noise_is_wrong_with_more():
    split = split_of()
    doses = [make_dose(split, 0.5, noise, seed=3) for noise in (0.1, 0.4, 1.0)]
    for dose, more in pairwise(doses):
        np.testing.assert_array_equal(dose.is_taught, more.is_taught)
        assert (more.is_wrong | ~dose.is_wrong).all()
    assert [int(dose.is_wrong.sum()) for dose in doses] == [13, 52, 130]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("noise", [0.2, 1.0])
def test_a_wrong_recipe_keeps_its_pair_and_is_part_of_nothing_that_the_book_has(kind: str, noise: float):
    split = split_of(kind)
    dose = make_dose(split, 0.8, noise, seed=1)
    graph, wrong = split.graph, dose.among(dose.is_wrong)
    assert len(wrong) == round(noise * dose.is_taught.sum())
    np.testing.assert_array_equal(wrong[:, :2], graph.recipes[dose.is_wrong, :2])
    assert not (wrong[:, :2] == wrong[:, 2:]).any()
    triples = recipe_triples(wrong)
    parts = triples[triples[:, 1] == COMPONENT_OF]
    assert len(parts)
    assert not is_in(parts, graph.triples, graph.num_entities).any()
    assert len(np.unique(dose.recipes, axis=0)) == len(dose.recipes)


@pytest.mark.parametrize("kind", KINDS)
def test_wrong_results_come_from_taught_recipes_of_the_same_fold(kind: str):
    split = split_of(kind)
    folds = make_folds(split, 4)
    dose = make_dose(split, 0.7, 0.5, seed=2, of_recipe=folds.of_recipe)
    for fold in range(4):
        own = folds.of_recipe == fold
        taught = set(split.graph.recipes[dose.is_taught & own, 2].tolist())
        assert set(dose.results[dose.is_wrong & own].tolist()) <= taught
    # Without folds they come from all of them.
    anywhere = make_dose(split, 0.7, 0.5, seed=2)
    np.testing.assert_array_equal(anywhere.is_taught, dose.is_taught)
    np.testing.assert_array_equal(anywhere.is_wrong, dose.is_wrong)
    assert (anywhere.results != dose.results).any()


def test_results_stay_about_as_frequent():
    split = split_of()
    dose = make_dose(split, 1, 1.0)
    before, after = (np.bincount(part[:, 2], minlength=80) for part in (split.recipes("train"), dose.recipes))
    assert np.corrcoef(before, after)[0, 1] > 0.5
    assert not set(dose.recipes[:, 2].tolist()) - set(split.recipes("train")[:, 2].tolist())


@pytest.mark.parametrize(("share", "noise"), [(0.3, 0.0), (0.5, 0.4), (1.0, 1.0)])
def test_folds_are_those_of_all_train_recipes_whatever_the_dose(share: float, noise: float):
    split = split_of()
    folds = make_folds(split, 5)
    dose = make_dose(split, share, noise, seed=4, of_recipe=folds.of_recipe)
    dosed = folds.dosed(dose)
    assert dosed.hash == folds.hash
    assert dosed.is_dosed
    assert not folds.is_dosed
    np.testing.assert_array_equal(dosed.of_recipe, folds.of_recipe)
    for fold in range(5):
        rows = [row for row in np.flatnonzero(dose.is_taught) if folds.of_recipe[row] != fold]
        expected = [(*split.graph.recipes[row, :2].tolist(), int(dose.results[row])) for row in rows]
        assert [tuple(row) for row in dosed.recipes([fold]).tolist()] == expected
        np.testing.assert_array_equal(dosed.triples([fold]), recipe_triples(np.array(expected)))
        # A fold and the model without it share nothing, and together they are the dose.
        own = {tuple(row) for row in dosed.recipes_of(fold).tolist()}
        assert own | set(expected) == {tuple(row) for row in dose.recipes.tolist()}
        assert not own & set(expected)


def test_the_draw_is_known():
    found = make_dose(open_graph("kitchen").split, 0.5, 0.2).hash
    assert found == "72814deb4a209acd106e701d5f964c98eb7136c8c2e2cdd55fae8ac618fe044b"


def test_too_few_recipes_for_a_dose_are_refused():
    split = split_of()
    of_recipe = make_folds(split, 3).of_recipe
    with refuses("share"):
        make_dose(split, 0.001)
    with pytest.raises(ConfigError, match="some in two folds or more"):
        make_dose(split, 0.004, of_recipe=of_recipe)
    with refuses("noise"):
        make_dose(split, 0.012, 0.1)
    single = make_split(
        RecipeGraph.from_recipes([(f"a{i}", f"b{i}", "soup") for i in range(9)], name="soups"),
        SplitConfig("by-recipe-plain"),
    )
    with refuses("noise"):
        make_dose(single, noise=0.5)


def test_a_dose_says_what_it_is():
    assert dose_words(1, 0) == ""
    assert dose_words(0.2, 0) == "20 % of the train recipes"
    assert dose_words(1, 0.5) == "100 % of the train recipes, 50 % of them with a wrong result"
