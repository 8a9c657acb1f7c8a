"""The sampled softmax: equal to the full one where everything is sampled, and to it on average
elsewhere."""

import math

import numpy as np
import pytest
import torch
from link_helpers import random_graph, train
from torch.nn.functional import cross_entropy

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.models.links import config as link_config
from wordcraft_kg.models.links.builders import ComplExN3, make_training_loop
from wordcraft_kg.models.links.config import FULL_SOFTMAX, NEGATIVES, ComplExConfig, LinksConfig
from wordcraft_kg.models.links.pykeen_bridge import pykeen_guard, triples_factory
from wordcraft_kg.models.links.symmetric_lcwa import (
    SampledSymmetricLCWATrainingLoop,
    sampled_cross_entropy,
)

SIZE, QUERIES = 9, 5


@pytest.fixture
def scores():
    return (
        torch.randn(QUERIES, SIZE, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
        * 2
    )


@pytest.fixture
def factory():
    graph = random_graph(num_entities=7, num_recipes=9)
    return triples_factory(graph, graph.triples)


def sampled_loss(scores, targets, drawn, expected):
    true = scores[torch.arange(len(scores)), targets]
    return sampled_cross_entropy(true, scores[:, drawn], expected.log(), drawn == targets[:, None])


def slow_sampled_loss(scores, targets, drawn, expected):
    """The formula of the docstring, by loops."""
    total = 0.0
    for row, target in zip(scores.tolist(), targets.tolist(), strict=True):
        others = sum(
            math.exp(row[j]) / m
            for j, m in zip(drawn.tolist(), expected.tolist(), strict=True)
            if j != target
        )
        total += math.log(math.exp(row[target]) + others) - row[target]
    return total / len(targets)


def test_with_every_entity_sampled_it_is_the_full_softmax(scores):
    """With every entity sampled and expected once it is the softmax over all."""
    targets = torch.tensor([0, 3, 3, 8, 5])
    scores.requires_grad_()
    found = sampled_loss(
        scores, targets, torch.randperm(SIZE), torch.ones(SIZE, dtype=torch.float64)
    )
    expected = cross_entropy(scores, targets)
    torch.testing.assert_close(found, expected)
    for ours, reference in zip(
        *(torch.autograd.grad(loss, scores) for loss in (found, expected)), strict=True
    ):
        torch.testing.assert_close(ours, reference)


def test_the_loss_follows_its_formula_with_repeated_entities(scores):
    """The loss follows its formula with repeated and true entities in the sample."""
    targets, drawn = torch.tensor([0, 3, 3, 8, 5]), torch.tensor([3, 3, 1, 8])
    expected = torch.tensor([0.5, 0.5, 2.0, 0.1], dtype=torch.float64)
    found = sampled_loss(scores, targets, drawn, expected).item()
    assert found == pytest.approx(slow_sampled_loss(scores, targets, drawn, expected))
    without_correction = sampled_loss(
        scores, targets, drawn, torch.ones(4, dtype=torch.float64)
    ).item()
    assert abs(found - without_correction) > 0.1


@pytest.fixture
def loop(factory):
    model = ComplExN3(triples_factory=factory, embedding_dim=3, init_scale=0.7, random_seed=3)
    model.train()
    return SampledSymmetricLCWATrainingLoop(model, factory, num_sampled=4_000)


def test_half_of_the_sample_is_uniform_and_half_follows_the_frequencies(loop, factory):
    ends = factory.mapped_triples[:, [0, 2]].flatten().tolist()
    expected = [0.5 / 7 + 0.5 * ends.count(entity) / len(ends) for entity in range(7)]
    np.testing.assert_allclose(loop.probabilities.numpy(), expected, rtol=1e-6)


def test_label_smoothing_is_refused(loop, factory):
    with pytest.raises(ConfigError, match="label smoothing"):
        loop._process_batch((factory.mapped_triples,), 0, 5, label_smoothing=0.1)


def test_a_sparse_gradient_moves_the_rows_of_a_dense_one(factory):
    """A sparse gradient moves the same rows as a dense one and no others."""
    after = []
    triples = factory.mapped_triples[:2]
    for is_sparse in (True, False):
        config = ComplExConfig(dim=3, negatives=2, init_scale=0.5)
        with pykeen_guard(0, threads=1):
            loop = make_training_loop(config, factory)
            (entity,) = loop.model.entity_representations
            entity._embeddings.sparse = is_sparse
            before = entity._embeddings.weight.detach().clone()
            loop.model.train()
            for seed in range(3):
                torch.manual_seed(seed)
                loop.optimizer.zero_grad()
                loop._process_batch((triples,), 0, 2).backward()
                assert entity._embeddings.weight.grad.is_sparse == is_sparse
                loop.optimizer.step()
            after.append(entity._embeddings.weight.detach() - before)
    torch.testing.assert_close(*after)
    assert after[0].any(dim=1).sum() < len(before)


@pytest.mark.parametrize(
    ("size", "asked", "expected"),
    [
        (FULL_SOFTMAX, None, 0),
        (FULL_SOFTMAX + 1, None, NEGATIVES),
        (FULL_SOFTMAX + 1, 0, 0),
        (5, 3, 3),
    ],
)
def test_the_softmax_is_sampled_above_a_size_unless_told_otherwise(size, asked, expected):
    config = ComplExConfig(negatives=asked)
    assert config.for_size(size).negatives == expected
    assert config.for_size(size).for_size(1).negatives == expected


def test_a_sampled_objective_chosen_for_size_is_recorded(
    opened_kitchen, tmp_path, monkeypatch, caplog
):
    """A sampled objective that was chosen for the size is said and recorded."""
    monkeypatch.setattr(link_config, "FULL_SOFTMAX", opened_kitchen.graph.num_entities - 1)
    trained = train(
        opened_kitchen, ComplExConfig(dim=4, epochs=1, n3=0.1, folds=0), tmp_path / "model"
    )
    assert "samples 512 entities per batch" in caplog.text
    settings = LinksConfig.read(trained.folder).settings
    assert isinstance(settings, ComplExConfig)
    assert settings.negatives == NEGATIVES
    assert "512 entities sampled" in (trained.folder / "README.md").read_text()
