"""Loops that compute the features of pairs on tables; see the package for the formulas.

A table has one goal, so what depends on the goal and a slot is computed once for all pairs, and
what depends on the goal and a result once for all pairs that may make it. See "Recipes by similar
recipes" in docs/explanation/recipe-scorer.md.
"""

from math import log, log1p, sqrt

import numpy as np

from wordcraft_kg.models.scorers.neighbours.compiled import compiled, in_place
from wordcraft_kg.models.scorers.neighbours.hash_loops import makes, num_links, pair_place
from wordcraft_kg.models.scorers.neighbours.regression import PRODUCT
from wordcraft_kg.models.scorers.neighbours.similar import alike_of, fourth, product

FLOOR = np.float32(1e-4)
"""Added to evidence before the logarithm."""
LEAST = np.float32(2e-3)
"""Products of two similarities below this number are skipped, with all that follow in the lists.

Validation prefers 2e-3 to 3e-5 and to no limit, and it looks at 44 of 1,024 pairs of neighbours.
"""
SHORTEST = np.float32(1e-6)
"""Shortest vector with a direction."""
MOST_RESULTS = 64
"""Results of a neighbour pair that count; a pair with more, in a damaged book, costs no more."""
NUM_LINKS = 13
"""Features of a link that count for a slot: all but the goal's own numbers of recipes."""
COUNT = 13
"""Place of ``count``, after them, in the order of ``pair_features.OF_SLOTS``."""
OF_SLOTS = 15
"""Features of a slot and a goal: the last one is a score of the link ranker."""
# Places in the order of `links.OF_COMPONENTS`.
(
    _WORDS,
    _KERNEL,
    _USES,
    _MADE,
    _LINK,
    _LINK_WORDS,
    _LINK_REVERSE,
    _LINK_WITH_GOAL,
    _COMBINES,
    _PARTNERS,
    _STEPS,
    _REGRESSION,
    _WORD_REGRESSION,
    _LINK_GOAL_USES,
    _LINK_GOAL_MADE,
) = range(NUM_LINKS + 2)
# In the order of `pair_features.OF_PAIRS`, behind the sums and minima of slots.
(
    _MAKES_ANYTHING,
    _MAKES_ALIKE,
    _MAKES_ANYTHING_WORDS,
    _MAKES_ALIKE_WORDS,
    _KNOWN,
    _MAKES,
    _PAIR_WORDS,
    _PAIR_KERNEL,
    _ITSELF,
    _GOAL_MADE,
    _GOAL_USES,
    _PAIR_REGRESSION,
    _PAIR_WORD_REGRESSION,
    _RESULT_REGRESSION,
) = range(2 * OF_SLOTS, 2 * OF_SLOTS + 14)


@in_place
def neighbour_pairs(used, pairs, a, b, begin, known_pairs):  # type: ignore[no-untyped-def]
    """Find the known pairs of neighbours of a and of b, the most similar neighbours first.

    Args:
        used: ``lists.used``.
        pairs: ``lists.pairs``.
        a: entity id.
        b: entity id.
        begin: where to begin in the following arrays.
        known_pairs: receives places in the hash table of pairs, weights k²(a, a') k²(b, b'), and
            the same by words; from :func:`room_for_pairs`.

    Returns:
        the end of the pairs, and the place of a + b itself, -1 if it is not known.
    """
    places, weights, words = known_pairs
    count = begin
    # Not a plain -1, which has a type of its own.
    itself = np.int64(-1)
    for row in range(used.ids.shape[1]):
        first_neighbour = used.ids[a, row]
        # Neighbours come by descending similarity: with the nearest one of b too small, all are.
        if first_neighbour < 0 or used.alike[a, row] * used.alike[b, 0] < LEAST:
            break
        for column in range(used.ids.shape[1]):
            second_neighbour = used.ids[b, column]
            weight = used.alike[a, row] * used.alike[b, column]
            if second_neighbour < 0 or weight < LEAST:
                break
            # By a or b itself, whose signature is in the fast cache.
            place = (
                pair_place(pairs, first_neighbour, second_neighbour)
                if row == 0
                else pair_place(pairs, second_neighbour, first_neighbour)
            )
            if place < 0:
                continue
            if first_neighbour == a and second_neighbour == b:
                itself = count
            places[count] = place
            weights[count] = weight
            words[count] = used.words[a, row] * used.words[b, column]
            count += 1
    return count, itself


