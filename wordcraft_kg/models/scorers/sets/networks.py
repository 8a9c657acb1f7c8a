"""Small networks of two layers, several of one shape as a committee."""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import torch
from torch import Tensor


class Networks(NamedTuple):
    """A committee of M networks ``second · tanh(x first + first_bias) + second_bias``.

    Attributes:
        first: shape (M, F, H).
        first_bias: shape (M, H).
        second: shape (M, H, O).
        second_bias: shape (M, O).
    """

    first: Tensor
    first_bias: Tensor
    second: Tensor
    second_bias: Tensor

    @classmethod
    def drawn(
        cls, members: int, sizes: tuple[int, int, int], generator: torch.Generator
    ) -> "Networks":
        """Draw the weights from which a fit begins.

        Args:
            members: number of networks.
            sizes: numbers of inputs, of hidden units and of outputs.
            generator: source of randomness.
        """
        num_inputs, hidden, num_outputs = sizes

        def uniform(fan_in: int, *shape: int) -> Tensor:
            bound = 1 / math.sqrt(fan_in)
            return (2 * torch.rand(members, *shape, generator=generator) - 1) * bound

        return cls(
            uniform(num_inputs, num_inputs, hidden),
            uniform(num_inputs, hidden),
            uniform(hidden, hidden, num_outputs),
            uniform(hidden, num_outputs),
        )

    @classmethod
    def of(cls, tensors: Mapping[str, Tensor], prefix: str) -> "Networks":
        """Return the networks stored under names with a prefix."""
        return cls(*(tensors[prefix + name] for name in cls._fields))

    def tensors(self, prefix: str) -> dict[str, Tensor]:
        """Return the weights by their names with a prefix."""
        return {prefix + name: weights for name, weights in self._asdict().items()}

    def __call__(self, inputs: Tensor, drop: Callable[[Tensor], Tensor] | None = None) -> Tensor:
        """Return the outputs of all members, shape (M, B, O).

        Args:
            inputs: shape (B, F).
            drop: dropout for a fit.
        """
        hidden = torch.tanh(inputs @ self.first + self.first_bias[:, None])
        if drop is not None:
            hidden = drop(hidden)
        return hidden @ self.second + self.second_bias[:, None]


def fit(
    networks: Networks,
    loss_of: Callable[[Networks, Tensor, Callable[[Tensor], Tensor]], Tensor],
    num_rows: int,
    generator: torch.Generator,
    *,
    epochs: int,
    rate: float,
    drop_share: float = 0.2,
    batch: int = 128,
) -> Networks:
    """Fit a committee by AdamW with a rate that rises and falls once.

    Args:
        networks: the committee at the start.
        loss_of: loss of the networks on some rows, with dropout.
        num_rows: number of training rows.
        generator: source of randomness.
        epochs: number of passes over all rows.
        rate: highest learning rate.
        drop_share: share of hidden units that each step leaves out.
        batch: rows in a step.
    """
    weights = [start.clone().requires_grad_() for start in networks]
    fitted = Networks(*weights)
    optimiser = torch.optim.AdamW(weights, rate, weight_decay=1e-2)
    steps = epochs * math.ceil(num_rows / batch)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=max(steps, 1))

    def drop(hidden: Tensor) -> Tensor:
        is_in = torch.rand(hidden.shape, generator=generator) >= drop_share
        return hidden * is_in / (1 - drop_share)

    for _ in range(epochs):
        for rows in torch.randperm(num_rows, generator=generator).split(batch):
            loss = loss_of(fitted, rows, drop)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
    return Networks(*(weight.detach() for weight in weights))
