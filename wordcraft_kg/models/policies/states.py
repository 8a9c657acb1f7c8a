"""States of environments as tensors: the single argument of policies and sources.

Environments know no torch, and policies know no environment: an agent converts a batched state by
``wordcraft_kg.agents.states.states_of``, a wrapper an observation by :meth:`States.of_observation`.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor


class Attempts(NamedTuple):
    """The attempts of B episodes, for sources that look ahead.

    Attributes:
        left: shape (B,), int64: attempts left, including the current attempt.
        tried: shape (B, n, 2), int64: ids of the pairs combined so far in each episode, padded with
            E. None if unknown: then a source may recommend a pair that has failed before.
    """

    left: Tensor
    tried: Tensor | None = None


class States(NamedTuple):
    """The states of B episodes, on tables with A slots.

    Ids equal environment ids: entities 0 to E - 1, and E for an empty slot or no selection. Only
    ``goal``, ``selection`` and ``table`` are always needed::

        policy(States(goal, selection, table))

    Attributes:
        goal: shape (B,), int64: the entity to make.
        selection: shape (B,), int64: the selected entity, E without a selection. If recipes have
            other sizes than two, shape (B, S): the selected entities in any order, then E.
        table: shape (B, A), int64: the entities on the table, E for empty slots. A policy needs an
            entity in each row, in any slot. With selections (B, S), the last slot is the action
            to combine, and holds E.
        task: shape (B,), int64: index into the tasks given to ``bind``, or the number of these
            tasks for a task that is not among them. None for tasks whose plans use no train
            recipe, or if no source reads tasks.
        attempts: attempts left and pairs tried; None if no source looks ahead.
    """

    goal: Tensor
    selection: Tensor
    table: Tensor
    task: Tensor | None = None
    attempts: Attempts | None = None

    @property
    def has_combine(self) -> bool:
        """Whether the last slot is the action to combine the selected entities."""
        return self.selection.ndim == 2

    def num_selected(self, nothing: int) -> Tensor:
        """Return the number of selected entities, shape (B,); ``nothing`` is E."""
        return (self.selection != nothing).reshape(len(self.goal), -1).sum(1)

    def slot_mask(self, nothing: int) -> Tensor:
        """Return which slots may be chosen, shape (B, A), bool; ``nothing`` is E."""
        mask = self.table != nothing
        if self.has_combine:
            mask[:, -1] = self.num_selected(nothing) > 0
        return mask

    def num_used_slots(self, nothing: int) -> int:
        """Return the number of slots up to the last one that is filled in any table, 1 or more.

        Free slots for results are a large share of a table, and the cost of pairs is quadratic.
        """
        filled = (self.table != nothing).any(0).nonzero()
        return int(filled[-1]) + 1 if len(filled) else 1

    def mean_over_selection(self, score: Callable[[Tensor], Tensor], nothing: int) -> Tensor:
        """Return the mean of scores with each selected entity, 0 without one.

        Args:
            score: scores slots with a selected entity: (B, A) from ids (B,), 0 for the id E.
            nothing: E.
        """
        if not self.has_combine:
            return score(self.selection)
        num_selected = self.num_selected(nothing)
        sums = torch.zeros(self.table.shape, device=self.table.device)
        for entities in self.selection.T[: int(num_selected.max())]:
            sums = sums + score(entities)
        return sums / num_selected.clamp(min=1)[:, None]

    def with_selections_on_table(self, nothing: int) -> "States":
        """Return states in which each selection (B,) is on the table, if need be in a further slot.

        Args:
            nothing: E.
        """
        selection = self.selection[:, None]
        is_there = (self.table == selection).any(1, keepdim=True) | (selection == nothing)
        if is_there.all():
            return self
        last_slot = selection.masked_fill(is_there, nothing)
        return self._replace(table=torch.cat([self.table, last_slot], dim=1))

    def rows(
        self,
        start: int,
        stop: int,
        device: torch.device | str = "cpu",
    ) -> "States":
        """Return a part of the states, on a device.

        Args:
            start: first row.
            stop: row after the last; rows beyond B are left out.
            device: device of the returned tensors. On the states' own device nothing is copied.

        Returns:
            States with B = stop - start or fewer.
        """
        return self._each(lambda tensor: tensor[start:stop].to(device))

    def of(self, rows: Tensor | slice | int) -> "States":
        """Return some of the states: their numbers or a mask, (n,) or (B,), a slice, or one time.

        A number is a time of states with a first axis of time, (T, B, ...).
        """
        return self._each(lambda tensor: tensor[rows])

    def flattened(self) -> "States":
        """Return states with a first axis of time, (T, B, ...), as T · B states."""
        return self._each(lambda tensor: tensor.flatten(0, 1))

    def _each(self, change: Callable[[Tensor], Tensor]) -> "States":
        """Return states of which each tensor has been changed."""
        attempts = self.attempts
        if attempts is not None:
            tried = None if attempts.tried is None else change(attempts.tried)
            attempts = Attempts(change(attempts.left), tried)
        task = None if self.task is None else change(self.task)
        tensors = change(self.goal), change(self.selection), change(self.table)
        return States(*tensors, task, attempts)

    @classmethod
    def of_observation(cls, observation: Mapping[str, Any], task: Any = None) -> "States":
        """Return the states in an observation of one environment (B = 1) or of B environments.

        Ids may have any number type, and single numbers the shape (), (B,) or (B, 1): rollout
        buffers of other libraries store ids as floats, and add an axis to single numbers.

        Args:
            observation: arrays or tensors ``goal``, ``selection`` (S ids in its last axis if
                recipes have other sizes than two), ``table`` with A slots in the last axis and, for
                sources that look ahead, ``attempts_left``. Further keys are ignored. Pairs tried
                are not observed, so ``attempts.tried`` is None.
            task: task indices in the same shape as ``goal``, see :attr:`task`; None without.
        """
        # Only the table has an axis of its own, so its last axis tells slots from episodes.
        table = torch.as_tensor(observation["table"]).long()
        attempts = None
        if "attempts_left" in observation:
            attempts = Attempts(_numbers(observation["attempts_left"]))
        goal = _numbers(observation["goal"])
        selection = torch.as_tensor(observation["selection"]).long()
        # More ids than goals are sets, of two places or more; single numbers may have an axis more.
        num_ids = selection.numel() // len(goal)
        selection = selection.reshape(-1) if num_ids == 1 else selection.reshape(-1, num_ids)
        return cls(
            goal=goal,
            selection=selection,
            table=table.reshape(-1, table.shape[-1]),
            task=None if task is None else _numbers(task),
            attempts=attempts,
        )


def _numbers(values: Any) -> Tensor:
    """Return numbers of any type and shape as int64, shape (B,)."""
    return torch.as_tensor(values).long().reshape(-1)
