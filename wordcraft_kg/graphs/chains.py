"""Chains: recipes of three and more ingredients as recipes of two, through half-products.

``a + b + c = r`` becomes ``a + b = a + b + …`` and ``a + b + … + c = r``, with the ingredients in
the order of their labels. A half-product carries its mark in its label, so that every file format,
copy and hash of a graph keeps it: no export can lose which entities are no things of the game.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.graphs.recipes import Recipe

HALF = " + …"
"""End of the label of each half-product."""


MOST_IN_CHAIN = 1_000
"""Most ingredients of a recipe, with repetitions.

The labels of a chain grow with the square of their number, and a larger weight in a hypergraph is
no count of an ingredient.
"""


def is_half_product(label: str) -> bool:
    """Return whether a label names a half-product of a chain."""
    return label.endswith(HALF)


def mark_half_products(labels: Sequence[str]) -> NDArray[np.bool_]:
    """Return which labels name half-products, shape (len(labels),), bool."""
    return np.fromiter(map(is_half_product, labels), np.bool_, len(labels))


def chain(ingredients: Sequence[str], result: str) -> list[Recipe]:
    """Return the recipes of two ingredients for a recipe of any number.

    Args:
        ingredients: labels, without repetition if there are three or more.
        result: label of the result.

    Example:
        >>> for recipe in chain(["stick", "coal", "rope"], "torch"):
        ...     print(recipe)
        coal + rope -> coal + rope + …
        coal + rope + … + stick -> torch
    """
    first, *later_ingredients = sorted(ingredients)
    if not later_ingredients:
        return [Recipe.of(first, first, result)]
    recipes = []
    # What is there after each step, and the same without the mark of a half-product.
    at_hand = first
    sum_label = first
    for ingredient in later_ingredients[:-1]:
        sum_label = f"{sum_label} + {ingredient}"
        recipes.append(Recipe.of(at_hand, ingredient, sum_label + HALF))
        at_hand = sum_label + HALF
    return [*recipes, Recipe.of(at_hand, later_ingredients[-1], result)]


def is_step(recipe: Recipe) -> bool:
    """Return whether a recipe could come from :func:`chain`.

    A half-product is named by its ingredients. A recipe for a half-product of another name is not
    of a chain: a book may have a thing whose label happens to end in :data:`HALF`, and
    :func:`unchained` would take it apart. A recipe for anything else may be the last of a chain.

    Example:
        >>> is_step(Recipe.of("coal + rope + …", "stick", "coal + rope + stick + …"))
        True
        >>> is_step(Recipe.of("x", "y", "coal + rope + …"))
        False
    """
    if not is_half_product(recipe.result):
        return True
    if len(recipe.ingredients) != 2:
        return False
    # In either order: a recipe sorts its ingredients again, after the half-product has its name.
    first_label, second_label = (label.removesuffix(HALF) for label in recipe.ingredients)
    return recipe.result.removesuffix(HALF) in (
        f"{first_label} + {second_label}",
        f"{second_label} + {first_label}",
    )


def makes_nothing(recipes: Iterable[Recipe]) -> bool:
    """Return whether recipes make no entity but half-products, or there are none."""
    return all(is_half_product(recipe.result) for recipe in recipes)


def unchained(recipes: Iterable[Recipe]) -> list[tuple[tuple[str, ...], str]]:
    """Return recipes as they were before :func:`chain`: ingredients, sorted, and the result.

    A half-product is taken apart until only ingredients are left. Its label holds those of its
    ingredients, so no chain leads back to itself (:func:`is_step`).

    Args:
        recipes: all recipes of a book or graph. Recipes without half-products stay as they are.

    Returns:
        A pair (ingredients, result) for each recipe whose result is no half-product, in the given
        order.

    Example:
        >>> unchained(chain(["stick", "coal", "rope"], "torch"))
        [(('coal', 'rope', 'stick'), 'torch')]
    """
    recipes = list(recipes)
    parts_of = {
        recipe.result: recipe.ingredients for recipe in recipes if is_half_product(recipe.result)
    }

    def expanded(label: str) -> list[str]:
        parts = []
        # A stack, not recursion: a chain of a thousand ingredients would reach Python's limit.
        stack = [label]
        while stack:
            current = stack.pop()
            if current in parts_of:
                stack += parts_of[current]
            else:
                parts.append(current)
        return parts

    full_recipes = []
    for recipe in recipes:
        if not is_half_product(recipe.result):
            parts = [part for label in recipe.ingredients for part in expanded(label)]
            full_recipes.append((tuple(sorted(parts)), recipe.result))
    return full_recipes
