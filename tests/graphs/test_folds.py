"""Folds of the train recipes."""

import numpy as np
import pytest
from graph_strategies import configs, splittable_graphs
from hypothesis import assume, given
from hypothesis import strategies as st
from test_splits import HELD_OUT_KINDS, drawn

from wordcraft_kg import SplitConfig, WordCraftConfig, World, make_split, open_graph
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs import recipe_triples
from wordcraft_kg.graphs.folds import OUTSIDE, SEVERAL, Folds, fold_of_tasks, make_folds
from wordcraft_kg.graphs.splits import groups_of


@given(splittable_graphs(), st.sampled_from(HELD_OUT_KINDS).flatmap(configs))
def test_folds_partition_the_train_recipes_and_keep_together_what_the_split_keeps_together(graph, config):
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
        expected = [row for row in range(split.graph.num_recipes) if folds.of_recipe[row] not in (OUTSIDE, fold)]
        assert np.flatnonzero(folds.seen([fold])).tolist() == expected
        np.testing.assert_array_equal(folds.triples([fold]), recipe_triples(split.graph.recipes[expected]))
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
    assert first.hash != Folds(make_split(split.graph, SplitConfig(seed=1)), 5, 0, first.of_recipe.copy()).hash


@pytest.mark.parametrize("count", [0, 1, 10_000, 2.5])
def test_a_number_of_folds_that_cannot_be_is_refused(count):
    with pytest.raises(ConfigError, match="folds"):
        make_folds(open_graph("kitchen").split, count)
