"""ComplEx: the matrix product scores, the paper's equations, and the training loop against PyKEEN's
own."""

import math

import hypothesis.extra.numpy as npst
import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st
from link_helpers import equation_2, n3, random_graph, train
from pykeen.nn.modules import ComplExInteraction
from pykeen.regularizers import PowerSumRegularizer
from small_scorers import embeddings
from torch.nn.functional import cross_entropy

from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.links import link_config
from wordcraft_kg.models.links.builders import (
    MatmulComplExInteraction,
    complex_model,
    log_counts,
    make_training_loop,
    with_popularity,
)
from wordcraft_kg.models.links.link_config import (
    FULL_SOFTMAX,
    NEGATIVES,
    PAPER_DIM,
    ComplExConfig,
    LinksConfig,
)
from wordcraft_kg.models.links.pykeen_bridge import pykeen_guard, triples_factory
from wordcraft_kg.models.links.symmetric_lcwa import (
    IndexedSymmetricLCWATrainingLoop,
    SampledSymmetricLCWATrainingLoop,
    sampled_cross_entropy,
)
from wordcraft_kg.models.scorers.factors import ComplExScorer

D = 6


def embedding(shape, seed, dtype=torch.complex64):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, D, dtype=dtype, generator=generator)


@pytest.fixture
def factory():
    graph = random_graph(num_entities=7, num_recipes=9)
    return triples_factory(graph, graph.triples)


def tiny_model(factory, n3=0.0):
    return complex_model(factory, ComplExConfig(dim=3, n3=n3, init_scale=0.7, seed=3))


def loop_of(model, factory, **options):
    model.train()
    return IndexedSymmetricLCWATrainingLoop(model=model, triples_factory=factory, **options)


def weights(model):
    (entity,), (relation,) = model.entity_representations, model.relation_representations
    return entity._plain_forward().detach().numpy(), relation._plain_forward().detach().numpy()


@given(npst.mutually_broadcastable_shapes(num_shapes=3, max_dims=3, max_side=4), st.booleans())
def test_matmul_interaction_equals_pykeens_for_any_broadcastable_shapes(shapes, is_conjugated):
    inputs = [embedding(shape, seed) for seed, shape in enumerate(shapes.input_shapes)]
    inputs = [x.conj() if is_conjugated else x for x in inputs]
    expected = ComplExInteraction()(*(x.resolve_conj() for x in inputs))
    torch.testing.assert_close(MatmulComplExInteraction()(*inputs), expected, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(
    ("weight", "part"),
    [(0.3, slice(0, None)), (1.0, slice(0, None)), (0, slice(0, None)), (0, slice(2, 5))],
)
def test_equation_2_loss_is_both_softmaxes_plus_n3_once(factory, weight, part):
    """Equation 2 loss of a batch is the softmax of both sides plus n3 once."""
    model = tiny_model(factory, weight)
    triples = factory.mapped_triples[part].tolist()
    loss = (
        loop_of(model, factory)
        ._process_batch((factory.mapped_triples,), part.start, part.stop)
        .item()
    )
    expected = equation_2(*weights(model), triples) + weight * n3(*weights(model), triples)
    assert loss == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("batch_size", [1, 4, 100])
def test_an_epoch_visits_every_triple_once_in_an_order_of_its_own(factory, batch_size):
    loop = loop_of(tiny_model(factory), factory)
    loader = loop._create_training_data_loader(
        factory, None, batch_size=batch_size, drop_last=False
    )
    epochs = [[batch for (batch,) in loader] for _ in range(5)]
    assert {len(batch) for batches in epochs for batch in batches[:-1]} <= {batch_size}
    orders = [torch.cat(batches).tolist() for batches in epochs]
    assert all(sorted(order) == sorted(factory.mapped_triples.tolist()) for order in orders)
    assert orders.count(orders[0]) < 5


def test_the_regulariser_is_the_papers(factory):
    (entity,) = complex_model(factory, ComplExConfig(n3=0.5)).entity_representations
    assert (entity().shape, entity().dtype) == ((factory.num_entities, PAPER_DIM), torch.complex64)
    assert isinstance(entity.regularizer, PowerSumRegularizer)
    assert (entity.regularizer.p, entity.regularizer.normalize) == (3.0, False)
    assert entity.regularizer.weight.item() == pytest.approx(0.5)


def test_initial_embeddings_have_the_scale_asked_for(factory):
    model = complex_model(factory, ComplExConfig(dim=500, init_scale=0.01))
    entity, _ = weights(model)
    assert entity.real.std() == pytest.approx(0.01, rel=0.1)
    assert entity.imag.std() == pytest.approx(0.01, rel=0.1)


def counted(triples, relation, entity, column):
    return sum(
        1 for triple in triples.tolist() if triple[1] == relation and triple[column] == entity
    )


def test_the_log_counts_are_those_of_a_loop():
    graph = random_graph()
    as_head, as_tail = log_counts(graph.triples, graph.num_entities)
    for found, column in ((as_head, 0), (as_tail, 2)):
        for relation in range(len(RELATIONS)):
            expected = [
                math.log1p(counted(graph.triples, relation, e, column))
                for e in range(graph.num_entities)
            ]
            assert found[relation].tolist() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("weight", [0.5, 16.0])
def test_scores_gain_the_weighted_log_counts_of_head_and_tail(weight):
    graph = random_graph(num_entities=12, num_recipes=40)
    assert np.any(
        counted(graph.triples, 1, 0, 0) != counted(graph.triples, 1, 0, 2)
    )  # componentOf is not symmetric
    before = embeddings(graph.num_entities, 4, seed=1)
    after = with_popularity(before, graph.triples, weight)
    assert after["entity_real"].shape == (graph.num_entities, 4 + 6)
    as_head, as_tail = log_counts(graph.triples, graph.num_entities)
    for relation in range(len(RELATIONS)):
        old, new = (
            ComplExScorer(e, graph.entities, graph.hash).table(relation) for e in (before, after)
        )
        gained = weight * (as_head[relation][:, None] + as_tail[relation][None, :])
        torch.testing.assert_close(new - old, gained, atol=2e-4, rtol=1e-5)


SIZE, QUERIES = 9, 5


@pytest.fixture
def scores():
    return (
        torch.randn(QUERIES, SIZE, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
        * 2
    )


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
    model = tiny_model(factory)
    model.train()
    return SampledSymmetricLCWATrainingLoop(model, factory, num_sampled=4_000)


def test_half_of_the_sample_is_uniform_and_half_follows_the_frequencies(loop, factory):
    ends = factory.mapped_triples[:, [0, 2]].flatten().tolist()
    expected = [0.5 / 7 + 0.5 * ends.count(entity) / len(ends) for entity in range(7)]
    np.testing.assert_allclose(loop.probabilities.numpy(), expected, rtol=1e-6)


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


def test_a_sampled_objective_chosen_for_size_is_recorded(opened_kitchen, tmp_path, monkeypatch):
    monkeypatch.setattr(link_config, "FULL_SOFTMAX", opened_kitchen.graph.num_entities - 1)
    trained = train(
        opened_kitchen, ComplExConfig(dim=4, epochs=1, n3=0.1, folds=0), tmp_path / "model"
    )
    settings = LinksConfig.read(trained.folder).settings
    assert isinstance(settings, ComplExConfig)
    assert settings.negatives == NEGATIVES
