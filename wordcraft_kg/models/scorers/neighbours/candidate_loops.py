"""Loops that choose entities which a plan may make before its goal."""

import numpy as np

from wordcraft_kg.models.scorers.neighbours.compiled import compiled, in_place
from wordcraft_kg.models.scorers.neighbours.feature_loops import (
    FLOOR,
    MOST_RESULTS,
    neighbour_pairs,
    room_for_pairs,
)
from wordcraft_kg.models.scorers.neighbours.list_loops import insert

_LATER = np.float32(0.05)
"""Weight of entities that only a further attempt can make."""
_FIRST = np.float32(1e6)
"""Weight of known results: they come before all others."""
_LEADS = np.float32(1e4)
"""Weight of entities that one known attempt after them makes the goal: they come next."""


@in_place
def _add_results(lists, a, b, factor, weights, known_pairs):  # type: ignore[no-untyped-def]
    """Add the results of a pair's neighbours to the weights of entities.

    Args:
        lists: the lists.
        a: entity id.
        b: entity id.
        factor: weight of the attempt: 1 for the first, less for further ones.
        weights: is added to, shape (T,).
        known_pairs: work space for :func:`neighbour_pairs`.
    """
    places, pair_weights, _ = known_pairs
    count, itself = neighbour_pairs(lists.used, lists.pairs, a, b, 0, known_pairs)
    for number in range(count):
        weight = pair_weights[number]
        # The pair itself, at the first attempt: its results are certain, not only likely.
        if number == itself and factor == 1:
            weight = _FIRST
        start = lists.pairs.starts[places[number]]
        results = min(lists.pairs.counts[places[number]], MOST_RESULTS)
        for recipe in range(start, start + results):
            weights[lists.result[recipe]] += factor * weight


@in_place
def _add_needs(lists, goal, factor, weights):  # type: ignore[no-untyped-def]
    """Add entities similar to the ingredients of a goal's supporting recipes to the weights.

    Args:
        lists: the lists.
        goal: entity id.
        factor: weight of the attempt.
        weights: is added to, shape (T,).
    """
    for row in range(lists.support.shape[1]):
        recipe = lists.support[goal, row]
        if recipe < 0:
            break
        for part in range(2):
            ingredient = lists.second[recipe] if part else lists.first[recipe]
            # An entity that no known recipe makes is in no list of made neighbours, not even in its
            # own; others are first in theirs.
            if lists.num_makers[ingredient] == 0:
                weights[ingredient] += factor * lists.support_alike[goal, row]
            for column in range(lists.made.ids.shape[1]):
                neighbour = lists.made.ids[ingredient, column]
                if neighbour < 0:
                    break
                weight = lists.support_alike[goal, row] * lists.made.alike[ingredient, column]
                weights[neighbour] += factor * weight


@in_place
def _add_leads(lists, goal, table, needs):  # type: ignore[no-untyped-def]
    """Add entities from which a known recipe leads to the goal to the weights.

    Args:
        lists: the lists.
        goal: entity id.
        table: shape (A,); negative for empty slots. The recipe's other ingredient is among them, or
            the entity itself.
        needs: is added to, shape (T,).
    """
    for row in range(lists.support.shape[1]):
        recipe = lists.support[goal, row]
        if recipe < 0:
            break
        if lists.result[recipe] != goal:
            continue
        first = lists.first[recipe]
        second = lists.second[recipe]
        if first == second:
            needs[first] += _LEADS
            continue
        for slot in range(len(table)):
            if table[slot] == first:
                needs[second] += _LEADS
            if table[slot] == second:
                needs[first] += _LEADS


@in_place
def _like_made(lists, entity, makes):  # type: ignore[no-untyped-def]
    """Return how strongly the made neighbours of an entity are made, for one that nothing makes.

    Args:
        lists: the lists.
        entity: entity id.
        makes: how strongly each entity is made, shape (T,); negative for those that do not count.
    """
    total = np.float32(0)
    for column in range(lists.made.ids.shape[1]):
        neighbour = lists.made.ids[entity, column]
        if neighbour < 0:
            break
        # A known result is certain, but not a reason to expect another one.
        strength = min(makes[neighbour], np.float32(1))
        total += lists.made.alike[entity, column] * max(strength, np.float32(0))
    return total


