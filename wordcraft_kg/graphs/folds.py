"""Folds of the train recipes, for cross-fitting: a model trained without a fold scores the fold.

Recipes that the split keeps together, such as recipes with equal ingredients, are in one fold. So a
fold is as new to a model trained on the remaining folds as the test recipes are to a model trained
on all train recipes.
"""

import hashlib
from collections.abc import Collection
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base import ConfigError, GraphMismatchError, refuse, whole
from wordcraft_kg.graphs.arrays import Ids, frozen
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.tasks import TaskSet
from wordcraft_kg.graphs.train_samples import TrainSample
from wordcraft_kg.graphs.triples import recipe_triples

OUTSIDE = -1
"""Fold of a recipe outside the train part."""
SEVERAL = -2
"""Fold of a task with several plans, such that no single fold has a recipe of each."""


class Folds:
    """A partition of a split's train recipes into K = ``count`` folds, see :func:`make_folds`.

    Attributes:
        split: the split whose train recipes are partitioned.
        count: number of folds.
        seed: random seed of the partition.
        of_recipe: shape (num_recipes,), int64: each recipe's fold from 0, :data:`OUTSIDE` outside
            train.
        train_sample: recipes to train on, possibly fewer than the train recipes or with wrong
            results. Independent of the folds, which a model without the sample has too.
    """

    def __init__(
        self,
        split: Split,
        count: int,
        seed: int,
        of_recipe: Ids,
        train_sample: TrainSample | None = None,
    ):
        """Bind a partition to its split; most callers want :func:`make_folds`.

        Args:
            split: the split.
            count: number of folds.
            seed: random seed of the partition.
            of_recipe: shape (num_recipes,), int64, each recipe's fold.
            train_sample: recipes to train on; None for all train recipes.
        """
        self.split = split
        self.count = count
        self.seed = seed
        self.of_recipe = frozen(of_recipe)
        self.train_sample = train_sample or TrainSample.of(split.graph, split.is_in("train"))

    def with_train_sample(self, train_sample: TrainSample) -> "Folds":
        """Return the same folds with different training recipes."""
        return Folds(self.split, self.count, self.seed, self.of_recipe, train_sample)

    @property
    def is_subsample(self) -> bool:
        """Whether the train sample differs from the train recipes: fewer, or wrong results."""
        sample = self.train_sample
        is_smaller = (sample.is_trained_on != self.split.is_in("train")).any()
        return bool(is_smaller or sample.is_wrong.any())

    def seen(self, left_out: Collection[int] = ()) -> NDArray[np.bool_]:
        """Mark the recipes that a model without the ``left_out`` folds has seen.

        Returns:
            Bool, shape (num_recipes,); False outside the train sample.
        """
        # np.isin takes no set: it would compare with the set as one object.
        return self.train_sample.is_trained_on & ~np.isin(self.of_recipe, list(left_out))

    def recipes(self, left_out: Collection[int] = ()) -> Ids:
        """Return the train sample outside the ``left_out`` folds, as trained on, shape (n, 3).

        A wrong recipe has its wrong result.

        Raises:
            GraphError: if a recipe of the graph has more than two ingredients, or one.
        """
        _ = self.split.graph.recipes
        return self.train_sample.among(self.seen(left_out))

    def recipes_of(self, fold: int) -> Ids:
        """Return the train sample in a fold, as trained on, as rows of ``graph.sets``."""
        return self.train_sample.among(self.of_recipe == fold)

    def triples_of(self, fold: int) -> Ids:
        """Return the triples of the train sample in a fold, shape (T, 3), sorted."""
        return frozen(recipe_triples(self.recipes_of(fold), self.split.graph.num_entities))

    def triples(self, left_out: Collection[int] = ()) -> Ids:
        """Return the triples of the train sample outside the ``left_out`` folds, sorted."""
        sample_recipes = self.train_sample.among(self.seen(left_out))
        return frozen(recipe_triples(sample_recipes, self.split.graph.num_entities))

    @cached_property
    def hash(self) -> str:
        """SHA-256 hash of the split and each recipe's fold."""
        return hashlib.sha256(self.split.hash.encode() + self.of_recipe.tobytes()).hexdigest()


