"""A memory of own successes: pairs that led to a goal, from which an agent learns again.

Rewards are rare, and an agent that has once made a goal forgets how while it learns other goals.
So the trainer raises the probability of remembered pairs whenever one is on the table of its goal.

Source: Oh et al. 2018, "Self-Imitation Learning"; differs by keeping pairs, not whole episodes, and
by learning from all of them that are on the tables at hand, not from a sample.
"""

import torch
from torch import Tensor


class Successes:
    """Pairs that led to a goal, each with the attempts that were left before it.

    Attributes:
        keys: shape (n,), int64: a number for each pair, goal and attempts left, in ascending order.
    """

    def __init__(self, num_entities: int, device: torch.device):
        """Remember nothing yet, of ``num_entities`` (E) entities."""
        self._size = num_entities + 1
        self.keys = torch.empty(0, dtype=torch.int64, device=device)

    def add(self, goal: Tensor, left: Tensor, one: Tensor, other: Tensor) -> None:
        """Remember pairs of entities that led to a goal.

        Args:
            goal: ids, shape (n,), int64.
            left: attempts left before the pair, shape (n,), int64.
            one: ids of an entity of each pair, shape (n,), int64.
            other: ids of its partner, shape (n,), int64; the order of a pair has no meaning.
        """
        new = self._keys(goal, left, one, other)
        self.keys = torch.cat([self.keys, new]).unique()

    def hold(self, goal: Tensor, left: Tensor, table: Tensor) -> Tensor:
        """Return which slot pairs of B tables are remembered.

        Args:
            goal: ids, shape (B,).
            left: attempts left, shape (B,).
            table: ids in the slots, shape (B, A).

        Returns:
            shape (B, A, A), bool, symmetric; False for empty slots, which no pair has.
        """
        if not len(self.keys):
            return torch.zeros(
                (*table.shape, table.shape[1]), dtype=torch.bool, device=table.device
            )
        goals = goal[:, None, None]
        attempts = left[:, None, None]
        table_keys = self._keys(goals, attempts, table[:, :, None], table[:, None])
        places = torch.searchsorted(self.keys, table_keys).clamp(max=len(self.keys) - 1)
        return self.keys[places] == table_keys

    def _keys(self, goal: Tensor, left: Tensor, one: Tensor, other: Tensor) -> Tensor:
        """Return a number for each pair, goal and attempts left, whatever the pair's order."""
        # With five attempts left, 63 bits are enough for a million entities.
        lower = torch.minimum(one, other)
        higher = torch.maximum(one, other)
        return ((left * self._size + goal) * self._size + lower) * self._size + higher


def led_to_goals(won: Tensor, over: Tensor, is_new: Tensor) -> Tensor:
    """Return which choices of an unroll led to the goal, shape (T, B), bool.

    These are the choices that made the goal, and earlier ones in their episodes that made something
    else.

    Args:
        won: shape (T, B), bool: the choice made the goal.
        over: shape (T, B), bool: the choice ended the episode.
        is_new: shape (T, B), bool: the choice changed the table.
    """
    led = torch.zeros_like(won)
    is_reached = torch.zeros_like(won[0])
    for t in reversed(range(len(won))):
        is_reached = won[t] | (is_reached & ~over[t])
        led[t] = is_reached & (won[t] | is_new[t])
    return led
