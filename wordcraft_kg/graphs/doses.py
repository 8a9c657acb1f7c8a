"""Doses of knowledge: a share of the train recipes, some of them with a wrong result, for a scorer to learn from.

How much a scorer knows, and how much of that is right, is varied to see what an agent gains by it. A wrong recipe keeps
its pair and gets the result of another one, so an entity is expected to be a result as often as before. That other one
is of the same fold: a model that leaves a fold out would otherwise meet the results of that fold elsewhere.
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
DRAWS = 1_000
"""Results that are tried for a recipe until one is wrong."""
STREAM = 0xD05E
"""Keeps the draw apart from others with the same seed."""


@dataclass(frozen=True, eq=False)
class Dose:
    """The recipes that a scorer learns from, and what they are said to make.

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
        ConfigError: if one is out of range, or they are to thin out a graph that has no held-out recipes.
    """
    number_in("share", share, SMALLEST, 1, "more than 0 and at most 1")
    number_in("noise", noise, 0, 1, "0 to 1")
    if kg == "full" and is_dosed(share, noise):
        name, value = ("share", share) if share < 1 else ("noise", noise)
        raise ConfigError(
            f"`{name}` {value:g} needs `kg` partial: a model of the full graph is judged by what it remembers of all "
            "recipes."
        )


def is_dosed(share: float, noise: float) -> bool:
    """Return whether settings ask for anything but all train recipes as they are."""
    return share < 1 or noise > 0


def dose_words(share: float, noise: float) -> str:
    """Say what a scorer has learned from, such as "20 % of the train recipes"; empty for all of them as they are."""
    if not is_dosed(share, noise):
        return ""
    wrong = f", {100 * noise:g} % of them with a wrong result" if noise else ""
    return f"{100 * share:g} % of the train recipes{wrong}"


def make_dose(
    split: Split, share: float = 1.0, noise: float = 0.0, seed: int = 0, *, of_recipe: Ids | None = None
) -> Dose:
    """Draw some of the train recipes, and give some of these the result of another one.

    Recipes of a smaller share are among those of a larger one with the same seed, and recipes that are wrong with less
    noise are wrong with more of it. A wrong recipe gives no componentOf triple that any recipe of the book gives, so it
    cannot tell anything of the test part by chance. Its combinesWith triples stay right.

    Args:
        split: the split; nothing is drawn from outside its train part.
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
    rng = np.random.default_rng([seed, STREAM])
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
    """Return a wrong result for each recipe, drawn from a pool.

    Args:
        recipes: shape (n, 3).
        pool: results to draw from, each as often as it is one, shape (m,).
        right: every ingredient and what it is a part of, in the whole book.
        rng: draws the results.
        noise: the setting, for the error.

    Raises:
        ConfigError: if none is found for one of them.
    """
    found: dict[tuple[int, int, int], None] = {}
    for a, b, _ in recipes.tolist():
        for result in pool[rng.integers(len(pool), size=DRAWS)].tolist():
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