def fold_of_tasks(of_recipe: Ids, tasks: TaskSet) -> Ids:
    """Return the fold to leave out for each crafting task: a fold with a recipe of each plan.

    To a model trained without this fold, a train task looks like a test task to a model of all
    train recipes: each plan has an unseen recipe, and other recipes of the plan may be known.

    Args:
        of_recipe: each recipe's fold, shape (num_recipes,).
        tasks: N tasks.

    Returns:
        Shape (N,). :data:`SEVERAL` if no fold has a recipe of each plan, and :data:`OUTSIDE` if
        each plan has a recipe outside train.

    Raises:
        GraphMismatchError: if a train task uses a recipe without a fold: the folds belong to
            another split.
    """
    task_folds = np.full(len(tasks), SEVERAL, dtype=np.int64)
    fold_of = of_recipe.tolist()
    # Counted without held-out recipes, on whose number nothing in training may depend.
    number = np.cumsum(of_recipe != OUTSIDE)
    for task, plans in enumerate(tasks.plans):
        folds_of_plans = [set(map(fold_of.__getitem__, plan)) for plan in plans]
        if tasks.part == "train" and any(OUTSIDE in folds for folds in folds_of_plans):
            raise GraphMismatchError(
                f"train task {task:,} uses a recipe outside all folds: the folds were made for "
                "another split. Take its train tasks, or train the model again on this split."
            )
        # A plan with a held-out recipe is new to every model, so the other plans decide.
        deciding = [folds for folds in folds_of_plans if OUTSIDE not in folds] or [{OUTSIDE}]
        shared = sorted(set.intersection(*deciding))
        if shared:
            # Deeper plans may leave a choice. It depends on the plan alone, so that a task has the
            # same fold in every set of tasks.
            task_folds[task] = shared[number[list(plans[0])].sum() % len(shared)]
    return task_folds


def make_folds(
    split: Split,
    count: int,
    seed: int = 0,
) -> Folds:
    """Partition the train recipes at random into folds with about equally many ingredient pairs.

    By-goal, by-slot and by-kind splits partition goals, recipe groups and kinds instead of pairs.

    Args:
        split: the split.
        count: number of folds, from 2.
        seed: random seed; another number of folds gives another partition.

    Raises:
        ConfigError: for fewer than two folds, or more folds than train pairs (goals, groups,
            kinds).

    Example:
        >>> folds = make_folds(open_graph("kitchen").split, 5)
        >>> np.bincount(folds.of_recipe[folds.of_recipe >= 0]).tolist()
        [54, 54, 55, 53, 52]
    """
    whole("folds", count, 2)
    rows = np.flatnonzero(split.is_in("train"))
    # The split's own groups: then a fold is as new to a model as the test part.
    groups, group_of_row = np.unique(split.train_groups, return_inverse=True)
    if len(groups) < 2:
        raise ConfigError(
            f"the {split.config.kind} split keeps all train recipes together, so none can be left "
            "out; choose another split, or a larger `train_ratio`."
        )
    if count > len(groups):
        raise refuse(
            "folds",
            count,
            f"2 to {len(groups):,}, as many as there are train pairs, goals, groups or kinds "
            "to keep together",
        )
    # Deal the shuffled groups out in turn: sizes differ by one group at most.
    order = np.random.default_rng([seed, count]).permutation(len(groups))
    fold_of_group = np.empty(len(groups), dtype=np.int64)
    fold_of_group[order] = np.arange(len(groups)) % count
    recipe_folds = np.full(split.graph.num_recipes, OUTSIDE, dtype=np.int64)
    recipe_folds[rows] = fold_of_group[group_of_row]
    return Folds(split, count, seed, recipe_folds)
