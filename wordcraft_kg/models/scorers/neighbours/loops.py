"""Inner loops of lists and features, compiled; see the package for the formulas.

Each function writes to its own arrays only, and visits entries in a fixed order.
"""

from math import log, log1p, sqrt
from typing import Any

import numpy as np

from wordcraft_kg.models.scorers.neighbours.compiled import compiled

# numba reads the types of arguments, so interfaces are untyped: `lists` is a `Lists`, the rest are
# arrays and numbers.
Array = Any

FLOOR = np.float32(1e-4)
"""Added to evidence before the logarithm."""
LEAST = np.float32(2e-3)
"""Products of two similarities below this number are skipped, with all that follow in the lists.

Validation prefers 2e-3 to 3e-5 and to no limit, and it looks at 44 of 1,024 pairs of neighbours.
"""
WORDS_WEIGHT = np.float32(0.2)
"""Weight of squared word cosines in the similarity, ``kernel.TEXT``."""
MOST_RESULTS = 64
"""Results of a neighbour pair that count; a pair with more, in a damaged book, costs no more."""
OF_SLOTS = 14
"""Features of an ingredient and a goal; their sum and minimum over both ingredients count."""
OF_PAIRS = 16
"""Features of a pair and a goal."""
_FAR = 2**31 - 1


# --- lists ----------------------------------------------------------------------------------------


@compiled
def _insert(ids, values, count, new, value):  # type: ignore[no-untyped-def]
    """Insert an entry into a list by descending value, then ascending id; return the new length."""
    size = len(ids)
    if count == size:
        last = values[size - 1]
        if value < last or (value == last and new > ids[size - 1]):
            return count
        place = size - 1
    else:
        place = count
        count += 1
    while place > 0 and (
        values[place - 1] < value or (values[place - 1] == value and ids[place - 1] > new)
    ):
        values[place] = values[place - 1]
        ids[place] = ids[place - 1]
        place -= 1
    values[place] = value
    ids[place] = new
    return count


@compiled
def largest(cosines: Array, start: int, near: Array) -> None:
    """Write each row's largest positive cosines' columns, the row's own left out, into ``near``."""
    rows, size = cosines.shape
    width = near.shape[1]
    if width == 0:
        return
    values = np.empty(width, dtype=np.float32)
    for row in range(rows):
        count = 0
        for column in range(size):
            value = cosines[row, column]
            # Most columns fail this test, which is why a list needs no sort of all columns.
            if value > 0 and column != start + row and (count < width or value > values[count - 1]):
                count = _insert(near[row], values, count, column, value)


@compiled
def structural_neighbours(  # type: ignore[no-untyped-def]
    starts, columns, data, column_starts, column_rows, column_data, common, width
):
    """Return the entities with the most similar profiles, ids ascending, and cosines.

    Profiles come by row and by column (compressed sparse rows of P and of Pᵀ); columns with more
    than ``common`` entries are skipped.
    """
    size = len(starts) - 1
    near = np.full((size, width), _FAR, dtype=np.int32)
    cosines = np.zeros((size, width), dtype=np.float32)
    sums = np.zeros(size, dtype=np.float32)
    touched = np.empty(size, dtype=np.int32)
    ids = np.empty(width, dtype=np.int32)
    values = np.empty(width, dtype=np.float32)
    for entity in range(size):
        number = 0
        for place in range(starts[entity], starts[entity + 1]):
            column = columns[place]
            if column_starts[column + 1] - column_starts[column] > common:
                continue
            for other in range(column_starts[column], column_starts[column + 1]):
                row = column_rows[other]
                if sums[row] == 0:
                    touched[number] = row
                    number += 1
                sums[row] += data[place] * column_data[other]
        count = 0
        for place in range(number):
            row = touched[place]
            if row != entity and (count < width or sums[row] >= values[count - 1]):
                count = _insert(ids, values, count, row, sums[row])
            sums[row] = 0
        order = np.argsort(ids[:count])
        for place in range(count):
            near[entity, place] = ids[order[place]]
            cosines[entity, place] = values[order[place]]
    return near, cosines


@compiled
def _dot(vectors, one, other):  # type: ignore[no-untyped-def]
    total = np.float32(0)
    for place in range(vectors.shape[1]):
        total += vectors[one, place] * vectors[other, place]
    return total


@compiled
def _product(left, right, one, other):  # type: ignore[no-untyped-def]
    total = np.float32(0)
    for place in range(left.shape[1]):
        total += left[one, place] * right[other, place]
    return total


