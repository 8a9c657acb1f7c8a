"""``score`` for entities that are in no graph."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from wordcraft_kg.cli import main

Run = Callable[..., Any]


@pytest.fixture(scope="session")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recipe scorer of the kitchen and a link predictor."""
    root = tmp_path_factory.mktemp("models")
    assert main(["train-recipes", "kitchen", "--folds", "3", "--out", str(root / "recipes"), "--quiet"]) == 0
    tiny = ["--dim", "4", "--epochs", "1", "--folds", "0", "--n3", "0.1"]
    assert main(["train-complex", "kitchen", *tiny, "--out", str(root / "links"), "--quiet"]) == 0
    return root


def test_a_word_that_is_in_no_graph_is_scored_and_the_answer_says_so(run: Run, models: Path):
    found = run("score", models / "recipes", "yogurt", "componentOf", "cake")
    assert found.code == 0, found.err
    assert "new  yogurt componentOf cake" in found.out
    assert "among all 81 entities" in found.out
    assert "'yogurt' is not in the graph: scored by its words alone." in found.out


def test_the_best_entities_for_a_new_word_are_listed_on_both_sides(run: Run, models: Path):
    parts = json.loads(run("score", models / "recipes", "_", "componentOf", "yogurt", "--json", "--top", "81").out)
    assert parts["by_words"] == ["yogurt"]
    assert len(parts["top"]) == 81
    assert {row["known"] for row in parts["top"]} == {"new"}
    partners = json.loads(run("score", models / "recipes", "yogurt", "combinesWith", "--json", "--top", "3").out)
    assert (partners["head"], len(partners["top"]), partners["by_words"]) == ("yogurt", 3, ["yogurt"])


def test_two_new_words_are_listed(run: Run, models: Path):
    found = run("score", models / "recipes", "yogurt", "combinesWith", "rice")
    assert "'yogurt', 'rice' are not in the graph: scored by their words alone." in found.out


def test_entities_of_the_graph_are_scored_as_before(run: Run, models: Path):
    found = json.loads(run("score", models / "recipes", "flour", "combinesWith", "water", "--json").out)
    assert found["by_words"] == []
    assert "not in the graph" not in run("score", models / "recipes", "flour", "combinesWith", "water").out


def test_a_misspelt_word_with_a_vector_is_scored_with_a_hint(run: Run, models: Path):
    found = run("score", models / "recipes", "flours", "combinesWith", "water")
    assert "'flours' is not in the graph: scored by its words alone. Did you mean 'flour'" in found.out


def test_new_words_of_a_file_are_scored_and_listed(run: Run, models: Path, tmp_path: Path):
    queries, out = tmp_path / "pairs.csv", tmp_path / "scores.csv"
    queries.write_text("yogurt,combinesWith,water\n_,componentOf,rice\nflour,combinesWith,yogurt\n")
    found = json.loads(run("score", models / "recipes", "--in", queries, "--top", "2", "--json").out)
    assert (found["found"], found["by_words"]) == (4, ["yogurt", "rice"])
    written = run("score", models / "recipes", "--in", queries, "--top", "2", "--out", out)
    assert "'yogurt', 'rice' are not in the graph" in written.out
    assert len(out.read_text().splitlines()) == 5


def test_a_word_without_a_vector_stops_a_file_with_its_line(run: Run, models: Path, tmp_path: Path):
    queries, out = tmp_path / "pairs.csv", tmp_path / "scores.csv"
    queries.write_text("yogurt,combinesWith,water\nflour,combinesWith,flouurr\n")
    found = run("score", models / "recipes", "--in", queries, "--out", out)
    assert (found.code, found.kind) == (1, "QueryFileError")
    assert f"{queries}, line 2: no entity 'flouurr'. Did you mean 'flour'" in found.err
    assert not out.exists()


@pytest.mark.parametrize(
    ("model", "word", "told"),
    [
        ("recipes", "flouurr", "No word of it has a vector in glove."),
        ("links", "yogurt", "knows the entities of its graph only"),
    ],
)
def test_what_a_model_cannot_score_is_refused_with_the_reason(run: Run, models: Path, model: str, word: str, told: str):
    found = run("score", models / model, word, "combinesWith", "water")
    assert (found.code, found.kind) == (1, "UnknownEntityError")
    assert f"no entity '{word}'." in found.err
    assert told in found.err
    assert "Traceback" not in found.err


def test_an_open_slot_is_not_taken_as_a_new_word(run: Run, models: Path):
    assert run("score", models / "recipes", "_", "combinesWith", "_").kind == "ConfigError"
    assert run("score", models / "recipes", "", "combinesWith", "").kind == "ConfigError"
