"""Recipes that a model is trained on: a sample of the train recipes, and folds for cross-fitting.

A sample may have less or noisy data. A wrong recipe keeps the ingredients and takes another
recipe's result from the same fold. So each entity stays about equally frequent as a result, and a
model that leaves a fold out never meets the fold's results elsewhere.

A model trained without a fold scores the fold. Recipes that the split keeps together, such as
recipes with equal ingredients, are in one fold: it is as new to this model as the test recipes are
to a model trained on all train recipes.
"""

import hashlib
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base import ConfigError, GraphMismatchError, number_in, refuse, whole
from wordcraft_kg.base.settings import SMALLEST
from wordcraft_kg.graphs.arrays import Ids, frozen
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import Split, groups_of
from wordcraft_kg.graphs.tasks import TaskSet
from wordcraft_kg.graphs.triples import COMPONENT_OF, recipe_triples

_OUTSIDE = -1  # result for recipes outside the sample
_TRIES = 1_000  # random results per recipe, until a result is wrong
_STREAM = 0xD05E  # separates this random stream from all streams with the same seed


@dataclass(frozen=True, eq=False)
class TrainSample:
    """Training recipes, perhaps with wrong results.

    Attributes:
        graph: the recipe graph.
        results: shape (num_recipes,), the result that each recipe has in the sample; -1 outside.
    """

    graph: RecipeGraph
    results: Ids

    @classmethod
    def of(cls, graph: RecipeGraph, rows: NDArray[np.bool_]) -> "TrainSample":
        """Return a sample with correct results.

        Args:
            graph: the recipe graph.
            rows: bool, shape (num_recipes,), True for recipes in the sample.
        """
        return cls(graph, frozen(np.where(rows, graph.sets[:, -1], _OUTSIDE)))

    @property
    def is_trained_on(self) -> NDArray[np.bool_]:
        """Whether each recipe is in the sample, shape (num_recipes,)."""
        return self.results != _OUTSIDE

    @property
    def is_wrong(self) -> NDArray[np.bool_]:
        """Whether each recipe has a wrong result in the sample, shape (num_recipes,)."""
        return self.is_trained_on & (self.results != self.graph.sets[:, -1])

    def among(self, rows: NDArray[np.bool_]) -> Ids:
        """Return the sample's recipes where ``rows`` is True, with their results in the sample.

        Args:
            rows: bool, shape (num_recipes,).

        Returns:
            Shape (n, columns) as ``graph.sets``, in its order; wrong results are not sorted.
        """
        is_selected = self.is_trained_on & rows
        return np.column_stack([self.graph.sets[is_selected, :-1], self.results[is_selected]])

    @cached_property
    def sets(self) -> Ids:
        """All recipes of the sample, with their results in the sample, as ``graph.sets``."""
        return frozen(self.among(self.is_trained_on))

    @cached_property
    def triples(self) -> Ids:
        """Triples that the sample's recipes give, shape (T, 3), sorted."""
        return frozen(recipe_triples(self.sets, self.graph.num_entities))

    @cached_property
    def hash(self) -> str:
        """SHA-256 hash of the graph and the training results."""
        digest = hashlib.sha256(self.graph.hash.encode())
        # Little-endian integers of eight bytes on any machine.
        digest.update(self.results.astype("<i8").tobytes())
        return digest.hexdigest()


def check_train_sample(
    kg: str,
    train_fraction: float,
    label_noise: float,
) -> None:
    """Check the settings of a train sample.

    Args:
        kg: knowledge graph of the training: partial, full or none.
        train_fraction: fraction of the train recipes to keep, above 0 and at most 1.
        label_noise: fraction of the kept recipes with a wrong result, 0 to 1.

    Raises:
        ConfigError: for a fraction out of range, or for changed recipes of the full graph.
    """
    number_in("train_fraction", train_fraction, SMALLEST, 1, "more than 0 and at most 1")
    number_in("label_noise", label_noise, 0, 1, "0 to 1")
    if kg != "partial" and is_subsample(train_fraction, label_noise):
        setting = (
            f"`train_fraction` {train_fraction:g}"
            if train_fraction < 1
            else f"`label_noise` {label_noise:g}"
        )
        raise ConfigError(
            f"{setting} needs `kg` partial: a model of the full graph is evaluated on its own "
            "training recipes, and a model of other books has no train recipes."
        )


def is_subsample(train_fraction: float, label_noise: float) -> bool:
    """Return whether the settings omit train recipes or make results wrong.

    Args:
        train_fraction: fraction of the train recipes to keep, above 0 and at most 1.
        label_noise: fraction of the kept recipes with a wrong result, 0 to 1.
    """
    return train_fraction < 1 or label_noise > 0


def describe_train_sample(train_fraction: float, label_noise: float) -> str:
    """Describe a train sample, as in "20 % of the train recipes"; "" for all train recipes.

    Args:
        train_fraction: fraction of the train recipes to keep, above 0 and at most 1.
        label_noise: fraction of the kept recipes with a wrong result, 0 to 1.
    """
    if not is_subsample(train_fraction, label_noise):
        return ""
    noise = f", {100 * label_noise:g} % of them with a wrong result" if label_noise else ""
    return f"{100 * train_fraction:g} % of the train recipes{noise}"


