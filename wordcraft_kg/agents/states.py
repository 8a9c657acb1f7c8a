"""Environment states as tensors, the input for policies and sources."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from wordcraft_kg.base.tensors import as_tensor
from wordcraft_kg.envs.batch import State
from wordcraft_kg.envs.world import World
from wordcraft_kg.models.policies.sources.source import Attempts

ROWS = 2_048
"""Largest batch for a policy or source; larger arrays would leave the processor cache."""


class States(NamedTuple):
    """The states of B environments: ids (B,), tables (B, A), task indices if plans use train recipes, attempts."""

    goal: Tensor
    selection: Tensor
    table: Tensor
    task: Tensor | None
    attempts: Attempts

    def rows(self, start: int, stop: int, device: torch.device | str = "cpu") -> "States":
        """Return the states ``start`` to ``stop`` (exclusive) on a device."""
        parts = [
            None if part is None else part[start:stop].to(device)
            for part in (*self[:4], *self.attempts)
        ]
        goal, selection, table, task, *attempts = parts
        return States(goal, selection, table, task, Attempts(*attempts))  # type: ignore[arg-type]


def states_of(state: State) -> States:
    """Return an engine's batched state as tensors, sharing memory on the CPU."""
    task = as_tensor(state.task) if has_train_recipes(state.world) else None
    attempts = Attempts(as_tensor(state.attempts_left), as_tensor(state.tried))
    return States(
        as_tensor(state.goal), as_tensor(state.selection), as_tensor(state.table), task, attempts
    )


def has_train_recipes(world: World) -> bool:
    """Return whether tasks may use train recipes, which may be a scorer's training data."""
    return world.config.part in ("train", "all")


def bind_tasks(scores: Iterable[Any], world: World) -> None:
    """Give the world's tasks to sources or policies that read them; LeakError if they would score in sample."""
    if has_train_recipes(world):
        for source in scores:
            if getattr(source, "reads_task", False):
                source.bind(world.tasks)
