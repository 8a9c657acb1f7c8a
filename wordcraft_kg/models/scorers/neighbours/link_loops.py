"""Loops that compute the features of links between one entity and others, see :mod:`.links`."""

from math import log, log1p

import numpy as np

from wordcraft_kg.models.scorers.neighbours.compiled import compiled
from wordcraft_kg.models.scorers.neighbours.feature_loops import (
    FLOOR,
    forget_links,
    links_of_slots,
    links_to_results,
)
from wordcraft_kg.models.scorers.neighbours.hash_loops import pair_place
from wordcraft_kg.models.scorers.neighbours.similar import alike_of, product

# Places in the order of `links.OF_COMBINES`.
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


@compiled
def component_features(lists, goals, tables, out):  # type: ignore[no-untyped-def]
    """Write the features of componentOf links from each slot to the goal.

    Args:
        lists: the lists.
        goals: shape (B,); negative for no goal.
        tables: shape (B, A); negative for empty slots.
        out: zeros, shape (B, A, 15), in the order of ``links.OF_COMPONENTS``; an empty slot,
            or one without goal, keeps its zeros.
    """
    structure = np.zeros(len(lists.norms), dtype=np.float32)
    kernels = np.empty(tables.shape[1], dtype=np.float32)
    cosines = np.empty(tables.shape[1], dtype=np.float32)
    entry_of = np.full(len(lists.norms), -1, dtype=np.int32)
    entries = np.empty((len(lists.parts), 2), dtype=np.int32)
    counts = np.empty(len(lists.parts), dtype=np.int32)
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

    Completion is the product ``H R Hᵀ`` of sparse matrices, see ``Lists.half_starts``.

    Args:
        lists: the lists.
        keys: shape (B,); negative for no entity.
        tables: shape (B, A); negative for empty slots.
        out: zeros, shape (B, A, 9), in the order of ``links.OF_COMBINES``; an empty slot, or one
            without key, keeps its zeros.
    """
    word = lists.by_words
    half_starts = lists.half_starts
    half_nodes = lists.half_nodes
    half_values = lists.half_values
    pair_starts = lists.node_starts
    pair_nodes = lists.node_partners
    pair_values = lists.node_values
    hashed = (lists.partner_bits, lists.pair_keys)
    width = lists.used.shape[1]
    kernels = np.empty(tables.shape[1], dtype=np.float32)
    cosines = np.empty(tables.shape[1], dtype=np.float32)
    structure = np.zeros(len(lists.norms), dtype=np.float32)
    reached = np.zeros(len(pair_starts) - 1, dtype=np.float32)
    for row in range(len(keys)):
        key = keys[row]
        if key < 0:
            continue
        alike_of(lists, key, tables[row], structure, kernels, cosines)
        # The key's row of H R, in an array of all nodes.
        for place in range(half_starts[key], half_starts[key + 1]):
            node = half_nodes[place]
            node_weight = half_values[place]
            for end in range(pair_starts[node], pair_starts[node + 1]):
                reached[pair_nodes[end]] += node_weight * pair_values[end]
        for slot in range(tables.shape[1]):
            entity = tables[row, slot]
            if entity < 0:
                continue
            completion = np.float32(0)
            for place in range(half_starts[entity], half_starts[entity + 1]):
                node = half_nodes[place]
                completion += half_values[place] * reached[node]
            # Known pairs of one of both and a neighbour of the other.
            near = np.float32(0)
            for number in range(width):
                near_key = lists.used[key, number]
                if near_key >= 0 and pair_place(*hashed, near_key, entity) >= 0:
                    near += lists.used_alike[key, number]
                near_entity = lists.used[entity, number]
                if near_entity >= 0 and pair_place(*hashed, near_entity, key) >= 0:
                    near += lists.used_alike[entity, number]
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
        for place in range(half_starts[key], half_starts[key + 1]):
            node = half_nodes[place]
            for end in range(pair_starts[node], pair_starts[node + 1]):
                reached[pair_nodes[end]] = 0
