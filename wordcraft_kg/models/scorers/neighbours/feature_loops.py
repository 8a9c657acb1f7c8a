"""Loops that compute the features of pairs on tables; see the package for the formulas.

A table has one goal, so what depends on the goal and a slot is computed once for all pairs, and
what depends on the goal and a result once for all pairs that may make it.
"""

from math import log, log1p
from typing import Any

import numpy as np

from wordcraft_kg.models.scorers.neighbours.compiled import compiled
from wordcraft_kg.models.scorers.neighbours.hash_loops import makes, num_links, pair_place
from wordcraft_kg.models.scorers.neighbours.similar import (
    clear,
    dot,
    fourth,
    product,
    similarity,
    spread,
)

Array = Any

FLOOR = np.float32(1e-4)
"""Added to evidence before the logarithm."""
LEAST = np.float32(2e-3)
"""Products of two similarities below this number are skipped, with all that follow in the lists.

Validation prefers 2e-3 to 3e-5 and to no limit, and it looks at 44 of 1,024 pairs of neighbours.
"""
MOST_RESULTS = 64
"""Results of a neighbour pair that count; a pair with more, in a damaged book, costs no more."""
OF_SLOTS = 16
"""Features of an ingredient and a goal, without the score by the link ranker."""
OF_PAIRS = 16
"""Features of a pair and a goal."""


@compiled
def neighbour_pairs(neighbours, hashed, a, b, places, weights, words):  # type: ignore[no-untyped-def]
    """Find the known pairs of neighbours of a and of b, the most similar neighbours first.

    Args:
        neighbours: ``lists.used``, ``lists.used_alike`` and ``lists.used_words``.
        hashed: ``lists.partner_bits`` and ``lists.pair_keys``.
        a: entity id.
        b: entity id.
        places: receives places in the hash table of pairs; as long as all pairs of neighbours.
        weights: receives k²(a, a') k²(b, b').
        words: receives the same by words.

    Returns:
        their number, and the number of a + b itself among them, -1 if it is not known.
    """
    used, used_alike, used_words = neighbours
    partner_bits, pair_keys = hashed
    count = 0
    itself = -1
    for row in range(used.shape[1]):
        one = used[a, row]
        if one < 0:
            break
        for column in range(used.shape[1]):
            other = used[b, column]
            weight = used_alike[a, row] * used_alike[b, column]
            if other < 0 or weight < LEAST:
                break
            place = pair_place(partner_bits, pair_keys, one, other)
            if place < 0:
                continue
            if one == a and other == b:
                itself = count
            places[count] = place
            weights[count] = weight
            words[count] = used_words[a, row] * used_words[b, column]
            count += 1
    return count, itself


@compiled
def needed_entities(lists, goal, count, needed, place_of, places):  # type: ignore[no-untyped-def]
    """Add the ingredients of a goal's supporting recipes to a list of different entities.

    Args:
        lists: the lists.
        goal: entity id.
        count: number of entities in ``needed``.
        needed: receives further entities; has room for twice the supporting recipes.
        place_of: the place of each entity in ``needed``, -1 for others; is written to.
        places: receives where each recipe's ingredients are in ``needed``, shape (R, 2).

    Returns:
        the new number of entities in ``needed``, and the number of supporting recipes.
    """
    recipes = 0
    for row in range(lists.support.shape[1]):
        recipe = lists.support[goal, row]
        if recipe < 0:
            break
        recipes += 1
        for part in range(2):
            entity = lists.second[recipe] if part else lists.first[recipe]
            if place_of[entity] < 0:
                place_of[entity] = count
                needed[count] = entity
                count += 1
            places[row, part] = place_of[entity]
    return count, recipes


@compiled
def alike_of(vectors, norms, entity, other, structure):  # type: ignore[no-untyped-def]
    """Return k and the word cosine of two entities.

    Args:
        vectors: unit word vectors, shape (T, D).
        norms: similarity of each entity with itself, shape (T,).
        entity: entity id.
        other: entity id.
        structure: the first entity's profile cosines, from ``spread``.
    """
    if entity == other:
        return np.float32(1), np.float32(1)
    cosine = dot(vectors, entity, other)
    return similarity(structure[other], cosine, norms[entity], norms[other]), cosine


