"""Scorers from models that PyKEEN's own pipeline has trained."""

import numpy as np
import pytest
import torch
from pykeen.pipeline import pipeline
from pykeen.triples import TriplesFactory

from wordcraft_kg import from_pykeen, open_graph, open_model, save_scorer
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.graphs import RELATIONS
from wordcraft_kg.models.scorers import config


def train(model="DistMult", **settings):
    quiet, kind = {"use_tqdm": False}, {"model": model, "model_kwargs": {"embedding_dim": 4}}
    return pipeline(**kind, epochs=1, random_seed=0, training_kwargs=quiet, evaluation_kwargs=quiet, **settings)


def on_kitchen(model="DistMult", **settings):
    return train(model, dataset="wordcraft", dataset_kwargs={"graph": "kitchen", **settings})


@pytest.mark.parametrize("is_inverse", [False, True])
def test_the_scorer_gives_every_triple_pykeens_own_score(is_inverse, opened_kitchen):
    result = on_kitchen("TransE", create_inverse_triples=is_inverse)
    scorer = from_pykeen(result.model, result.training, opened_kitchen)
    triples = torch.from_numpy(opened_kitchen.graph.triples[::7].copy())
    theirs = result.model.predict_hrt(triples)[:, 0]  # on this dataset PyKEEN's ids are the graph's
    torch.testing.assert_close(scorer.score(*triples.T), theirs)


def test_labels_are_matched_whatever_pykeens_ids_are(opened_kitchen):
    graph = opened_kitchen.graph
    labelled = [[graph.entities[h], RELATIONS[r], graph.entities[t]] for h, r, t in graph.triples.tolist()]
    factory = TriplesFactory.from_labeled_triples(
        np.array(labelled),
        entity_to_id={label: i for i, label in enumerate(reversed(graph.entities))},
        relation_to_id={name: i for i, name in enumerate(reversed(RELATIONS))},
    )
    result = train(training=factory, testing=factory)
    scorer = from_pykeen(result.model, factory, opened_kitchen)
    for head, relation, tail in labelled[::50]:
        ids = [factory.entity_to_id[head], factory.relation_to_id[relation], factory.entity_to_id[tail]]
        assert float(scorer.score(head, relation, tail)) == pytest.approx(
            result.model.predict_hrt(torch.tensor([ids])).item(), abs=1e-5
        )


def test_a_model_of_another_graph_is_refused_with_what_differs():
    result = on_kitchen()
    with pytest.raises(GraphMismatchError, match=r"entities .* are missing .* are unknown"):
        from_pykeen(result.model, result.training, open_graph("paper-examples"))


def test_a_table_that_is_too_large_is_refused(opened_kitchen, monkeypatch):
    result = on_kitchen()
    monkeypatch.setattr(config, "TABLE_LIMIT", 1_000)
    with pytest.raises(ConfigError, match="80 entities"):
        from_pykeen(result.model, result.training, opened_kitchen)


def test_it_becomes_a_model_folder_of_the_same_scores(opened_kitchen, tmp_path):
    result = on_kitchen("TransE")
    scorer = from_pykeen(result.model, result.training, opened_kitchen)
    model = open_model(save_scorer(tmp_path / "model", scorer, opened_kitchen, kg="partial"))
    assert (model.kg, model.provenance["what it is"]) == ("partial", "TransE")
    torch.testing.assert_close(model.scorer.table(0), scorer.table(0))
