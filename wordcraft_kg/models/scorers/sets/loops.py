"""Compiled loops of sets: votes of similar goals, the beam over ingredients, features of sets.

Sets are rows of ingredient numbers in ascending order, -1 behind the last.
"""

# ruff: noqa: C901, PLR0912, PLR0913 - numba inlines what a call would split
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.scorers.neighbours.compiled import compiled

WIDTHS = ((0.1, 0.15), (0.3, 0.5), (0.05, 0.08))
"""Widths of the kernels: of kinds of parts and words, and of amounts."""
_KINDS = np.array([width for width, _ in WIDTHS], dtype=np.float32)
_AMOUNTS = np.array([width for _, width in WIDTHS], dtype=np.float32)
NUM_KERNELS = len(WIDTHS)
NO_SHARE = -12.0
"""Log share of an ingredient that lacks the part, or that the goal does not allow."""
_FLOOR = 1e-9
_SMALL_VOTE = 1e-3
"""Share of the mean vote that each ingredient gets, and that popularity decides."""
_WEIGHT_OF_SET = 50.0
_PRIOR = 0.3
"""Added to counts of ingredients that occur together."""


class SetLists(NamedTuple):
    """Train recipes as arrays; goals, ingredients, sets and parts have numbers of their own.

    Attributes:
        goal_starts: first place of each goal in the next two, shape (G + 1,).
        goal_parts: parts of the goals.
        goal_amounts: their shares, float32.
        recipe_goals: goal of each recipe, shape (R,).
        recipe_sets: set of each recipe, shape (R,).
        sets: shape (S, 8), ascending ingredients, -1 behind the last.
        set_counts: number of recipes of each set, float32.
        set_keys: sorted keys of the sets, see :func:`set_key`.
        set_order: set of each sorted key.
        counts: number of recipes of each ingredient, float32, shape (N,).
        pair_keys: sorted ``first * N + second`` of ingredients that occur together.
        pair_counts: number of recipes with both, float32.
        has_part: whether an ingredient brings a part, shape (N, P).
        is_key: whether a part is a key part, shape (P,).
        style: the kind of each ingredient, shape (N, K), float32.
    """

    goal_starts: Ids
    goal_parts: Ids
    goal_amounts: NDArray[np.float32]
    recipe_goals: Ids
    recipe_sets: Ids
    sets: Ids
    set_counts: NDArray[np.float32]
    set_keys: Ids
    set_order: Ids
    counts: NDArray[np.float32]
    pair_keys: Ids
    pair_counts: NDArray[np.float32]
    has_part: NDArray[np.bool_]
    is_key: NDArray[np.bool_]
    style: NDArray[np.float32]


@compiled
def set_key(ingredients):  # type: ignore[no-untyped-def]
    """Return a number that differs between sets, but for accidents; callers compare the sets."""
    key = np.int64(1469598103934665603)
    for ingredient in ingredients:
        if ingredient < 0:
            break
        key = (key ^ np.int64(ingredient + 1)) * np.int64(1099511628211)
        key ^= key >> np.int64(29)
    return key


@compiled
def keys_of_sets(sets, out):  # type: ignore[no-untyped-def]
    """Write the key of each set."""
    for row in range(len(sets)):
        out[row] = set_key(sets[row])


@compiled
def set_number(lists, ingredients):  # type: ignore[no-untyped-def]
    """Return the number of a known set, or -1."""
    key = set_key(ingredients)
    place = np.searchsorted(lists.set_keys, key)
    while place < len(lists.set_keys) and lists.set_keys[place] == key:
        number = lists.set_order[place]
        same = True
        for column in range(len(ingredients)):
            if lists.sets[number, column] != ingredients[column]:
                same = False
                break
        if same:
            return number
        place += 1
    return -1


