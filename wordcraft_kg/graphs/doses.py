"""Doses of knowledge: a share of the train recipes, some of them with a wrong result, for a scorer to learn from.

A wrong recipe keeps its pair and gets the result of another one of the same fold. So entities are results as often as
before, on average, and a model that leaves a fold out does not meet its results elsewhere.
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

UNTAUGHT = -1
"""Result of a recipe that is not in a dose."""
_DRAWS = 1_000  # results that are tried for a recipe until one is wrong
_STREAM = 0xD05E  # keeps the draw apart from others with the same seed


@dataclass(frozen=True, eq=False)
class Dose:
    """The recipes that a scorer learns from, with the results that it is taught.

    Attributes:
        graph: the graph of the recipes.
        results: shape (num_recipes,), int64: the result that is taught of each recipe, :data:`UNTAUGHT` for none.
    """

    graph: RecipeGraph
    results: Ids

    @classmethod
    def of(cls, graph: RecipeGraph, rows: NDArray[np.bool_]) -> "Dose":
        """Return the dose of some recipes as they are, ``rows`` of shape (num_recipes,)."""
        return cls(graph, frozen(np.where(rows, graph.recipes[:, 2], UNTAUGHT)))

    @property
    def is_taught(self) -> NDArray[np.bool_]:
        """Which recipes are in it, shape (num_recipes,)."""
        return self.results != UNTAUGHT

    @property
    def is_wrong(self) -> NDArray[np.bool_]:
        """Which recipes are taught with a wrong result, shape (num_recipes,)."""
        return self.is_taught & (self.results != self.graph.recipes[:, 2])

    def among(self, rows: NDArray[np.bool_]) -> Ids:
        """Return those of some recipes that are in it, as they are taught, shape (n, 3), in the graph's order."""
        chosen = self.is_taught & rows
        return np.column_stack([self.graph.recipes[chosen, :2], self.results[chosen]])

    @cached_property
    def recipes(self) -> Ids:
        """All its recipes as they are taught, shape (n, 3)."""
        return frozen(self.among(self.is_taught))

    @cached_property
    def triples(self) -> Ids:
        """The triples of its recipes, shape (T, 3), sorted."""
        return frozen(recipe_triples(self.recipes))

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the graph's hash and the results, in hexadecimal."""
        return hashlib.sha256(self.graph.hash.encode() + self.results.astype("<i8").tobytes()).hexdigest()


def check_dose(kg: str, share: float, noise: float) -> None:
    """Check the settings of a dose.

    Raises:
        ConfigError: if one is out of range, or the graph has no held-out recipes.
    """
    number_in("share", share, SMALLEST, 1, "more than 0 and at most 1")
    number_in("noise", noise, 0, 1, "0 to 1")
    if kg == "full" and is_dosed(share, noise):
        setting = f"`share` {share:g}" if share < 1 else f"`noise` {noise:g}"
        raise ConfigError(
            f"{setting} needs `kg` partial: a model of the full graph is judged by what it remembers of all recipes."
        )


def is_dosed(share: float, noise: float) -> bool:
    """Return whether settings ask for anything but all train recipes as they are."""
    return share < 1 or noise > 0


def dose_words(share: float, noise: float) -> str:
    """Return a dose in words, such as "20 % of the train recipes"; empty for all of them as they are."""
    if not is_dosed(share, noise):
        return ""
    wrong = f", {100 * noise:g} % of them with a wrong result" if noise else ""
    return f"{100 * share:g} % of the train recipes{wrong}"


def make_dose(
    split: Split, share: float = 1.0, noise: float = 0.0, seed: int = 0, *, of_recipe: Ids | None = None
) -> Dose:
    """Draw some of the train recipes, and give some of these the result of another one.

    Doses of one seed are nested, in their recipes and in their wrong recipes. A wrong recipe gives no componentOf
    triple that any recipe of the book gives, so it tells nothing of the test part; its combinesWith triples stay right.

    Args:
        split: split whose train part is drawn from.
        share: share of its train recipes.
        noise: share of those with a wrong result.
        seed: seed of the draw.
        of_recipe: fold of each recipe, shape (num_recipes,), from which its wrong result is. Default: all in one.

    Raises:
        ConfigError: if there are too few recipes for that.

    Example:
        >>> dose = make_dose(open_graph("kitchen").split, share=0.5, noise=0.2)
        >>> int(dose.is_taught.sum()), int(dose.is_wrong.sum())
        (130, 26)
    """
    graph, train = split.graph, np.flatnonzero(split.is_in("train"))
    if not is_dosed(share, noise):
        return Dose.of(graph, split.is_in("train"))
    rng = np.random.default_rng([seed, _STREAM])
    order, doubt = rng.permutation(len(train)), rng.permutation(len(train))
    taken = order[: round(share * len(train))]
    groups = np.zeros(graph.num_recipes, dtype=np.int64) if of_recipe is None else of_recipe
    if not len(taken) or (of_recipe is not None and len(np.unique(of_recipe[train[taken]])) < 2):
        expected = "at least one of them" if of_recipe is None else "some in two folds or more"
        raise refuse("share", share, f"more of the {len(train):,} train recipes than {len(taken)}, {expected}")
    wrong = train[taken[np.argsort(doubt[taken])][: round(noise * len(taken))]]
    if noise and not len(wrong):
        raise refuse("noise", noise, f"at least one of the {len(taken)} recipes with a wrong result, or 0")
    results = np.full(graph.num_recipes, UNTAUGHT, dtype=np.int64)
    results[train[taken]] = graph.recipes[train[taken], 2]
    parts = graph.triples[graph.triples[:, 1] == COMPONENT_OF]
    right = set(zip(parts[:, 0].tolist(), parts[:, 2].tolist(), strict=True))
    for group in np.unique(groups[wrong]).tolist():
        rows = np.sort(wrong[groups[wrong] == group])
        pool = graph.recipes[(results != UNTAUGHT) & (groups == group), 2]
        results[rows] = _wrong_results(graph.recipes[rows], pool, right, rng, noise)
    return Dose(graph, frozen(results))


def _wrong_results(
    recipes: Ids, pool: Ids, right: set[tuple[int, int]], rng: np.random.Generator, noise: float
) -> list[int]:
    """Return a wrong result for each recipe (n, 3), drawn from a pool of results (m,).

    ``right`` holds every (ingredient, result) of the book; ``noise`` is the setting, for the error.
    """
    found: dict[tuple[int, int, int], None] = {}
    for a, b, _ in recipes.tolist():
        for result in pool[rng.integers(len(pool), size=_DRAWS)].tolist():
            is_new = (a, b, result) not in found  # a pair may have two wrong results, too
            if is_new and result not in (a, b) and (a, result) not in right and (b, result) not in right:
                found[a, b, result] = None
                break
        else:
            raise ConfigError(
                f"`noise` {noise:g}: among the {len(pool)} recipes that results are exchanged with, none has a result "
                "that is wrong for another. Use a larger `share`, fewer `folds` or another `seed`."
            )
    return [result for _, _, result in found]
