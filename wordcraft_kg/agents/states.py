"""The input of policies and sources: the states of an engine's environments as tensors."""

from typing import NamedTuple

import torch
from torch import Tensor

from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.tensors import as_tensor


class States(NamedTuple):
    """States of B environments, as policies and sources take them.

    Attributes:
        goal, selection: shape (B,), int64.
        table: shape (B, A), int64.
        task: shape (B,), int64: index of the task among the train tasks; None for other parts.
    """

    goal: Tensor
    selection: Tensor
    table: Tensor
    task: Tensor | None

    def rows(self, start: int, stop: int, device: torch.device | str = "cpu") -> "States":
        """Return some of the states, on a device."""
        return States(*(None if part is None else part[start:stop].to(device) for part in self))  # type: ignore[arg-type]


def states_of(engine: BatchEngine) -> States:
    """Return the states of an engine's environments; on a CPU they share its memory, which the next step changes."""
    task = as_tensor(engine.task) if engine.config.part == "train" else None
    return States(as_tensor(engine.goal), as_tensor(engine.selection), as_tensor(engine.table), task)
