"""Loops that make neighbour lists.

Each function writes to its own arrays only, and visits entries in a fixed order.
"""

import numpy as np

from wordcraft_kg.models.scorers.neighbours.compiled import compiled, in_place
from wordcraft_kg.models.scorers.neighbours.similar import fourth, product, similarity

FAR = 2**31 - 1
"""The id at the end of a list of ascending ids: above all entities."""


@in_place
def insert(ids, values, count, new, value):  # type: ignore[no-untyped-def]
    """Insert an entry into a list by descending value, then ascending id.

    Args:
        ids: the list's ids, of which the first ``count`` are valid.
        values: the list's values, as long as ``ids``.
        count: length of the list so far.
        new: id to insert.
        value: value to insert.

    Returns:
        the new length; a full list drops its last entry, or the new one.
    """
    size = len(ids)
    if count == size:
        last = values[size - 1]
        if value < last or (value == last and new > ids[size - 1]):
            return count
        place = size - 1
    else:
        place = count
        count += 1
    # Entries with smaller values move one place back, until the new one fits.
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
def largest(cosines, start, near):  # type: ignore[no-untyped-def]
    """Write the columns of each row's largest positive cosines, the largest first.

    Args:
        cosines: shape (rows, T).
        start: entity of the first row; an entity is left out of its own row.
        near: receives the columns, shape (rows, K).
    """
    rows, size = cosines.shape
    width = near.shape[1]
    values = np.empty(width, dtype=np.float32)
    for row in range(rows):
        count = 0
        for column in range(size):
            value = cosines[row, column]
            # Most columns fail this test, which is why a list needs no sort of all columns.
            if value > 0 and column != start + row and (count < width or value > values[count - 1]):
                count = insert(near[row], values, count, column, value)


@compiled
def structural_neighbours(  # type: ignore[no-untyped-def]
    starts,
    columns,
    data,
    column_starts,
    column_rows,
    column_data,
    common,
    first,
    near,
    cosines,
):
    """Write the entities with the most similar profiles, ids ascending, and cosines.

    Profiles come by row and by column, as compressed sparse rows of P and of Pᵀ. N entities are
    served, so that threads can share all.

    Args:
        starts: where each entity's entries begin and the last one's end, shape (T + 1,).
        columns: column of each entry, ascending within an entity.
        data: value of each entry.
        column_starts: as ``starts``, by column of P, shape (M + 1,).
        column_rows: entity of each entry, by column.
        column_data: value of each entry, by column.
        common: columns with more entries than this number are skipped.
        first: the first of the N entities.
        near: receives ids, shape (N, K); ``FAR`` everywhere before, and then at the end of lists.
        cosines: receives cosines, shape (N, K); zeros before.
    """
    size = len(starts) - 1
    width = near.shape[1]
    sums = np.zeros(size, dtype=np.float32)
    touched = np.empty(size, dtype=np.int32)
    ids = np.empty(width, dtype=np.int32)
    values = np.empty(width, dtype=np.float32)
    for row_of_list in range(len(near)):
        entity = first + row_of_list
        # The sums of all entities that share a column with this one, in the order of columns.
        number = 0
        for place in range(starts[entity], starts[entity + 1]):
            column = columns[place]
            if column_starts[column + 1] - column_starts[column] > common:
                continue
            for column_place in range(column_starts[column], column_starts[column + 1]):
                row = column_rows[column_place]
                # All values are positive, so a sum of 0 is one that has not begun.
                if sums[row] == 0:
                    touched[number] = row
                    number += 1
                sums[row] += data[place] * column_data[column_place]
        count = 0
        for place in range(number):
            row = touched[place]
            if row != entity and (count < width or sums[row] >= values[count - 1]):
                count = insert(ids, values, count, row, sums[row])
            # Only touched sums are cleared: clearing all would cost T for each entity.
            sums[row] = 0
        order = np.argsort(ids[:count])
        for place in range(count):
            near[row_of_list, place] = ids[order[place]]
            cosines[row_of_list, place] = values[order[place]]


