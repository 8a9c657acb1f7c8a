"""The input of policies and sources: the state of a batch of environments as tensors."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from wordcraft_kg.base.tensors import as_tensor
from wordcraft_kg.envs.batch import State
from wordcraft_kg.envs.world import World


class States(NamedTuple):
    """States of B environments, as policies and sources take them.

    Attributes:
        goal, selection: shape (B,), int64.
        table: shape (B, A), int64.
        task: shape (B,), int64: number of the task among the world's; None for parts without train recipes.
    """

    goal: Tensor
    selection: Tensor
    table: Tensor
    task: Tensor | None

    def rows(self, start: int, stop: int, device: torch.device | str = "cpu") -> "States":
        """Return some of the states, on a device."""
        return States(*(None if part is None else part[start:stop].to(device) for part in self))  # type: ignore[arg-type]


def states_of(state: State) -> States:
    """Return the state of a batch as tensors, which share its memory on a CPU."""
    task = as_tensor(state.task) if has_train_recipes(state.world) else None
    return States(as_tensor(state.goal), as_tensor(state.selection), as_tensor(state.table), task)


def has_train_recipes(world: World) -> bool:
    """Return whether a world's tasks need train recipes, on which a scorer may have been trained."""
    return world.config.part in ("train", "all")


def bind_tasks(scores: Iterable[Any], world: World) -> None:
    """Tell sources or policies that ask for it which tasks the numbers of :func:`states_of` stand for.

    Raises:
        LeakError: if one would score a task by a model that has been trained on its recipes.
    """
    if has_train_recipes(world):
        for one in scores:
            if getattr(one, "reads_task", False):
                one.bind(world.tasks)
