"""A small ranker: one hidden layer, fitted by the softmax over the candidates of each query."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

HIDDEN = 32
WEIGHT_DECAY = 1e-4


@dataclass(frozen=True, eq=False)
class Ranker:
    """``score(x) = second · relu(x first + first_bias) + bias``, on features as they are.

    Attributes:
        first: shape (F, H).
        first_bias: shape (H,).
        second: shape (H,).
        bias: shape ().
    """

    first: Tensor
    first_bias: Tensor
    second: Tensor
    bias: Tensor

    def __call__(self, features: Tensor) -> Tensor:
        """Score features of shape (..., F)."""
        return torch.relu(features @ self.first + self.first_bias) @ self.second + self.bias


Batch = tuple[Tensor, Tensor, Tensor]
"""Features (B, N, F) of the candidates of B queries, which of them compete (B, N), and which are right (B, N)."""


def fit_ranker(
    batches: Sequence[Batch],
    mean: Tensor,
    deviation: Tensor,
    *,
    epochs: int,
    learning_rate: float,
    generator: torch.Generator,
) -> Ranker:
    """Fit a ranker by ``-log Σ_right softmax(scores)``, with AdamW and one cycle of the learning rate.

    Args:
        batches: the queries.
        mean: of the features, shape (F,).
        deviation: of the features, shape (F,).
        epochs: passes over the batches.
        learning_rate: its largest value.
        generator: draws the first weights and the order of the batches.
    """
    size = len(mean)
    deviation = deviation.clamp(min=1e-6)

    def drawn(*shape: int, fan: int) -> Tensor:
        return (torch.rand(*shape, generator=generator) * 2 - 1) / math.sqrt(fan)

    first, first_bias = drawn(size, HIDDEN, fan=size), drawn(HIDDEN, fan=size)
    second, bias = drawn(HIDDEN, fan=HIDDEN), torch.zeros(())
    parameters = [each.requires_grad_() for each in (first, first_bias, second, bias)]
    optimizer = torch.optim.AdamW(parameters, lr=learning_rate, weight_decay=WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, learning_rate, total_steps=max(epochs * len(batches), 2))

    def standardised() -> Ranker:
        # The scale of the features is taken into the weights: a pass over the weights, not over the features.
        scaled = first / deviation[:, None]
        return Ranker(scaled, first_bias - mean @ scaled, second, bias)

    for number in _shuffled(len(batches), epochs, generator):
        features, competes, is_right = batches[number]
        scores = standardised()(features)
        log_shares = scores.masked_fill(~competes, -torch.inf).log_softmax(-1)
        loss = -log_shares.masked_fill(~is_right, -torch.inf).logsumexp(-1).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return Ranker(*(weights.detach() for weights in vars(standardised()).values()))


def _shuffled(amount: int, epochs: int, generator: torch.Generator) -> Iterator[int]:
    for _ in range(epochs):
        yield from torch.randperm(amount, generator=generator).tolist()
