"""The input of policies and sources: the states of an engine's environments as tensors."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from wordcraft_kg.base.tensors import as_tensor
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.world import World


class States(NamedTuple):
    """States of B environments, as policies and sources take them.

    Attributes:
        goal, selection: shape (B,), int64.
        table: shape (B, A), int64.
        task: shape (B,), int64: number of the task among the engine's; None for parts without train recipes.
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
    task = as_tensor(engine.task) if has_train_recipes(engine) else None
    return States(as_tensor(engine.goal), as_tensor(engine.selection), as_tensor(engine.table), task)


def has_train_recipes(engine: BatchEngine | World) -> bool:
    """Return whether an engine's or a world's tasks need train recipes, on which a scorer may have been trained."""
    return engine.config.part in ("train", "all")


def bind_tasks(scores: Iterable[Any], engine: BatchEngine) -> None:
    """Tell sources or policies what the numbers of :func:`states_of` stand for; what does not ask for it is left alone.

    Raises:
        LeakError: if one would score a task by a model that has been trained on its recipes.
    """
    if has_train_recipes(engine):
        for one in scores:
            if getattr(one, "reads_task", False):
                one.bind(engine.world.tasks)