@compiled
def room_for_pairs(lists, number):  # type: ignore[no-untyped-def]
    """Return work space for the known pairs of neighbours of a number of pairs.

    Room for more pairs than there are costs nothing: memory that nobody writes to is not taken.
    """
    size = number * lists.used.ids.shape[1] ** 2
    weights = np.empty(size, dtype=np.float32)
    return np.empty(size, dtype=np.int64), weights, np.empty_like(weights)


@in_place
def links_to_results(lists, goal, entry_of, entries, counts):  # type: ignore[no-untyped-def]
    """List the known links to a goal's neighbours by their ingredient.

    All slots of a table share the goal, so they share these lists.

    Args:
        lists: the lists.
        goal: entity id.
        entry_of: receives each ingredient's first entry, -1 without links; shape (T,), -1 before.
        entries: receives the neighbour's place in ``lists.made`` and the next entry of the same
            ingredient, -1 at the end: shape (L, 2), places ascending.
        counts: receives the number of recipes with the link, shape (L,).
    """
    end = np.int64(0)
    places = lists.made.ids.shape[1]
    # From the last neighbour to the first, so that an ingredient's list begins with the first.
    for column in range(places - 1, -1, -1):
        result = lists.made.ids[goal, column]
        if result < 0:
            continue
        for place in range(lists.parts.starts[result], lists.parts.starts[result + 1]):
            part = lists.parts.columns[place]
            entries[end, 0] = column
            entries[end, 1] = entry_of[part]
            counts[end] = lists.parts.values[place]
            entry_of[part] = end
            end += 1


@in_place
def forget_links(lists, goal, entry_of):  # type: ignore[no-untyped-def]
    """Write -1 again where :func:`links_to_results` wrote first entries.

    Args:
        lists: the lists.
        goal: entity id.
        entry_of: shape (T,).
    """
    for column in range(lists.made.ids.shape[1]):
        result = lists.made.ids[goal, column]
        if result < 0:
            break
        for place in range(lists.parts.starts[result], lists.parts.starts[result + 1]):
            entry_of[lists.parts.columns[place]] = -1


@in_place
def links_of_slots(lists, to_results, goal, table, cosines, kernels, out):  # type: ignore[no-untyped-def]
    """Write the features of componentOf links, in the order of ``links.OF_COMPONENTS``.

    Args:
        lists: the lists.
        to_results: the arrays of :func:`links_to_results` for the goal.
        goal: the result.
        table: the ingredients, shape (A,); negative for empty slots.
        cosines: word cosines of slots and goal, shape (A,).
        kernels: their similarities k, shape (A,).
        out: shape (A, 15).
    """
    kernel = lists.by_kernel
    word = lists.by_words
    entry_of, entries, counts = to_results
    links = (lists.result_bits, lists.parts)
    for slot in range(len(table)):
        entity = table[slot]
        if entity < 0:
            continue
        soft = np.float32(0)
        soft_words = np.float32(0)
        with_goal = np.float32(0)
        for row in range(lists.used.ids.shape[1]):
            neighbour = lists.used.ids[entity, row]
            if neighbour < 0:
                break
            neighbour_weight = lists.used.alike[entity, row]
            if pair_place(lists.pairs, goal, neighbour) >= 0:
                with_goal += neighbour_weight
            entry = entry_of[neighbour]
            while entry >= 0:
                column = entries[entry, 0]
                weight = neighbour_weight * lists.made.alike[goal, column]
                # Neighbours come by descending similarity, so all that follow are below, too.
                if weight < LEAST:
                    break
                number = counts[entry]
                word_weight = lists.used.words[entity, row] * lists.made.words[goal, column]
                soft += number * weight
                soft_words += number * word_weight
                entry = entries[entry, 1]
        reverse = np.float32(0)
        for column in range(lists.made.ids.shape[1]):
            result = lists.made.ids[entity, column]
            if result < 0:
                break
            reverse += lists.made.alike[entity, column] * num_links(*links, goal, result)
        partners = 0
        steps = 0
        for place in range(lists.parts.starts[goal], lists.parts.starts[goal + 1]):
            part = lists.parts.columns[place]
            if pair_place(lists.pairs, entity, part) >= 0:
                partners += 1
            if num_links(*links, entity, part) > 0:
                steps += 1
        out[slot, _WORDS] = cosines[slot]
        out[slot, _KERNEL] = kernels[slot]
        out[slot, _USES] = log1p(lists.num_uses[entity])
        out[slot, _MADE] = log1p(lists.num_makers[entity])
        out[slot, _LINK] = log(FLOOR + soft)
        out[slot, _LINK_WORDS] = log(FLOOR + soft_words)
        out[slot, _LINK_REVERSE] = log(FLOOR + reverse)
        out[slot, _LINK_WITH_GOAL] = log(FLOOR + with_goal)
        out[slot, _COMBINES] = 1 if pair_place(lists.pairs, entity, goal) >= 0 else 0
        out[slot, _PARTNERS] = log1p(partners)
        out[slot, _STEPS] = log1p(steps)
        out[slot, _REGRESSION] = product(kernel.left, kernel.right, entity, goal)
        out[slot, _WORD_REGRESSION] = product(word.left, word.right, entity, goal)
        out[slot, _LINK_GOAL_USES] = log1p(lists.num_uses[goal])
        out[slot, _LINK_GOAL_MADE] = log1p(lists.num_makers[goal])