@compiled
def _one_way(near, cosines, one, other):  # type: ignore[no-untyped-def]
    low = 0
    high = near.shape[1]
    while low < high:
        middle = (low + high) >> 1
        if near[one, middle] < other:
            low = middle + 1
        else:
            high = middle
    if low < near.shape[1] and near[one, low] == other:
        return cosines[one, low]
    return np.float32(0)


@compiled
def _kernel(near, cosines, norms, one, other, words):  # type: ignore[no-untyped-def]
    """Return the normalised similarity of two entities with a word cosine."""
    if one == other:
        return np.float32(1)
    structure = _one_way(near, cosines, one, other)
    if structure == 0:
        structure = _one_way(near, cosines, other, one)
    positive = max(words, np.float32(0))
    value = (structure + WORDS_WEIGHT * positive * positive) / sqrt(norms[one] * norms[other])
    return min(np.float32(value), np.float32(1))


@compiled
def _fourth(words):  # type: ignore[no-untyped-def]
    square = words * words if words > 0 else np.float32(0)
    return square * square


@compiled
def merged_neighbours(  # type: ignore[no-untyped-def]
    vectors, near, cosines, norms, near_words, is_allowed, width
):
    """Return each entity's most similar allowed entities by structure and words together.

    Candidates are the entity itself and both kinds of neighbours. Returns ids, squared
    similarities, and word cosines to the power 4; the most similar first.
    """
    size = len(near)
    ids = np.full((size, width), -1, dtype=np.int32)
    alike = np.zeros((size, width), dtype=np.float32)
    words_alike = np.zeros((size, width), dtype=np.float32)
    is_listed = np.zeros(size, dtype=np.bool_)
    values = np.empty(width, dtype=np.float32)
    listed = np.empty(1 + near.shape[1] + near_words.shape[1], dtype=np.int32)
    for entity in range(size):
        number = 1
        listed[0] = entity
        for place in range(near.shape[1]):
            if near[entity, place] == _FAR:
                break
            listed[number] = near[entity, place]
            number += 1
        for place in range(near_words.shape[1]):
            if near_words[entity, place] < 0:
                break
            listed[number] = near_words[entity, place]
            number += 1
        count = 0
        for place in range(number):
            other = listed[place]
            if is_listed[other] or not is_allowed[other]:
                continue
            is_listed[other] = True
            value = _kernel(near, cosines, norms, entity, other, _dot(vectors, entity, other))
            if value > 0:
                count = _insert(ids[entity], values, count, other, value)
        for place in range(number):
            is_listed[listed[place]] = False
        for place in range(count):
            other = ids[entity, place]
            alike[entity, place] = values[place] * values[place]
            is_same = other == entity
            words_alike[entity, place] = 1 if is_same else _fourth(_dot(vectors, entity, other))
    return ids, alike, words_alike


@compiled
def supporting(made, alike, words_alike, starts, by_result, width):  # type: ignore[no-untyped-def]
    """Return the recipes that make a goal's neighbours, with the neighbours' similarities."""
    size = len(made)
    numbers = np.full((size, width), -1, dtype=np.int32)
    of_alike = np.zeros((size, width), dtype=np.float32)
    of_words = np.zeros((size, width), dtype=np.float32)
    for goal in range(size):
        count = 0
        for place in range(made.shape[1]):
            result = made[goal, place]
            if result < 0 or count == width:
                break
            for row in range(
                starts[result], min(starts[result + 1], starts[result] + width - count)
            ):
                numbers[goal, count + row - starts[result]] = by_result[row]
                of_alike[goal, count + row - starts[result]] = alike[goal, place]
                of_words[goal, count + row - starts[result]] = words_alike[goal, place]
            count += min(starts[result + 1] - starts[result], width - count)
    return numbers, of_alike, of_words


# --- hash tables ----------------------------------------------------------------------------------


@compiled
def _place(keys, key):  # type: ignore[no-untyped-def]
    """Return the place of a key in an open hash table, or of the empty place where it belongs."""
    mask = len(keys) - 1
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    place = np.int64((mixed ^ (mixed >> np.uint64(29))) & np.uint64(mask))
    while keys[place] != -1 and keys[place] != key:
        place = (place + 1) & mask
    return place


