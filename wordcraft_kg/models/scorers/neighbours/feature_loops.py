"""Loops that compute the features of pairs on tables; see the package for the formulas.

A table has one goal, so what depends on the goal and a slot is computed once for all pairs, and
what depends on the goal and a result once for all pairs that may make it.
"""

from math import log, log1p
from typing import Any

import numpy as np

from wordcraft_kg.models.scorers.neighbours.compiled import compiled, in_place
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
# Their places, in the order of `pair_features.OF_SLOTS`: of links first.
(
    _WORDS,
    _KERNEL,
    _USES,
    _MADE,
    _LINK,
    _LINK_WORDS,
    _LINK_EXACT,
    _LINK_TO_GOAL,
    _LINK_REVERSE,
    _LINK_WITH_GOAL,
    _COMBINES,
    _REGRESSION,
    _COUNT,
    _EVIDENCE,
    _BEST_EVIDENCE,
    _WORDS_EVIDENCE,
) = range(OF_SLOTS)
# In the order of `pair_features.OF_PAIRS`.
(
    _PAIR_EVIDENCE,
    _PAIR_WORDS_EVIDENCE,
    _PAIR_BEST_EVIDENCE,
    _MAKES_ANYTHING,
    _MAKES_ALIKE,
    _MAKES_BEST,
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
) = range(OF_PAIRS)


@in_place
def neighbour_pairs(  # type: ignore[no-untyped-def]
    used, used_alike, used_words, partner_bits, pair_keys, a, b, begin, places, weights, words
):
    """Find the known pairs of neighbours of a and of b, the most similar neighbours first.

    Args:
        used: ``lists.used``.
        used_alike: ``lists.used_alike``.
        used_words: ``lists.used_words``.
        partner_bits: ``lists.partner_bits``.
        pair_keys: ``lists.pair_keys``.
        a: entity id.
        b: entity id.
        begin: where to begin in the following arrays, which have room for all pairs of neighbours.
        places: receives places in the hash table of pairs.
        weights: receives k²(a, a') k²(b, b').
        words: receives the same by words.

    Returns:
        the end of the pairs, and the place of a + b itself, -1 if it is not known.
    """
    count = begin
    # Not a plain -1, which has a type of its own.
    itself = np.int64(-1)
    for row in range(used.shape[1]):
        one = used[a, row]
        if one < 0:
            break
        for column in range(used.shape[1]):
            other = used[b, column]
            weight = used_alike[a, row] * used_alike[b, column]
            if other < 0 or weight < LEAST:
                break
            # By a or b itself, whose signature is in the fast cache.
            place = (
                pair_place(partner_bits, pair_keys, one, other)
                if row == 0
                else pair_place(partner_bits, pair_keys, other, one)
            )
            if place < 0:
                continue
            if one == a and other == b:
                itself = count
            places[count] = place
            weights[count] = weight
            words[count] = used_words[a, row] * used_words[b, column]
            count += 1
    return count, itself


@in_place
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


@in_place
def alike_of(  # type: ignore[no-untyped-def]
    vectors, norms, all_kernels, all_cosines, entity, others, structure, kernels, cosines
):
    """Write the similarities k and word cosines of an entity and others.

    Args:
        vectors: ``lists.vectors``.
        norms: ``lists.norms``.
        all_kernels: ``lists.kernels``.
        all_cosines: ``lists.cosines``.
        entity: entity id.
        others: entity ids, shape (n,); negative for none.
        structure: the entity's profile cosines, from ``spread``.
        kernels: receives the similarities, shape (n,); 0 for none.
        cosines: receives the word cosines, likewise.
    """
    # The branch is outside of the loop: within, numba would count references for each entity.
    if len(all_kernels) > 0:
        for number in range(len(others)):
            other = others[number]
            kernels[number] = all_kernels[entity, other] if other >= 0 else 0
            cosines[number] = all_cosines[entity, other] if other >= 0 else 0
        return
    for number in range(len(others)):
        other = others[number]
        kernel = np.float32(0)
        cosine = np.float32(0)
        if other == entity:
            kernel = np.float32(1)
            cosine = np.float32(1)
        elif other >= 0:
            cosine = dot(vectors, entity, other)
            kernel = similarity(structure[other], cosine, norms[entity], norms[other])
        kernels[number] = kernel
        cosines[number] = cosine