@in_place
def _write_neighbour_features(  # type: ignore[no-untyped-def]
    out,
    pairs,
    known_pairs,
    first,
    last,
    result_weights,
    result_words,
):
    """Write ``makes_anything`` to ``makes_alike_words``: from known pairs of neighbours.

    Args:
        out: shape (F,).
        pairs: ``lists.pairs``.
        known_pairs: from :func:`neighbour_pairs`.
        first: number of the first known pair.
        last: end of the known pairs.
        result_weights: k² of each result and the goal, shape (T,).
        result_words: the same by words.
    """
    places, weights, words = known_pairs
    anything = np.float32(0)
    alike = np.float32(0)
    anything_words = np.float32(0)
    alike_words = np.float32(0)
    for number in range(first, last):
        place = places[number]
        weight = weights[number]
        weight_by_words = words[number]
        start = pairs.starts[place]
        results = min(pairs.counts[place], MOST_RESULTS)
        anything += results * weight
        anything_words += results * weight_by_words
        for recipe in range(start, start + results):
            result = pairs.results[recipe]
            alike += weight * result_weights[result]
            alike_words += weight_by_words * result_words[result]
    out[_MAKES_ANYTHING] = log(FLOOR + anything)
    out[_MAKES_ALIKE] = log(FLOOR + alike)
    out[_MAKES_ANYTHING_WORDS] = log(FLOOR + anything_words)
    out[_MAKES_ALIKE_WORDS] = log(FLOOR + alike_words)


@in_place
def _all_neighbour_pairs(lists, table, first_slots, second_slots, starts, known_pairs):  # type: ignore[no-untyped-def]
    """Find the known pairs of neighbours of all pairs of slots.

    Args:
        lists: the lists.
        table: shape (A,); negative for empty slots.
        first_slots: first slot of each pair, shape (P,).
        second_slots: second slot of each pair, shape (P,).
        starts: receives where each pair's begin, and the end, shape (P + 1,).
        known_pairs: as in :func:`neighbour_pairs`.
    """
    end = np.int64(0)
    for pair in range(len(first_slots)):
        starts[pair] = end
        a = table[first_slots[pair]]
        b = table[second_slots[pair]]
        if a < 0 or b < 0:
            continue
        end, _ = neighbour_pairs(lists.used, lists.pairs, a, b, end, known_pairs)
    starts[len(first_slots)] = end


