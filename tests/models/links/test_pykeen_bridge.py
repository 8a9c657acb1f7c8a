"""The guard around PyKEEN's global seeding, and what of PyKEEN's logging it lets through."""

import random
from functools import cache

import numpy as np
import pytest
import torch
from helpers import frozen, write_graph
from link_helpers import random_graph
from pykeen.datasets import dataset_resolver, get_dataset
from pykeen.pipeline import pipeline
from pykeen.triples import TriplesFactory

from wordcraft_kg import from_pykeen, open_graph, open_model, save_scorer
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError, SplitError
from wordcraft_kg.graphs import RELATIONS
from wordcraft_kg.models.links.pykeen_bridge import (
    pykeen_guard,
    triples_factory,
)
from wordcraft_kg.models.scorers import score_limits


def draws():
    return random.random(), float(np.random.rand()), float(torch.rand(()))  # noqa: NPY002


@pytest.fixture(autouse=True)
def start():
    random.seed(11)
    np.random.seed(11)  # noqa: NPY002
    torch.manual_seed(11)


def test_draws_inside_the_guard_depend_on_the_seed_alone():
    found = []
    for seed, warm_up in ((3, 0), (3, 5), (4, 0)):
        for _ in range(warm_up):
            draws()
        with pykeen_guard(seed=seed, threads=1):
            found.append(draws())
    assert found[0] == found[1]
    assert all(one != other for one, other in zip(found[0], found[2], strict=True))


def test_a_triples_factory_has_the_graphs_triples_and_ids():
    """A triples factory has the graphs triples and ids and shares no memory."""
    graph = random_graph()
    factory = triples_factory(graph, graph.triples)
    assert factory.mapped_triples.tolist() == graph.triples.tolist()
    assert factory.mapped_triples.dtype == torch.int64
    assert factory.entity_to_id == {label: i for i, label in enumerate(graph.entities)}
    assert factory.relation_to_id == {label: i for i, label in enumerate(RELATIONS)}
    assert triples_factory(graph, graph.triples[:1]).num_entities == graph.num_entities
    factory.mapped_triples[0, 0] += 1
    assert factory.mapped_triples[0, 0] == graph.triples[0, 0] + 1


def train(model="DistMult", **settings):
    quiet, kind = {"use_tqdm": False}, {"model": model, "model_kwargs": {"embedding_dim": 4}}
    with frozen():
        return pipeline(
            **kind,
            epochs=1,
            random_seed=0,
            training_kwargs=quiet,
            evaluation_kwargs=quiet,
            **settings,
        )


@cache
def on_kitchen(is_inverse):
    graph = {"graph": "kitchen", "create_inverse_triples": is_inverse}
    result = train("TransE", dataset="wordcraft", dataset_kwargs=graph)
    return result.model, result.training


@pytest.mark.parametrize("is_inverse", [False, True])
def test_the_scorer_gives_every_triple_pykeens_own_score(is_inverse, opened_kitchen):
    model, training = on_kitchen(is_inverse)
    scorer = from_pykeen(model, training, opened_kitchen)
    triples = torch.from_numpy(opened_kitchen.graph.triples[::7].copy())
    theirs = model.predict_hrt(triples)[:, 0]  # on this dataset PyKEEN's ids are the graph's
    torch.testing.assert_close(scorer.score(*triples.T), theirs)


def test_labels_are_matched_whatever_pykeens_ids_are(opened_kitchen):
    graph = opened_kitchen.graph
    labelled = [
        [graph.entities[h], RELATIONS[r], graph.entities[t]] for h, r, t in graph.triples.tolist()
    ]
    factory = TriplesFactory.from_labeled_triples(
        np.array(labelled),
        entity_to_id={label: i for i, label in enumerate(reversed(graph.entities))},
        relation_to_id={name: i for i, name in enumerate(reversed(RELATIONS))},
    )
    result = train(training=factory, testing=factory)
    scorer = from_pykeen(result.model, factory, opened_kitchen)
    for head, relation, tail in labelled[::50]:
        ids = [
            factory.entity_to_id[head],
            factory.relation_to_id[relation],
            factory.entity_to_id[tail],
        ]
        theirs = result.model.predict_hrt(torch.tensor([ids])).item()
        assert float(scorer.score(head, relation, tail)) == pytest.approx(theirs, abs=1e-5)


def test_a_model_of_another_graph_is_refused_with_what_differs():
    with pytest.raises(GraphMismatchError, match=r"entities .* are missing .* are unknown"):
        from_pykeen(*on_kitchen(False), open_graph("paper-examples"))


def test_a_table_that_is_too_large_is_refused(opened_kitchen, monkeypatch):
    monkeypatch.setattr(score_limits, "TABLE_LIMIT", 1_000)
    with pytest.raises(ConfigError, match="80 entities"):
        from_pykeen(*on_kitchen(False), opened_kitchen)


def test_it_becomes_a_model_folder_of_the_same_scores(opened_kitchen, tmp_path):
    scorer = from_pykeen(*on_kitchen(False), opened_kitchen)
    model = open_model(save_scorer(tmp_path / "model", scorer, opened_kitchen, kg="partial"))
    assert (model.kg, model.provenance["what it is"]) == ("partial", "TransE")
    torch.testing.assert_close(model.scorer.table(0), scorer.table(0))


@pytest.fixture(autouse=True)
def own_pykeen_cache(tmp_path, monkeypatch):
    """Keep PyKEEN's cache of datasets out of the user's home."""
    monkeypatch.setattr("pykeen.datasets.utils.PYKEEN_DATASETS", tmp_path / "pykeen-cache")


def test_the_dataset_holds_the_parts_of_the_graphs_split_and_keeps_its_ids(
    parted_kitchen, parted_folder
):
    dataset = dataset_resolver.make("wordcraft", {"graph": parted_folder})
    graph, split = parted_kitchen.graph, parted_kitchen.split
    factories = (dataset.training, dataset.validation, dataset.testing)
    parts = (split.partial, split.held_out("valid"), split.held_out("test"))
    for factory, triples in zip(factories, parts, strict=True):
        assert sorted(factory.mapped_triples.tolist()) == sorted(triples.tolist())
        assert factory.entity_to_id == {name: i for i, name in enumerate(graph.entities)}
    assert dataset.training.relation_to_id == {name: i for i, name in enumerate(RELATIONS)}


def test_the_dataset_adds_inverse_triples_when_asked(parted_folder):
    plain, doubled = (
        dataset_resolver.make(
            "wordcraft", {"graph": parted_folder, "create_inverse_triples": inverse}
        ).training
        for inverse in (False, True)
    )
    assert (plain.num_relations, doubled.num_relations) == (2, 4)


def test_the_dataset_of_a_graph_without_test_triples_is_refused(tmp_path):
    with pytest.raises(SplitError, match="another split"):
        dataset_resolver.make(
            "wordcraft", {"graph": write_graph(tmp_path / "unsplit", kind="none")}
        )


def test_pykeen_sees_a_graph_that_was_built_again_in_the_same_folder(tmp_path):
    for seed in (0, 1):
        folder = write_graph(tmp_path / "graph", seed=seed)
        dataset = get_dataset(dataset="wordcraft", dataset_kwargs={"graph": str(folder)})
        partial = open_graph(folder).split.partial
        assert sorted(dataset.training.mapped_triples.tolist()) == sorted(partial.tolist())