@compiled
def count_together(lists, first, second):  # type: ignore[no-untyped-def]
    """Return the number of recipes with two ingredients, the smaller number first."""
    key = first * len(lists.counts) + second
    place = np.searchsorted(lists.pair_keys, key)
    if place < len(lists.pair_keys) and lists.pair_keys[place] == key:
        return lists.pair_counts[place]
    return np.float32(0)


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
    num_parts = 0
    for part in range(len(amounts)):
        if amounts[part] > 0:
            num_parts += 1
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
                -kinds / _KINDS[kernel] - (1 - overlap) / _AMOUNTS[kernel]
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
def write_shares(lists, keys, is_allowed, votes, log_network, shares):  # type: ignore[no-untyped-def]
    """Write log shares of ingredients for each key part: by three kernels, and by the network.

    Args:
        lists: the train recipes.
        keys: key parts of the goal.
        is_allowed: shape (N,), which ingredients take part.
        votes: shape (3, N).
        log_network: the network's scores, shape (N,).
        shares: shape (4, keys, N), filled with :data:`NO_SHARE`; is written.

    Returns:
        The first key part that no ingredient brings, or -1.
    """
    num_ingredients = len(is_allowed)
    missing = -1
    for place in range(len(keys)):
        part = keys[place]
        options = 0
        top = -np.inf
        for i in range(num_ingredients):
            if is_allowed[i] and lists.has_part[i, part]:
                options += 1
                top = max(top, log_network[i])
        if not options:
            if missing < 0:
                missing = part
            continue
        for kernel in range(3):
            mean = 0.0
            for i in range(num_ingredients):
                if is_allowed[i] and lists.has_part[i, part]:
                    mean += votes[kernel, i] / options
            total = 0.0
            for i in range(num_ingredients):
                if is_allowed[i] and lists.has_part[i, part]:
                    total += (
                        votes[kernel, i] + _SMALL_VOTE * mean + _FLOOR * (lists.counts[i] + 0.1)
                    )
            for i in range(num_ingredients):
                if is_allowed[i] and lists.has_part[i, part]:
                    number = (
                        votes[kernel, i] + _SMALL_VOTE * mean + _FLOOR * (lists.counts[i] + 0.1)
                    )
                    shares[kernel, place, i] = math.log(number / total)
        total = 0.0
        for i in range(num_ingredients):
            if is_allowed[i] and lists.has_part[i, part]:
                total += math.exp(log_network[i] - top)
        for i in range(num_ingredients):
            if is_allowed[i] and lists.has_part[i, part]:
                shares[3, place, i] = log_network[i] - top - math.log(total)
    return missing


@compiled
def search(lists, keys, shares, log_sizes, top, sets):  # type: ignore[no-untyped-def]
    """Write the best sets that cover all key parts, one part after the other.

    Without parts, ``log_sizes`` has numbers, and each step adds an ingredient, or one again.

    Args:
        lists: the train recipes.
        keys: key parts of the goal.
        shares: log shares, shape (4, keys, N).
        log_sizes: log probability of each number of ingredients, shape (8,); empty with parts.
        top: most ingredients that are tried for a part.
        sets: shape (K, 8), is written.

    Returns:
        The number of sets.
    """
    width = sets.shape[1]
    most = len(sets)
    num_keys = len(keys)
    num_ingredients = shares.shape[2]
    options = np.full((num_keys, top), -1, dtype=np.int64)
    scores = np.full((num_keys, top), -np.inf)
    num_options = np.zeros(num_keys, dtype=np.int64)
    for place in range(num_keys):
        for i in range(num_ingredients):
            if shares[0, place, i] <= NO_SHARE and shares[3, place, i] <= NO_SHARE:
                continue
            score = 0.5 * shares[0, place, i] + 0.5 * shares[3, place, i]
            slot = num_options[place]
            if slot == top:
                if score <= scores[place, top - 1]:
                    continue
                slot = top - 1
            else:
                num_options[place] += 1
            while slot > 0 and scores[place, slot - 1] < score:
                scores[place, slot] = scores[place, slot - 1]
                options[place, slot] = options[place, slot - 1]
                slot -= 1
            scores[place, slot] = score
            options[place, slot] = i
    is_free = len(log_sizes) > 0
    # Parts with few options first: they leave the beam the most room.
    order = np.argsort(num_options, kind="mergesort")
    steps = width if is_free else num_keys
    room = most * (top + 1)
    next_sets = np.full((room, width), -1, dtype=np.int64)
    next_scores = np.empty(room)
    next_sizes = np.zeros(room, dtype=np.int64)
    beam = np.full((most, width), -1, dtype=np.int64)
    beam_scores = np.zeros(most)
    beam_sizes = np.zeros(most, dtype=np.int64)
    in_beam = 1
    # Finished sets of a model without parts, of all sizes together.
    done = np.full((steps * most, width), -1, dtype=np.int64)
    done_scores = np.empty(steps * most)
    num_done = 0
    for step in range(steps):
        place = 0 if is_free else order[step]
        count = 0
        for row in range(in_beam):
            size = beam_sizes[row]
            is_covered = False
            if not is_free:
                for column in range(size):
                    if lists.has_part[beam[row, column], keys[place]]:
                        is_covered = True
                        break
            if is_covered:
                next_sets[count] = beam[row]
                next_scores[count] = beam_scores[row]
                next_sizes[count] = size
                count += 1
                continue
            if size == width:
                continue
            for slot in range(num_options[place]):
                next_sets[count] = beam[row]
                column = size
                ingredient = options[place, slot]
                while column > 0 and next_sets[count, column - 1] > ingredient:
                    next_sets[count, column] = next_sets[count, column - 1]
                    column -= 1
                next_sets[count, column] = ingredient
                next_scores[count] = beam_scores[row] + scores[place, slot]
                next_sizes[count] = size + 1
                count += 1
        best = np.argsort(-next_scores[:count], kind="mergesort")
        in_beam = 0
        for row in best:
            is_new = True
            for other in range(in_beam):
                same = True
                for column in range(width):
                    if beam[other, column] != next_sets[row, column]:
                        same = False
                        break
                if same:
                    is_new = False
                    break
            if is_new:
                beam[in_beam] = next_sets[row]
                beam_scores[in_beam] = next_scores[row]
                beam_sizes[in_beam] = next_sizes[row]
                in_beam += 1
                if in_beam == most:
                    break
        if is_free:
            for row in range(in_beam):
                done[num_done] = beam[row]
                # A larger set has more ways in which its ingredients could come.
                done_scores[num_done] = beam_scores[row] + log_sizes[step] + math.lgamma(step + 2.0)
                num_done += 1
    if not is_free:
        sets[:in_beam] = beam[:in_beam]
        return in_beam
    best = np.argsort(-done_scores[:num_done], kind="mergesort")
    num_sets = min(most, num_done)
    for row in range(num_sets):
        sets[row] = done[best[row]]
    return num_sets