@compiled
def _different_results(pairs, places, is_listed):  # type: ignore[no-untyped-def]
    """Return the results of known pairs, each once.

    Args:
        pairs: ``lists.pairs``.
        places: places of the pairs in the hash table.
        is_listed: work space, shape (T,): False before and after.
    """
    # Room for all entities: memory that nobody writes to is not taken.
    results = np.empty(len(is_listed), dtype=np.int32)
    count = 0
    for number in range(len(places)):
        start = pairs.starts[places[number]]
        end = start + min(pairs.counts[places[number]], MOST_RESULTS)
        for recipe in range(start, end):
            result = pairs.results[recipe]
            if not is_listed[result]:
                is_listed[result] = True
                results[count] = result
                count += 1
    results = results[:count]
    for result in results:
        is_listed[result] = False
    return results


@in_place
def _end_of_table(goals, tables, start):  # type: ignore[no-untyped-def]
    """Return the first row after ``start`` with another table, or without a goal."""
    end = start + 1
    while end < len(goals) and goals[end] >= 0:
        for slot in range(tables.shape[1]):
            if tables[end, slot] != tables[start, slot]:
                return end
        end += 1
    return end


@in_place
def _write_slot_features(links, counts, i, j, out):  # type: ignore[no-untyped-def]
    """Write the sums and minima of two slots' features, but for the score of the link ranker.

    Args:
        links: features of the slots' links to the goal, shape (A, 13) or wider.
        counts: logarithms of the slots' recipes that make the goal, shape (A,).
        i: first slot.
        j: second slot.
        out: shape (F,).
    """
    for place in range(NUM_LINKS):
        out[place] = links[i, place] + links[j, place]
        out[OF_SLOTS + place] = min(links[i, place], links[j, place])
    out[COUNT] = counts[i] + counts[j]
    out[OF_SLOTS + COUNT] = min(counts[i], counts[j])


@in_place
def _expect_result(coordinates, weights, a, b, pair, expected):  # type: ignore[no-untyped-def]
    """Write the direction of the words that regression expects of a pair's result.

    Args:
        coordinates: by words, shape (T, m), of which the first r count.
        weights: ``lists.result_weights``, shape (2 r, r).
        a: entity id.
        b: entity id.
        pair: row of ``expected``.
        expected: receives a vector of length 1, or zeros without words; shape (P, r).
    """
    size = weights.shape[1]
    expected[pair] = 0
    for row in range(size):
        total = coordinates[a, row] + coordinates[b, row]
        scaled_product = PRODUCT * coordinates[a, row] * coordinates[b, row]
        for column in range(size):
            expected[pair, column] += total * weights[row, column]
            expected[pair, column] += scaled_product * weights[size + row, column]
    length = sqrt(product(expected, expected, pair, pair))
    for column in range(size):
        expected[pair, column] /= max(length, SHORTEST)


@in_place
def _write_pair_features(lists, goal, table, slot_pairs, slots, neighbours, results, values, out):  # type: ignore[no-untyped-def]
    """Write the features of a table's pairs and a goal.

    Args:
        lists: the lists.
        goal: entity id.
        table: shape (A,); negative for empty slots.
        slot_pairs: first and second slot of each pair, shape (P,) each.
        slots: features of the slots' links to the goal, shape (A, 15), and logarithms of their
            recipes that make it, shape (A,).
        neighbours: where the known pairs of neighbours of each pair begin, and these, from
            :func:`_all_neighbour_pairs`.
        results: k² of each result of these and the goal, and the same by words, shape (T,).
        values: features of the pairs alone: places in the hash table and both regressions,
            shape (P,); expected words of results, shape (P, r); word cosines and similarities of
            slots, shape (A, A).
        out: shape (P, F).
    """
    first_slots, second_slots = slot_pairs
    links, counts = slots
    starts, known_pairs = neighbours
    own_places, regression, word_regression, expected, cosines, kernels = values
    goal_made = log1p(lists.num_makers[goal])
    goal_uses = log1p(lists.num_uses[goal])
    for pair in range(len(first_slots)):
        i = first_slots[pair]
        j = second_slots[pair]
        if table[i] < 0 or table[j] < 0:
            continue
        features = out[pair]
        _write_slot_features(links, counts, i, j, features)
        ends = (starts[pair], starts[pair + 1])
        _write_neighbour_features(features, lists.pairs, known_pairs, *ends, *results)
        place = own_places[pair]
        is_made = place >= 0 and makes(lists.pairs, place, goal)
        features[_KNOWN] = 1 if place >= 0 else 0
        features[_MAKES] = 1 if is_made else 0
        features[_PAIR_WORDS] = cosines[i, j]
        features[_PAIR_KERNEL] = kernels[i, j]
        features[_ITSELF] = 1 if table[i] == table[j] else 0
        features[_GOAL_MADE] = goal_made
        features[_GOAL_USES] = goal_uses
        features[_PAIR_REGRESSION] = regression[pair]
        features[_PAIR_WORD_REGRESSION] = word_regression[pair]
        features[_RESULT_REGRESSION] = product(expected, lists.by_words.right, pair, goal)


