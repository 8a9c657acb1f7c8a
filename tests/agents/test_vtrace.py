"""V-trace against the sum in the paper, and in special cases."""

import math

import hypothesis.extra.numpy as npst
import hypothesis.strategies as st
import numpy as np
import torch
from hypothesis import given

from wordcraft_kg.agents.vtrace import v_trace

CLIPS, LIMITS = ("clip_rho", "clip_c", "clip_pg_rho"), (0.0, 0.4, 1.0, 2.5, math.inf)


def slow_v_trace(log_rhos, discounts, rewards, values, bootstrap_value, clip_rho=1.0, clip_c=1.0, clip_pg_rho=1.0):
    """Espeholt et al. 2018, equation 1 as it stands: for each start a sum over later steps, with products of c."""
    steps, batch = rewards.shape
    vs, advantages = np.zeros((steps, batch)), np.zeros((steps, batch))
    for b in range(batch):
        ratio = [math.exp(x) for x in log_rhos[:, b]]
        value = [*values[:, b], bootstrap_value[b]]
        target = [*value]
        for s in range(steps):
            for t in range(s, steps):
                product = 1.0
                for i in range(s, t):
                    product *= discounts[i, b] * min(clip_c, ratio[i])
                delta = min(clip_rho, ratio[t]) * (rewards[t, b] + discounts[t, b] * value[t + 1] - value[t])
                target[s] += product * delta
        for s in range(steps):
            vs[s, b] = target[s]
            error = rewards[s, b] + discounts[s, b] * target[s + 1] - value[s]
            advantages[s, b] = min(clip_pg_rho, ratio[s]) * error
    return vs, advantages


def random_unroll(seed, steps=6, batch=5):
    rng = np.random.default_rng(seed)
    shape = (steps, batch)
    discounts = 0.9 * (rng.random(shape) > 0.3)
    return [rng.normal(size=shape), discounts, *(rng.normal(size=shape) for _ in range(2)), rng.normal(size=batch)]


def tensors(arrays):
    return [torch.from_numpy(np.asarray(array)) for array in arrays]


@st.composite
def unrolls(draw):
    shape = draw(st.tuples(st.integers(1, 5), st.integers(1, 3)))
    numbers = npst.arrays(np.float64, shape, elements=st.floats(-3, 3))
    discounts = npst.arrays(np.float64, shape, elements=st.sampled_from([0.0, 0.5, 0.99, 1.0]))
    bootstrap = npst.arrays(np.float64, shape[1:], elements=st.floats(-3, 3))
    return [draw(numbers), draw(discounts), draw(numbers), draw(numbers), draw(bootstrap)]


@given(unrolls(), st.fixed_dictionaries({}, optional=dict.fromkeys(CLIPS, st.sampled_from(LIMITS))))
def test_targets_and_advantages_are_those_of_the_papers_sum_and_clips_are_one_by_default(unroll, clips):
    for one, other in zip(v_trace(*tensors(unroll), **clips), slow_v_trace(*unroll, **clips), strict=True):
        np.testing.assert_allclose(one.numpy(), other, rtol=1e-9, atol=1e-9)


def test_two_steps_worked_out_by_hand():
    log_rhos = torch.tensor([[2.0], [0.5]]).log()
    discounts, rewards, values = (torch.tensor(column)[:, None] for column in ([0.5, 0.5], [1.0, 2.0], [0.5, 1.0]))
    got = v_trace(log_rhos, discounts, rewards, values, torch.tensor([4.0]))
    # Last step: .5 (2 + .5 * 4 - 1) = 1.5. First: 1 (1 + .5 * 1 - .5) = 1, and .5 * 1 * 1.5 comes from the last.
    torch.testing.assert_close(got.vs, torch.tensor([[2.25], [2.5]]))
    torch.testing.assert_close(got.pg_advantages, torch.tensor([[1 + 0.5 * 2.5 - 0.5], [1.5]]))


def test_no_gradient_passes_and_nothing_given_changes():
    given_tensors = [tensor.float().requires_grad_() for tensor in tensors(random_unroll(3))]
    copies = [tensor.detach().clone() for tensor in given_tensors]
    got = v_trace(*given_tensors)
    for tensor in got:
        assert not tensor.requires_grad
        assert tensor.dtype == torch.float32
    assert all(map(torch.equal, given_tensors, copies))
