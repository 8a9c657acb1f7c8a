"""Train samples: a fraction of the train recipes, some with a wrong result: less or noisy data.

A wrong recipe keeps the ingredients and takes another recipe's result from the same cross-fitting
fold. So each entity stays about equally frequent as a result, and a model that leaves a fold out
never meets the fold's results elsewhere.
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import SMALLEST, number_in, refuse
from wordcraft_kg.graphs.arrays import Ids, frozen
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import Split
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

    @property
    def recipes(self) -> Ids:
        """All recipes of a sample of pairs, shape (n, 3), rows (a, b, result).

        Raises:
            GraphError: if a recipe of the graph has more than two ingredients, or one.
        """
        _ = self.graph.recipes
        return self.sets

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
        setting = f"`label_noise` {label_noise:g}"
        if train_fraction < 1:
            setting = f"`train_fraction` {train_fraction:g}"
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
    description = f"{100 * train_fraction:g} % of the train recipes"
    if label_noise:
        description = f"{description}, {100 * label_noise:g} % of them with a wrong result"
    return description


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
    if of_recipe is None:
        folds = np.zeros(graph.num_recipes, dtype=np.int64)
        needed_folds = 1
        expected = "at least one of them"
    else:
        folds = of_recipe
        # A model that leaves out the only fold would have nothing to train on.
        needed_folds = 2
        expected = "some in two folds or more"
    if len(np.unique(folds[train[sampled_order]])) < needed_folds:
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
