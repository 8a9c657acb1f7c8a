"""Features of links: their names, how they are computed for any entities and candidates, and loops.

Each link is computed by itself: loops follow the neighbours of both entities to the known links.
Those of componentOf share what depends on the result, so links are asked for by result. See "The
rankers" in docs/explanation/recipe-scorer.md.
"""

# ruff: noqa: C901 - numba inlines what a call would split
from math import log, log1p

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, Ids
from wordcraft_kg.models.scorers.neighbours.compiled import compiled
from wordcraft_kg.models.scorers.neighbours.feature_loops import (
    FLOOR,
    forget_links,
    links_of_slots,
    links_to_results,
)
from wordcraft_kg.models.scorers.neighbours.hash_loops import pair_place
from wordcraft_kg.models.scorers.neighbours.lists import Lists
from wordcraft_kg.models.scorers.neighbours.similar import alike_of, product

OF_COMPONENTS = (
    "words",
    "kernel",
    "uses",
    "made",
    "link",
    "link_words",
    "link_reverse",
    "link_with_goal",
    "combines",
    "link_partners",
    "link_steps",
    "regression",
    "word_regression",
    "goal_uses",
    "goal_made",
)
"""Features of a componentOf link from x to c, in the order of the link ranker's weights.

| feature | meaning |
|---|---|
| words, kernel | word cosine and similarity of x and c |
| uses, made | log(1 + recipes that use x, that make x) |
| link, link_words | log of known links x' -> c' of neighbours, by likeness and by words |
| link_reverse | log of links from c to neighbours of x: c as ingredient, x as result |
| link_with_goal, combines | log of x's neighbours that combine with c; whether x does |
| link_partners | log(1 + ingredients of c that combine with x) |
| link_steps | log(1 + ingredients of c that x is an ingredient of) |
| regression, word_regression | componentOf(x, c) by kernel regression: by k, by word vectors |
| goal_uses, goal_made | log(1 + recipes that use c, that make c) |
"""
OF_COMBINES = (
    "words",
    "kernel",
    "uses_sum",
    "uses_difference",
    "made_sum",
    "itself",
    "completion",
    "near_pairs",
    "word_regression",
)
"""Features of a combinesWith link between a and b, in the order of the link ranker's weights.

| feature | meaning |
|---|---|
| words, kernel | word cosine and similarity of a and b |
| uses_*, made_sum | sum and difference of log(1 + recipes that use it, that make it) |
| itself | whether a equals b |
| completion | log of paths over pairs with the same result, see ``kernel.completion`` |
| near_pairs | log of known pairs of a and a neighbour of b, or the other way round |
| word_regression | combinesWith(a, b) by kernel regression of word vectors |
"""
# Places in the order of `OF_COMBINES`.
(
    _WORDS,
    _KERNEL,
    _USES_SUM,
    _USES_DIFFERENCE,
    _MADE_SUM,
    _ITSELF,
    _COMPLETION,
    _NEAR_PAIRS,
    _WORD_REGRESSION,
) = range(9)
LINK_FEATURES = {COMBINES_WITH: OF_COMBINES, COMPONENT_OF: OF_COMPONENTS}
"""Names of the features of each relation."""
CELLS = 2**17
"""Links whose features are in memory at once, about."""


def links_by_key(lists: Lists, relation: int, keys: Ids, slots: Ids) -> Tensor:
    """Return the features of links between keys and slots.

    Args:
        lists: the lists.
        relation: relation id.
        keys: the results of componentOf links, or one end of combinesWith links; ids, shape (B,),
            -1 for none.
        slots: the other ends, ids, shape (B, A), -1 for none.

    Returns:
        shape (B, A, F), float32; zeros without a key or slot.
    """
    features = np.zeros((*slots.shape, len(LINK_FEATURES[relation])), dtype=np.float32)
    # Arrays without gaps, for which the loops are compiled.
    arrays = np.ascontiguousarray(keys), np.ascontiguousarray(slots), features
    if relation == COMBINES_WITH:
        combines_features(lists, *arrays)
    else:
        component_features(lists, *arrays)
    return torch.from_numpy(features)


def link_features(lists: Lists, relation: int, heads: Ids, tails: Ids) -> Tensor:
    """Return the features of the links of all heads with all tails.

    Args:
        lists: the lists.
        relation: relation id.
        heads: ids, shape (H,).
        tails: ids, shape (N,).

    Returns:
        shape (H, N, F), float32.
    """
    if relation == COMBINES_WITH:
        return links_by_key(lists, relation, heads, np.tile(tails, (len(heads), 1)))
    # All heads share what depends on a result: (N, H, F) to (H, N, F).
    by_result = links_by_key(lists, relation, tails, np.tile(heads, (len(tails), 1)))
    return by_result.transpose(0, 1)


