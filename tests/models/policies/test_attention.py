"""Attention over the table: masks, mixtures and entity vectors; `test_policies.py` compares its logits with loops."""

import math

import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from small_scorers import normal

from wordcraft_kg.models.policies.attention import Slots, TableAttention, masked_softmax, mix_logits
from wordcraft_kg.models.policies.policy import EntityVectors, log_policy

KEY_SIZE = 3
NUM_ENTITIES = 7


def attention_of(dim):
    attention = TableAttention(dim, KEY_SIZE)
    for i, parameter in enumerate(attention.parameters()):
        parameter.data = normal(*parameter.shape, seed=i + 1)
    return attention


def alpha_of(attention, vectors, goal, selection, table):
    rows = attention.rows({**vectors.weights(), **attention.weights()}, goal, selection)
    return Slots(vectors.weights().get("vectors"), table).dot(rows)


@st.composite
def masked_logits(draw):
    """Logits as large as their differences can be, and masks with at least one slot that holds something."""
    size, num_slots = draw(st.integers(1, 4)), draw(st.integers(1, 5))
    numbers = st.floats(-(2.0**126), 2.0**126, width=32) | st.floats(-5, 5, width=32)
    row = st.lists(numbers, min_size=num_slots, max_size=num_slots)
    filled = st.lists(st.booleans(), min_size=num_slots, max_size=num_slots).filter(any)
    logits = torch.tensor(draw(st.lists(row, min_size=size, max_size=size)))
    return logits, torch.tensor(draw(st.lists(filled, min_size=size, max_size=size)))


@given(masked_logits())
@example((torch.tensor([[1e38, -1e38, 0.0]]), torch.tensor([[False, True, True]])))
@example((torch.tensor([[float("inf"), float("nan"), 1.0]]), torch.tensor([[False, False, True]])))
def test_a_masked_slot_has_probability_exactly_zero_and_the_others_share_one(drawn):
    logits, mask = drawn
    found = masked_softmax(logits, mask)
    assert found.shape == logits.shape
    for probabilities, row, is_real in zip(found.tolist(), logits.tolist(), mask.tolist(), strict=True):
        top = max(x for x, real in zip(row, is_real, strict=True) if real)
        total = sum(math.exp(x - top) for x, real in zip(row, is_real, strict=True) if real)
        for probability, x, real in zip(probabilities, row, is_real, strict=True):
            assert probability == (pytest.approx(math.exp(x - top) / total, abs=1e-5) if real else 0.0)


@given(masked_logits())
def test_the_log_policy_is_the_log_of_the_softmax_with_slots_first(drawn):
    logits, mask = drawn
    found = log_policy(logits.masked_fill(~mask, -torch.inf))
    assert found.shape == logits.T.shape
    assert torch.equal(found.isneginf(), ~mask.T)
    torch.testing.assert_close(found.exp(), masked_softmax(logits, mask).T)


LARGE = st.floats(-(2.0**100), 2.0**100, width=32) | st.sampled_from([0.0, -1.0, 1e-45, -1e30, 1e30])


@given(lambdas=st.tuples(LARGE, LARGE, LARGE), mask=st.lists(st.booleans(), min_size=4, max_size=4).filter(any))
@example(lambdas=(0.0, 0.0, 0.0), mask=[True, False, False, False])  # in the released code λ → 0 unmasks empty slots
@example(lambdas=(1e30, -1e30, 1e30), mask=[False, True, False, True])
def test_a_masked_slot_has_probability_exactly_zero_for_any_lambda(lambdas, mask):
    logits = torch.tensor([[[9.0, 1.0, -3.0, 0.5], [1e3, 2.0, -1e3, 0.0], [0.0, -5.0, 7.0, 1.0]]])
    real = torch.tensor([mask])
    probabilities = torch.softmax(mix_logits(logits, torch.tensor([lambdas]), real), dim=1)
    assert not probabilities.isnan().any()
    assert (probabilities[~real] == 0).all()
    assert float(probabilities.sum()) == pytest.approx(1, abs=1e-5)


MIDDLE_IS_EMPTY = torch.tensor([[True, False, True]])


@pytest.mark.parametrize("lam", [math.nan, math.inf, -math.inf, 3e38])
def test_a_masked_slot_stays_masked_even_if_lambda_is_broken(lam):
    assert mix_logits(torch.ones(1, 2, 3), torch.tensor([[lam, 1.0]]), MIDDLE_IS_EMPTY)[0, 1] == -torch.inf


def test_masked_slots_neither_receive_nor_send_gradients():
    logits = torch.ones(1, 2, 3).requires_grad_()
    lambdas = torch.tensor([[2.0, 3.0]]).requires_grad_()
    mixed = mix_logits(logits * torch.tensor([1.0, 10.0, 1.0]), lambdas, MIDDLE_IS_EMPTY)
    torch.log_softmax(mixed, dim=1)[0, 0].backward()
    assert logits.grad.isfinite().all()
    assert lambdas.grad.isfinite().all()
    assert not logits.grad[:, :, 1].any()
    torch.testing.assert_close(logits.grad[0, :, 0], torch.tensor([1.0, 1.5]))


def test_constant_vectors_are_a_float32_copy_that_nothing_trains():
    given_ones = normal(NUM_ENTITIES, 5).double().requires_grad_()
    vectors = EntityVectors(NUM_ENTITIES, given_ones)
    before = given_ones.detach().float().clone()
    given_ones.data.zero_()
    assert list(vectors.parameters()) == []
    assert not vectors.weights()["vectors"].requires_grad
    assert vectors.weights()["vectors"].dtype == torch.float32
    assert torch.equal(vectors.weights()["vectors"][:-1], before)
    assert list(vectors.state_dict()) == ["vectors"]
    assert (vectors.dim, vectors.is_one_hot) == (5, False)


def test_learned_vectors_are_parameters_and_one_hot_ones_are_never_written_out():
    vectors, one_hot = EntityVectors(NUM_ENTITIES, learned_dim=6), EntityVectors(NUM_ENTITIES)
    (parameter,) = vectors.parameters()
    assert parameter.shape == (NUM_ENTITIES, 6)
    assert parameter.detach().std() == pytest.approx(1, abs=0.5)
    assert (one_hot.weights(), list(one_hot.parameters())) == ({}, [])
    assert (vectors.dim, vectors.is_one_hot) == (6, False)
    assert (one_hot.dim, one_hot.is_one_hot) == (NUM_ENTITIES, True)


def test_the_vector_of_nothing_is_still_zero_after_a_step_that_it_was_part_of():
    vectors, attention = EntityVectors(NUM_ENTITIES, learned_dim=5), attention_of(5)
    table = torch.tensor([[0, 1, NUM_ENTITIES]])
    before = vectors.weights()["vectors"].detach()
    for _ in range(2):  # the second with moved vectors
        alpha_of(attention, vectors, torch.tensor([2]), torch.tensor([NUM_ENTITIES]), table).sum().backward()
        torch.optim.SGD(vectors.parameters(), lr=0.1).step()
    moved = (vectors.weights()["vectors"].detach() != before).any(dim=1).tolist()
    assert moved == [entity in (0, 1, 2) for entity in range(NUM_ENTITIES + 1)]
    assert not vectors.weights()["vectors"][NUM_ENTITIES].any()
