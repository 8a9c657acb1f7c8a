"""Actor-critic loss terms against loops, and their derivatives."""

import math

import pytest
import torch

from wordcraft_kg.agents.losses import baseline_loss, entropy, policy_gradient_loss


@pytest.fixture
def unroll():
    """Two arrays of three steps and four environments."""
    return torch.randn(2, 3, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


@pytest.fixture
def logits():
    """Six states of five slots; the last slots are empty, in one row all but one."""
    logits = torch.randn(6, 5, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    for row, num_filled in enumerate([5, 4, 3, 2, 1, 5]):
        logits[row, num_filled:] = -torch.inf
    return logits


def slow_entropy(logits):
    total = 0.0
    for row in logits.tolist():
        weights = [math.exp(x) for x in row]
        shares = [weight / sum(weights) for weight in weights]
        total -= sum(p * math.log(p) for p in shares if p)
    return total


def test_losses_are_sums_over_steps_and_environments(unroll, logits):
    pairs = list(zip(*(array.flatten().tolist() for array in unroll), strict=True))
    assert policy_gradient_loss(*unroll).item() == pytest.approx(-sum(p * a for p, a in pairs))
    assert baseline_loss(*unroll).item() == pytest.approx(sum((t - v) ** 2 for v, t in pairs) / 2)
    assert entropy(torch.log_softmax(logits, dim=1)).item() == pytest.approx(slow_entropy(logits))


def test_the_entropys_gradient_is_finite_and_that_of_the_formula_where_slots_are_empty(logits):
    logits.requires_grad_()
    log_policies = torch.log_softmax(logits, dim=1)
    entropy(log_policies).backward()
    shares = log_policies.exp().detach()
    for row in range(len(logits)):
        own = slow_entropy(logits.detach()[row : row + 1])
        for slot, p in enumerate(shares[row].tolist()):
            # d H / d z_i = -p_i (log p_i + H), which is 0 for an empty slot
            assert logits.grad[row, slot].item() == pytest.approx(-p * (math.log(p) + own) if p else 0.0, abs=1e-12)


def test_log_probabilities_are_pushed_by_their_advantages_and_values_towards_their_targets(unroll):
    one, other = unroll
    one.requires_grad_()
    assert torch.equal(torch.autograd.grad(policy_gradient_loss(one, other), one)[0], -other)
    torch.testing.assert_close(torch.autograd.grad(baseline_loss(one, other), one)[0], one.detach() - other)
