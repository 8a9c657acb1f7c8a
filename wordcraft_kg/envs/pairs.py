"""Numbers and results of pairs of entities, for many pairs at once."""

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.envs.arrays import Array, Arrays
from wordcraft_kg.graphs.recipe_graph import RecipeGraph

# Largest number of entities for a square table of all pairs, with 4 bytes a cell: 64 MiB.
_DENSE_LIMIT = 4_096


class Pairs:
    """Numbers of pairs by entity ids: a table for a small graph, otherwise a binary search.

    Attributes:
        no_pair: the number of all pairs without a result, equal to the graph's number of pairs.
        results: results of each pair, padded with the id of nothing: shape (num_pairs + 1, r). The
            last row, of pairs without results, is empty.
    """

    def __init__(
        self,
        graph: RecipeGraph,
        usable: NDArray[np.bool_],
        arrays: Arrays,
        *,
        keeps_last: bool = False,
    ):
        """Look up pairs of a graph by some of its recipes.

        Args:
            graph: the recipe graph, whose pair numbers count.
            usable: shape (num_recipes,), bool: recipes that make something.
            arrays: array operations by NumPy or torch.
            keeps_last: whether a pair makes its last result only.
        """
        self.xp = arrays.xp
        self.size = graph.num_entities + 1
        self.no_pair = graph.num_pairs
        rows = np.flatnonzero(usable)
        if keeps_last:
            pair = graph.pair_of_recipe[rows]
            rows = rows[np.append(pair[1:] != pair[:-1], True)[: len(rows)]]
        a, b, result = graph.recipes[rows].T
        pair, first, counts = np.unique(
            graph.pair_of_recipe[rows], return_index=True, return_counts=True
        )
        # Recipes are sorted by pair: a result's place is its distance from the pair's first.
        place = np.arange(len(rows)) - np.repeat(first, counts)
        results = np.full((self.no_pair + 1, counts.max(initial=1)), graph.num_entities)
        results[np.repeat(pair, counts), place] = result
        self.results = arrays.array(results)
        self.is_dense = graph.num_entities <= _DENSE_LIMIT
        if self.is_dense:
            # Row and column E, of nothing, keep `no_pair`, so callers need no mask.
            table = np.full((self.size, self.size), self.no_pair, dtype=np.int32)
            table[a[first], b[first]] = pair
            table[b[first], a[first]] = pair
            self._table = arrays.array(table.reshape(-1))
        else:
            # A sentinel at the end, so that a search for any key ends at a valid index.
            sentinel = np.iinfo("int64").max
            self._keys = arrays.array(np.append(a[first] * self.size + b[first], sentinel))
            self._numbers = arrays.array(np.append(pair, self.no_pair))

    def __call__(self, one: Array, other: Array) -> Array:
        """Return pair numbers, for ids of equal shapes, in any order."""
        if self.is_dense:
            return self._table.take(one * self.size + other)
        lower = self.xp.minimum(one, other)
        higher = self.xp.maximum(one, other)
        keys = lower * self.size + higher
        places = self.xp.searchsorted(self._keys, keys)
        return self.xp.where(self._keys[places] == keys, self._numbers[places], self.no_pair)