@compiled
def write_features(  # type: ignore[no-untyped-def]
    lists, sets, styles, shares, votes, set_votes, similarity, log_sizes, proxies, features
):
    """Write the features of sets for a goal, which a committee of networks scores.

    Args:
        lists: the train recipes.
        sets: shape (n, 8), numbers of ingredients, those of unknown ones from N on.
        styles: kind of each ingredient, shape (N + unknown, K).
        shares: shape (4, keys, N + unknown).
        votes: shape (3, N).
        set_votes: shape (3, S).
        similarity: shape (3, G).
        log_sizes: log share of each number of ingredients among similar recipes, shape (8,).
        proxies: known ingredient that stands for each, shape (N + unknown,).
        features: shape (n, F), is written.
    """
    num_keys = shares.shape[1]
    num_kinds = styles.shape[1]
    num_recipes = np.float32(len(lists.recipe_goals))
    totals = np.zeros(3)
    for kernel in range(3):
        for number in range(set_votes.shape[1]):
            totals[kernel] += set_votes[kernel, number]
    nearest = 0.0
    for goal in range(similarity.shape[1]):
        nearest = max(nearest, similarity[0, goal])
    near_style = np.zeros(num_kinds)
    all_votes = 0.0
    for i in range(votes.shape[1]):
        all_votes += votes[1, i]
    for i in range(votes.shape[1]):
        weight = votes[1, i] / max(all_votes, 1e-9)
        if weight > 0:
            for kind in range(num_kinds):
                near_style[kind] += weight * lists.style[i, kind]
    for row in range(len(sets)):
        size = 0
        is_known = True
        for ingredient in sets[row]:
            if ingredient < 0:
                break
            size += 1
            is_known &= ingredient < len(lists.counts)
        out = features[row]
        column = 0
        for source in range(4):
            total = 0.0
            least = np.inf
            for place in range(size):
                best = -np.inf
                for key in range(num_keys):
                    best = max(best, shares[source, key, sets[row, place]])
                total += best
                least = min(least, best)
            out[column] = total
            out[column + 1] = least
            column += 2
        for source in (0, 3):
            total = 0.0
            for key in range(num_keys):
                best = -np.inf
                for place in range(size):
                    best = max(best, shares[source, key, sets[row, place]])
                total += best
            out[column] = total
            column += 1
        number = set_number(lists, sets[row]) if is_known else -1
        for kernel in range(3):
            share = set_votes[kernel, number] / max(totals[kernel], 1e-12) if number >= 0 else 0.0
            out[column] = math.log1p(_WEIGHT_OF_SET * share)
            column += 1
        out[column] = math.log1p(lists.set_counts[number]) if number >= 0 else 0.0
        out[column + 1] = size - num_keys
        out[column + 2] = size
        out[column + 3] = num_keys
        column += 4
        lift = 0.0
        least = np.inf
        pairs = 0
        popularity = 0.0
        rarest = np.inf
        for place in range(size):
            i = proxies[sets[row, place]]
            log_count = math.log(lists.counts[i] + 1)
            popularity += log_count / size
            rarest = min(rarest, log_count)
            for second in range(place + 1, size):
                j = proxies[sets[row, second]]
                expected = lists.counts[i] * lists.counts[j] / num_recipes
                together = count_together(lists, min(i, j), max(i, j))
                value = math.log((together + _PRIOR) / (expected + _PRIOR))
                lift += value
                least = min(least, value)
                pairs += 1
        out[column] = lift / pairs if pairs else 0.0
        out[column + 1] = least if pairs else 0.0
        out[column + 2] = popularity
        out[column + 3] = rarest
        out[column + 4] = nearest
        out[column + 5] = math.log(totals[0] + 1e-9)
        out[column + 6] = log_sizes[size - 1]
        column += 7
        distance = 0.0
        for kind in range(num_kinds):
            mean = 0.0
            for place in range(size):
                mean += styles[sets[row, place], kind] / size
            out[column + 1 + kind] = mean - near_style[kind]
            out[column + 1 + num_kinds + kind] = mean
            distance += abs(mean - near_style[kind])
        out[column] = distance


def num_features(num_kinds: int) -> int:
    """Return the number of features of a set, with so many kinds of ingredients."""
    return 8 + 2 + 3 + 4 + 7 + 1 + 2 * num_kinds
