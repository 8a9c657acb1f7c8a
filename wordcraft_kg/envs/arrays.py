"""Arrays and look-ups of recipes for the batched engine: NumPy on the CPU, torch on a device.

The engine is written once, with operators, indexing and functions that both libraries share; this
module holds the rest. On the CPU, NumPy is twice as fast as torch, because a step is some thirty
calls on short arrays, and a call costs NumPy half as much; an agent sees the same memory through
``torch.from_numpy``. On a device, tensors never leave the device.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs import Ids, RecipeGraph

Array = NDArray[Any]
"""A NumPy array, or a torch tensor on a device, limited to NumPy's interface."""


class Arrays:
    """Array operations on the CPU, by NumPy; a subclass provides the same operations by torch.

    Attributes:
        xp: the module, ``numpy`` or ``torch``.
        on_device: whether arrays lie on a device. Reading a value there waits for pending work, so
            all rows are computed, and masks select the valid rows.
    """

    xp: Any = np
    on_device = False

    def array(self, values: NDArray[Any]) -> Array:
        """Convert a NumPy array to this library's array."""
        return np.ascontiguousarray(values)

    def numpy(self, values: Array) -> NDArray[Any]:
        """Copy an array to a NumPy array."""
        return np.array(values)

    def copy(self, values: Array) -> Array:
        """Copy an array."""
        return values.copy()

    def full(
        self,
        shape: tuple[int, ...],
        value: int,
        dtype: str = "int64",
    ) -> Array:
        """Return an array with the same value everywhere.

        Args:
            shape: its shape.
            value: the value.
            dtype: name of a data type that both libraries know.
        """
        values = np.empty(shape, dtype)
        values.fill(value)  # a third of the time of `np.full`, for few environments
        return values

    def cast(self, values: Array, dtype: str) -> Array:
        """Convert an array to a data type, such as ``float32``."""
        return values.astype(dtype)

    def sorted_rows(self, values: Array) -> Array:
        """Return a matrix with the values sorted within each row."""
        rows = np.array(values, order="C")  # three times as fast as sorting a transposed view
        rows.sort(axis=1)
        return rows

    def row_sums(self, values: Array) -> Array:
        """Return the sum of each row of a matrix of integers or booleans, int64, with overflow."""
        # A tenth of the time of `sum` for short rows.
        return values @ np.ones(values.shape[1], dtype=np.int64)

    def take_rows(self, values: Array, rows: Array) -> Array:
        """Return the rows with the given indices."""
        return values.take(rows, axis=0)  # several times as fast as an index

    def rows(self, mask: Array) -> Array:
        """Return the indices of True rows in a mask; on a device all rows.

        Counting the rows would wait for the device.
        """
        return mask.nonzero()[0]


class _TorchArrays(Arrays):
    """A device's arrays; the device ``cpu`` lets tests run the code for devices."""

    on_device = True

    def __init__(self, device: str):
        import torch

        if device.startswith("cuda") and not torch.cuda.is_available():
            raise ConfigError(f"`device` {device!r}: torch finds no CUDA device here; use cpu.")
        self.torch: Any = torch
        self.xp = torch
        self.device = device

    def array(self, values: NDArray[Any]) -> Array:
        return self.torch.tensor(values, device=self.device)

    def numpy(self, values: Any) -> NDArray[Any]:
        return np.array(values.cpu().numpy())

    def copy(self, values: Any) -> Array:
        return values.clone()

    def full(
        self,
        shape: tuple[int, ...],
        value: int,
        dtype: str = "int64",
    ) -> Array:
        return self.torch.full(shape, value, dtype=getattr(self.torch, dtype), device=self.device)

    def cast(self, values: Any, dtype: str) -> Array:
        return values.to(getattr(self.torch, dtype))

    def sorted_rows(self, values: Array) -> Array:
        return self.torch.sort(values, dim=1).values

    def row_sums(self, values: Any) -> Array:
        return values.sum(1)

    def take_rows(self, values: Array, rows: Array) -> Array:
        return values[rows]

    def rows(self, mask: Array) -> Array:
        return self.torch.arange(len(mask), device=self.device)


def arrays_of(device: str) -> Arrays:
    """Return the array operations for a device.

    ``cpu`` is NumPy; a torch device such as ``cuda`` is torch, and ``torch:cpu`` torch on the CPU,
    for tests.

    Raises:
        ConfigError: if torch finds no such device.
    """
    return Arrays() if device == "cpu" else _TorchArrays(device.removeprefix("torch:"))


STRIDE = -7046029254386353131
"""Keys that differ by multiples of this odd number, 2**64 / golden ratio, hash independently."""


def mixed(x: Array) -> Array:
    """Hash 64-bit integers with the finaliser of SplitMix64 (Steele et al. 2014).

    Products wrap around at 64 bits.
    """
    # Shifts of signed integers copy the sign, so the masks make them shifts of unsigned ones, which
    # torch lacks.
    x = x ^ ((x >> 30) & 0x3FFFFFFFF)
    x *= -4658895280553007687
    x ^= (x >> 27) & 0x1FFFFFFFFF
    x *= -7723592293110705685
    x ^= (x >> 31) & 0x1FFFFFFFF
    return x


