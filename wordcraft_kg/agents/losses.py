"""Actor-critic loss terms, summed over time and batch as in IMPALA.

Sums, not means: the paper's learning rate and costs belong to sums.
"""

import torch
from torch import Tensor


def policy_gradient_loss(log_probs: Tensor, advantages: Tensor) -> Tensor:
    """Return ``-Σ log π(a|x) · advantage``.

    Args:
        log_probs: shape (T, B), nats: log-probabilities of the chosen actions.
        advantages: shape (T, B), without gradients.

    Returns:
        shape ().
    """
    weighted = log_probs * advantages
    return -weighted.sum()


def baseline_loss(values: Tensor, targets: Tensor) -> Tensor:
    """Return ``½ Σ (vs - V)²``.

    Args:
        values: shape (T, B): state values V.
        targets: shape (T, B): value targets vs, without gradients.

    Returns:
        shape ().
    """
    errors = targets - values
    return 0.5 * errors.square().sum()


def entropy(log_policies: Tensor) -> Tensor:
    """Return the summed entropy ``-Σ π log π`` in nats, for log-probabilities (N, A)."""
    # An empty slot has log π = -inf and π = 0: the product would be NaN, and its limit is 0.
    finite = log_policies.masked_fill(log_policies == -torch.inf, 0)
    expected = log_policies.exp() * finite
    return -expected.sum()


def divergence(log_policies: Tensor, references: Tensor) -> Tensor:
    """Return the summed divergence ``Σ π (log π - log ρ)`` in nats.

    Slots with probability 0 under π add 0. Where π is above 0, ρ must be, too.

    Args:
        log_policies: shape (N, A), nats: log π.
        references: shape (N, A), nats: log ρ.

    Returns:
        shape ().
    """
    differences = log_policies - references
    finite = differences.masked_fill(log_policies == -torch.inf, 0)
    expected = log_policies.exp() * finite
    return expected.sum()


def memory_loss(log_policies: Tensor, remembered: Tensor) -> Tensor:
    """Return ``-Σ log Σ π`` in nats: the inner sum over remembered choices of a state.

    States without a remembered choice add 0.

    Args:
        log_policies: shape (C, N), nats: log π.
        remembered: shape (C, N), bool; no choice with probability 0.

    Returns:
        shape ().

    Source: Oh et al. 2018, "Self-Imitation Learning", with all successes worth the same.
    """
    has_any = remembered.any(0)
    # Elsewhere the sum over no choice would be log 0; all choices give a constant instead.
    target_log_probs = log_policies.masked_fill(~remembered & has_any, -torch.inf)
    return -torch.logsumexp(target_log_probs, dim=0).masked_fill(~has_any, 0).sum()
