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


def read_tensors(path: Path, data: bytes) -> dict[str, torch.Tensor]:
    """Return the tensors in a safetensors file by name.

    safetensors and not pickle: reading a file from the internet runs no code of its author.

    Args:
        path: where the bytes come from, for the error.
        data: content of the file.

    Raises:
        ArtefactError: if the file is damaged, or a tensor holds NaN or infinity.
    """
    try:
        tensors = safetensors.torch.load(data)
    except (SafetensorError, ValueError, KeyError) as error:
        raise ArtefactError(
            f"{path} is damaged ({error}). Train the model again, or restore a copy."
        ) from None
    for name, tensor in tensors.items():
        if not _is_finite(tensor):
            raise ArtefactError(
                f"{path} is damaged: the tensor {name} holds NaN or infinity. "
                "Train the model again, or restore a copy."
            )
    return tensors


def _is_finite(tensor: Tensor) -> bool:
    if not tensor.is_floating_point() or not tensor.numel():
        return True
    # The extremes are enough: NaN is an extreme for torch. Checking each number would take twice
    # the tensor's memory.
    return bool(torch.isfinite(torch.stack(tensor.aminmax())).all())


def with_prefix(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return the tensors whose name begins with ``prefix``; the returned names omit the prefix."""
    return {
        name.removeprefix(prefix): tensor
        for name, tensor in tensors.items()
        if name.startswith(prefix)
    }


def lazily_zero(tensor: Tensor) -> Tensor:
    """Return a zero tensor, shaped and typed like ``tensor``; it takes memory when written."""
    # NumPy takes zero pages from the system, which cost nothing until a write; torch writes zeros.
    return torch.from_numpy(np.zeros(tensor.shape, tensor.numpy().dtype))


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
