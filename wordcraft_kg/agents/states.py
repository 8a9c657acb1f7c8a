"""Environment states as tensors, the input for policies and sources."""

from collections.abc import Iterable
from typing import Any

from wordcraft_kg.base.tensors import as_tensor
from wordcraft_kg.envs.batch import State
from wordcraft_kg.envs.world import World
from wordcraft_kg.models.policies.states import Attempts, States

ROWS = 2_048
"""Largest batch for a policy or source; larger arrays would leave the processor cache."""


def states_of(state: State) -> States:
    """Return an engine's batched state as tensors.

    On the CPU the tensors share the engine's memory, so use or copy them before the next step. Task
    numbers are left out (None) in parts without train recipes: there every model is out of sample.
    """
    return States(
        goal=as_tensor(state.goal),
        selection=as_tensor(state.selection),
        table=as_tensor(state.table),
        task=as_tensor(state.task) if has_train_recipes(state.world) else None,
        attempts=Attempts(as_tensor(state.attempts_left), as_tensor(state.tried)),
    )


def has_train_recipes(world: World) -> bool:
    """Return whether tasks may use train recipes, which may be a scorer's training data."""
    return world.config.part in ("train", "all")


def bind_tasks(scores: Iterable[Any], world: World) -> None:
    """Tell sources or policies which tasks the numbers of :func:`states_of` index.

    Objects that read no tasks, and scripted players' functions, are left alone.

    Args:
        scores: policies, sources or plain functions.
        world: world with the tasks; no effect if they use no train recipes.

    Raises:
        LeakError: if one would score a task by a model trained on the task's recipes.
        GraphMismatchError: if the tasks belong to another graph or split than a cross-fitted
            scorer.
    """
    # Other tasks have no train recipes to leave out: the model of all train recipes scores them.
    if has_train_recipes(world):
        for source in scores:
            if getattr(source, "reads_task", False):
                source.bind(world.tasks)