@in_place
def links_to_results(lists, goal, entry_of, entries, counts, to_goal):  # type: ignore[no-untyped-def]
    """List the known links to a goal's neighbours by their ingredient.

    All slots of a table share the goal, so they share these lists.

    Args:
        lists: the lists.
        goal: entity id.
        entry_of: receives each ingredient's first entry, -1 without links; shape (T,), -1 before.
        entries: receives the neighbour's place in ``lists.made`` and the next entry of the same
            ingredient, -1 at the end: shape (L, 2), places ascending.
        counts: receives the number of recipes with the link, shape (L,).
        to_goal: receives the number of recipes of each ingredient and the goal itself; shape (T,),
            zeros before.

    """
    end = np.int64(0)
    places = lists.made.shape[1]
    # From the last neighbour to the first, so that an ingredient's list begins with the first.
    for column in range(places - 1, -1, -1):
        result = lists.made[goal, column]
        if result < 0:
            continue
        for place in range(lists.part_starts[result], lists.part_starts[result + 1]):
            part = lists.parts[place]
            entries[end, 0] = column
            entries[end, 1] = entry_of[part]
            counts[end] = lists.part_counts[place]
            entry_of[part] = end
            end += 1
    for place in range(lists.part_starts[goal], lists.part_starts[goal + 1]):
        to_goal[lists.parts[place]] = lists.part_counts[place]


@in_place
def forget_links(lists, goal, entry_of, to_goal):  # type: ignore[no-untyped-def]
    """Write -1 and 0 again where :func:`links_to_results` wrote first entries and numbers.

    Args:
        lists: the lists.
        goal: entity id.
        entry_of: shape (T,).
        to_goal: shape (T,).
    """
    for place in range(lists.part_starts[goal], lists.part_starts[goal + 1]):
        to_goal[lists.parts[place]] = 0
    for column in range(lists.made.shape[1]):
        result = lists.made[goal, column]
        if result < 0:
            break
        for place in range(lists.part_starts[result], lists.part_starts[result + 1]):
            entry_of[lists.parts[place]] = -1


@in_place
def _evidence_of_slots(  # type: ignore[no-untyped-def]
    lists, goal, table, alike, words, places, recipes, out
):
    """Write ``count`` and the features after it, of each slot and a goal: those that links lack.

    Args:
        lists: the lists.
        goal: entity id.
        table: shape (A,); negative for empty slots.
        alike: k² of each needed entity and each slot, shape (needed, A).
        words: the same by words.
        places: from :func:`needed_entities`.
        recipes: number of supporting recipes.
        out: shape (A, 16).
    """
    for slot in range(len(table)):
        entity = table[slot]
        if entity < 0:
            continue
        total = np.float32(0)
        best = np.float32(0)
        by_words = np.float32(0)
        for row in range(recipes):
            of_goal = lists.support_alike[goal, row]
            of_goal_words = lists.support_words[goal, row]
            # Both ingredients of the supporting recipe.
            for part in range(2):
                place = places[row, part]
                value = of_goal * alike[place, slot]
                total += value
                best = max(best, value)
                by_words += of_goal_words * words[place, slot]
        number = num_links(lists.result_bits, lists.link_keys, lists.link_counts, entity, goal)
        out[slot, _COUNT] = log1p(number)
        out[slot, _EVIDENCE] = log(FLOOR + total)
        out[slot, _BEST_EVIDENCE] = log(FLOOR + best)
        out[slot, _WORDS_EVIDENCE] = log(FLOOR + by_words)