@compiled
def pair_table(pairs: Array, size: int):  # type: ignore[no-untyped-def]
    """Return a hash table of ascending pair keys: keys, first recipe, number of recipes."""
    keys = np.full(size, -1, dtype=np.int64)
    starts = np.zeros(size, dtype=np.int32)
    counts = np.zeros(size, dtype=np.int32)
    for row in range(len(pairs)):
        place = _place(keys, pairs[row])
        if keys[place] == -1:
            keys[place] = pairs[row]
            starts[place] = row
        counts[place] += 1
    return keys, starts, counts


@compiled
def count_table(links: Array, size: int):  # type: ignore[no-untyped-def]
    """Return a hash table of keys and their number."""
    keys = np.full(size, -1, dtype=np.int64)
    counts = np.zeros(size, dtype=np.int32)
    for row in range(len(links)):
        place = _place(keys, links[row])
        keys[place] = links[row]
        counts[place] += 1
    return keys, counts


@compiled
def _pair(lists, a, b):  # type: ignore[no-untyped-def]
    """Return the place of a pair in the hash table, -1 if no recipe uses it."""
    low = min(a, b)
    high = max(a, b)
    place = _place(lists.pair_keys, np.int64(low) * len(lists.norms) + high)
    return place if lists.pair_keys[place] != -1 else -1


@compiled
def _links(lists, ingredient, result):  # type: ignore[no-untyped-def]
    """Return the number of recipes that use an ingredient and make a result."""
    place = _place(lists.link_keys, np.int64(ingredient) * len(lists.norms) + result)
    return lists.link_counts[place]


@compiled
def _makes(lists, place, goal):  # type: ignore[no-untyped-def]
    """Return whether a pair, by its place, makes the goal: its results are ascending."""
    low = lists.pair_starts[place]
    end = low + lists.pair_counts[place]
    high = end
    while low < high:
        middle = (low + high) >> 1
        if lists.result[middle] < goal:
            low = middle + 1
        else:
            high = middle
    return low < end and lists.result[low] == goal


# --- features -------------------------------------------------------------------------------------


@compiled
def _alike(lists, one, other, words):  # type: ignore[no-untyped-def]
    return _kernel(lists.near, lists.near_cosines, lists.norms, one, other, words)


@compiled
def _cosine(lists, one, other):  # type: ignore[no-untyped-def]
    return np.float32(1) if one == other else _dot(lists.vectors, one, other)


@compiled
def _of_slot(lists, entity, goal, out, alike, words_alike):  # type: ignore[no-untyped-def]
    """Write the features of an ingredient and a goal, and its likeness to supporting recipes."""
    total = np.float32(0)
    best = np.float32(0)
    by_words = np.float32(0)
    for row in range(lists.support.shape[1]):
        recipe = lists.support[goal, row]
        if recipe < 0:
            break
        of_goal = lists.support_alike[goal, row]
        for part in range(2):
            other = lists.second[recipe] if part else lists.first[recipe]
            words = _cosine(lists, entity, other)
            value = _alike(lists, entity, other, words)
            value *= value
            fourth = _fourth(words)
            alike[row, part] = value
            words_alike[row, part] = fourth
            total += of_goal * value
            by_words += lists.support_words[goal, row] * fourth
            best = max(best, of_goal * value)
    words = _cosine(lists, entity, goal)
    out[0] = log(FLOOR + total)
    out[1] = log(FLOOR + best)
    out[2] = log(FLOOR + by_words)
    out[3] = words
    out[4] = _alike(lists, entity, goal, words)
    out[5] = log1p(lists.num_uses[entity])
    out[6] = log1p(lists.num_makers[entity])
    out[7] = log1p(_links(lists, entity, goal))
    soft = np.float32(0)
    soft_words = np.float32(0)
    exact = np.float32(0)
    with_goal = np.float32(0)
    reverse = np.float32(0)
    for column in range(lists.made.shape[1]):
        result = lists.made[goal, column]
        if result < 0:
            break
        exact += lists.made_alike[goal, column] * _links(lists, entity, result)
    for row in range(lists.used.shape[1]):
        other = lists.used[entity, row]
        if other < 0:
            break
        if _pair(lists, goal, other) >= 0:
            with_goal += lists.used_alike[entity, row]
        for column in range(lists.made.shape[1]):
            result = lists.made[goal, column]
            weight = lists.used_alike[entity, row] * lists.made_alike[goal, column]
            if result < 0 or weight < LEAST:
                break
            number = _links(lists, other, result)
            if number:
                soft += number * weight
                soft_words += (
                    number * lists.used_words[entity, row] * lists.made_words[goal, column]
                )
    for column in range(lists.made.shape[1]):
        result = lists.made[entity, column]
        if result < 0:
            break
        reverse += lists.made_alike[entity, column] * _links(lists, goal, result)
    out[8] = log(FLOOR + soft)
    out[9] = log(FLOOR + exact)
    out[10] = log(FLOOR + soft_words)
    out[11] = log(FLOOR + reverse)
    out[12] = log(FLOOR + with_goal)
    out[13] = _product(lists.left, lists.right, entity, goal)