@compiled
def table_features(lists, goals, tables, one, other, links, out):  # type: ignore[no-untyped-def]
    """Write the features of pairs of slots, but for scores of link rankers.

    What depends on the table alone is computed once for rows with the same table that follow each
    other: a planner asks for many results of one table.

    Args:
        lists: the lists.
        goals: shape (B,); negative for no goal.
        tables: shape (B, A); negative for empty slots.
        one: first slot of each pair, shape (P,).
        other: second slot of each pair, shape (P,).
        links: features of the slots' links to the goals, shape (B, A, 15).
        out: zeros, shape (B, P, F); a pair with an empty slot, or without goal, keeps its zeros.
    """
    size = len(lists.norms)
    slots = tables.shape[1]
    # Work space, made once for the batch.
    structure = np.zeros(size, dtype=np.float32)
    is_listed = np.zeros(size, dtype=np.bool_)
    alike = np.empty(size, dtype=np.float32)
    words = np.empty(size, dtype=np.float32)
    cosines = np.empty((slots, slots), dtype=np.float32)
    kernels = np.empty((slots, slots), dtype=np.float32)
    counts = np.empty(slots, dtype=np.float32)
    starts = np.empty(len(one) + 1, dtype=np.int64)
    own_places = np.empty(len(one), dtype=np.int64)
    regression = np.empty(len(one), dtype=np.float32)
    word_regression = np.empty(len(one), dtype=np.float32)
    expected = np.empty((len(one), lists.result_weights.shape[1]), dtype=np.float32)
    kernel = lists.by_kernel
    word = lists.by_words
    known_pairs = room_for_pairs(lists, len(one))
    end = np.int64(0)
    while end < len(goals):
        begin = end
        if goals[begin] < 0:
            end += 1
            continue
        end = _end_of_table(goals, tables, begin)
        table = tables[begin]
        for slot in range(slots):
            if table[slot] >= 0:
                alike_of(lists, table[slot], table, structure, kernels[slot], cosines[slot])
        _all_neighbour_pairs(lists, table, one, other, starts, known_pairs)
        results = _different_results(lists.pairs, known_pairs[0][: starts[-1]], is_listed)
        result_kernels = np.empty(len(results), dtype=np.float32)
        result_cosines = np.empty(len(results), dtype=np.float32)
        for pair in range(len(one)):
            a = table[one[pair]]
            b = table[other[pair]]
            if a >= 0 and b >= 0:
                own_places[pair] = pair_place(lists.pairs, a, b)
                regression[pair] = product(kernel.pair_left, kernel.right, a, b)
                word_regression[pair] = product(word.pair_left, word.right, a, b)
                _expect_result(word.right, lists.result_weights, a, b, pair, expected)
        for row in range(begin, end):
            goal = goals[row]
            alike_of(lists, goal, results, structure, result_kernels, result_cosines)
            for number in range(len(results)):
                result = results[number]
                alike[result] = result_kernels[number] * result_kernels[number]
                words[result] = fourth(result_cosines[number])
            for slot in range(slots):
                counts[slot] = 0
                if table[slot] >= 0:
                    number = num_links(lists.result_bits, lists.parts, table[slot], goal)
                    counts[slot] = log1p(number)
            _write_pair_features(
                lists,
                goal,
                table,
                (one, other),
                (links[row], counts),
                (starts, known_pairs),
                (alike, words),
                (own_places, regression, word_regression, expected, cosines, kernels),
                out[row],
            )
