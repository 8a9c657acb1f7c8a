"""Compiled loops of sets: votes of similar goals, and the beam over ingredients.

Sets are rows of ingredient numbers in ascending order, -1 behind the last.
"""

# ruff: noqa: C901, PLR0912 - numba inlines what a call would split
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.scorers.neighbours.compiled import compiled

WIDTHS = ((0.1, 0.15), (0.3, 0.5), (0.05, 0.08))
"""Widths of the kernels: of kinds of parts and words, and of amounts."""
_WIDTHS = np.array(WIDTHS, dtype=np.float32)
NUM_KERNELS = len(WIDTHS)
_SWEEPS = 20
"""Rounds over a set's ingredients in which their amounts come to rest."""
NO_SHARE = -12.0
"""Log share of an ingredient that lacks the part, or that the goal does not allow."""


class SetLists(NamedTuple):
    """Train recipes as arrays; goals, ingredients, sets and parts have numbers of their own.

    Attributes:
        goal_starts: first place of each goal in the next two, shape (G + 1,).
        goal_parts: parts of the goals.
        goal_amounts: their shares, float32.
        recipe_goals: goal of each recipe, shape (R,).
        recipe_sets: set of each recipe, shape (R,).
        sets: shape (S, 8), ascending ingredients, -1 behind the last.
        has_part: whether an ingredient brings a part, shape (N, P).
    """

    goal_starts: Ids
    goal_parts: Ids
    goal_amounts: NDArray[np.float32]
    recipe_goals: Ids
    recipe_sets: Ids
    sets: Ids
    has_part: NDArray[np.bool_]


@compiled
def write_with(ingredient, size, row):  # type: ignore[no-untyped-def]
    """Add an ingredient to a set, in ascending order.

    Args:
        ingredient: its number.
        size: number of ingredients before.
        row: the set, shape (8,), is written.
    """
    column = size
    while column > 0 and row[column - 1] > ingredient:
        row[column] = row[column - 1]
        column -= 1
    row[column] = ingredient


@compiled
def vote(lists, amounts, cosines, similarity, set_votes, votes):  # type: ignore[no-untyped-def]
    """Let known goals vote for their sets and ingredients by their similarity to a goal.

    Args:
        lists: the train recipes.
        amounts: the goal's shares of parts, shape (P,).
        cosines: similarity of words to each known goal, shape (G,); 1 without words.
        similarity: shape (3, G), is written.
        set_votes: zeros, shape (3, S), are written.
        votes: zeros, shape (3, N), are written.
    """
    num_parts = np.sum(amounts > 0)
    for goal in range(len(lists.goal_starts) - 1):
        start = lists.goal_starts[goal]
        end = lists.goal_starts[goal + 1]
        common = 0
        overlap = np.float32(0)
        for place in range(start, end):
            amount = amounts[lists.goal_parts[place]]
            if amount > 0:
                common += 1
                overlap += min(amount, lists.goal_amounts[place])
        union = max(num_parts + end - start - common, 1)
        kinds = 1 - np.float32(common) / np.float32(union) + 1 - cosines[goal]
        for kernel in range(3):
            similarity[kernel, goal] = math.exp(
                -kinds / _WIDTHS[kernel, 0] - (1 - overlap) / _WIDTHS[kernel, 1]
            )
    for recipe in range(len(lists.recipe_goals)):
        goal = lists.recipe_goals[recipe]
        number = lists.recipe_sets[recipe]
        for kernel in range(3):
            set_votes[kernel, number] += similarity[kernel, goal]
    for number in range(len(lists.sets)):
        for ingredient in lists.sets[number]:
            if ingredient < 0:
                break
            for kernel in range(3):
                votes[kernel, ingredient] += set_votes[kernel, number]