@in_place
def links_of_slots(lists, to_results, goal, table, cosines, kernels, out):  # type: ignore[no-untyped-def]
    """Write ``words`` to ``regression`` of componentOf links: all but the goal's numbers.

    Args:
        lists: the lists.
        to_results: the arrays of :func:`links_to_results` for the goal.
        goal: the result.
        table: the ingredients, shape (A,); negative for empty slots.
        cosines: word cosines of slots and goal, shape (A,).
        kernels: their similarities k, shape (A,).
        out: shape (A, 12) or wider.
    """
    entry_of, entries, counts, num_to_goal = to_results
    hashed = (lists.partner_bits, lists.pair_keys)
    links = (lists.result_bits, lists.link_keys, lists.link_counts)
    for slot in range(len(table)):
        entity = table[slot]
        if entity < 0:
            continue
        soft = np.float32(0)
        soft_words = np.float32(0)
        with_goal = np.float32(0)
        to_goal = np.float32(0)
        for row in range(lists.used.shape[1]):
            other = lists.used[entity, row]
            if other < 0:
                break
            of_other = lists.used_alike[entity, row]
            if pair_place(*hashed, goal, other) >= 0:
                with_goal += of_other
            to_goal += of_other * num_to_goal[other]
            entry = entry_of[other]
            while entry >= 0:
                column = entries[entry, 0]
                weight = of_other * lists.made_alike[goal, column]
                # Neighbours come by descending similarity, so all that follow are below, too.
                if weight < LEAST:
                    break
                number = counts[entry]
                of_words = lists.used_words[entity, row] * lists.made_words[goal, column]
                soft += number * weight
                soft_words += number * of_words
                entry = entries[entry, 1]
        exact = np.float32(0)
        entry = entry_of[entity]
        while entry >= 0:
            exact += lists.made_alike[goal, entries[entry, 0]] * counts[entry]
            entry = entries[entry, 1]
        reverse = np.float32(0)
        for column in range(lists.made.shape[1]):
            result = lists.made[entity, column]
            if result < 0:
                break
            reverse += lists.made_alike[entity, column] * num_links(*links, goal, result)
        out[slot, _WORDS] = cosines[slot]
        out[slot, _KERNEL] = kernels[slot]
        out[slot, _USES] = log1p(lists.num_uses[entity])
        out[slot, _MADE] = log1p(lists.num_makers[entity])
        out[slot, _LINK] = log(FLOOR + soft)
        out[slot, _LINK_WORDS] = log(FLOOR + soft_words)
        out[slot, _LINK_EXACT] = log(FLOOR + exact)
        out[slot, _LINK_TO_GOAL] = log(FLOOR + to_goal)
        out[slot, _LINK_REVERSE] = log(FLOOR + reverse)
        out[slot, _LINK_WITH_GOAL] = log(FLOOR + with_goal)
        out[slot, _COMBINES] = 1 if pair_place(*hashed, entity, goal) >= 0 else 0
        out[slot, _REGRESSION] = product(lists.left, lists.right, entity, goal)


@in_place
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
        # Entries are read by both indices: for rows of their own, numba would count references.
        first = places[row, 0]
        second = places[row, 1]
        of_goal = support_alike[row]
        of_goal_words = support_words[row]
        own_first = alike[first, slot]
        own_second = alike[second, slot]
        own_words_first = words[first, slot]
        own_words_second = words[second, slot]
        for other in range(low, high):
            straight = own_first * alike[second, other]
            crossed = own_second * alike[first, other]
            evidence[other] += of_goal * (straight + crossed)
            better = straight if straight > crossed else crossed
            value = of_goal * better
            best[other] = value if value > best[other] else best[other]
            straight_words = own_words_first * words[second, other]
            crossed_words = own_words_second * words[first, other]
            by_words[other] += of_goal_words * (straight_words + crossed_words)