@compiled
def _of_pair(lists, a, b, goal, alike, other_alike, words, other_words, out):  # type: ignore[no-untyped-def]
    """Write the features of a pair and a goal; the arrays hold likeness to supporting recipes."""
    evidence = np.float32(0)
    by_words = np.float32(0)
    best = np.float32(0)
    for row in range(lists.support.shape[1]):
        if lists.support[goal, row] < 0:
            break
        straight = alike[row, 0] * other_alike[row, 1]
        crossed = alike[row, 1] * other_alike[row, 0]
        of_goal = lists.support_alike[goal, row]
        evidence += of_goal * (straight + crossed)
        best = max(best, of_goal * max(straight, crossed))
        by_words += lists.support_words[goal, row] * (
            words[row, 0] * other_words[row, 1] + words[row, 1] * other_words[row, 0]
        )
    anything = np.float32(0)
    makes = np.float32(0)
    nearest = np.float32(0)
    anything_words = np.float32(0)
    makes_words = np.float32(0)
    for row in range(lists.used.shape[1]):
        one = lists.used[a, row]
        if one < 0:
            break
        for column in range(lists.used.shape[1]):
            other = lists.used[b, column]
            weight = lists.used_alike[a, row] * lists.used_alike[b, column]
            if other < 0 or weight < LEAST:
                break
            place = _pair(lists, one, other)
            if place < 0:
                continue
            weight_words = lists.used_words[a, row] * lists.used_words[b, column]
            start = lists.pair_starts[place]
            for recipe in range(start, start + min(lists.pair_counts[place], MOST_RESULTS)):
                result = lists.result[recipe]
                cosine = _cosine(lists, result, goal)
                value = _alike(lists, result, goal, cosine)
                value *= value
                anything += weight
                makes += weight * value
                nearest = max(nearest, weight * value)
                anything_words += weight_words
                makes_words += weight_words * _fourth(cosine)
    place = _pair(lists, a, b)
    cosine = _cosine(lists, a, b)
    out[0] = log(FLOOR + evidence)
    out[1] = log(FLOOR + by_words)
    out[2] = log(FLOOR + best)
    out[3] = log(FLOOR + anything)
    out[4] = log(FLOOR + makes)
    out[5] = log(FLOOR + nearest)
    out[6] = log(FLOOR + anything_words)
    out[7] = log(FLOOR + makes_words)
    out[8] = 1 if place >= 0 else 0
    out[9] = 1 if place >= 0 and _makes(lists, place, goal) else 0
    out[10] = cosine
    out[11] = _alike(lists, a, b, cosine)
    out[12] = 1 if a == b else 0
    out[13] = log1p(lists.num_makers[goal])
    out[14] = log1p(lists.num_uses[goal])
    out[15] = _product(lists.pair_left, lists.right, a, b)


@compiled
def table_features(  # type: ignore[no-untyped-def]
    lists, goals, tables, one, other, out
):
    """Write the features of pairs of slots.

    Args:
        lists: the lists.
        goals: shape (B,); negative for no goal.
        tables: shape (B, A); negative for empty slots.
        one: first slot of each pair, shape (P,).
        other: second slot of each pair, shape (P,).
        out: zeros, shape (B, P, F); a pair with an empty slot, or without goal, keeps its zeros.
    """
    slots = tables.shape[1]
    width = lists.support.shape[1]
    alike = np.empty((slots, width, 2), dtype=np.float32)
    words = np.empty((slots, width, 2), dtype=np.float32)
    of_slots = np.empty((slots, OF_SLOTS), dtype=np.float32)
    for row in range(len(goals)):
        goal = goals[row]
        if goal < 0:
            continue
        for slot in range(slots):
            if tables[row, slot] >= 0:
                _of_slot(lists, tables[row, slot], goal, of_slots[slot], alike[slot], words[slot])
        for pair in range(len(one)):
            i = one[pair]
            j = other[pair]
            a = tables[row, i]
            b = tables[row, j]
            if a < 0 or b < 0:
                continue
            features = out[row, pair]
            for number in range(OF_SLOTS):
                features[number] = of_slots[i, number] + of_slots[j, number]
                features[OF_SLOTS + number] = min(of_slots[i, number], of_slots[j, number])
            _of_pair(
                lists, a, b, goal, alike[i], alike[j], words[i], words[j], features[2 * OF_SLOTS :]
            )


