"""Mixed logits against a loop over sources."""

import math

import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from torch import Tensor

from wordcraft_kg.models.policies.attention import mix_logits


def slow_mixture(logits: Tensor, lambdas: Tensor, mask: Tensor) -> list[list[float]]:
    """``β_i = Σ_s λ_s · source_s,i``, and -inf for empty slots."""
    return [
        [
            sum(float(lam * channel[i]) for lam, channel in zip(row, channels, strict=True)) if is_real else -math.inf
            for i, is_real in enumerate(slots)
        ]
        for row, channels, slots in zip(lambdas.double(), logits.double(), mask.tolist(), strict=True)
    ]


@pytest.mark.parametrize("num_sources", [1, 2, 3])
def test_beta_is_the_sum_of_sources_weighted_by_lambda(num_sources: int):
    generator = torch.Generator().manual_seed(0)
    logits = torch.randn(5, num_sources, 4, generator=generator)
    lambdas = torch.randn(5, num_sources, generator=generator)
    mask = torch.rand(5, 4, generator=generator) < 0.6
    found = mix_logits(logits, lambdas, mask)
    assert (found.shape, found.dtype) == ((5, 4), torch.float32)
    assert torch.equal(found.isneginf(), ~mask)
    torch.testing.assert_close(found, torch.tensor(slow_mixture(logits, lambdas, mask)))


LARGE = st.floats(-(2.0**100), 2.0**100, width=32) | st.sampled_from([0.0, -1.0, 1e-45, -1e30, 1e30])


@given(lambdas=st.tuples(LARGE, LARGE, LARGE), mask=st.lists(st.booleans(), min_size=4, max_size=4).filter(any))
@example(lambdas=(0.0, 0.0, 0.0), mask=[True, False, False, False])  # in the released code λ → 0 unmasks empty slots
@example(lambdas=(1e30, -1e30, 1e30), mask=[False, True, False, True])
def test_a_masked_slot_has_probability_exactly_zero_for_any_lambda(lambdas: tuple[float, ...], mask: list[bool]):
    logits = torch.tensor([[[9.0, 1.0, -3.0, 0.5], [1e3, 2.0, -1e3, 0.0], [0.0, -5.0, 7.0, 1.0]]])
    real = torch.tensor([mask])
    probabilities = torch.softmax(mix_logits(logits, torch.tensor([lambdas]), real), dim=1)
    assert not probabilities.isnan().any()
    assert (probabilities[~real] == 0).all()
    assert float(probabilities.sum()) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("lam", [math.nan, math.inf, -math.inf, 3e38])
def test_a_masked_slot_stays_masked_even_if_lambda_is_broken(lam: float):
    mixed = mix_logits(torch.ones(1, 2, 3), torch.tensor([[lam, 1.0]]), torch.tensor([[True, False, True]]))
    assert mixed[0, 1] == -torch.inf


def test_masked_slots_neither_receive_nor_send_gradients():
    logits = torch.ones(1, 2, 3).requires_grad_()
    lambdas = torch.tensor([[2.0, 3.0]]).requires_grad_()
    mixed = mix_logits(logits * torch.tensor([1.0, 10.0, 1.0]), lambdas, torch.tensor([[True, False, True]]))
    torch.log_softmax(mixed, dim=1)[0, 0].backward()
    assert logits.grad.isfinite().all()
    assert lambdas.grad.isfinite().all()
    assert not logits.grad[:, :, 1].any()
    torch.testing.assert_close(logits.grad[0, :, 0], torch.tensor([1.0, 1.5]))
