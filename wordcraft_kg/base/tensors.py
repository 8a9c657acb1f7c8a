"""Tensors in files, and conversion between arrays and tensors."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor

from wordcraft_kg.base.errors import ArtefactError, ConfigError

MAX_WEIGHT = 1e6
"""Largest absolute value of a number in a stored model.

Trained ones are below 100. With three layers of larger numbers, scores would be infinite or NaN.
"""
_DTYPES = (
    *(torch.bool, torch.uint8, torch.int32, torch.int64),
    *(torch.float16, torch.float32, torch.float64),
)
"""Types of stored tensors."""


def read_tensors(
    path: Path,
    data: bytes,
    largest_value: float = MAX_WEIGHT,
) -> dict[str, torch.Tensor]:
    """Return the tensors in a safetensors file by name.

    safetensors and not pickle: reading a file from the internet runs no code of its author.

    Args:
        path: where the bytes come from, for the error.
        data: content of the file.
        largest_value: limit of the absolute values of floating-point numbers.

    Raises:
        ArtefactError: if the file is damaged, or a tensor has a type that this package does not
            write, or holds NaN, infinity or a number above the limit.
    """
    try:
        tensors = safetensors.torch.load(data)
    except (SafetensorError, ValueError, KeyError) as error:
        raise ArtefactError(
            f"{path} is damaged ({error}). Train the model again, or restore a copy."
        ) from None
    for name, tensor in tensors.items():
        if tensor.dtype not in _DTYPES:
            expected = ", ".join(map(str, _DTYPES))
            raise ArtefactError(
                f"{path}: the tensor {name!r} has type {tensor.dtype}; expected one of {expected}. "
                "Train the model again, or restore a copy."
            )
        if not largest(tensor) <= largest_value:
            raise ArtefactError(
                f"{path} is damaged: the tensor {name!r} holds NaN, infinity or a number above "
                f"{largest_value:g}. Train the model again, or restore a copy."
            )
    return tensors


def largest(tensor: Tensor) -> float:
    """Return the largest absolute value of floating-point numbers, NaN if one is; else 0."""
    if not tensor.is_floating_point() or not tensor.numel():
        return 0.0
    # NaN is an extreme for torch. Absolute values would take the tensor's memory again.
    low, high = torch.stack(tensor.aminmax()).tolist()
    return float(max(-low, high))


def check_tensors(
    tensors: Mapping[str, Tensor],
    layouts: Mapping[str, str],
    **sizes: int,
) -> None:
    """Check types and shapes of tensors from a file; :func:`read_tensors` has checked the numbers.

    Args:
        tensors: tensors by name; further tensors are ignored.
        layouts: each expected tensor's axis names, then its type, such as ``N N float32``. Axes
            with the same name have the same size, also across tensors.
        **sizes: known sizes by axis name; the first tensor with another axis sets the axis's size.

    Raises:
        KeyError: if a tensor is missing.
        ValueError: if a tensor has another type or shape.
    """
    for name, layout in layouts.items():
        *axes, dtype = layout.split()
        tensor = tensors[name]
        # With too few or too many axes, the comparison of `ndim` below fails.
        expected = [
            sizes.setdefault(axis, size) for axis, size in zip(axes, tensor.shape, strict=False)
        ]
        if (
            str(tensor.dtype) != f"torch.{dtype}"
            or len(axes) != tensor.ndim
            or expected != list(tensor.shape)
        ):
            shape = ", ".join(f"{axis} = {sizes[axis]}" for axis in axes if axis in sizes)
            raise ValueError(
                f"{name} has type {tensor.dtype}, shape {tuple(tensor.shape)}: expected {layout}"
                f" with {shape or 'no axes'}"
            )


def with_prefix(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return the tensors whose name begins with ``prefix``; the returned names omit the prefix."""
    return {
        name.removeprefix(prefix): tensor
        for name, tensor in tensors.items()
        if name.startswith(prefix)
    }


def copied(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return contiguous CPU copies of named tensors, for writing in safetensors format."""
    # A clone, because safetensors refuses tensors that share memory.
    return {name: tensor.detach().cpu().clone().contiguous() for name, tensor in tensors.items()}


def as_tensor(values: Any) -> Tensor:
    """Return a NumPy array as a tensor that shares its memory; return a tensor unchanged."""
    return torch.from_numpy(values) if isinstance(values, np.ndarray) else values


def check_device(device: str) -> None:
    """Check that torch can compute on a device, such as ``cuda``, by computing on it once.

    Raises:
        ConfigError: if the device is unknown or not available.
    """
    try:
        torch.zeros(1, device=device).item()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"`device` {device!r}: not available here ({reason}). Use cpu.") from None


@contextmanager
def torch_threads(number: int) -> Iterator[None]:
    """Limit torch to a number of CPU threads in this block."""
    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)
