"""Opening a model folder with the graph and split that it was trained on."""

import json
import shutil
from dataclasses import replace

import pytest
from graph_folders import write_graph
from link_helpers import flip_bit, train
from refusals import refuses

from wordcraft_kg import ComplExConfig, RecipeGraph, SplitConfig, make_split, open_book, open_graph, open_model
from wordcraft_kg.base.errors import ArtefactError, GraphMismatchError
from wordcraft_kg.graphs import write_graph_folder

SHORT = ComplExConfig(dim=4, epochs=2, n3=0.1, folds=2)


@pytest.fixture
def on_disk(parted_folder, tmp_path):
    """A model folder, and the graph folder beside it, for a test to move or replace."""
    shutil.copytree(parted_folder, tmp_path / "graph")
    return train(open_graph(tmp_path / "graph"), SHORT, tmp_path / "model").folder, tmp_path / "graph"


def test_an_opened_model_has_its_scorer_graph_split_and_history(complex_folder, opened_kitchen):
    opened = open_model(complex_folder)
    assert (opened.opened.graph, opened.opened.split.hash) == (opened_kitchen.graph, opened_kitchen.split.hash)
    assert opened.scorer.graph_hash == opened_kitchen.graph.hash
    assert (opened.kg, [row.epoch for row in opened.trace]) == ("partial", [1, 2, 3, 4])
    assert (
        opened.provenance["weights"]
        == json.loads((complex_folder / "run.json").read_text())["outputs"]["model.safetensors"]
    )


@pytest.mark.parametrize(("folder", "model"), [("elsewhere", "../model"), ("graph", "{}"), (".", "model")])
def test_a_model_finds_its_graph_from_anywhere(on_disk, tmp_path, monkeypatch, folder, model):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / folder)
    assert open_model(model.format(on_disk[0])).opened.split.hash == open_graph(on_disk[1]).split.hash


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
    write_graph_folder(tmp_path / "graph", smaller, make_split(RecipeGraph.from_book(smaller), SplitConfig()))
    with pytest.raises(GraphMismatchError):
        open_model(complex_folder, str(tmp_path / "graph"))


@pytest.mark.parametrize("name", ["config.toml", "metrics.json", "trace.jsonl", "vocabulary.json", "model.safetensors"])
def test_an_output_that_is_changed_or_missing_is_an_artefact_error_that_names_it(spoilt, name):
    folder, path = spoilt(name)
    flip_bit(path, -1)
    with pytest.raises(ArtefactError, match=rf"{name} is damaged"):
        open_model(folder)
    path.unlink()
    with pytest.raises(ArtefactError, match=rf"{name} is missing"):
        open_model(folder)


def test_a_model_folder_needs_nothing_but_what_its_run_wrote(spoilt):
    folder, card = spoilt("README.md")
    card.unlink()
    (folder / "notes.txt").write_text("a note of mine")
    assert open_model(folder).kg == "partial"
