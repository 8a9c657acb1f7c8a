"""Guarded recipes, which distractors must not complete, checked for many tables at once."""

from typing import Any

import numpy as np

from wordcraft_kg.envs.arrays import Array, Arrays
from wordcraft_kg.envs.world import World

BITS = 31  # recipes in one table of marks: two bits each in 62
_FILTER_BITS = 15  # recipes that the filter distinguishes: two bits each in 30
_ROOM = 32  # places in the filter per ingredient: more give fewer false alarms, fewer fit a smaller cache


class Guards:
    """A check whether distractors complete a guarded recipe (one that tables must not offer) for the goal.

    The *marks* of an entity are an integer: bit k is set if the entity is the first ingredient of the goal's guarded
    recipe k, bit k + 31 for the second ingredient; marks combine with a bitwise or. One look-up per entity checks up to
    31 recipes; goals with more recipes have further tables. Only ingredients of guarded recipes have marks, found by
    binary search, so memory grows with the recipes.

    Most tables are far from completing a guarded recipe. A *filter* finds the tables at risk, in a table of marks small
    enough for the processor's cache: ingredients share places and recipes share 15 bits, so no risk is missed.

    Tables of R environments are checked together: ``tasks`` holds task indices, shape (R,), and ``candidates`` K ids of
    possible distractors for each, shape (K, R).
    """

    def __init__(self, world: World, arrays: Arrays):
        """Mark the ingredients of guarded recipes, and each task's starting ingredients with all products."""
        self.arrays = arrays
        recipes = world.graph.recipes[world.guarded_recipes]
        recipes = recipes[np.argsort(recipes[:, 2], kind="stable")]
        goals, first, counts = np.unique(recipes[:, 2], return_index=True, return_counts=True)
        number = np.arange(len(recipes)) - np.repeat(first, counts)
        # An entity of a goal has the key row + entity. Odd strides spread the keys' last bits, which index the filter.
        stride = (world.nothing + 1) | 1
        row_of = np.zeros(world.nothing + 1, dtype=np.int64)
        row_of[goals] = np.arange(1, len(goals) + 1) * stride
        pairs = row_of[recipes[:, 2:]] + recipes[:, :2]
        keys, place = np.unique(pairs, return_inverse=True)
        place = place.reshape(-1, 2)
        tables = int(number.max()) // BITS + 1 if len(number) else 0
        marks = np.zeros(
            (tables, len(keys) + 1), dtype=np.int64
        )  # the last marks belong to entities without any
        self._mask = (1 << (_ROOM * len(keys)).bit_length()) - 1
        folded = np.zeros(self._mask + 1, dtype=np.int32)
        for side in range(2):
            bit = np.int64(1) << (number % BITS + side * BITS)
            np.bitwise_or.at(marks, (number // BITS, place[:, side]), bit)
            # Most goals have a recipe or two: counted from the goal's id, goals that share places rarely share bits.
            bit = np.int64(1) << ((number + recipes[:, 2]) % _FILTER_BITS + side * _FILTER_BITS)
            np.bitwise_or.at(folded, pairs[:, side] & self._mask, bit.astype(np.int32))
        keys = np.append(keys, np.iinfo(np.int64).max)
        self._keys = arrays.array(keys)
        self._tables = [arrays.array(table) for table in marks]
        self._filter = arrays.array(folded)
        rows = row_of[world.tasks.goals]
        self._rows = arrays.array(rows)
        if tables:
            near = np.concatenate([world.tasks.starts, world.makeable], axis=1)
            near_keys = (
                rows[:, None] + near
            ).T  # "nothing" is not an ingredient, but may share a place in the filter
            self._near_folded = arrays.array(np.bitwise_or.reduce(folded[near_keys & self._mask]))
            places = _find(np, keys, near_keys)
            self._near = [arrays.array(np.bitwise_or.reduce(table[places])) for table in marks]

    def __bool__(self) -> bool:
        """Whether any recipe is guarded."""
        return bool(self._tables)

    def at_risk(self, candidates: Array, tasks: Array) -> Array:
        """Return for R tables whether their candidates may complete a guarded recipe for the goal, shape (R,), bool."""
        if not self:
            return self.arrays.full((candidates.shape[1],), 0, "bool")
        marks = self._filter[(self._rows[tasks] + candidates) & self._mask]
        theirs = marks[0]
        for more in marks[1:]:
            theirs = theirs | more
        return _completed(theirs, self._near_folded[tasks], _FILTER_BITS) != 0

    def refuse(self, candidates: Array, allowed: Array, tasks: Array) -> Array:
        """Set candidates that complete a guarded recipe to False in ``allowed``, K candidates in R tables, (K, R)."""
        keys = self._rows[tasks] + candidates
        places = _find(self.arrays.xp, self._keys, keys)
        candidate_marks = [table[places] for table in self._tables]
        present_marks = [near[tasks] for near in self._near]
        for i in range(len(candidates)):
            for marks, present in zip(candidate_marks, present_marks, strict=True):
                allowed[i] &= _completed(marks[i], present, BITS) == 0
            present_marks = [
                present | self.arrays.xp.where(allowed[i], marks[i], 0)
                for marks, present in zip(candidate_marks, present_marks, strict=True)
            ]
        return allowed


def _find(xp: Any, keys: Array, wanted: Array) -> Array:
    """Return indices in sorted keys; the last index, a sentinel, for missing keys."""
    places = xp.searchsorted(keys, wanted)
    return xp.where(keys[places] == wanted, places, len(keys) - 1)


def _completed(marks: Array, present: Array, bits: int) -> Array:
    """Return a bit for each recipe that the marks complete, alone or with the present marks."""
    return ((marks & ((marks | present) >> bits)) | ((marks >> bits) & present)) & ((1 << bits) - 1)