@in_place
def _pair_side(  # type: ignore[no-untyped-def]
    pair_starts,
    pair_counts,
    result_of,
    places,
    weights,
    words,
    first,
    last,
    known,
    known_words,
    out,
):
    """Write ``makes_anything`` to ``makes_alike_words``: from known pairs of neighbours.

    Args:
        pair_starts: ``lists.pair_starts``.
        pair_counts: ``lists.pair_counts``.
        result_of: ``lists.result``.
        places: of known pairs, from :func:`neighbour_pairs`, likewise the following two.
        weights: likewise.
        words: likewise.
        first: number of the first known pair.
        last: end of the known pairs.
        known: k² of each result and the goal, shape (T,).
        known_words: the same by words.
        out: shape (16,).
    """
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
            value = weight * known[result]
            alike += value
            nearest = max(nearest, value)
            alike_words += weight_by_words * known_words[result]
    out[_MAKES_ANYTHING] = log(FLOOR + anything)
    out[_MAKES_ALIKE] = log(FLOOR + alike)
    out[_MAKES_BEST] = log(FLOOR + nearest)
    out[_MAKES_ANYTHING_WORDS] = log(FLOOR + anything_words)
    out[_MAKES_ALIKE_WORDS] = log(FLOOR + alike_words)


@in_place
def _all_neighbour_pairs(lists, table, one, other, starts, places, weights, words):  # type: ignore[no-untyped-def]
    """Find the known pairs of neighbours of all pairs of slots.

    Args:
        lists: the lists.
        table: shape (A,); negative for empty slots.
        one: first slot of each pair, shape (P,).
        other: second slot of each pair, shape (P,).
        starts: receives where each pair's begin, and the end, shape (P + 1,).
        places: as in :func:`neighbour_pairs`, likewise the following two: with room for all pairs
            of neighbours of all pairs of slots.
        weights: likewise.
        words: likewise.
    """
    end = np.int64(0)
    for pair in range(len(one)):
        starts[pair] = end
        a = table[one[pair]]
        b = table[other[pair]]
        if a < 0 or b < 0:
            continue
        end, _ = neighbour_pairs(
            lists.used,
            lists.used_alike,
            lists.used_words,
            lists.partner_bits,
            lists.pair_keys,
            a,
            b,
            end,
            places,
            weights,
            words,
        )
    starts[len(one)] = end