@compiled
def _of_slot(lists, entity, goal, cosine, kernel, alike, words, places, recipes, out):  # type: ignore[no-untyped-def]
    """Write the features of an ingredient and a goal.

    Args:
        lists: the lists.
        entity: the ingredient.
        goal: the goal.
        cosine: their word cosine.
        kernel: their similarity k.
        alike: k² of each needed entity and the ingredient.
        words: the same by words.
        places: from :func:`needed_entities`.
        recipes: number of supporting recipes.
        out: shape (16,).
    """
    links = (lists.result_bits, lists.link_keys, lists.link_counts)
    total = np.float32(0)
    best = np.float32(0)
    by_words = np.float32(0)
    for row in range(recipes):
        of_goal = lists.support_alike[goal, row]
        of_goal_words = lists.support_words[goal, row]
        # Both ingredients of the supporting recipe.
        for part in range(2):
            place = places[row, part]
            value = of_goal * alike[place]
            total += value
            best = max(best, value)
            by_words += of_goal_words * words[place]
    out[12] = log1p(num_links(*links, entity, goal))
    out[13] = log(FLOOR + total)
    out[14] = log(FLOOR + best)
    out[15] = log(FLOOR + by_words)
    of_link(lists, entity, goal, cosine, kernel, out)


@compiled
def of_link(lists, entity, goal, cosine, kernel, out):  # type: ignore[no-untyped-def]
    """Write the features of a componentOf link, without the goal's numbers: ``out[:12]``.

    Args:
        lists: the lists.
        entity: the ingredient.
        goal: the result.
        cosine: their word cosine.
        kernel: their similarity k.
        out: shape (12,) or longer.
    """
    out[0] = cosine
    out[1] = kernel
    out[2] = log1p(lists.num_uses[entity])
    out[3] = log1p(lists.num_makers[entity])
    hashed = (lists.partner_bits, lists.pair_keys)
    links = (lists.result_bits, lists.link_keys, lists.link_counts)
    soft = np.float32(0)
    soft_words = np.float32(0)
    with_goal = np.float32(0)
    to_goal = np.float32(0)
    for row in range(lists.used.shape[1]):
        other = lists.used[entity, row]
        if other < 0:
            break
        of_other = lists.used_alike[entity, row]
        words_of_other = lists.used_words[entity, row]
        if pair_place(*hashed, goal, other) >= 0:
            with_goal += of_other
        to_goal += of_other * num_links(*links, other, goal)
        for column in range(lists.made.shape[1]):
            result = lists.made[goal, column]
            weight = of_other * lists.made_alike[goal, column]
            # Neighbours come by descending similarity, so all that follow are below, too.
            if result < 0 or weight < LEAST:
                break
            number = num_links(*links, other, result)
            if number:
                of_words = words_of_other * lists.made_words[goal, column]
                soft += number * weight
                soft_words += number * of_words
    exact = np.float32(0)
    for column in range(lists.made.shape[1]):
        result = lists.made[goal, column]
        if result < 0:
            break
        number = num_links(*links, entity, result)
        exact += lists.made_alike[goal, column] * number
    reverse = np.float32(0)
    for column in range(lists.made.shape[1]):
        result = lists.made[entity, column]
        if result < 0:
            break
        number = num_links(*links, goal, result)
        reverse += lists.made_alike[entity, column] * number
    out[4] = log(FLOOR + soft)
    out[5] = log(FLOOR + soft_words)
    out[6] = log(FLOOR + exact)
    out[7] = log(FLOOR + to_goal)
    out[8] = log(FLOOR + reverse)
    out[9] = log(FLOOR + with_goal)
    out[10] = 1 if pair_place(*hashed, entity, goal) >= 0 else 0
    out[11] = product(lists.left, lists.right, entity, goal)


