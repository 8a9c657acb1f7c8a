"""Actor-critic loss terms, summed over time and batch as in IMPALA."""

import torch
from torch import Tensor


def policy_gradient_loss(log_probs: Tensor, advantages: Tensor) -> Tensor:
    """Return ``-Σ log π(a|x) · advantage`` over log-probabilities of actions and advantages, shape (T, B) each."""
    return -(log_probs * advantages).sum()


def baseline_loss(values: Tensor, targets: Tensor) -> Tensor:
    """Return ``½ Σ (vs - V)²`` over state values V and value targets vs, shape (T, B) each."""
    return 0.5 * (targets - values).square().sum()


def entropy(log_policies: Tensor) -> Tensor:
    """Return the summed entropy ``-Σ π log π`` in nats, for log-probabilities of shape (N, A); -inf adds 0."""
    return -(log_policies.exp() * log_policies.masked_fill(log_policies == -torch.inf, 0)).sum()


def divergence(log_policies: Tensor, references: Tensor) -> Tensor:
    """Return the summed divergence ``Σ π (log π - log ρ)`` in nats, both of shape (N, A); where π is 0, 0 is added."""
    ratios = (log_policies - references).masked_fill(log_policies == -torch.inf, 0)
    return (log_policies.exp() * ratios).sum()
