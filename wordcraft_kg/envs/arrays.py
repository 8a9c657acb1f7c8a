"""Arrays and look-ups of pairs for the batched engine: NumPy on the CPU, torch on a device.

The engine is written once, with operators, indexing and functions that both libraries share; this
module holds the rest. On the CPU, NumPy is twice as fast as torch, because a step is some thirty
calls on short arrays, and a call costs NumPy half as much; an agent sees the same memory through
``torch.from_numpy``. On a device, tensors never leave the device.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.recipe_graph import RecipeGraph

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
        self._arrays = arrays
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