# Largest number of entities for a square table of all pairs, with 4 bytes a cell: 64 MiB.
_DENSE_LIMIT = 4_096


class _Lookup:
    """Results by number of a pair or set, as in ``graph.pair_of_recipe``.

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
    ):
        """Store the results of some recipes of a graph.

        Args:
            graph: the recipe graph, whose pair numbers count.
            usable: shape (num_recipes,), bool: recipes that make something.
            arrays: array operations by NumPy or torch.
        """
        self._arrays = arrays
        self.no_pair = graph.num_pairs
        rows = np.flatnonzero(usable)
        pair, first, counts = np.unique(
            graph.pair_of_recipe[rows], return_index=True, return_counts=True
        )
        # Recipes are sorted by pair: a result's place is its distance from the pair's first.
        place = np.arange(len(rows)) - np.repeat(first, counts)
        results = np.full((self.no_pair + 1, counts.max(initial=1)), graph.num_entities)
        results[np.repeat(pair, counts), place] = graph.sets[rows, -1]
        self.results = arrays.array(results)
        # The numbers of pairs with a result, ascending, and the first recipe of each.
        self._pair: Ids = pair
        self._first_rows: Ids = rows[first]


class Pairs(_Lookup):
    """Numbers of pairs by entity ids: a table for a small graph, otherwise a binary search."""

    def __init__(
        self,
        graph: RecipeGraph,
        usable: NDArray[np.bool_],
        arrays: Arrays,
    ):
        """Look up pairs of a graph; arguments as of the base class.

        Raises:
            GraphError: if a recipe has more than two ingredients, or one.
        """
        super().__init__(graph, usable, arrays)
        self.size = graph.num_entities + 1
        a, b, _ = graph.recipes[self._first_rows].T
        self.is_dense = graph.num_entities <= _DENSE_LIMIT
        if self.is_dense:
            # Row and column E, of nothing, keep `no_pair`, so callers need no mask.
            table = np.full((self.size, self.size), self.no_pair, dtype=np.int32)
            table[a, b] = self._pair
            table[b, a] = self._pair
            self._table = arrays.array(table.reshape(-1))
        else:
            # A sentinel at the end, so that a search for any key ends at a valid index.
            sentinel = np.iinfo("int64").max
            self._keys = arrays.array(np.append(a * self.size + b, sentinel))
            self._numbers = arrays.array(np.append(self._pair, self.no_pair))

    def __call__(self, first: Array, second: Array) -> Array:
        """Return pair numbers, for ids of equal shapes, in any order."""
        if self.is_dense:
            return self._table.take(first * self.size + second)
        lower = self._arrays.xp.minimum(first, second)
        higher = self._arrays.xp.maximum(first, second)
        keys = lower * self.size + higher
        places = self._arrays.xp.searchsorted(self._keys, keys)
        has_result = self._keys[places] == keys
        return self._arrays.xp.where(has_result, self._numbers[places], self.no_pair)


class Sets(_Lookup):
    """Numbers of ingredient sets, by a binary search for the sum of their entities' hashes."""

    def __init__(
        self,
        graph: RecipeGraph,
        usable: NDArray[np.bool_],
        arrays: Arrays,
    ):
        """Look up sets of a graph; arguments as of the base class."""
        super().__init__(graph, usable, arrays)
        # A sum does not depend on the order, and counts an entity as often as it is there. Nothing,
        # the padding, adds 0. Sums wrap around at 64 bits.
        hashes = mixed(np.arange(1, graph.num_entities + 2) * STRIDE)
        hashes[-1] = 0
        members = graph.sets[self._first_rows, :-1]
        keys = hashes[members].sum(axis=1)
        order = np.argsort(keys)
        # A last row that no picks have, so that a search for any key ends at a valid index.
        unreal = np.full((1, members.shape[1]), -1)
        self._hashes = arrays.array(hashes)
        self._keys = arrays.array(np.append(keys[order], np.iinfo("int64").max))
        self._members = arrays.array(np.concatenate([members[order], unreal]))
        self._numbers = arrays.array(np.append(self._pair[order], self.no_pair))

    def __call__(self, picks: Array) -> Array:
        """Return the numbers of picked sets (R, S), padded with nothing, in any order: (R,)."""
        arrays = self._arrays
        keys = arrays.row_sums(self._hashes[picks])
        places = arrays.xp.searchsorted(self._keys, keys)
        pair = arrays.full((len(picks),), self.no_pair)
        rows = arrays.rows(self._keys[places] == keys)
        if len(rows):
            # Equal sums are no proof of equal sets.
            is_equal = (self._members[places[rows]] == arrays.sorted_rows(picks[rows])).all(1)
            pair[rows] = arrays.xp.where(is_equal, self._numbers[places[rows]], self.no_pair)
        return pair