@compiled
def _different_results(pair_starts, pair_counts, result_of, places, is_listed):  # type: ignore[no-untyped-def]
    """Return the results of known pairs, each once.

    Args:
        pair_starts: ``lists.pair_starts``.
        pair_counts: ``lists.pair_counts``.
        result_of: ``lists.result``.
        places: places of the pairs in the hash table.
        is_listed: work space, shape (T,): False before and after.
    """
    total = 0
    for number in range(len(places)):
        total += min(pair_counts[places[number]], MOST_RESULTS)
    results = np.empty(total, dtype=np.int32)
    count = 0
    for number in range(len(places)):
        start = pair_starts[places[number]]
        end = start + min(pair_counts[places[number]], MOST_RESULTS)
        for recipe in range(start, end):
            result = result_of[recipe]
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
def _of_pairs(  # type: ignore[no-untyped-def]
    lists,
    goal,
    table,
    slots_of_pairs,
    ranges,
    needed,
    places,
    recipes,
    known_pairs,
    starts,
    of_results,
    own_features,
    sums,
    out,
):
    """Write the features of a table's pairs and a goal.

    Args:
        lists: the lists.
        goal: entity id.
        table: shape (A,); negative for empty slots.
        slots_of_pairs: first and second slot of each pair, shape (P,) each; by first slot.
        ranges: of each first slot, the range of its second slots, shape (A, 2).
        needed: k² of each needed entity and each slot, and the same by words, shape (needed, A).
        places: from :func:`needed_entities`.
        recipes: number of supporting recipes.
        known_pairs: from :func:`_all_neighbour_pairs`.
        starts: likewise.
        of_results: k² of each result of these and the goal, and the same by words, shape (T,).
        own_features: of the pairs alone: places in the hash table and regression, shape (P,); word
            cosines and similarities of slots, shape (A, A).
        sums: work space, shape (3, A).
        out: shape (P, 16).
    """
    one, other = slots_of_pairs
    alike, words = needed
    pair_places, pair_weights, pair_words = known_pairs
    known, known_words = of_results
    own_places, regression, slot_cosines, slot_kernels = own_features
    recipes_of_pairs = (lists.pair_starts, lists.pair_counts, lists.result)
    support = (lists.support_alike[goal], lists.support_words[goal])
    goal_made = log1p(lists.num_makers[goal])
    goal_uses = log1p(lists.num_uses[goal])
    # First slot of the pairs whose sums are known; pairs come by their first slot.
    summed = -1
    for pair in range(len(one)):
        i = one[pair]
        j = other[pair]
        a = table[i]
        b = table[j]
        if a < 0 or b < 0:
            continue
        of_pair = out[pair]
        if i != summed:
            summed = i
            _goal_sides(
                support,
                i,
                ranges[i, 0],
                ranges[i, 1],
                alike,
                words,
                places,
                recipes,
                sums,
            )
        of_pair[_PAIR_EVIDENCE] = log(FLOOR + sums[0, j])
        of_pair[_PAIR_WORDS_EVIDENCE] = log(FLOOR + sums[1, j])
        of_pair[_PAIR_BEST_EVIDENCE] = log(FLOOR + sums[2, j])
        _pair_side(
            *recipes_of_pairs,
            pair_places,
            pair_weights,
            pair_words,
            starts[pair],
            starts[pair + 1],
            known,
            known_words,
            of_pair,
        )
        place = own_places[pair]
        of_pair[_KNOWN] = 1 if place >= 0 else 0
        of_pair[_MAKES] = 1 if place >= 0 and makes(*recipes_of_pairs, place, goal) else 0
        of_pair[_PAIR_WORDS] = slot_cosines[i, j]
        of_pair[_PAIR_KERNEL] = slot_kernels[i, j]
        of_pair[_ITSELF] = 1 if a == b else 0
        of_pair[_GOAL_MADE] = goal_made
        of_pair[_GOAL_USES] = goal_uses
        of_pair[_PAIR_REGRESSION] = regression[pair]