@compiled
def component_features(lists, goals, tables, out):  # type: ignore[no-untyped-def]
    """Write the features of componentOf links from each slot to the goal.

    Args:
        lists: the lists.
        goals: shape (B,); negative for no goal.
        tables: shape (B, A); negative for empty slots.
        out: zeros, shape (B, A, 15), in the order of ``OF_COMPONENTS``; an empty slot,
            or one without goal, keeps its zeros.
    """
    structure = np.zeros(len(lists.norms), dtype=np.float32)
    kernels = np.empty(tables.shape[1], dtype=np.float32)
    cosines = np.empty(tables.shape[1], dtype=np.float32)
    entry_of = np.full(len(lists.norms), -1, dtype=np.int32)
    entries = np.empty((len(lists.parts.columns), 2), dtype=np.int32)
    counts = np.empty(len(lists.parts.columns), dtype=np.int32)
    to_results = (entry_of, entries, counts)
    for row in range(len(goals)):
        goal = goals[row]
        if goal < 0:
            continue
        # k is symmetric, so the goal's profile serves all slots.
        alike_of(lists, goal, tables[row], structure, kernels, cosines)
        links_to_results(lists, goal, *to_results)
        links_of_slots(lists, to_results, goal, tables[row], cosines, kernels, out[row])
        forget_links(lists, goal, entry_of)


@compiled
def combines_features(lists, keys, tables, out):  # type: ignore[no-untyped-def]
    """Write the features of combinesWith links between each slot and one entity.

    Completion is the product ``H R Hᵀ`` of sparse matrices, see ``Lists.half``.

    Args:
        lists: the lists.
        keys: shape (B,); negative for no entity.
        tables: shape (B, A); negative for empty slots.
        out: zeros, shape (B, A, 9), in the order of ``OF_COMBINES``; an empty slot, or one
            without key, keeps its zeros.
    """
    word = lists.by_words
    half = lists.half
    nodes = lists.nodes
    used = lists.used
    kernels = np.empty(tables.shape[1], dtype=np.float32)
    cosines = np.empty(tables.shape[1], dtype=np.float32)
    structure = np.zeros(len(lists.norms), dtype=np.float32)
    reached = np.zeros(len(nodes.starts) - 1, dtype=np.float32)
    for row in range(len(keys)):
        key = keys[row]
        if key < 0:
            continue
        alike_of(lists, key, tables[row], structure, kernels, cosines)
        # The key's row of H R, in an array of all nodes.
        for place in range(half.starts[key], half.starts[key + 1]):
            node = half.columns[place]
            node_weight = half.values[place]
            for end in range(nodes.starts[node], nodes.starts[node + 1]):
                reached[nodes.columns[end]] += node_weight * nodes.values[end]
        for slot in range(tables.shape[1]):
            entity = tables[row, slot]
            if entity < 0:
                continue
            completion = np.float32(0)
            for place in range(half.starts[entity], half.starts[entity + 1]):
                node = half.columns[place]
                completion += half.values[place] * reached[node]
            # Known pairs of one of both and a neighbour of the other.
            near = np.float32(0)
            for number in range(used.ids.shape[1]):
                near_key = used.ids[key, number]
                if near_key >= 0 and pair_place(lists.pairs, near_key, entity) >= 0:
                    near += used.alike[key, number]
                near_entity = used.ids[entity, number]
                if near_entity >= 0 and pair_place(lists.pairs, near_entity, key) >= 0:
                    near += used.alike[entity, number]
            uses = log1p(lists.num_uses[key])
            other_uses = log1p(lists.num_uses[entity])
            num_made = log1p(lists.num_makers[key])
            other_made = log1p(lists.num_makers[entity])
            features = out[row, slot]
            features[_WORDS] = cosines[slot]
            features[_KERNEL] = kernels[slot]
            features[_USES_SUM] = uses + other_uses
            features[_USES_DIFFERENCE] = abs(uses - other_uses)
            features[_MADE_SUM] = num_made + other_made
            features[_ITSELF] = 1 if key == entity else 0
            features[_COMPLETION] = log(FLOOR + completion)
            features[_NEAR_PAIRS] = log(FLOOR + near)
            features[_WORD_REGRESSION] = product(word.pair_left, word.right, key, entity)
        # Cleared where it was written, for the next key.
        for place in range(half.starts[key], half.starts[key + 1]):
            node = half.columns[place]
            for end in range(nodes.starts[node], nodes.starts[node + 1]):
                reached[nodes.columns[end]] = 0