@compiled
def _goal_sides(support, slot, low, high, alike, words, places, recipes, sums):  # type: ignore[no-untyped-def]
    """Sum the recipes that support the goal, for the pairs of a slot and a range of slots.

    The range is the inner loop, so that the processor adds for several slots at once; each pair's
    sum keeps its order.

    Args:
        support: similarities of the recipes' results to the goal, and the same by words.
        slot: the pairs' common slot.
        low: first slot of the range.
        high: end of the range.
        alike: k² of each needed entity and each slot, shape (needed, A).
        words: the same by words.
        places: from :func:`needed_entities`.
        recipes: number of supporting recipes.
        sums: receives the evidence, the evidence by words, and the best recipe's, shape (3, A).
    """
    support_alike, support_words = support
    evidence = sums[0]
    by_words = sums[1]
    best = sums[2]
    for other in range(low, high):
        evidence[other] = 0
        by_words[other] = 0
        best[other] = 0
    for row in range(recipes):
        first = places[row, 0]
        second = places[row, 1]
        of_first = alike[first]
        of_second = alike[second]
        words_of_first = words[first]
        words_of_second = words[second]
        of_goal = support_alike[row]
        of_goal_words = support_words[row]
        own_first = of_first[slot]
        own_second = of_second[slot]
        own_words_first = words_of_first[slot]
        own_words_second = words_of_second[slot]
        for other in range(low, high):
            straight = own_first * of_second[other]
            crossed = own_second * of_first[other]
            evidence[other] += of_goal * (straight + crossed)
            better = straight if straight > crossed else crossed
            value = of_goal * better
            best[other] = value if value > best[other] else best[other]
            straight_words = own_words_first * words_of_second[other]
            crossed_words = own_words_second * words_of_first[other]
            by_words[other] += of_goal_words * (straight_words + crossed_words)


@compiled
def _pair_side(  # type: ignore[no-untyped-def]
    recipes, vectors, norms, pairs, first, last, goal, structure, row, known_row, known, out
):
    """Write the features of a pair from known pairs of neighbours: ``out[3:8]``.

    Args:
        recipes: first recipe and number of recipes of each place in the hash table, and results.
        vectors: unit word vectors, shape (T, D).
        norms: similarity of each entity with itself, shape (T,).
        pairs: places, weights and words of known pairs, from :func:`neighbour_pairs`.
        first: number of the first known pair.
        last: end of the known pairs.
        goal: entity id.
        structure: the goal's profile cosines, from ``spread``.
        row: number of the table.
        known_row: the table for which ``known`` was written, for each entity.
        known: k² and words⁴ of each result and the goal, written once for each table: shape (T, 2).
        out: shape (16,).
    """
    pair_starts, pair_counts, result_of = recipes
    places, weights, words = pairs
    anything = np.float32(0)
    alike = np.float32(0)
    nearest = np.float32(0)
    anything_words = np.float32(0)
    alike_words = np.float32(0)
    for number in range(first, last):
        place = places[number]
        weight = weights[number]
        weight_by_words = words[number]
        start = pair_starts[place]
        results = min(pair_counts[place], MOST_RESULTS)
        anything += results * weight
        anything_words += results * weight_by_words
        for recipe in range(start, start + results):
            result = result_of[recipe]
            if known_row[result] != row:
                known_row[result] = row
                kernel, cosine = alike_of(vectors, norms, goal, result, structure)
                known[result, 0] = kernel * kernel
                known[result, 1] = fourth(cosine)
            value = weight * known[result, 0]
            alike += value
            nearest = max(nearest, value)
            alike_words += weight_by_words * known[result, 1]
    out[3] = log(FLOOR + anything)
    out[4] = log(FLOOR + alike)
    out[5] = log(FLOOR + nearest)
    out[6] = log(FLOOR + anything_words)
    out[7] = log(FLOOR + alike_words)


@compiled
def _all_neighbour_pairs(lists, table, one, other, starts):  # type: ignore[no-untyped-def]
    """Find the known pairs of neighbours of all pairs of slots.

    Args:
        lists: the lists.
        table: shape (A,); negative for empty slots.
        one: first slot of each pair, shape (P,).
        other: second slot of each pair, shape (P,).
        starts: receives where each pair's begin, and the end, shape (P + 1,).

    Returns:
        places, weights and words, as in :func:`neighbour_pairs`, all pairs of slots in turn.
    """
    neighbours = (lists.used, lists.used_alike, lists.used_words)
    hashed = (lists.partner_bits, lists.pair_keys)
    most = lists.used.shape[1] ** 2
    room = 2 * most
    places = np.empty(room, dtype=np.int64)
    weights = np.empty(room, dtype=np.float32)
    words = np.empty(room, dtype=np.float32)
    end = 0
    for pair in range(len(one)):
        starts[pair] = end
        a = table[one[pair]]
        b = table[other[pair]]
        if a < 0 or b < 0:
            continue
        if room < end + most:
            room *= 2
            # A plain loop compiles several times as fast as `np.append`.
            more_places = np.empty(room, dtype=np.int64)
            more_weights = np.empty(room, dtype=np.float32)
            more_words = np.empty(room, dtype=np.float32)
            for number in range(end):
                more_places[number] = places[number]
                more_weights[number] = weights[number]
                more_words[number] = words[number]
            places = more_places
            weights = more_weights
            words = more_words
        found, _ = neighbour_pairs(
            neighbours, hashed, a, b, places[end:], weights[end:], words[end:]
        )
        end += found
    starts[len(one)] = end
    return places, weights, words


