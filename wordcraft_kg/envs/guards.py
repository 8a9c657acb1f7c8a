"""Recipes that no distractor may complete, checked for many tables at once."""

import numpy as np

from wordcraft_kg.envs.arrays import Array, Arrays
from wordcraft_kg.envs.world import World

BITS = 15
"""Recipes of a goal in one table of marks: two bits each in 31."""
_FIRST = (1 << BITS) - 1


class Guards:
    """The guarded recipes of a world's goals, as marks of their ingredients.

    The guarded recipes of a goal are numbered. The *marks* of an entity are an integer: bit k is set if the entity is
    the first ingredient of the goal's recipe k, bit k + 15 if it is the second. The marks of several entities are
    combined with a bitwise or; both bits of a recipe are then set exactly if both ingredients are among them, and
    ``marks & (marks >> 15)`` has a bit for each such recipe. So one look-up per entity checks all recipes of a goal at
    once. Goals with more than 15 guarded recipes have further tables of marks. Each guarded goal has a row; all other
    goals share row 0, which is empty.

    Tables of R environments are checked side by side: ``tasks`` has shape (R,), ``candidates`` (K, R).
    """

    def __init__(self, world: World, arrays: Arrays):
        """Mark the ingredients of the guarded recipes."""
        self.arrays = arrays
        recipes = world.graph.recipes[world.guarded_recipes]
        goals, counts = np.unique(recipes[:, 2], return_counts=True)
        tables = -(-int(counts.max()) // BITS) if len(goals) else 0
        row_of = np.zeros(world.nothing + 1, dtype=np.int64)
        row_of[goals] = np.arange(1, len(goals) + 1)
        marks = np.zeros((tables, len(goals) + 1, world.nothing + 1), dtype=np.int32)
        numbered = np.zeros(len(goals) + 1, dtype=np.int64)
        for a, b, goal in recipes.tolist():
            row = row_of[goal]
            table, bit = divmod(int(numbered[row]), BITS)
            numbered[row] += 1
            marks[table, row, a] |= 1 << bit
            marks[table, row, b] |= 1 << (bit + BITS)
        self._tables = [arrays.array(table.reshape(-1)) for table in marks]
        self._rows = arrays.array(row_of[world.tasks.goals] * (world.nothing + 1))
        near = np.concatenate([world.tasks.starts, world.makeable], axis=1)
        self._near = arrays.array(near.astype(np.int32))

    def __bool__(self) -> bool:
        """Whether any recipe is guarded."""
        return bool(self._tables)

    def at_risk(self, candidates: Array, tasks: Array) -> Array:
        """Return which tables could complete a guarded recipe if all their candidates were on them, shape (R,)."""
        risk = self.arrays.full((candidates.shape[1],), 0, "bool")
        row, near = self._rows[tasks], self._near[tasks].T
        for table in self._tables:
            marks = _marks(table, row, candidates)
            takes_part = marks != 0
            for entity in near:
                marks |= table[row + entity]
            risk |= takes_part & (_complete(marks) != 0)
        return risk

    def refuse(self, candidates: Array, allowed: Array, tasks: Array) -> Array:
        """Refuse candidates, in their order, that complete a recipe with what is there or can be made from the start.

        Where a goal has several tables of marks, a candidate that a later table refuses counts as present for the
        earlier ones, which refuses a few candidates needlessly.

        Args:
            candidates: ids.
            allowed: shape (K, R), bool: which of them are taken unless refused here; changed in place.
            tasks: the tables' tasks.
        """
        row, near = self._rows[tasks], self._near[tasks].T
        for table in self._tables:
            there = _marks(table, row, near)
            for i in range(len(candidates)):
                more = there | table[row + candidates[i]]
                allowed[i] &= (_complete(more) & ~_complete(there)) == 0
                there = self.arrays.xp.where(allowed[i], more, there)
        return allowed


def _marks(table: Array, row: Array, entities: Array) -> Array:
    """Return the marks of each column's entities, combined with a bitwise or."""
    marks = table[row + entities[0]]
    for entity in entities[1:]:
        marks |= table[row + entity]
    return marks


def _complete(marks: Array) -> Array:
    """Return a bit for each recipe of which both ingredients are marked."""
    return marks & (marks >> BITS) & _FIRST
