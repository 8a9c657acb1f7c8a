"""The arrays that the batched engine computes with: NumPy's on the CPU, torch's on a device.

The engine is written once, in the operators, the indexing and the functions that both share; here is what they spell
differently. On the CPU its arrays are NumPy's, because a step is some thirty calls on short arrays and a call costs
NumPy half of what it costs torch; an agent sees the same memory through ``torch.from_numpy``. On a CUDA device they are
torch tensors that never leave it.
"""

from collections.abc import Sequence
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.errors import ConfigError

Array = NDArray[Any]
"""A NumPy array, or on a device a torch tensor, which is used only in ways in which NumPy's arrays can be used too."""
Values = Array | float


class Functions(Protocol):
    """What NumPy and torch spell the same."""

    def where(self, mask: Array, one: Values, other: Values, /) -> Array: ...  # noqa: D102
    def concatenate(self, parts: Sequence[Array], axis: int = 0, /) -> Array: ...  # noqa: D102
    def cumsum(self, values: Array, axis: int, /) -> Array: ...  # noqa: D102
    def searchsorted(self, values: Array, wanted: Array, *, side: str = "left") -> Array: ...  # noqa: D102
    def minimum(self, one: Array, other: Array, /) -> Array: ...  # noqa: D102
    def maximum(self, one: Array, other: Array, /) -> Array: ...  # noqa: D102


class Arrays:
    """NumPy's arrays.

    Attributes:
        xp: the functions that both kinds have.
        on_device: whether they are a device's. Looking at a value there waits for all that is under way, so nothing may
            depend on one: all rows are computed, and masks say which of them count.
    """

    xp = cast(Functions, np)
    on_device = False

    def array(self, values: NDArray[Any]) -> Array:
        """Bring NumPy values to this side."""
        return np.ascontiguousarray(values)

    def numpy(self, values: Array) -> NDArray[Any]:
        """Return a copy of NumPy's kind."""
        return np.array(values)

    def full(self, shape: tuple[int, ...], value: int, dtype: str = "int64") -> Array:
        """Return an array of one value."""
        return np.full(shape, value, dtype=dtype)

    def cast(self, values: Array, dtype: str) -> Array:
        """Return values as another type."""
        return values.astype(dtype)

    def sorted_rows(self, values: Array) -> Array:
        """Return a matrix with each row sorted."""
        return np.sort(values, axis=1)

    def take_in_rows(self, values: Array, columns: Array) -> Array:
        """Return the values of each row in the columns given for it."""
        return np.take_along_axis(values, columns, axis=1)

    def rows(self, mask: Array) -> Array:
        """Return the rows to compute: those where the mask is True, on a device all."""
        return mask.nonzero()[0]


class TorchArrays(Arrays):
    """A device's arrays; the device ``cpu`` does there what a device does, for tests."""

    on_device = True

    def __init__(self, device: str):
        """Take a device of torch.

        Raises:
            ConfigError: if it is not there.
        """
        import torch

        if device.startswith("cuda") and not torch.cuda.is_available():
            raise ConfigError(f"device '{device}': torch finds no CUDA device here; use cpu.")
        self.torch: Any = torch
        self.xp = cast(Functions, torch)
        self.device = device

    def array(self, values: NDArray[Any]) -> Array:  # noqa: D102 - these say what those of NumPy say
        return self.torch.tensor(values, device=self.device)

    def numpy(self, values: Any) -> NDArray[Any]:  # noqa: D102
        return np.array(values.cpu().numpy())

    def full(self, shape: tuple[int, ...], value: int, dtype: str = "int64") -> Array:  # noqa: D102
        return self.torch.full(shape, value, dtype=getattr(self.torch, dtype), device=self.device)

    def cast(self, values: Any, dtype: str) -> Array:  # noqa: D102
        return values.to(getattr(self.torch, dtype))

    def sorted_rows(self, values: Array) -> Array:  # noqa: D102
        return self.torch.sort(values, dim=1).values

    def take_in_rows(self, values: Any, columns: Array) -> Array:  # noqa: D102
        return values.gather(1, self.cast(columns, "int64"))

    def rows(self, mask: Array) -> Array:  # noqa: D102
        return self.torch.arange(len(mask), device=self.device)


def arrays_of(device: str) -> Arrays:
    """Return the arrays of ``cpu``, of a device of torch such as ``cuda``, or with ``torch:cpu`` of torch on the CPU.

    Raises:
        ConfigError: if the device is not there.
    """
    return Arrays() if device == "cpu" else TorchArrays(device.removeprefix("torch:"))
