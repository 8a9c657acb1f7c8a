"""Actor-critic loss terms, summed over time and batch as in IMPALA."""

import torch
from torch import Tensor


def policy_gradient_loss(log_probs: Tensor, advantages: Tensor) -> Tensor:
    """Return ``-Σ log π(a|x) · advantage``: shapes (T, B)."""
    return -(log_probs * advantages).sum()


def baseline_loss(values: Tensor, targets: Tensor) -> Tensor:
    """Return ``½ Σ (vs - V)²``: shapes (T, B)."""
    return 0.5 * (targets - values).square().sum()


def entropy(log_policies: Tensor) -> Tensor:
    """Return ``-Σ π log π`` in nats for log-probabilities of shape (N, A); slots of probability 0 (-inf) add 0."""
    return -(log_policies.exp() * log_policies.masked_fill(log_policies == -torch.inf, 0)).sum()