@in_place
def _alike_of_slots(  # type: ignore[no-untyped-def]
    lists, table, needed, structure, likeness, alike, words, slot_kernels, slot_cosines
):
    """Write the likeness of all slots and needed entities, and of all slots.

    Args:
        lists: the lists.
        table: shape (A,); negative for empty slots.
        needed: entity ids, shape (n,).
        structure: work space, shape (T,): zeros before and after.
        likeness: work space, shape (2, n).
        alike: receives k² of each needed entity and each slot, shape (n, A); zeros before.
        words: receives the same by words, likewise.
        slot_kernels: receives the similarities k of slots, shape (A, A).
        slot_cosines: receives their word cosines, shape (A, A).
    """
    similar = (lists.vectors, lists.norms, lists.kernels, lists.cosines)
    kernels = likeness[0]
    cosines = likeness[1]
    for slot in range(len(table)):
        entity = table[slot]
        if entity < 0:
            continue
        spread(lists, entity, structure)
        alike_of(*similar, entity, needed, structure, kernels, cosines)
        for number in range(len(needed)):
            alike[number, slot] = kernels[number] * kernels[number]
            words[number, slot] = fourth(cosines[number])
        alike_of(*similar, entity, table, structure, slot_kernels[slot], slot_cosines[slot])
        clear(lists, entity, structure)


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
    is_listed = np.zeros(size, dtype=np.bool_)
    known = np.empty(size, dtype=np.float32)
    known_words = np.empty(size, dtype=np.float32)
    slot_cosines = np.empty((slots, slots), dtype=np.float32)
    slot_kernels = np.empty((slots, slots), dtype=np.float32)
    goal_cosines = np.empty(slots, dtype=np.float32)
    goal_kernels = np.empty(slots, dtype=np.float32)
    starts = np.empty(len(one) + 1, dtype=np.int64)
    own_places = np.empty(len(one), dtype=np.int64)
    regression = np.empty(len(one), dtype=np.float32)
    sums = np.empty((3, slots), dtype=np.float32)
    # Room for more pairs than there are costs nothing: memory that nobody writes to is not taken.
    most = len(one) * lists.used.shape[1] ** 2
    known_pairs = (
        np.empty(most, dtype=np.int64),
        np.empty(most, dtype=np.float32),
        np.empty(most, dtype=np.float32),
    )
    similar = (lists.vectors, lists.norms, lists.kernels, lists.cosines)
    entry_of = np.full(size, -1, dtype=np.int32)
    entries = np.empty((len(lists.parts), 2), dtype=np.int32)
    counts = np.empty(len(lists.parts), dtype=np.int32)
    to_goal = np.zeros(size, dtype=np.int32)
    to_results = (entry_of, entries, counts, to_goal)
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
        likeness = np.empty((2, count), dtype=np.float32)
        _alike_of_slots(
            lists,
            table,
            needed[:count],
            structure,
            likeness,
            alike,
            words,
            slot_kernels,
            slot_cosines,
        )
        _all_neighbour_pairs(lists, table, one, other, starts, *known_pairs)
        results = _different_results(*recipes_of_pairs, known_pairs[0][: starts[-1]], is_listed)
        result_kernels = np.empty(len(results), dtype=np.float32)
        result_cosines = np.empty(len(results), dtype=np.float32)
        for pair in range(len(one)):
            a = table[one[pair]]
            b = table[other[pair]]
            if a >= 0 and b >= 0:
                own_places[pair] = pair_place(*hashed, a, b)
                regression[pair] = product(lists.pair_left, lists.right, a, b)
        for row in range(begin, end):
            goal = goals[row]
            spread(lists, goal, of_goal)
            links_to_results(lists, goal, *to_results)
            alike_of(*similar, goal, results, of_goal, result_kernels, result_cosines)
            for number in range(len(results)):
                result = results[number]
                known[result] = result_kernels[number] * result_kernels[number]
                known_words[result] = fourth(result_cosines[number])
            alike_of(*similar, goal, table, of_goal, goal_kernels, goal_cosines)
            links_of_slots(
                lists, to_results, goal, table, goal_cosines, goal_kernels, of_slots[row]
            )
            _evidence_of_slots(
                lists,
                goal,
                table,
                alike,
                words,
                places[row - begin],
                recipes[row - begin],
                of_slots[row],
            )
            forget_links(lists, goal, entry_of, to_goal)
            own_features = (own_places, regression, slot_cosines, slot_kernels)
            _of_pairs(
                lists,
                goal,
                table,
                (one, other),
                ranges,
                (alike, words),
                places[row - begin],
                recipes[row - begin],
                known_pairs,
                starts,
                (known, known_words),
                own_features,
                sums,
                of_pairs[row],
            )
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
    size = len(lists.norms)
    similar = (lists.vectors, lists.norms, lists.kernels, lists.cosines)
    structure = np.zeros(size, dtype=np.float32)
    parts = np.empty((2, len(terms)), dtype=np.int32)
    # By entity of the pair, part of the recipe, and recipe.
    kernels = np.empty((2, 2, len(terms)), dtype=np.float32)
    cosines = np.empty(len(terms), dtype=np.float32)
    for row in range(len(terms)):
        recipe = lists.support[goal, row]
        parts[0, row] = lists.first[recipe] if recipe >= 0 else -1
        parts[1, row] = lists.second[recipe] if recipe >= 0 else -1
    for side in range(2):
        entity = b if side else a
        spread(lists, entity, structure)
        for part in range(2):
            alike_of(*similar, entity, parts[part], structure, kernels[side, part], cosines)
        clear(lists, entity, structure)
    squares = kernels * kernels
    for row in range(len(terms)):
        terms[row, 0] = squares[0, 0, row] * squares[1, 1, row]
        terms[row, 1] = squares[0, 1, row] * squares[1, 0, row]