@compiled
def merged_neighbours(  # type: ignore[no-untyped-def]
    vectors,
    near,
    norms,
    near_words,
    num_uses,
    num_makers,
    first,
    used,
    made,
):
    """Write entities' most similar ingredients and results by structure and words together.

    Candidates are the entity itself and both kinds of neighbours. N entities are served, so that
    threads can share all.

    Args:
        vectors: unit word vectors, shape (T, D).
        near: structural neighbours, with their profile cosines as values.
        norms: each entity's similarity with itself, shape (T,).
        near_words: neighbours by words, shape (T, K_w), -1 at the end.
        num_uses: recipes that use an entity, shape (T,): ingredients have some.
        num_makers: recipes that make an entity, shape (T,): results have some.
        first: the first of the N entities.
        used: receives the ingredients: ids, -1 everywhere before, and then at the end of lists;
            squared similarities and word cosines to the power 4, zeros before; shape (N, width)
            each, the most similar first.
        made: receives the results, likewise.
    """
    size = len(norms)
    used_ids, used_alike, _ = used
    made_ids, made_alike, _ = made
    is_listed = np.zeros(size, dtype=np.bool_)
    structure = np.zeros(size, dtype=np.float32)
    cosines = np.empty(size, dtype=np.float32)
    longest = 0
    for entity in range(first, first + len(used_ids)):
        longest = max(longest, near.starts[entity + 1] - near.starts[entity])
    listed = np.empty(1 + longest + near_words.shape[1], dtype=np.int32)
    for row in range(len(used_ids)):
        entity = first + row
        number = 1
        listed[0] = entity
        for place in range(near.starts[entity], near.starts[entity + 1]):
            structure[near.columns[place]] = near.values[place]
            listed[number] = near.columns[place]
            number += 1
        for place in range(near_words.shape[1]):
            if near_words[entity, place] < 0:
                break
            listed[number] = near_words[entity, place]
            number += 1
        num_used = np.int64(0)
        num_made = np.int64(0)
        for place in range(number):
            candidate = listed[place]
            is_unknown = num_uses[candidate] == 0 and num_makers[candidate] == 0
            # An entity may be a neighbour of both kinds, and counts once.
            if is_listed[candidate] or is_unknown:
                continue
            is_listed[candidate] = True
            value = np.float32(1)
            cosines[candidate] = 1
            if candidate != entity:
                cosines[candidate] = product(vectors, vectors, entity, candidate)
                value = similarity(
                    structure[candidate], cosines[candidate], norms[entity], norms[candidate]
                )
            if value > 0 and num_uses[candidate] > 0:
                num_used = insert(used_ids[row], used_alike[row], num_used, candidate, value)
            if value > 0 and num_makers[candidate] > 0:
                num_made = insert(made_ids[row], made_alike[row], num_made, candidate, value)
        # Work space is cleared where it was written.
        for place in range(number):
            is_listed[listed[place]] = False
            structure[listed[place]] = 0
        for (ids, alike, words), count in ((used, num_used), (made, num_made)):
            for place in range(count):
                alike[row, place] *= alike[row, place]
                words[row, place] = fourth(cosines[ids[row, place]])


@compiled
def supporting(made, alike, starts, by_result, width):  # type: ignore[no-untyped-def]
    """Return the recipes that make a goal's neighbours, with the neighbours' similarities.

    Args:
        made: neighbours that are results, shape (T, G), the most similar first, -1 at the end.
        alike: their squared similarities, shape (T, G).
        starts: where each result's recipes begin in ``by_result``, and the last one's end.
        by_result: recipe numbers, by result.
        width: R, the length of the lists.

    Returns:
        recipe numbers, -1 at the end, and similarities of their results to the goal: shape (T, R)
        each.
    """
    size = len(made)
    numbers = np.full((size, width), -1, dtype=np.int32)
    goal_alike = np.zeros((size, width), dtype=np.float32)
    for goal in range(size):
        count = 0
        for place in range(made.shape[1]):
            result = made[goal, place]
            if result < 0 or count == width:
                break
            start = starts[result]
            # The list may end within the recipes of a result.
            end = min(starts[result + 1], start + width - count)
            for row in range(start, end):
                numbers[goal, count] = by_result[row]
                goal_alike[goal, count] = alike[goal, place]
                count += 1
    return numbers, goal_alike


@in_place
def word_cosines(vectors, out):  # type: ignore[no-untyped-def]
    """Write the word cosines of all entities, 1 on the diagonal.

    Args:
        vectors: unit word vectors, shape (T, D).
        out: shape (T, T).
    """
    for entity in range(len(vectors)):
        out[entity, entity] = 1
        for partner in range(entity):
            cosine = product(vectors, vectors, entity, partner)
            out[entity, partner] = cosine
            out[partner, entity] = cosine


@in_place
def all_kernels(near, norms, cosines, out):  # type: ignore[no-untyped-def]
    """Write the similarities k of all entities, 1 on the diagonal.

    Args:
        near: structural neighbours, with their profile cosines as values.
        norms: each entity's similarity with itself, shape (T,).
        cosines: word cosines, shape (T, T).
        out: shape (T, T); zeros before.
    """
    for entity in range(len(norms)):
        row = out[entity]
        for place in range(near.starts[entity], near.starts[entity + 1]):
            row[near.columns[place]] = near.values[place]
        for partner in range(len(norms)):
            words = cosines[entity, partner]
            row[partner] = similarity(row[partner], words, norms[entity], norms[partner])
        row[entity] = 1
