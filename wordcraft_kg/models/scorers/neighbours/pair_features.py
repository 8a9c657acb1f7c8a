"""Features of a pair and a goal: their names, and how they are put together."""

from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.scorers.neighbours.feature_loops import table_features
from wordcraft_kg.models.scorers.neighbours.links import OF_COMPONENTS
from wordcraft_kg.models.scorers.neighbours.lists import Floats, Lists

OF_SLOTS = (
    *OF_COMPONENTS[:-2],
    "count",
    "component",
)
"""Features of an ingredient x and a goal c; the sum and the minimum over both ingredients count.

Those of componentOf links, without ``goal_uses`` and ``goal_made``, come first.

| feature | meaning |
|---|---|
| count | log(1 + recipes that make c with x) |
| component | score of componentOf(x, c) by the link ranker |
"""
OF_PAIRS = (
    "makes_anything",
    "makes_alike",
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
    "pair_word_regression",
    "result_regression",
    "combines_pair",
)
"""Features of a pair (a, b) and a goal c.

| feature | meaning |
|---|---|
| makes_anything | log of known pairs (a', b') of neighbours, by likeness |
| makes_alike | the same times the likeness of their results and c |
| makes_anything_words, makes_alike_words | both sums by words |
| known, makes | a + b has known results; c is a known result |
| pair_words, pair_kernel, itself | word cosine and similarity of a and b; a equals b |
| goal_made, goal_uses | log(1 + recipes that make c, that use c) |
| pair_regression, pair_word_regression | combinesWith(a, b) by kernel regression |
| result_regression | cosine of c's words and those that regression from a and b expects |
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


def pair_features(
    lists: Lists,
    slot_pairs: tuple[Ids, Ids],
    goals: Ids,
    tables: Ids,
    links: Floats,
) -> Floats:
    """Return the features of slot pairs, without those that need link scores: these are 0.

    Args:
        lists: the lists.
        slot_pairs: first and second slot of each pair, shape (P,) each.
        goals: shape (B,); -1 for no goal.
        tables: shape (B, A); -1 for empty slots.
        links: features of the componentOf links of slots and goals, shape (B, A, 15).

    Returns:
        shape (B, P, F), in the order of :data:`FEATURES`; zeros for a pair with an empty slot.
    """
    first_slots, second_slots = slot_pairs
    features = np.zeros((len(goals), len(first_slots), len(FEATURES)), dtype=np.float32)
    table_features(
        lists,
        # Arrays without gaps, for which the loop is compiled.
        np.ascontiguousarray(goals),
        np.ascontiguousarray(tables),
        first_slots,
        second_slots,
        links,
        features,
    )
    return features


def with_link_scores(
    features: Tensor,
    component: Tensor,
    combines: Tensor | None,
    slot_pairs: tuple[Tensor, Tensor],
) -> None:
    """Write the features that are scores of links.

    Args:
        features: of pairs, shape (B, P, F); is written to.
        component: componentOf scores of slots and goals, shape (B, A).
        combines: combinesWith scores of pairs, shape (B, P); None if only recipes tell of them.
        slot_pairs: first and second slot of each pair, shape (P,) each.
    """
    first_slots, second_slots = slot_pairs
    first = component.index_select(1, first_slots)
    second = component.index_select(1, second_slots)
    features[..., FEATURES.index("component_sum")] = first + second
    features[..., FEATURES.index("component_min")] = torch.minimum(first, second)
    if combines is not None:
        features[..., FEATURES.index("combines_pair")] = combines


@lru_cache
def only_pair(device: torch.device) -> tuple[Tensor, Tensor]:
    """Return slot 0 with slot 1, the only pair of a recipe's two slots that counts."""
    return torch.tensor([0], device=device), torch.tensor([1], device=device)


@lru_cache
def pairs_of(slots: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the first and second slot in each slot pair, shape (P,) each, with first <= second."""
    first_slots, second_slots = torch.triu_indices(slots, slots, device=device)
    return first_slots, second_slots