def draw_train_sample(
    split: Split,
    train_fraction: float = 1.0,
    label_noise: float = 0.0,
    seed: int = 0,
    *,
    of_recipe: Ids | None = None,
) -> TrainSample:
    """Sample train recipes, and replace some results by wrong results.

    With the same seed, a larger fraction keeps all recipes of a smaller fraction, and more noise
    keeps all wrong recipes, so that curves over fractions compare nested samples. No train recipe
    gives a wrong recipe's componentOf triples; combinesWith triples stay right. A held-out recipe
    may give one by chance: were such triples avoided, the sample would tell the test part.

    Args:
        split: the split.
        train_fraction: fraction of the train recipes to keep, above 0 and at most 1.
        label_noise: fraction of the kept recipes that get a wrong result, 0 to 1.
        seed: random seed.
        of_recipe: each recipe's cross-fitting fold, shape (num_recipes,); wrong results come from
            the same fold. None for a single fold.

    Raises:
        ConfigError: if the fractions leave too few recipes, or no result would be wrong for a drawn
            recipe.

    Example:
        >>> split = open_graph("kitchen").split
        >>> train_sample = draw_train_sample(split, train_fraction=0.5, label_noise=0.2)
        >>> int(train_sample.is_trained_on.sum()), int(train_sample.is_wrong.sum())
        (130, 26)
    """
    graph = split.graph
    train = np.flatnonzero(split.is_in("train"))
    if not is_subsample(train_fraction, label_noise):
        return TrainSample.of(graph, split.is_in("train"))
    rng = np.random.default_rng([seed, _STREAM])
    # Both orders are drawn for all train recipes, whatever the fractions: prefixes are nested.
    order = rng.permutation(len(train))
    doubt = rng.permutation(len(train))
    sampled_order = order[: round(train_fraction * len(train))]
    folds = np.zeros(graph.num_recipes, dtype=np.int64) if of_recipe is None else of_recipe
    # A model that leaves out the only fold would have nothing to train on.
    needed_folds = 1 if of_recipe is None else 2
    if len(np.unique(folds[train[sampled_order]])) < needed_folds:
        expected = "at least one of them" if needed_folds == 1 else "some in two folds or more"
        raise refuse(
            "train_fraction",
            train_fraction,
            f"more of the {len(train):,} train recipes than {len(sampled_order)}, {expected}",
        )
    most_doubted = sampled_order[np.argsort(doubt[sampled_order])]
    wrong = train[most_doubted[: round(label_noise * len(sampled_order))]]
    if label_noise and not len(wrong):
        raise refuse(
            "label_noise",
            label_noise,
            f"at least one of the {len(sampled_order)} recipes with a wrong result, or 0",
        )
    results = np.full(graph.num_recipes, _OUTSIDE, dtype=np.int64)
    results[train[sampled_order]] = graph.sets[train[sampled_order], -1]
    heads, _, tails = split.partial[split.partial[:, 1] == COMPONENT_OF].T.tolist()
    right = set(zip(heads, tails, strict=True))
    for fold in np.unique(folds[wrong]).tolist():
        rows = np.sort(wrong[folds[wrong] == fold])
        # A result stands in the pool once for each recipe, so frequent results stay frequent.
        pool = graph.sets[(results != _OUTSIDE) & (folds == fold), -1]
        results[rows] = _wrong_results(graph.sets[rows], pool, right, rng, label_noise)
    return TrainSample(graph, frozen(results))


def _wrong_results(
    recipes: Ids,
    pool: Ids,
    right: set[tuple[int, int]],
    rng: np.random.Generator,
    label_noise: float,
) -> list[int]:
    """Draw a wrong result for each recipe.

    Args:
        recipes: shape (n, columns), rows of ``graph.sets``: the recipes to make wrong.
        pool: shape (m,), results to draw from.
        right: (ingredient, result) of all train recipes.
        rng: draws the results.
        label_noise: the setting, for the error.
    """
    wrong_recipes: dict[tuple[int, ...], None] = {}
    for *ingredients, _ in recipes.tolist():
        for result in pool[rng.integers(len(pool), size=_TRIES)].tolist():
            is_right = any((ingredient, result) in right for ingredient in ingredients)
            recipe = (*ingredients, result)
            # A pair with two recipes gets two wrong results.
            if not is_right and result not in ingredients and recipe not in wrong_recipes:
                wrong_recipes[recipe] = None
                break
        else:
            raise ConfigError(
                f"`label_noise` {label_noise:g}: among {len(pool)} recipes for the exchange of "
                "results, no result is wrong for another recipe. Use a larger `train_fraction`, "
                "fewer `folds` or another `seed`."
            )
    return [result for *_, result in wrong_recipes]


# --- folds for cross-fitting ---------------------------------------------------------------------

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
        whole_part = TrainSample.of(self.split.graph, self.split.is_in("train"))
        return bool((self.train_sample.results != whole_part.results).any())

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
    # The split's own groups, found without held-out recipes: then a fold is as new to a model as
    # the test part.
    train_groups = groups_of(split.graph.part(split.is_in("train")), split.config.kind)
    groups, group_of_row = np.unique(train_groups, return_inverse=True)
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
