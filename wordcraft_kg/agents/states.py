"""Environment states as tensors, the input for policies and sources."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from wordcraft_kg.base.tensors import as_tensor
from wordcraft_kg.envs.batch import State
from wordcraft_kg.envs.world import World


class States(NamedTuple):
    """A batch of B environment states.

    Attributes:
        goal, selection: shape (B,), int64.
        table: shape (B, A), int64.
        task: shape (B,), int64: task index; None for splits without train recipes.
    """

    goal: Tensor
    selection: Tensor
    table: Tensor
    task: Tensor | None

    def rows(self, start: int, stop: int, device: torch.device | str = "cpu") -> "States":
        """Return a slice on a device."""
        return States(*(None if part is None else part[start:stop].to(device) for part in self))  # type: ignore[arg-type]


def states_of(state: State) -> States:
    """Return batch states as tensors, sharing memory on the CPU."""
    task = as_tensor(state.task) if has_train_recipes(state.world) else None
    return States(as_tensor(state.goal), as_tensor(state.selection), as_tensor(state.table), task)


def has_train_recipes(world: World) -> bool:
    """Return whether a plan may use train recipes, and so the training data of a scorer."""
    return world.config.part in ("train", "all")


def bind_tasks(scores: Iterable[Any], world: World) -> None:
    """Bind sources or policies that read task indices to the tasks in a world.

    Raises:
        LeakError: if a model would score tasks with recipes from its training data.
    """
    if has_train_recipes(world):
        for source in scores:
            if getattr(source, "reads_task", False):
                source.bind(world.tasks)
