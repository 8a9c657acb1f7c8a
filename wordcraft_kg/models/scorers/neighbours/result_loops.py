"""Loops that choose entities which a pair may make, from the results of its neighbours."""

import numpy as np

from wordcraft_kg.models.scorers.neighbours.compiled import compiled
from wordcraft_kg.models.scorers.neighbours.feature_loops import MOST_RESULTS, neighbour_pairs
from wordcraft_kg.models.scorers.neighbours.list_loops import insert


@compiled
def results_of_pairs(lists, first, second, out):  # type: ignore[no-untyped-def]
    """Write the entities that neighbours of pairs make, the likeliest first; -1 at the end.

    An entity counts by the likeness of the pairs that make it, all together.

    Args:
        lists: the lists.
        first: shape (n,).
        second: shape (n,).
        out: shape (n, C).
    """
    width = out.shape[1]
    neighbours = (lists.used, lists.used_alike, lists.used_words)
    hashed = (lists.partner_bits, lists.pair_keys)
    max_pairs = lists.used.shape[1] ** 2
    # Work space, made once for all pairs.
    places = np.empty(max_pairs, dtype=np.int64)
    weights = np.empty(max_pairs, dtype=np.float32)
    words = np.empty(max_pairs, dtype=np.float32)
    totals = np.zeros(len(lists.norms), dtype=np.float32)
    result_ids = np.empty(max_pairs * MOST_RESULTS, dtype=np.int32)
    values = np.empty(width, dtype=np.float32)
    for row in range(len(first)):
        num_neighbour_pairs, _ = neighbour_pairs(
            *neighbours, *hashed, first[row], second[row], 0, places, weights, words
        )
        count = 0
        for number in range(num_neighbour_pairs):
            place = places[number]
            start = lists.pair_starts[place]
            results = min(lists.pair_counts[place], MOST_RESULTS)
            for recipe in range(start, start + results):
                entity = lists.result[recipe]
                if totals[entity] == 0:
                    result_ids[count] = entity
                    count += 1
                totals[entity] += weights[number]
        num_results = 0
        for number in range(count):
            entity = result_ids[number]
            value = totals[entity]
            # Each entity once: what is counted is cleared for the next pair.
            totals[entity] = 0
            if num_results < width or value > values[num_results - 1]:
                num_results = insert(out[row], values, num_results, entity, value)
        for place in range(num_results, width):
            out[row, place] = -1
