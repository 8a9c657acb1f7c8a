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
    most = lists.used.shape[1] ** 2
    # Work space, made once for all pairs.
    places = np.empty(most, dtype=np.int64)
    weights = np.empty(most, dtype=np.float32)
    words = np.empty(most, dtype=np.float32)
    totals = np.zeros(len(lists.norms), dtype=np.float32)
    made = np.empty(most * MOST_RESULTS, dtype=np.int32)
    values = np.empty(width, dtype=np.float32)
    for row in range(len(first)):
        found, _ = neighbour_pairs(
            *neighbours, *hashed, first[row], second[row], 0, places, weights, words
        )
        count = 0
        for number in range(found):
            place = places[number]
            start = lists.pair_starts[place]
            results = min(lists.pair_counts[place], MOST_RESULTS)
            for recipe in range(start, start + results):
                entity = lists.result[recipe]
                if totals[entity] == 0:
                    made[count] = entity
                    count += 1
                totals[entity] += weights[number]
        chosen = 0
        for number in range(count):
            entity = made[number]
            value = totals[entity]
            # Each entity once: what is counted is cleared for the next pair.
            totals[entity] = 0
            if chosen < width or value > values[chosen - 1]:
                chosen = insert(out[row], values, chosen, entity, value)
        for place in range(chosen, width):
            out[row, place] = -1
