"""Actor-critic loss terms, summed over time and batch as in IMPALA.

Sums, not means: the paper's learning rate and costs belong to sums.
"""

import torch
from torch import Tensor


def policy_gradient_loss(log_probs: Tensor, advantages: Tensor) -> Tensor:
    """Return ``-Σ log π(a|x) · advantage``.

    ``log_probs`` of the chosen actions and ``advantages``, without gradients, have shape (T, B).
    """
    return -(log_probs * advantages).sum()


def baseline_loss(values: Tensor, targets: Tensor) -> Tensor:
    """Return ``½ Σ (vs - V)²`` over state values V and value targets vs, shape (T, B) each."""
    return 0.5 * (targets - values).square().sum()


def entropy(log_policies: Tensor) -> Tensor:
    """Return the summed entropy ``-Σ π log π`` in nats, for log-probabilities (N, A)."""
    # An empty slot has log π = -inf and π = 0: the product would be NaN, and its limit is 0.
    finite = log_policies.masked_fill(log_policies == -torch.inf, 0)
    return -(log_policies.exp() * finite).sum()


def divergence(log_policies: Tensor, references: Tensor) -> Tensor:
    """Return the summed divergence ``Σ π (log π - log ρ)`` in nats, both of shape (N, A).

    Slots with probability 0 under π add 0. Where π is above 0, ρ must be, too.
    """
    differences = log_policies - references
    finite = differences.masked_fill(log_policies == -torch.inf, 0)
    return (log_policies.exp() * finite).sum()