# --- evidence and candidates ----------------------------------------------------------------------


@compiled
def support_terms(lists, a, b, goal, terms):  # type: ignore[no-untyped-def]
    """Write similarities of a goal's supporting recipes, (R, 2): straight and crossed."""
    for row in range(lists.support.shape[1]):
        recipe = lists.support[goal, row]
        if recipe < 0:
            break
        first = lists.first[recipe]
        second = lists.second[recipe]
        a_first = _alike(lists, a, first, _cosine(lists, a, first)) ** 2
        a_second = _alike(lists, a, second, _cosine(lists, a, second)) ** 2
        b_first = _alike(lists, b, first, _cosine(lists, b, first)) ** 2
        b_second = _alike(lists, b, second, _cosine(lists, b, second)) ** 2
        terms[row, 0] = a_first * b_second
        terms[row, 1] = a_second * b_first


_LATER = np.float32(0.05)
"""Weight of entities that only a further attempt can make."""
_FIRST = np.float32(1e6)
"""Weight of known results: they come before all others."""


@compiled
def _add_results(lists, a, b, factor, weights):  # type: ignore[no-untyped-def]
    """Add the results of a pair's neighbours to the weights of entities."""
    for row in range(lists.used.shape[1]):
        one = lists.used[a, row]
        if one < 0:
            break
        for column in range(lists.used.shape[1]):
            other = lists.used[b, column]
            weight = lists.used_alike[a, row] * lists.used_alike[b, column]
            if other < 0 or weight < LEAST:
                break
            place = _pair(lists, one, other)
            if place < 0:
                continue
            if factor == 1 and one == a and other == b:
                weight = _FIRST
            start = lists.pair_starts[place]
            for recipe in range(start, start + min(lists.pair_counts[place], MOST_RESULTS)):
                weights[lists.result[recipe]] += factor * weight


@compiled
def _add_needs(lists, goal, factor, weights):  # type: ignore[no-untyped-def]
    """Add entities similar to the ingredients of a goal's supporting recipes to the weights."""
    for row in range(lists.support.shape[1]):
        recipe = lists.support[goal, row]
        if recipe < 0:
            break
        for part in range(2):
            needed = lists.second[recipe] if part else lists.first[recipe]
            for column in range(lists.made.shape[1]):
                other = lists.made[needed, column]
                if other < 0:
                    break
                weight = lists.support_alike[goal, row] * lists.made_alike[needed, column]
                weights[other] += factor * weight


@compiled
def _best(weights, ids, values):  # type: ignore[no-untyped-def]
    """Write the entities with the largest positive weights; return their number."""
    count = 0
    for entity in range(len(weights)):
        value = weights[entity]
        if value > 0 and (count < len(ids) or value > values[count - 1]):
            count = _insert(ids, values, count, entity, value)
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
    width = out.shape[1]
    best_values = np.empty(width, dtype=np.float32)
    for row in range(len(goals)):
        goal = goals[row]
        table = tables[row]
        makes = np.zeros(size, dtype=np.float32)
        needs = np.zeros(size, dtype=np.float32)
        for i in range(len(table)):
            for j in range(i, len(table)):
                if table[i] >= 0 and table[j] >= 0:
                    _add_results(lists, table[i], table[j], np.float32(1), makes)
        _add_needs(lists, goal, np.float32(1), needs)
        for _ in range(further):
            for place in range(_best(makes, ids, values)):
                for slot in range(len(table)):
                    if table[slot] >= 0:
                        _add_results(lists, ids[place], table[slot], _LATER, makes)
            for place in range(_best(needs, ids, values)):
                _add_needs(lists, ids[place], _LATER, needs)
        for slot in range(len(table)):
            if table[slot] >= 0:
                makes[table[slot]] = -1
        makes[goal] = -1
        for entity in range(size):
            if makes[entity] >= 0 and (makes[entity] > 0 or needs[entity] > 0):
                makes[entity] = (makes[entity] + FLOOR) * (needs[entity] + FLOOR)
            else:
                makes[entity] = 0
        count = _best(makes, out[row], best_values)
        for place in range(count, width):
            out[row, place] = -1
