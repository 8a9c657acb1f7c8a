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
    """Return tensors from safetensors bytes by name; ArtefactError naming ``path`` for damage, NaN or infinity."""
    try:
        tensors = safetensors.torch.load(data)
    except (SafetensorError, ValueError, KeyError) as error:
        raise ArtefactError(
            f"{path} is damaged ({error}). Train the model again, or restore a copy."
        ) from None
    for name, tensor in tensors.items():
        # Checking the extremes is enough; checking each number takes twice the tensor's memory.
        if (
            tensor.is_floating_point()
            and tensor.numel()
            and not torch.isfinite(torch.stack(tensor.aminmax())).all()
        ):
            raise ArtefactError(
                f"{path} is damaged: the tensor {name} holds NaN or infinity. Train the model again, or restore a copy."
            )
    return tensors


def with_prefix(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return the tensors with names that begin with ``prefix``; the returned names omit the prefix."""
    return {
        name.removeprefix(prefix): tensor
        for name, tensor in tensors.items()
        if name.startswith(prefix)
    }


def lazily_zero(tensor: Tensor) -> Tensor:
    """Return a zero tensor with the shape and type of ``tensor`` that takes no memory until values are written."""
    return torch.from_numpy(np.zeros(tensor.shape, tensor.numpy().dtype))


def copied(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return contiguous CPU copies of named tensors, for writing in safetensors format."""
    return {name: tensor.detach().cpu().clone().contiguous() for name, tensor in tensors.items()}


def as_tensor(values: Any) -> Tensor:
    """Return a NumPy array as a tensor that shares the array's memory; return a tensor unchanged."""
    return torch.from_numpy(values) if isinstance(values, np.ndarray) else values


def check_device(device: str) -> None:
    """Raise a :class:`ConfigError` unless torch can compute on the named device, such as ``cuda``."""
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
