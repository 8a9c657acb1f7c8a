"""Known recipes that support another recipe: what explains a score."""

from typing import NamedTuple

import numpy as np

from wordcraft_kg.models.scorers.neighbours.lists import Lists

LEAST_SHARE = 0.01
"""Smallest evidence share of a supporting recipe that counts as a reason."""


class Support(NamedTuple):
    """A known recipe that supports another recipe, by ids, and its weight.

    The weight is the recipe similarity, 1 for equality: the product of entity similarities for both
    ingredients (in the better order) and the result. ``share`` is relative to the sum over all
    supporting recipes, ``strength`` to the strongest of them.
    """

    recipe: tuple[int, int, int]
    weight: float
    share: float
    strength: float


def supporting_recipes(
    lists: Lists,
    recipe: tuple[int, int, int],
    num_entities: int,
    limit: int,
) -> list[Support]:
    """Return up to ``limit`` known recipes that support a recipe.

    Recipes that make the goal itself come first, if their share is at least :data:`LEAST_SHARE`,
    then the others; both by share.

    Args:
        lists: of the known recipes.
        recipe: ids of both ingredients and of the goal.
        num_entities: E: recipes of other books, with further ids, have no labels here.
        limit: maximum number of recipes.
    """
    # Compiled loops are imported late: numba takes as long to import as all the rest.
    from wordcraft_kg.models.scorers.neighbours.feature_loops import support_terms

    a, b, goal = recipe
    numbers = lists.support[goal]
    orders = np.zeros((len(numbers), 2), dtype=np.float32)
    support_terms(lists, a, b, goal, orders)
    # -1 ends the list.
    numbers = numbers[numbers >= 0]
    orders = orders[: len(numbers)]
    like_goal = lists.support_alike[goal, : len(numbers)]
    # Both orders count as evidence, as in the feature; a weight is the better order's alone.
    evidence = like_goal * orders.sum(1)
    weights = np.minimum(like_goal * orders.max(1, initial=0), 1)
    # Without evidence all shares are 0, not NaN.
    smallest = np.finfo(np.float32).tiny
    shares = evidence / max(evidence.sum(), smallest)
    strengths = evidence / max(evidence.max(initial=0), smallest)
    results = lists.result[numbers]
    is_other = (results != goal) | (shares < LEAST_SHARE)
    # The last key counts first; ties stay in the order of the list.
    by_share = np.lexsort((-evidence, is_other))
    supports: list[Support] = []
    for row in by_share.tolist():
        if len(supports) == limit:
            break
        number = numbers[row]
        support_ids = int(lists.first[number]), int(lists.second[number]), int(results[row])
        if weights[row] > 0 and max(support_ids) < num_entities:
            figures = float(weights[row]), float(shares[row]), float(strengths[row])
            supports.append(Support(support_ids, *figures))
    return supports
