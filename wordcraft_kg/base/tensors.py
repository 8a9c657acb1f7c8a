"""Tensors in files, and conversion between arrays and tensors."""

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
        ArtefactError: for damaged bytes, or NaN or infinity in a tensor.
    """
    try:
        tensors = safetensors.torch.load(data)
    except (SafetensorError, ValueError, KeyError) as error:
        raise ArtefactError(f"{path} is damaged ({error}). Train the model again, or restore a copy.") from None
    for name, tensor in tensors.items():
        # Checking the extremes is enough; checking each number takes twice the tensor's memory.
        if tensor.is_floating_point() and tensor.numel() and not torch.isfinite(torch.stack(tensor.aminmax())).all():
            raise ArtefactError(
                f"{path} is damaged: the tensor {name} holds NaN or infinity. Train the model again, or restore a copy."
            )
    return tensors


def with_prefix(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return all tensors with names that begin with ``prefix``, without the prefix."""
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def lazily_zero(tensor: Tensor) -> Tensor:
    """Return zeros with a tensor's shape and type that take no memory until written, unlike torch's zeros."""
    return torch.from_numpy(np.zeros(tensor.shape, tensor.numpy().dtype))


def copied(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return contiguous copies on the CPU, for safetensors."""
    return {name: tensor.detach().cpu().clone().contiguous() for name, tensor in tensors.items()}


def as_tensor(values: Any) -> Tensor:
    """Return an engine's array as a tensor that shares memory; a device's tensor is returned as is."""
    return torch.from_numpy(values) if isinstance(values, np.ndarray) else values


def check_device(device: str) -> None:
    """Raise a :class:`ConfigError` unless torch can compute on a device."""
    try:
        torch.zeros(1, device=device).item()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"`device` {device!r}: not available here ({reason}). Use cpu.") from None