@compiled
def _end_of_table(goals, tables, start):  # type: ignore[no-untyped-def]
    """Return the first row after ``start`` with another table, or without a goal."""
    end = start + 1
    while end < len(goals) and goals[end] >= 0:
        for slot in range(tables.shape[1]):
            if tables[end, slot] != tables[start, slot]:
                return end
        end += 1
    return end


@compiled
def table_features(lists, goals, tables, one, other, of_slots, of_pairs):  # type: ignore[no-untyped-def]
    """Write the features of slots, and of pairs of slots.

    What depends on the table alone is computed once for rows with the same table that follow each
    other: a planner asks for many results of one table.

    Args:
        lists: the lists.
        goals: shape (B,); negative for no goal.
        tables: shape (B, A); negative for empty slots.
        one: first slot of each pair, shape (P,).
        other: second slot of each pair, shape (P,).
        of_slots: zeros, shape (B, A, 16); an empty slot, or one without goal, keeps its zeros.
        of_pairs: zeros, shape (B, P, 16), likewise.
    """
    size = len(lists.norms)
    slots = tables.shape[1]
    width = lists.support.shape[1]
    # Work space, made once for the batch.
    place_of = np.full(size, -1, dtype=np.int32)
    structure = np.zeros(size, dtype=np.float32)
    of_goal = np.zeros(size, dtype=np.float32)
    known_row = np.full(size, -1, dtype=np.int64)
    known = np.empty((size, 2), dtype=np.float32)
    cosines = np.empty((slots, slots), dtype=np.float32)
    kernels = np.empty((slots, slots), dtype=np.float32)
    starts = np.empty(len(one) + 1, dtype=np.int64)
    own_places = np.empty(len(one), dtype=np.int64)
    regression = np.empty(len(one), dtype=np.float32)
    sums = np.empty((3, slots), dtype=np.float32)
    hashed = (lists.partner_bits, lists.pair_keys)
    recipes_of_pairs = (lists.pair_starts, lists.pair_counts, lists.result)
    # Of each first slot, the range of its second slots.
    ranges = np.zeros((slots, 2), dtype=np.int64)
    ranges[:, 0] = slots
    for pair in range(len(one)):
        slot = one[pair]
        ranges[slot, 0] = min(ranges[slot, 0], other[pair])
        ranges[slot, 1] = max(ranges[slot, 1], other[pair] + 1)
    end = np.int64(0)
    while end < len(goals):
        begin = end
        if goals[begin] < 0:
            end += 1
            continue
        end = _end_of_table(goals, tables, begin)
        table = tables[begin]
        # Ingredients that any of the goals needs, each once.
        needed = np.empty((end - begin) * 2 * width, dtype=np.int32)
        places = np.empty((end - begin, width, 2), dtype=np.int32)
        recipes = np.empty(end - begin, dtype=np.int64)
        # Not a plain 0, which numba takes for a type of its own: functions compile twice for it.
        count = np.int64(0)
        for row in range(begin, end):
            count, recipes[row - begin] = needed_entities(
                lists,
                goals[row],
                count,
                needed,
                place_of,
                places[row - begin],
            )
        for number in range(count):
            place_of[needed[number]] = -1
        # By needed entity, then by slot: loops over slots read and write what lies together.
        alike = np.zeros((count, slots), dtype=np.float32)
        words = np.zeros((count, slots), dtype=np.float32)
        # A needed entity's word vector is read once for all slots.
        for number in range(count):
            for slot in range(slots):
                entity = table[slot]
                if entity >= 0:
                    words[number, slot] = dot(lists.vectors, entity, needed[number])
        for slot in range(slots):
            entity = table[slot]
            if entity < 0:
                continue
            spread(lists, entity, structure)
            norm = lists.norms[entity]
            for number in range(count):
                other_entity = needed[number]
                value = np.float32(1)
                cosine = np.float32(1)
                if other_entity != entity:
                    cosine = words[number, slot]
                    norm_of_other = lists.norms[other_entity]
                    value = similarity(structure[other_entity], cosine, norm, norm_of_other)
                alike[number, slot] = value * value
                words[number, slot] = fourth(cosine)
            for place in range(slots):
                if table[place] >= 0:
                    value, cosine = alike_of(
                        lists.vectors, lists.norms, entity, table[place], structure
                    )
                    cosines[slot, place] = cosine
                    kernels[slot, place] = value
            for row in range(begin, end):
                value, cosine = alike_of(lists.vectors, lists.norms, entity, goals[row], structure)
                _of_slot(
                    lists,
                    entity,
                    goals[row],
                    cosine,
                    value,
                    alike[:, slot],
                    words[:, slot],
                    places[row - begin],
                    recipes[row - begin],
                    of_slots[row, slot],
                )
            clear(lists, entity, structure)
        known_pairs = _all_neighbour_pairs(lists, table, one, other, starts)
        for pair in range(len(one)):
            a = table[one[pair]]
            b = table[other[pair]]
            if a >= 0 and b >= 0:
                own_places[pair] = pair_place(*hashed, a, b)
                regression[pair] = product(lists.pair_left, lists.right, a, b)
        for row in range(begin, end):
            goal = goals[row]
            goal_made = log1p(lists.num_makers[goal])
            goal_uses = log1p(lists.num_uses[goal])
            support = (lists.support_alike[goal], lists.support_words[goal])
            spread(lists, goal, of_goal)
            # First slot of the pairs whose sums are known; pairs come by their first slot.
            summed = -1
            for pair in range(len(one)):
                i = one[pair]
                j = other[pair]
                a = table[i]
                b = table[j]
                if a < 0 or b < 0:
                    continue
                of_pair = of_pairs[row, pair]
                if i != summed:
                    summed = i
                    _goal_sides(
                        support,
                        i,
                        ranges[i, 0],
                        ranges[i, 1],
                        alike,
                        words,
                        places[row - begin],
                        recipes[row - begin],
                        sums,
                    )
                of_pair[0] = log(FLOOR + sums[0, j])
                of_pair[1] = log(FLOOR + sums[1, j])
                of_pair[2] = log(FLOOR + sums[2, j])
                _pair_side(
                    recipes_of_pairs,
                    lists.vectors,
                    lists.norms,
                    known_pairs,
                    starts[pair],
                    starts[pair + 1],
                    goal,
                    of_goal,
                    row,
                    known_row,
                    known,
                    of_pair,
                )
                place = own_places[pair]
                of_pair[8] = 1 if place >= 0 else 0
                of_pair[9] = 1 if place >= 0 and makes(*recipes_of_pairs, place, goal) else 0
                of_pair[10] = cosines[i, j]
                of_pair[11] = kernels[i, j]
                of_pair[12] = 1 if a == b else 0
                of_pair[13] = goal_made
                of_pair[14] = goal_uses
                of_pair[15] = regression[pair]
            clear(lists, goal, of_goal)


@compiled
def support_terms(lists, a, b, goal, terms):  # type: ignore[no-untyped-def]
    """Write k² of a pair and the pair of each recipe that supports a goal, in both orders.

    Args:
        lists: the lists.
        a: entity id.
        b: entity id.
        goal: entity id.
        terms: shape (R, 2): straight and crossed.
    """
    structure = np.zeros((2, len(lists.norms)), dtype=np.float32)
    spread(lists, a, structure[0])
    spread(lists, b, structure[1])
    squares = np.empty((2, 2), dtype=np.float32)
    for row in range(lists.support.shape[1]):
        recipe = lists.support[goal, row]
        if recipe < 0:
            break
        for part in range(2):
            entity = lists.second[recipe] if part else lists.first[recipe]
            for side in range(2):
                own = b if side else a
                value, _ = alike_of(lists.vectors, lists.norms, own, entity, structure[side])
                squares[side, part] = value * value
        terms[row, 0] = squares[0, 0] * squares[1, 1]
        terms[row, 1] = squares[0, 1] * squares[1, 0]
