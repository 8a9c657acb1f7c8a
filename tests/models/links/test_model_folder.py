"""Model folders: saved scorers, and models opened with the graph and split that they were trained
on."""

import json
import re
import shutil
from dataclasses import replace

import pytest
import torch
from helpers import refuses, write_graph
from link_helpers import flip_bit, random_graph, train
from small_scorers import embeddings

from wordcraft_kg import (
    ComplExConfig,
    RecipeGraph,
    SplitConfig,
    load_scorer,
    make_split,
    open_book,
    open_graph,
    open_model,
    save_scorer,
)
from wordcraft_kg.base import ArtefactError, ConfigError, GraphMismatchError, sha256_of
from wordcraft_kg.graphs import write_graph_folder
from wordcraft_kg.models.scorers.baselines import SymbolicScorer
from wordcraft_kg.models.scorers.factors import ComplExScorer, TableScorer
from wordcraft_kg.models.scorers.scorer import Scorer

SHORT = ComplExConfig(dim=4, epochs=2, n3=0.1, folds=2)


@pytest.fixture
def on_disk(parted_folder, tmp_path):
    """A model folder, and the graph folder beside it, for a test to move or replace."""
    shutil.copytree(parted_folder, tmp_path / "graph")
    return train(
        open_graph(tmp_path / "graph"), SHORT, tmp_path / "model"
    ).folder, tmp_path / "graph"


def test_an_opened_model_has_its_scorer_graph_split_and_history(complex_folder, opened_kitchen):
    opened = open_model(complex_folder)
    assert (opened.opened.graph, opened.opened.split.hash) == (
        opened_kitchen.graph,
        opened_kitchen.split.hash,
    )
    assert opened.scorer.graph_hash == opened_kitchen.graph.hash
    assert (opened.kg, [row.epoch for row in opened.history.trace]) == ("partial", [1, 2, 3, 4])
    assert (
        opened.provenance["weights"]
        == json.loads((complex_folder / "run.json").read_text())["outputs"]["model.safetensors"]
    )


def test_a_graph_that_has_moved_is_an_error_that_asks_for_it(on_disk, tmp_path):
    model, graph = on_disk
    graph.rename(tmp_path / "moved")
    with refuses("graph", ArtefactError):
        open_model(model)
    assert open_model(model, str(tmp_path / "moved")).opened.source == str(tmp_path / "moved")


def test_a_graph_built_again_is_accepted_with_the_same_split_only(on_disk):
    model, graph = on_disk
    write_graph(graph, train_ratio=0.7, valid_ratio=0.15)
    assert open_model(model).opened.graph.name == "kitchen"
    write_graph(graph, train_ratio=0.7, valid_ratio=0.15, seed=1)
    with refuses("graph", GraphMismatchError):
        open_model(model)


def test_another_graph_is_refused(complex_folder, tmp_path):
    book = open_book("kitchen")
    smaller = replace(book, recipes=book.recipes[:-1])
    write_graph_folder(
        tmp_path / "graph", smaller, make_split(RecipeGraph.from_book(smaller), SplitConfig())
    )
    with pytest.raises(GraphMismatchError):
        open_model(complex_folder, str(tmp_path / "graph"))


@pytest.mark.parametrize(
    "name",
    [
        "config.toml",
        "metrics.json",
        "trace.jsonl",
        "vocabulary.json",
        "model.safetensors",
        "run.json",
    ],
)
def test_a_changed_or_missing_output_is_named(spoilt, name):
    """An output that is changed or missing is an artefact error that names it."""
    folder, path = spoilt(name)
    flip_bit(path, 0, bit=5)
    with pytest.raises(ArtefactError, match=rf"{name} is damaged"):
        open_model(folder)
    path.unlink()
    with pytest.raises(ArtefactError, match=rf"{name} is missing|has none of .*{name}"):
        open_model(folder)


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        (lambda known: {"entities": known["entities"][::-1]}, "or in another order"),
        (lambda known: {"entities": known["entities"][:1] * 2}, "occurs twice"),
        (lambda known: {"relations": known["relations"][::-1]}, "relations are not"),
        (lambda known: {"graph": ""}, "was trained on graph"),
    ],
)
def test_a_vocabulary_that_is_not_the_graphs_is_refused(spoilt, changed, expected):
    """The hash in the run record fits, as somebody who forges a folder would see to."""
    folder, path = spoilt("vocabulary.json")
    known = json.loads(path.read_text())
    path.write_text(json.dumps(known | changed(known)))
    run = json.loads((folder / "run.json").read_text())
    run["outputs"][path.name] = sha256_of(path)
    (folder / "run.json").write_text(json.dumps(run))
    with pytest.raises(ArtefactError, match=expected):
        open_model(folder)


def test_a_model_folder_needs_nothing_but_what_its_run_wrote(spoilt):
    folder, card = spoilt("README.md")
    card.unlink()
    (folder / "notes.txt").write_text("a note of mine")
    assert open_model(folder).kg == "partial"


