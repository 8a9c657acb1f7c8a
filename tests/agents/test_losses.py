"""The terms of the actor-critic loss, by loops and by their derivatives."""

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
    """Six states of five slots; the last ones are empty, in one row all but one."""
    logits = torch.randn(6, 5, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    for row, there in enumerate([5, 4, 3, 2, 1, 5]):
        logits[row, there:] = -torch.inf
    return logits


def slow_entropy(logits):
    total = 0.0
    for row in logits.tolist():
        weights = [math.exp(x) for x in row]
        shares = [weight / sum(weights) for weight in weights]
        total -= sum(p * math.log(p) for p in shares if p)
    return total


def test_the_policy_gradient_loss_is_the_sum_over_steps_and_environments(unroll):
    log_probs, advantages = unroll
    expected = -sum(p * a for p, a in zip(log_probs.flatten().tolist(), advantages.flatten().tolist(), strict=True))
    assert policy_gradient_loss(log_probs, advantages).item() == pytest.approx(expected)


def test_the_baseline_loss_is_half_the_sum_of_squares(unroll):
    values, targets = unroll
    expected = sum((t - v) ** 2 for v, t in zip(values.flatten().tolist(), targets.flatten().tolist(), strict=True)) / 2
    assert baseline_loss(values, targets).item() == pytest.approx(expected)


def test_the_entropy_is_the_sum_over_states_in_nats(logits):
    assert entropy(torch.log_softmax(logits, dim=1)).item() == pytest.approx(slow_entropy(logits))


@pytest.mark.parametrize("there", [1, 2, 5])
def test_the_entropy_of_an_even_policy_is_the_logarithm_of_its_slots(there):
    logits = torch.zeros(3, 5)
    logits[:, there:] = -torch.inf
    assert entropy(torch.log_softmax(logits, dim=1)).item() == pytest.approx(3 * math.log(there), abs=1e-6)


def test_twice_the_batch_gives_twice_the_loss(unroll, logits):
    one, other = unroll
    twice = [torch.cat([array, array], dim=1) for array in unroll]
    assert policy_gradient_loss(*twice).item() == pytest.approx(2 * policy_gradient_loss(one, other).item())
    assert baseline_loss(*twice).item() == pytest.approx(2 * baseline_loss(one, other).item())
    log_policies = torch.log_softmax(logits, dim=1)
    assert entropy(torch.cat([log_policies] * 2)).item() == pytest.approx(2 * entropy(log_policies).item())


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