@in_place
def _best(weights, ids, values):  # type: ignore[no-untyped-def]
    """Write the entities with the largest positive weights; return their number.

    Args:
        weights: shape (T,).
        ids: receives the entities, the largest weight first.
        values: receives their weights.
    """
    count = 0
    for entity in range(len(weights)):
        value = weights[entity]
        if value > 0 and (count < len(ids) or value > values[count - 1]):
            count = insert(ids, values, count, entity, value)
    return count


@compiled
def intermediates(lists, goals, tables, further, near, out):  # type: ignore[no-untyped-def]
    """Write entities that a plan may make before the goal, the best first; -1 at the end.

    An entity counts by the product of two weights: how strongly neighbours of the table's pairs
    make it, and how much the goal's neighbours need it. Known results come first.

    Args:
        lists: the lists.
        goals: shape (B,).
        tables: shape (B, A); negative for empty slots.
        further: attempts between the first and the last, 0 or more.
        near: entities that stand for all others in a further attempt.
        out: shape (B, W).
    """
    size = len(lists.norms)
    ids = np.empty(near, dtype=np.int32)
    values = np.empty(near, dtype=np.float32)
    # Work space for a pair, made once for the batch.
    best_values = np.empty(out.shape[1], dtype=np.float32)
    known_pairs = room_for_pairs(lists, 1)
    for row in range(len(goals)):
        goal = goals[row]
        table = tables[row]
        makes = np.zeros(size, dtype=np.float32)
        needs = np.zeros(size, dtype=np.float32)
        for i in range(len(table)):
            for j in range(i, len(table)):
                if table[i] >= 0 and table[j] >= 0:
                    _add_results(lists, table[i], table[j], np.float32(1), makes, known_pairs)
        _add_needs(lists, goal, np.float32(1), needs)
        _add_leads(lists, goal, table, needs)
        for _ in range(further):
            for place in range(_best(makes, ids, values)):
                for slot in range(len(table)):
                    if table[slot] >= 0:
                        _add_results(lists, ids[place], table[slot], _LATER, makes, known_pairs)
            for place in range(_best(needs, ids, values)):
                _add_needs(lists, ids[place], _LATER, needs)
        for slot in range(len(table)):
            if table[slot] >= 0:
                makes[table[slot]] = -1
        # Neither the goal nor an entity on the table is made before the goal.
        makes[goal] = -1
        # In a by-goal split, no known recipe makes some of the entities that a plan needs. They are
        # in no list of made neighbours, so the order does not count.
        for entity in range(size):
            if needs[entity] > 0 and makes[entity] == 0 and lists.num_makers[entity] == 0:
                makes[entity] = _like_made(lists, entity, makes)
        for entity in range(size):
            if makes[entity] >= 0:
                # The floor keeps entities that one side or none speaks for, far behind the others:
                # with room for all entities, the search leaves out no plan.
                makes[entity] = (makes[entity] + FLOOR) * (needs[entity] + FLOOR)
            else:
                makes[entity] = 0
        out[row, _best(makes, out[row], best_values) :] = -1


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
    # Work space, made once for all pairs.
    known_pairs = room_for_pairs(lists, 1)
    places, weights, _ = known_pairs
    totals = np.zeros(len(lists.norms), dtype=np.float32)
    result_ids = np.empty(len(places) * MOST_RESULTS, dtype=np.int32)
    values = np.empty(width, dtype=np.float32)
    for row in range(len(first)):
        num_neighbour_pairs, _ = neighbour_pairs(
            lists.used, lists.pairs, first[row], second[row], 0, known_pairs
        )
        count = 0
        for number in range(num_neighbour_pairs):
            place = places[number]
            start = lists.pairs.starts[place]
            results = min(lists.pairs.counts[place], MOST_RESULTS)
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
        out[row, num_results:] = -1
