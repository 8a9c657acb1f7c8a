"""Tensors in files, and arrays as tensors."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor

from wordcraft_kg.base.errors import ArtefactError, ConfigError


def read_tensors(path: Path, data: bytes) -> dict[str, torch.Tensor]:
    """Parse safetensors bytes.

    Raises:
        ArtefactError: if they are damaged, or a tensor holds a number that is not finite.
    """
    try:
        tensors = safetensors.torch.load(data)
    except (SafetensorError, ValueError, KeyError) as error:
        raise ArtefactError(f"{path} is damaged ({error}). Train the model again, or restore a copy.") from None
    for name, tensor in tensors.items():
        # The extremes are not finite if anything is not; asking each number takes twice the tensor's memory.
        if tensor.is_floating_point() and tensor.numel() and not torch.isfinite(torch.stack(tensor.aminmax())).all():
            raise ArtefactError(
                f"{path} is damaged: the tensor {name} holds NaN or infinity. Train the model again, or restore a copy."
            )
    return tensors


def with_prefix(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return the tensors whose names begin with ``prefix``, by the rest of their names."""
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def lazily_zero(tensor: Tensor) -> Tensor:
    """Return zeros of a tensor's shape and type that take no memory until they are written; torch writes its own."""
    return torch.from_numpy(np.zeros(tensor.shape, tensor.numpy().dtype))


def copied(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return copies on the CPU that own their memory, as safetensors wants them."""
    return {name: tensor.detach().cpu().clone().contiguous() for name, tensor in tensors.items()}


def as_tensor(values: Any) -> Tensor:
    """Return an engine's array as a tensor: the same memory on the CPU, the tensor itself on a device."""
    return torch.from_numpy(values) if isinstance(values, np.ndarray) else values


def check_device(device: str) -> None:
    """Check that torch can compute on a device.

    Raises:
        ConfigError: saying why not.
    """
    try:
        torch.zeros(1, device=device).item()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"`device` {device!r}: not available here ({reason}). Use cpu.") from None
