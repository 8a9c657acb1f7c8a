"""Guarded recipes, which distractors must not complete, checked for many tables at once."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.envs.arrays import Array, Arrays
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.arrays import Ids

BITS = 31
"""Recipes in one table of marks: two bits each, so 62 bits of an int64, without its sign."""
# Recipes that the filter distinguishes: two bits each in 30.
_FILTER_BITS = 15
# Places in the filter per ingredient: more give fewer false alarms, fewer fit a smaller cache.
_ROOM = 32


class Guards:
    """A check whether distractors complete a guarded recipe for the goal.

    A guarded recipe is one that tables must not offer, see :attr:`World.guarded_recipes`.

    The *marks* of an entity are an integer: bit k is set if the entity is the first ingredient of
    the goal's guarded recipe k, bit k + 31 for the second ingredient; marks combine with a bitwise
    or. One look-up per entity checks up to 31 recipes; goals with more recipes have further tables.
    Only ingredients of guarded recipes have marks, found by binary search, so memory grows with the
    recipes.

    Most tables are far from completing a guarded recipe. A *filter* finds the tables at risk, in a
    table of marks small enough for the processor's cache: ingredients share places and recipes
    share 15 bits. So there are false alarms, but no risk is missed.

    Tables of R environments are checked together: ``tasks`` holds task indices, shape (R,), and
    ``candidates`` K ids of possible distractors for each, shape (K, R).
    """

    def __init__(self, world: World, arrays: Arrays):
        """Mark the ingredients of guarded recipes, and each task's start with all products."""
        self.arrays = arrays
        # Recipes by goal, numbered from 0 for each goal.
        recipes = world.graph.recipes[world.guarded_recipes]
        recipes = recipes[np.argsort(recipes[:, 2], kind="stable")]
        made = recipes[:, 2]
        goals, first, counts = np.unique(
            made,
            return_index=True,
            return_counts=True,
        )
        # Row of the first recipe for the same goal, for each recipe.
        first_of_goal = np.repeat(first, counts)
        number = np.arange(len(recipes)) - first_of_goal

        # An entity of a goal has the key row + entity. Odd strides spread the keys' last bits,
        # which index the filter. Row 0 belongs to goals without guarded recipes.
        stride = (world.nothing + 1) | 1
        row_of = np.zeros(world.nothing + 1, dtype=np.int64)
        row_of[goals] = np.arange(1, len(goals) + 1) * stride
        pairs = row_of[made][:, None] + recipes[:, :2]
        keys, place = np.unique(pairs, return_inverse=True)
        place = place.reshape(-1, 2)  # the shape of inverses differs between versions of NumPy

        # A power of two, so that a bitwise and replaces a remainder.
        places_wanted = _ROOM * len(keys)
        num_places = 1 << places_wanted.bit_length()
        self._mask = num_places - 1
        marks = _marks(number, place, len(keys))
        folded = np.zeros(self._mask + 1, dtype=np.int32)
        # Most goals have a recipe or two: counted from the goal's id, goals that share places
        # rarely share bits.
        bit_number = (number + made) % _FILTER_BITS
        for side in range(2):
            shift = bit_number + side * _FILTER_BITS
            bit = np.int64(1) << shift
            places = pairs[:, side] & self._mask
            # `at`, because an ingredient of several recipes occurs several times.
            np.bitwise_or.at(folded, places, bit.astype(np.int32))

        # A sentinel after all keys, so that every search ends at a valid index.
        keys = np.append(keys, np.iinfo(np.int64).max)
        self._keys = arrays.array(keys)
        self._tables = [arrays.array(table) for table in marks]
        self._filter = arrays.array(folded)
        rows = row_of[world.tasks.goals]
        self._rows = arrays.array(rows)
        if len(marks):
            near = np.concatenate([world.tasks.starts, world.makeable], axis=1)
            # "Nothing", which pads both, is no ingredient, but may share a place in the filter.
            near_keys = (rows[:, None] + near).T
            folded_near = folded[near_keys & self._mask]
            self._near_folded = arrays.array(np.bitwise_or.reduce(folded_near))
            places = _find(np, keys, near_keys)
            of_tables = [np.bitwise_or.reduce(table[places]) for table in marks]
            self._near = [arrays.array(near_marks) for near_marks in of_tables]

    def __bool__(self) -> bool:
        """Whether any recipe is guarded."""
        return bool(self._tables)

    def at_risk(self, candidates: Array, tasks: Array) -> Array:
        """Return which tables' candidates may complete a guarded recipe for the goal.

        Args:
            candidates: shape (K, R).
            tasks: shape (R,).

        Returns:
            shape (R,), bool. True where :meth:`refuse` has to look; never False in error.
        """
        if not self:
            return self.arrays.full((candidates.shape[1],), 0, "bool")
        marks = self._filter[(self._rows[tasks] + candidates) & self._mask]
        theirs = marks[0]
        for more in marks[1:]:
            theirs = theirs | more
        return _completed(theirs, self._near_folded[tasks], _FILTER_BITS) != 0

    def refuse(
        self,
        candidates: Array,
        allowed: Array,
        tasks: Array,
    ) -> Array:
        """Refuse candidates, in their order, that complete a guarded recipe.

        A recipe is complete with the start, its products, and candidates that were taken before.

        Args:
            candidates: shape (K, R).
            allowed: shape (K, R), bool: candidates that are taken unless refused here; changed in
                place.
            tasks: shape (R,).

        Returns:
            ``allowed``.
        """
        keys = self._rows[tasks] + candidates
        places = _find(self.arrays.xp, self._keys, keys)
        candidate_marks = [table[places] for table in self._tables]
        present_marks = [near[tasks] for near in self._near]
        for i in range(len(candidates)):
            for marks, present in zip(candidate_marks, present_marks, strict=True):
                allowed[i] &= _completed(marks[i], present, BITS) == 0
            # Present from now on, if no table of marks has refused it.
            for table, marks in enumerate(candidate_marks):
                taken = self.arrays.xp.where(allowed[i], marks[i], 0)
                present_marks[table] = present_marks[table] | taken
        return allowed


def _marks(
    number: Ids,
    place: Ids,
    amount: int,
) -> NDArray[np.int64]:
    """Return the marks of ingredients, a row for each table of 31 recipes.

    Args:
        number: shape (n,): number of each recipe among its goal's.
        place: shape (n, 2): number of each ingredient.
        amount: number of ingredients.

    Returns:
        shape (tables, amount + 1); the last column belongs to entities without marks.
    """
    tables = int(number.max()) // BITS + 1 if len(number) else 0
    marks = np.zeros((tables, amount + 1), dtype=np.int64)
    for side in range(2):
        bit = np.int64(1) << (number % BITS + side * BITS)
        # `at`, because an ingredient of several recipes occurs several times.
        np.bitwise_or.at(marks, (number // BITS, place[:, side]), bit)
    return marks


def _find(
    xp: Any,
    keys: Array,
    wanted: Array,
) -> Array:
    """Return indices in sorted keys; the last index, a sentinel, for missing keys."""
    places = xp.searchsorted(keys, wanted)
    return xp.where(keys[places] == wanted, places, len(keys) - 1)


def _completed(
    marks: Array,
    present: Array,
    bits: int,
) -> Array:
    """Return a bit for each recipe that the marks complete, alone or with the present marks."""
    # The first ingredient is among the marks and the second anywhere, or the other way round.
    second_anywhere = (marks | present) >> bits
    of_first = marks & second_anywhere
    of_second = (marks >> bits) & present
    return (of_first | of_second) & ((1 << bits) - 1)
