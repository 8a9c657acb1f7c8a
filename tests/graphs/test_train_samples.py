"""Train samples and folds: which recipes are trained on, with which results, and what they must not
reveal."""

from itertools import pairwise

import numpy as np
import pytest
from graph_strategies import configs, splittable_graphs
from helpers import refuses
from hypothesis import assume, given, strategies as st
from test_splits import HELD_OUT_KINDS, drawn

from wordcraft_kg import RecipeGraph, SplitConfig, WordCraftConfig, World, make_split, open_graph
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs import (
    COMPONENT_OF,
    OUTSIDE,
    Folds,
    TrainSample,
    describe_train_sample,
    draw_train_sample,
    fold_of_tasks,
    is_in,
    make_folds,
    recipe_triples,
)
from wordcraft_kg.graphs.splits import groups_of
from wordcraft_kg.graphs.train_samples import SEVERAL

KINDS = ("by-recipe", "by-goal", "by-slot")


def split_of(kind="by-recipe"):
    return make_split(open_graph("kitchen").graph, SplitConfig(kind))


def test_everything_as_it_is_is_the_train_part():
    split = split_of()
    train_sample = draw_train_sample(split, seed=7)
    np.testing.assert_array_equal(train_sample.sets, split.recipes("train"))
    np.testing.assert_array_equal(train_sample.triples, split.partial)
    assert not train_sample.is_wrong.any()
    assert train_sample.hash == TrainSample.of(split.graph, split.is_in("train")).hash
    known = "72814deb4a209acd106e701d5f964c98eb7136c8c2e2cdd55fae8ac618fe044b"
    assert draw_train_sample(split, 0.5, 0.2).hash == known
    wrong = draw_train_sample(split, 1, 1.0).sets
    before, after = (
        np.bincount(recipes[:, 2], minlength=80) for recipes in (train_sample.sets, wrong)
    )
    assert np.corrcoef(before, after)[0, 1] > 0.5
    assert not np.any(after[before == 0])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [0, 1])
def test_a_smaller_share_is_part_of_a_larger_one(kind, seed):
    split = split_of(kind)
    shares = (0.1, 0.3, 0.5, 1.0)
    train_samples = [
        draw_train_sample(split, train_fraction, seed=seed).is_trained_on
        for train_fraction in shares
    ]
    larger = [*train_samples[1:], split.is_in("train")]
    for train_fraction, train_sample, more in zip(shares, train_samples, larger, strict=True):
        assert train_sample.sum() == round(train_fraction * split.is_in("train").sum())
        assert (more | ~train_sample).all()
    assert (train_samples[0] != draw_train_sample(split, 0.1, seed=seed + 1).is_trained_on).any()


def test_what_is_wrong_with_less_noise_is_wrong_with_more():
    split = split_of()
    train_samples = [
        draw_train_sample(split, 0.5, label_noise, seed=3) for label_noise in (0.1, 0.4, 1.0)
    ]
    for train_sample, more in pairwise(train_samples):
        np.testing.assert_array_equal(train_sample.is_trained_on, more.is_trained_on)
        assert (more.is_wrong | ~train_sample.is_wrong).all()
    assert [int(train_sample.is_wrong.sum()) for train_sample in train_samples] == [13, 52, 130]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("label_noise", [0.2, 1.0])
def test_a_wrong_recipe_keeps_its_pair_and_is_no_train_recipe(kind, label_noise):
    """A wrong recipe keeps its pair and is part of nothing that the train recipes have."""
    split = split_of(kind)
    train_sample = draw_train_sample(split, 0.8, label_noise, seed=1)
    graph, wrong = split.graph, train_sample.among(train_sample.is_wrong)
    assert len(wrong) == round(label_noise * train_sample.is_trained_on.sum())
    np.testing.assert_array_equal(wrong[:, :2], graph.recipes[train_sample.is_wrong, :2])
    assert not (wrong[:, :2] == wrong[:, 2:]).any()
    triples = recipe_triples(wrong)
    parts = triples[triples[:, 1] == COMPONENT_OF]
    assert len(parts)
    assert not is_in(parts, split.partial, graph.num_entities).any()
    assert len(np.unique(train_sample.sets, axis=0)) == len(train_sample.sets)


@pytest.mark.parametrize("kind", KINDS)
def test_wrong_results_come_from_recipes_of_the_same_fold(kind):
    split = split_of(kind)
    folds = make_folds(split, 4)
    train_sample = draw_train_sample(split, 0.7, 0.5, seed=2, of_recipe=folds.of_recipe)
    for fold in range(4):
        own = folds.of_recipe == fold
        results = set(split.graph.recipes[train_sample.is_trained_on & own, 2].tolist())
        assert set(train_sample.results[train_sample.is_wrong & own].tolist()) <= results
    # Without folds they come from all of them.
    anywhere = draw_train_sample(split, 0.7, 0.5, seed=2)
    np.testing.assert_array_equal(anywhere.is_trained_on, train_sample.is_trained_on)
    np.testing.assert_array_equal(anywhere.is_wrong, train_sample.is_wrong)
    assert (anywhere.results != train_sample.results).any()


