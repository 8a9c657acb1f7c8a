"""Features of a pair and a goal: their names, and how they are put together."""

from functools import lru_cache

import torch
from torch import Tensor

from wordcraft_kg.models.scorers.neighbours.link_rows import OF_COMPONENTS

OF_SLOTS = (
    *OF_COMPONENTS[:-2],
    "count",
    "evidence",
    "best_evidence",
    "words_evidence",
    "component",
)
"""Features of an ingredient x and a goal c; the sum and the minimum over both ingredients count.

Those of componentOf links, without ``goal_uses`` and ``goal_made``, come first.

| feature | meaning |
|---|---|
| count | log(1 + recipes that make c with x) |
| evidence | log of a sum over recipes that make c's neighbours, by likeness of c and of x |
| best_evidence, words_evidence | the largest term; the sum by words |
| component | score of componentOf(x, c) by the link ranker |
"""
OF_PAIRS = (
    "pair_evidence",
    "pair_words_evidence",
    "pair_best_evidence",
    "makes_anything",
    "makes_alike",
    "makes_best",
    "makes_anything_words",
    "makes_alike_words",
    "known",
    "makes",
    "pair_words",
    "pair_kernel",
    "itself",
    "goal_made",
    "goal_uses",
    "pair_regression",
    "combines_pair",
)
"""Features of a pair (a, b) and a goal c.

| feature | meaning |
|---|---|
| pair_evidence | log of the recipe-to-recipe kernel over recipes that make c's neighbours |
| pair_words_evidence, pair_best_evidence | the same by words; its largest term |
| makes_anything | log of known pairs (a', b') of neighbours, by likeness |
| makes_alike, makes_best | the same times the likeness of their results and c: sum, largest term |
| makes_anything_words, makes_alike_words | both sums by words |
| known, makes | a + b has known results; c is a known result |
| pair_words, pair_kernel, itself | word cosine and similarity of a and b; a equals b |
| goal_made, goal_uses | log(1 + recipes that make c, that use c) |
| pair_regression | combinesWith(a, b) by kernel regression |
| combines_pair | score of combinesWith(a, b), where outside knowledge tells of pairs; else 0 |
"""
FEATURES = (
    *(f"{name}_sum" for name in OF_SLOTS),
    *(f"{name}_min" for name in OF_SLOTS),
    *OF_PAIRS,
)
"""All features, in the order of the ranker's weights."""
OF_ENCODER = ("encoder", "encoder_result", "encoder_pair")
"""Further features of a pair and a goal, after all others, in a model with a pair encoder.

| feature | meaning |
|---|---|
| encoder | s, the encoder's score of the recipe |
| encoder_result | s - u: how well the goal fits the pair |
| encoder_pair | u, which does not depend on the goal |
"""


def component_inputs(slots: Tensor, pairs: Tensor) -> Tensor:
    """Return the features of componentOf links between slots and goals, for the link ranker.

    Args:
        slots: features of slots, as loops write them, shape (B, A, 16).
        pairs: features of pairs, shape (B, P, 16): they tell the goals' numbers of recipes.

    Returns:
        shape (B, A, 14), in the order of :data:`~.link_rows.OF_COMPONENTS`.
    """
    # The last two features are of the goal alone, and stand among the features of pairs.
    num_of_slots = len(OF_COMPONENTS) - 2
    goal_columns = [OF_PAIRS.index(name) for name in OF_COMPONENTS[num_of_slots:]]
    # Pairs with an empty slot are zeros, others have the goal's numbers. (B, P, 2) to (B, 2).
    of_goal = pairs[..., goal_columns].amax(1)
    num_slots = slots.shape[1]
    # (B, 2) to (B, A, 2).
    of_goals = of_goal[:, None].expand(-1, num_slots, -1)
    of_slots = slots[..., :num_of_slots]
    return torch.cat([of_slots, of_goals], dim=-1)


def features_of_pairs(
    slots: Tensor,
    pairs: Tensor,
    component: Tensor,
    combines: Tensor,
    one: Tensor,
    other: Tensor,
) -> Tensor:
    """Return the features of pairs, in the order of :data:`FEATURES`.

    Args:
        slots: features of slots, as loops write them, shape (B, A, 16).
        pairs: features of pairs, shape (B, P, 16).
        component: link scores of slots and goals, shape (B, A).
        combines: link scores of pairs, shape (B, P).
        one: first slot of each pair, shape (P,).
        other: second slot of each pair, shape (P,).

    Returns:
        shape (B, P, F).
    """
    of_slots = torch.cat([slots, component[..., None]], dim=-1)
    of_one = of_slots.index_select(1, one)
    of_other = of_slots.index_select(1, other)
    # The order of a pair does not count: both parts are symmetric.
    total = of_one + of_other
    least = torch.minimum(of_one, of_other)
    return torch.cat([total, least, pairs, combines[..., None]], dim=-1)


@lru_cache
def pairs_of(slots: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the first and second slot in each slot pair, shape (P,) each, with first <= second."""
    one, other = torch.triu_indices(slots, slots, device=device)
    return one, other


@lru_cache
def square_of(slots: int, device: torch.device) -> Tensor:
    """Return the number of each slot pair in :func:`pairs_of`, in both orders, shape (A * A,)."""
    one, other = pairs_of(slots, device)
    every = torch.arange(len(one), device=device)
    number = torch.zeros(slots, slots, dtype=torch.int64, device=device)
    number[one, other] = every
    number[other, one] = every
    return number.view(-1)
