"""``score`` for entities that are in no graph."""

import pytest

from wordcraft_kg.cli import main


@pytest.fixture(scope="session")
def models(tmp_path_factory):
    """A folder with a recipe scorer of the kitchen and a link predictor."""
    root = tmp_path_factory.mktemp("models")
    assert main(["train-recipes", "kitchen", "--folds", "3", "--out", str(root / "recipes"), "--quiet"]) == 0
    tiny = ["--dim", "4", "--epochs", "1", "--folds", "0", "--n3", "0.1"]
    assert main(["train-complex", "kitchen", *tiny, "--out", str(root / "links"), "--quiet"]) == 0
    return root


def test_a_word_that_is_in_no_graph_is_scored_and_the_answer_says_so(run, models):
    found = run("score", models / "recipes", "yogurt", "componentOf", "cake")
    assert found.code == 0, found.err
    assert "new  yogurt componentOf cake" in found.out
    assert "among all 81 entities" in found.out
    assert "'yogurt' is not in the graph: scored by its words alone." in found.out


def test_the_best_entities_for_a_new_word_are_listed_on_both_sides(printed, models):
    parts = printed("score", models / "recipes", "_", "componentOf", "yogurt", "--top", "81")
    assert parts["by_words"] == ["yogurt"]
    assert len(parts["top"]) == 81
    assert {row["known"] for row in parts["top"]} == {"new"}
    partners = printed("score", models / "recipes", "yogurt", "combinesWith", "--top", "3")
    assert (partners["head"], len(partners["top"]), partners["by_words"]) == ("yogurt", 3, ["yogurt"])


def test_two_new_words_are_listed(run, models):
    found = run("score", models / "recipes", "yogurt", "combinesWith", "rice")
    assert "'yogurt', 'rice' are not in the graph: scored by their words alone." in found.out


def test_entities_of_the_graph_are_scored_as_before(printed, run, models):
    found = printed("score", models / "recipes", "flour", "combinesWith", "water")
    assert found["by_words"] == []
    assert "not in the graph" not in run("score", models / "recipes", "flour", "combinesWith", "water").out


def test_a_misspelt_word_with_a_vector_is_scored_with_a_hint(run, models):
    found = run("score", models / "recipes", "flours", "combinesWith", "water")
    assert "'flours' is not in the graph: scored by its words alone. Did you mean 'flour'" in found.out


def test_new_words_of_a_file_are_scored_and_listed(printed, run, models, tmp_path):
    queries, out = tmp_path / "pairs.csv", tmp_path / "scores.csv"
    queries.write_text("yogurt,combinesWith,water\n_,componentOf,rice\nflour,combinesWith,yogurt\n")
    found = printed("score", models / "recipes", "--in", queries, "--top", "2")
    assert (found["found"], found["by_words"]) == (4, ["yogurt", "rice"])
    written = run("score", models / "recipes", "--in", queries, "--top", "2", "--out", out)
    assert "'yogurt', 'rice' are not in the graph" in written.out
    assert len(out.read_text().splitlines()) == 5


def test_a_word_without_a_vector_stops_a_file_with_its_line(refused, models, tmp_path):
    queries, out = tmp_path / "pairs.csv", tmp_path / "scores.csv"
    queries.write_text("yogurt,combinesWith,water\nflour,combinesWith,flouurr\n")
    command = ("score", models / "recipes", "--in", queries, "--out", out)
    refused(*command, says=f"{queries}, line 2: no entity 'flouurr'. Did you mean 'flour'", kind="QueryFileError")
    assert not out.exists()


@pytest.mark.parametrize(
    ("model", "word", "told"),
    [
        ("recipes", "flouurr", "No word of it has a vector in glove."),
        ("links", "yogurt", "knows the entities of its graph only"),
    ],
)
def test_what_a_model_cannot_score_is_refused_with_the_reason(refused, models, model, word, told):
    command = ("score", models / model, word, "combinesWith", "water")
    refused(*command, says=[f"no entity '{word}'.", told], kind="UnknownEntityError")


def test_an_open_slot_is_not_taken_as_a_new_word(run, models):
    assert run("score", models / "recipes", "_", "combinesWith", "_").kind == "ConfigError"
    assert run("score", models / "recipes", "", "combinesWith", "").kind == "ConfigError"