@compiled
def search(lists, keys, shares, log_again, log_sizes, top, sets):  # type: ignore[no-untyped-def]
    """Write the best sets that cover all key parts, one part after the other.

    In a second round, each part, and each lost part that the goal has, may come from one ingredient
    more. Without parts, ``log_sizes`` has numbers, and each step adds an ingredient, or one again.

    Args:
        lists: the train recipes.
        keys: key parts of the goal.
        shares: log shares by key part and lost part of the goal, shape (4, keys + lost, N).
        log_again: log probability that one ingredient more brings the part, shape (keys + lost,).
        log_sizes: log probability of each number of ingredients, shape (8,); empty with parts.
        top: most ingredients that are tried for a part.
        sets: shape (K, 8), is written.

    Returns:
        The number of sets.
    """
    width = sets.shape[1]
    beam_width = len(sets)
    num_keys = len(keys)
    num_parts = shares.shape[1]
    num_ingredients = shares.shape[2]
    # Of two kernels, the nearest goals' and the network's.
    mean_shares = 0.5 * shares[0] + 0.5 * shares[3]
    options = np.empty((num_parts, num_ingredients), dtype=np.int64)
    num_options = np.empty(num_parts, dtype=np.int64)
    for place in range(num_parts):
        options[place] = np.argsort(-mean_shares[place], kind="mergesort")
        num_options[place] = min(top, np.sum(mean_shares[place] != NO_SHARE))
    is_free = len(log_sizes) > 0
    # Parts with few options first: they leave the beam the most room.
    order = np.argsort(num_options[:num_keys], kind="mergesort")
    steps = width if is_free else num_keys + num_parts
    room = beam_width * (top + 1)
    next_sets = np.full((room, width), -1, dtype=np.int64)
    next_scores = np.empty(room)
    next_sizes = np.zeros(room, dtype=np.int64)
    beam = np.full((beam_width, width), -1, dtype=np.int64)
    beam_scores = np.zeros(beam_width)
    beam_sizes = np.zeros(beam_width, dtype=np.int64)
    in_beam = 1
    # Finished sets of a model without parts, of all sizes together.
    finished = np.full((width * beam_width, width), -1, dtype=np.int64)
    finished_scores = np.empty(width * beam_width)
    num_finished = 0
    for step in range(steps):
        is_again = not is_free and step >= num_keys
        place = 0
        if not is_free:
            place = step - num_keys if is_again else order[step]
        cost = log_again[place] if is_again else 0.0
        count = 0
        for row in range(in_beam):
            size = beam_sizes[row]
            is_first = not is_free and not is_again
            is_covered = is_first and np.any(lists.has_part[beam[row, :size], keys[place]])
            if is_covered or is_again:
                next_sets[count] = beam[row]
                next_scores[count] = beam_scores[row]
                next_sizes[count] = size
                count += 1
            if is_covered or size == width:
                continue
            for slot in range(num_options[place]):
                ingredient = options[place, slot]
                if is_again and np.any(beam[row] == ingredient):
                    continue
                next_sets[count] = beam[row]
                write_with(ingredient, size, next_sets[count])
                next_scores[count] = beam_scores[row] + mean_shares[place, ingredient] + cost
                next_sizes[count] = size + 1
                count += 1
        best = np.argsort(-next_scores[:count], kind="mergesort")
        in_beam = 0
        for row in best:
            is_new = True
            for earlier in range(in_beam):
                if np.all(next_sets[row] == beam[earlier]):
                    is_new = False
                    break
            if is_new:
                beam[in_beam] = next_sets[row]
                beam_scores[in_beam] = next_scores[row]
                beam_sizes[in_beam] = next_sizes[row]
                in_beam += 1
                if in_beam == beam_width:
                    break
        if is_free:
            end = num_finished + in_beam
            finished[num_finished:end] = beam[:in_beam]
            # A larger set has more ways in which its ingredients could come.
            finished_scores[num_finished:end] = (
                beam_scores[:in_beam] + log_sizes[step] + math.lgamma(step + 2.0)
            )
            num_finished = end
    if not is_free:
        sets[:in_beam] = beam[:in_beam]
        return in_beam
    best = np.argsort(-finished_scores[:num_finished], kind="mergesort")
    num_sets = min(beam_width, num_finished)
    sets[:num_sets] = finished[best[:num_sets]]
    return num_sets


@compiled
def balance(members, parts, amounts, result):  # type: ignore[no-untyped-def]
    """Write how well amounts of ingredients can add up to a goal's key parts.

    The amounts are those of least squares, none below 0.

    Args:
        members: shares of parts of each set's ingredients, shape (n, 8, P), 0 for none.
        parts: 0 for a key part, 1 for a shared part, 2 for a lost one, shape (P,).
        amounts: the goal's shares of parts, shape (P,).
        result: shape (n, 3), is written: what is missing of the key parts or too much, and of the
            shared and the lost parts what is too much, or too little if below 0.
    """
    num_parts = len(parts)
    residual = np.empty(num_parts)
    for row in range(len(members)):
        weights = np.zeros(members.shape[1])
        residual[:] = amounts
        for _ in range(_SWEEPS):
            for column in range(members.shape[1]):
                product = 0.0
                square = 0.0
                for part in range(num_parts):
                    if parts[part] == 0:
                        share = members[row, column, part]
                        product += share * residual[part]
                        square += share * share
                if square == 0:
                    continue
                weight = max(weights[column] + product / square, 0.0)
                step = weight - weights[column]
                weights[column] = weight
                # Number by number: a product of arrays would be made first, in five times the time.
                for part in range(num_parts):
                    residual[part] -= step * members[row, column, part]
        result[row] = 0
        for part in range(num_parts):
            excess = abs(residual[part]) if parts[part] == 0 else -residual[part]
            result[row, parts[part]] += excess
