"""The committee of rankers: gradients against automatic differentiation, and what it learns."""

import pytest
import torch

from wordcraft_kg.models.recipes.committee import (
    TABLES,
    Examples,
    _Batch,
    _moments,
    _Network,
    _set_gradients,
    fit_committee,
)


@pytest.fixture
def generator():
    return torch.Generator().manual_seed(3)


def drawn_queries(generator, queries=40, candidates=7, features=5):
    """Return queries some of whose candidates do not compete, and with one or more right ones."""
    values = torch.randn(queries, candidates, features, generator=generator)
    competes = torch.rand(queries, candidates, generator=generator) < 0.6
    is_right = competes & (torch.rand(queries, candidates, generator=generator) < 0.3)
    competes[:, 0] = True
    is_right[:, 0] = True
    return Examples(values, competes, is_right)


def loss_of(network, queries, mean, scale):
    """Return the mean of ``-log Σ_right softmax(scores)``, query by query."""
    first, first_bias, second = network
    losses = []
    for values, competes, is_right in zip(*queries, strict=True):
        scores = ((values - mean) / scale @ first + first_bias).relu() @ second
        shares = scores[competes].softmax(0)
        losses.append(-shares[is_right[competes]].sum().log())
    return torch.stack(losses).mean()


def test_gradients_are_those_of_automatic_differentiation(generator):
    queries = drawn_queries(generator)
    mean, scale = _moments(queries)
    networks = [_Network.drawn(5, generator) for _ in range(2)]
    _set_gradients(networks, _Batch.of(queries, mean, scale))
    for network in networks:
        copy = [weights.clone().requires_grad_() for weights in network]
        loss_of(copy, queries, mean, scale).backward()
        for weights, expected in zip(network, copy, strict=True):
            torch.testing.assert_close(weights.grad, expected.grad, rtol=1e-4, atol=1e-6)


def test_moments_are_those_of_competing_candidates(generator):
    queries = drawn_queries(generator)
    queries.features[..., 2] = 4.0
    known = queries.features[queries.competes]
    mean, scale = _moments(queries)
    torch.testing.assert_close(mean, known.mean(0))
    varies = torch.tensor([0, 1, 3, 4])
    torch.testing.assert_close(scale[varies], known.std(0)[varies])
    # A constant says nothing: its weight becomes 0.
    assert scale[2] == torch.inf


def test_committee_learns_which_candidate_is_right(generator):
    queries = drawn_queries(generator, queries=200)
    queries.is_right.zero_()
    # The competing candidate with the largest feature 1 is right.
    among = queries.features[..., 1].masked_fill(~queries.competes, -torch.inf)
    queries.is_right[torch.arange(200), among.argmax(1)] = True
    ranker = fit_committee(queries, generator, TABLES._replace(steps=300))
    scores = ranker(queries.features).masked_fill(~queries.competes, -torch.inf)
    assert (scores.argmax(1) == among.argmax(1)).float().mean() > 0.9