class Lengths(Scorer):
    """Scores a triple by the lengths of its labels."""

    def _score(self, heads, relations, tails):
        lengths = torch.tensor([float(len(label)) for label in self.entities])
        return lengths[heads] - 2 * lengths[tails] + relations


@pytest.fixture
def mine(opened_kitchen):
    return Lengths(opened_kitchen.graph.entities, opened_kitchen.graph.hash)


def complex_scorer(opened):
    return ComplExScorer(
        embeddings(opened.graph.num_entities, 3), opened.graph.entities, opened.graph.hash
    )


@pytest.mark.parametrize(
    "make", [lambda opened: Lengths(opened.graph.entities, opened.graph.hash), complex_scorer]
)
def test_a_saved_scorer_scores_as_before_and_embeddings_stay_embeddings(
    make, opened_kitchen, tmp_path
):
    mine = make(opened_kitchen)
    folder = save_scorer(tmp_path / "mine", mine, opened_kitchen, kg="partial")
    loaded = load_scorer(folder)
    for relation in ("combinesWith", "componentOf"):
        torch.testing.assert_close(loaded.table(relation), mine.table(relation), rtol=0, atol=0)
    assert loaded.entities == opened_kitchen.graph.entities
    is_small = (
        folder / "model.safetensors"
    ).stat().st_size < opened_kitchen.graph.num_entities**2 * 4
    assert is_small == (make is complex_scorer)


@pytest.mark.parametrize("kg", ["partial", "full"])
def test_an_opened_folder_says_what_the_scorer_has_seen(kg, mine, opened_kitchen, tmp_path):
    """An opened folder says what the scorer has seen and that it was not trained here."""
    folder = save_scorer(tmp_path / "mine", mine, opened_kitchen, kg=kg, origin="lengths of labels")
    model = open_model(folder)
    assert (model.kg, model.metrics, model.history.trace) == (kg, None, ())
    assert model.opened.split.hash == opened_kitchen.split.hash
    assert model.provenance["what it is"] == "lengths of labels"
    assert "someone else" in model.provenance["trained by"]
    card = (folder / "README.md").read_text()
    assert "not trained by wordcraft-kg" in card
    assert ("memory, not prediction" in card) == (kg == "full")
    assert card.startswith("---\nlibrary_name: wordcraft-kg\n")


def test_all_that_a_folder_holds_is_hashed(mine, opened_kitchen, tmp_path):
    folder = save_scorer(tmp_path / "mine", mine, opened_kitchen, kg="partial")
    for name in ("model.safetensors", "vocabulary.json", "config.toml"):
        whole = (folder / name).read_bytes()
        (folder / name).write_bytes(whole.replace(b"a", b"b", 1))
        with pytest.raises(ArtefactError, match=re.escape(name)):
            open_model(folder)
        (folder / name).write_bytes(whole)
    assert open_model(folder).kg == "partial"


def test_a_scorer_of_another_graph_is_refused(opened_kitchen, tmp_path):
    other = random_graph()
    with pytest.raises(GraphMismatchError):
        save_scorer(
            tmp_path / "x", SymbolicScorer(other, other.triples), opened_kitchen, kg="partial"
        )
    entities = opened_kitchen.graph.entities[::-1]
    with pytest.raises(GraphMismatchError, match="or in another order"):
        save_scorer(
            tmp_path / "x",
            Lengths(entities, opened_kitchen.graph.hash),
            opened_kitchen,
            kg="partial",
        )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_scores_that_are_not_finite_are_refused(bad, opened_kitchen, tmp_path):
    graph = opened_kitchen.graph
    scores = torch.zeros(2, graph.num_entities, graph.num_entities)
    scores[1, 2, 3] = bad
    with pytest.raises(ConfigError, match="not finite"):
        save_scorer(
            tmp_path / "x",
            TableScorer(scores, graph.entities, graph.hash),
            opened_kitchen,
            kg="full",
        )
    assert not list(tmp_path.iterdir())


def test_what_it_has_seen_has_to_be_one_of_two(mine, opened_kitchen, tmp_path):
    with refuses("kg"):
        save_scorer(tmp_path / "x", mine, opened_kitchen, kg="some")


def test_a_table_that_is_too_large_is_refused_before_it_is_computed(
    mine, opened_kitchen, tmp_path, monkeypatch
):
    monkeypatch.setattr("wordcraft_kg.models.scorers.score_limits.TABLE_LIMIT", 1_000)
    monkeypatch.setattr(Lengths, "table", None)
    with pytest.raises(ConfigError, match="80 entities"):
        save_scorer(tmp_path / "x", mine, opened_kitchen, kg="partial")
    save_scorer(tmp_path / "complex", complex_scorer(opened_kitchen), opened_kitchen, kg="partial")