@pytest.mark.parametrize(("train_fraction", "label_noise"), [(0.3, 0.0), (0.5, 0.4), (1.0, 1.0)])
def test_folds_are_those_of_all_train_recipes_whatever_the_sample(train_fraction, label_noise):
    split = split_of()
    folds = make_folds(split, 5)
    train_sample = draw_train_sample(
        split, train_fraction, label_noise, seed=4, of_recipe=folds.of_recipe
    )
    with_train_sample = folds.with_train_sample(train_sample)
    assert with_train_sample.hash == folds.hash
    assert with_train_sample.is_subsample
    assert not folds.is_subsample
    np.testing.assert_array_equal(with_train_sample.of_recipe, folds.of_recipe)
    for fold in range(5):
        rows = [
            row
            for row in np.flatnonzero(train_sample.is_trained_on)
            if folds.of_recipe[row] != fold
        ]
        expected = [
            (*split.graph.recipes[row, :2].tolist(), int(train_sample.results[row])) for row in rows
        ]
        assert [tuple(row) for row in with_train_sample.recipes([fold]).tolist()] == expected
        np.testing.assert_array_equal(
            with_train_sample.triples([fold]), recipe_triples(np.array(expected))
        )
        # A fold and the model without it share nothing, and together they are the train sample.
        own = {tuple(row) for row in with_train_sample.recipes_of(fold).tolist()}
        assert own | set(expected) == {tuple(row) for row in train_sample.sets.tolist()}
        assert not own & set(expected)


def test_too_few_recipes_for_a_sample_are_refused():
    split = split_of()
    of_recipe = make_folds(split, 3).of_recipe
    with refuses("train_fraction"):
        draw_train_sample(split, 0.001)
    with pytest.raises(ConfigError, match="some in two folds or more"):
        draw_train_sample(split, 0.004, of_recipe=of_recipe)
    with refuses("label_noise"):
        draw_train_sample(split, 0.012, 0.1)
    soups = RecipeGraph.from_recipes([(f"a{i}", f"b{i}", "soup") for i in range(9)], name="soups")
    single = make_split(soups, SplitConfig("by-recipe-plain"))
    with refuses("label_noise"):
        draw_train_sample(single, label_noise=0.5)


def test_a_train_sample_says_what_it_is():
    assert describe_train_sample(1, 0) == ""
    assert describe_train_sample(0.2, 0) == "20 % of the train recipes"
    assert (
        describe_train_sample(1, 0.5)
        == "100 % of the train recipes, 50 % of them with a wrong result"
    )


@given(splittable_graphs(), st.sampled_from(HELD_OUT_KINDS).flatmap(configs))
def test_folds_partition_train_and_keep_groups_together(graph, config):
    """Folds partition the train recipes and keep together what the split keeps together."""
    split = drawn(graph, config)
    groups = groups_of(graph, config.kind)
    train = split.is_in("train")
    count = len(np.unique(groups[train]))
    assume(count >= 2)
    folds = make_folds(split, min(3, count))
    assert ((folds.of_recipe == OUTSIDE) == ~train).all()
    assert set(folds.of_recipe[train].tolist()) == set(range(folds.count))
    for group in np.unique(groups[train]):
        assert len(np.unique(folds.of_recipe[train & (groups == group)])) == 1


def test_kinds_that_cannot_be_left_out_are_refused():
    graph = open_graph("kitchen").graph
    graph.kinds = tuple("ab"[row % 2] for row in range(graph.num_recipes))
    with pytest.raises(ConfigError, match="by-kind split keeps all train recipes together"):
        make_folds(make_split(graph, SplitConfig("by-kind", train_ratio=0.5)), 3)


def test_a_fold_is_unseen_and_nothing_else_of_train_is():
    split = open_graph("kitchen").split
    folds = make_folds(split, 4)
    for fold in range(4):
        expected = [
            row
            for row in range(split.graph.num_recipes)
            if folds.of_recipe[row] not in (OUTSIDE, fold)
        ]
        assert np.flatnonzero(folds.seen([fold])).tolist() == expected
        np.testing.assert_array_equal(
            folds.triples([fold]), recipe_triples(split.graph.recipes[expected])
        )
    np.testing.assert_array_equal(folds.triples(), split.partial)


@pytest.mark.parametrize("depth", [1, 2])
def test_a_task_leaves_out_a_fold_with_a_recipe_of_each_plan(depth):
    opened = open_graph("kitchen")
    folds = make_folds(opened.split, 3)
    tasks = World(opened, WordCraftConfig(part="train", depth=depth, num_distractors=0)).tasks
    of_task = fold_of_tasks(folds.of_recipe, tasks)
    for plans, fold in zip(tasks.plans, of_task.tolist(), strict=True):
        of_plans = [{int(folds.of_recipe[row]) for row in plan} for plan in plans]
        shared = [one for one in range(3) if all(one in of_plan for of_plan in of_plans)]
        assert fold in (shared or [SEVERAL])
    # At depth 1, too: cream + cream makes butter, so cream + salt is a task with two plans.
    assert (of_task != SEVERAL).any()
    assert (of_task == SEVERAL).any()


def test_the_same_seed_gives_the_same_folds_and_their_hash_names_them():
    split = open_graph("kitchen").split
    first, again, other = (make_folds(split, 5, seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.of_recipe, again.of_recipe)
    assert first.hash == again.hash != other.hash
    assert (
        first.hash
        != Folds(make_split(split.graph, SplitConfig(seed=1)), 5, 0, first.of_recipe.copy()).hash
    )


@pytest.mark.parametrize("count", [0, 1, 10_000, 2.5])
def test_a_number_of_folds_that_cannot_be_is_refused(count):
    with pytest.raises(ConfigError, match="folds"):
        make_folds(open_graph("kitchen").split, count)
