"""Scorers from models that PyKEEN's own pipeline has trained and saved."""

import gzip
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from pykeen.pipeline import PipelineResult, pipeline
from pykeen.triples import TriplesFactory
from refusals import refuses

from wordcraft_kg.base.errors import ArtefactError, GraphMismatchError, OutputExistsError
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.links.pykeen_bridge import triples_factory
from wordcraft_kg.models.links.pykeen_import import from_pykeen, import_pykeen


def train(model: str = "DistMult", **settings: Any) -> PipelineResult:
    return pipeline(
        model=model,
        model_kwargs={"embedding_dim": 4},
        epochs=1,
        random_seed=0,
        training_kwargs={"use_tqdm": False},
        evaluation_kwargs={"use_tqdm": False},
        **settings,
    )


def on_kitchen(model: str = "DistMult", **settings: Any) -> PipelineResult:
    return train(model, dataset="wordcraft", dataset_kwargs={"graph": "kitchen", **settings})


def packed(text: bytes) -> bytes:
    """Compress without the time, so that every worker of a test run sees the same parameters."""
    return gzip.compress(text, mtime=0)


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pipeline's result on the partial graph; read only."""
    folder = tmp_path_factory.mktemp("pykeen") / "result"
    on_kitchen("TransE").save_to_directory(folder)
    return folder


@pytest.fixture
def copied(saved: Path, tmp_path: Path) -> Path:
    """A copy, for a test to damage."""
    for path in saved.rglob("*"):
        if path.is_file():
            to = tmp_path / "result" / path.relative_to(saved)
            to.parent.mkdir(parents=True, exist_ok=True)
            to.write_bytes(path.read_bytes())
    return tmp_path / "result"


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


def test_a_saved_result_becomes_a_model_folder(saved, opened_kitchen, tmp_path):
    found = import_pykeen(saved, "kitchen", tmp_path / "model", trust_pickle=True)
    assert (found.model, found.triples, found.held_out, found.kg) == ("TransE", 790, 0, "partial")
    model = open_model(tmp_path / "model")
    assert model.kg == "partial"
    theirs = torch.load(saved / "trained_model.pkl", weights_only=False)
    triples = torch.from_numpy(opened_kitchen.graph.triples[::7].copy())
    torch.testing.assert_close(model.scorer.score(*triples.T), theirs.predict_hrt(triples)[:, 0])


def test_a_model_that_has_seen_a_held_out_triple_counts_as_one_of_the_full_graph(opened_kitchen, tmp_path):
    split = opened_kitchen.split
    with_one_more = np.concatenate([split.partial, split.unseen[:1]])
    factory = triples_factory(opened_kitchen.graph, with_one_more)
    train(training=factory, testing=factory).save_to_directory(tmp_path / "result")
    found = import_pykeen(tmp_path / "result", "kitchen", tmp_path / "model", trust_pickle=True)
    assert (found.held_out, found.kg) == (1, "full")
    assert open_model(tmp_path / "model").kg == "full"


class Trap:
    """A pickle of this writes a file when it is read."""

    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_no_pickle_is_read_unless_it_is_trusted(copied, tmp_path):
    (copied / "trained_model.pkl").write_bytes(pickle.dumps(Trap(tmp_path / "sprung")))
    with refuses("trust_pickle"):
        import_pykeen(copied, "kitchen", tmp_path / "model")
    assert not (tmp_path / "sprung").exists()
    with pytest.raises(ArtefactError):
        import_pykeen(copied, "kitchen", tmp_path / "model", trust_pickle=True)
    assert (tmp_path / "sprung").exists()  # the trap works
    assert not (tmp_path / "model").exists()


def test_a_model_of_another_graph_is_refused_with_what_differs(saved, tmp_path):
    with pytest.raises(GraphMismatchError):
        import_pykeen(saved, "paper-examples", tmp_path / "model", trust_pickle=True)
    assert not (tmp_path / "model").exists()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("trained_model.pkl", None, "trained_model.pkl is missing; expected a folder written by PyKEEN"),
        ("trained_model.pkl", b"nonsense", "cannot be read"),
        ("training_triples/entity_to_id.tsv.gz", None, "is missing"),
        ("training_triples/entity_to_id.tsv.gz", b"nonsense", "is damaged"),
        (
            "training_triples/entity_to_id.tsv.gz",
            packed(b"id\tlabel\n0\twater\n2\tflour\n"),
            "not 0 to 1",
        ),
        ("training_triples/relation_to_id.tsv.gz", packed(b"number\tlabel\n0\twater\n"), "is damaged"),
        (
            "training_triples/numeric_triples.tsv.gz",
            packed(b"head\trelation\ttail\n0\t0\t80\n"),
            "in no vocabulary",
        ),
    ],
)
def test_a_damaged_folder_is_an_error_that_names_the_file(name, content, said, copied, tmp_path):
    (copied / name).unlink()
    if content is not None:
        (copied / name).write_bytes(content)
    with pytest.raises(ArtefactError, match=said) as error:
        import_pykeen(copied, "kitchen", tmp_path / "model", trust_pickle=True)
    assert Path(name).name in str(error.value)
    assert not (tmp_path / "model").exists()


def test_something_else_than_a_model_is_refused(copied, tmp_path):
    torch.save({"weights": torch.zeros(2)}, copied / "trained_model.pkl")
    with pytest.raises(ArtefactError, match="holds a dict; expected a model of PyKEEN's"):
        import_pykeen(copied, "kitchen", tmp_path / "model", trust_pickle=True)


def test_an_output_that_exists_is_refused_before_the_pickle_is_read(copied, tmp_path):
    (copied / "trained_model.pkl").write_bytes(pickle.dumps(Trap(tmp_path / "sprung")))
    (tmp_path / "model").mkdir()
    with pytest.raises(OutputExistsError):
        import_pykeen(copied, "kitchen", tmp_path / "model", trust_pickle=True)
    assert not (tmp_path / "sprung").exists()
