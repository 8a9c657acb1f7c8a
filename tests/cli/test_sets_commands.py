"""Recipes of up to eight ingredients from end to end: the kitchen of the examples."""

import io
import json
from pathlib import Path

import pytest
from quick import QUICK, text_of

BOOK = Path(__file__).parents[2] / "examples" / "kitchen-sets.csv"
SYNTHESIS = {
    "train": {f"made {i}": [[f"part {i % 9}", f"part {i % 8}", "salt"]] for i in range(90)},
    "test": {f"made {i}": [[f"part {i % 9}", f"part {i % 7}"]] for i in range(90, 120)},
}


@pytest.fixture
def folder(tmp_path):
    text_of(
        *("build-graph", BOOK, "--split", "by-recipe-plain", "--train-ratio", 0.6),
        *("--out", tmp_path / "graph", "--quiet"),
    )
    return tmp_path / "graph"


def test_sets_are_built_described_exported_trained_on_and_ranked(run, folder, tmp_path):
    described = json.loads(text_of("describe", folder, "--json"))
    sizes = described["sets"]["recipes_by_number_of_ingredients"]
    assert sizes == {"2": 10, "3": 14, "4": 21, "5": 9, "6": 6}
    assert described["sets"]["inside_another_set"] == 2
    assert described["reachability"]["reachable"] == described["entities"] == 91
    assert "pesto = basil + cheese + garlic + oil + salt + walnut" in text_of(
        "describe", folder, "--entity", "pasta with pesto"
    )
    for format in ("hif", "parquet", "graphml"):
        assert run("export", folder, "--format", format, "--out", tmp_path / format).code == 0
    model = tmp_path / "model"
    trained = run("train-complex", folder, *QUICK, "--out", model, "--json")
    assert trained.code == 0
    assert json.loads(trained.out)["train_mrr"] > 0
    ranked = json.loads(text_of("evaluate-links", model, "--json", "--quiet"))
    assert ranked["checks_passed"] is False  # by-recipe-plain covers not all entities
    assert set(ranked["baselines"]) == {"frequency", "votes", "neighbours", "random"}


def test_commands_play_sets(run, folder, tmp_path, monkeypatch):
    """Tasks, scripted players, a program and the terminal, on one book."""
    text = run("describe", folder, "--tasks", "--part", "test").out
    assert "plan" in text
    assert " + " in text
    options = ("--distractors", "1", "--distractor-seeds", "1", "--json", "--quiet")
    players = json.loads(run("evaluate-agent", folder, *options).out)
    assert "recipe oracle" in json.dumps(players)
    out = tmp_path / "chats.jsonl"
    run("chats", folder, "--part", "train", "--tasks", "3", "--out", out)
    calls = [
        message["tool_calls"][0]["function"]["arguments"]
        for line in out.read_text().splitlines()
        for message in json.loads(line)["messages"]
        if message.get("tool_calls")
    ]
    assert calls
    assert all(list(call) == ["items"] for call in calls)
    monkeypatch.setattr("sys.stdin", io.StringIO("1 + 2 + 2\nq\n"))
    played = run("play", folder, "--seed", "3", "--episodes", "1")
    assert played.code == 0
    assert "Name the items to combine" in played.out


def test_open_ended_play_refuses_sets_with_one_line(run, folder):
    outcome = run("discover", folder)
    assert outcome.code == 1
    assert "-> pesto has 6 ingredients; recipe scorers, the planner" in outcome.err


def test_published_parts_of_a_table_of_targets_are_a_split(run, tmp_path, caplog):
    path = tmp_path / "targets.json"
    path.write_text(json.dumps(SYNTHESIS))
    told = ("build-graph", path, "--columns", "{}{}[][],{}{key}", "--json")
    default = run(*told, "--out", tmp_path / "default")
    assert json.loads(default.out)["split"]["kind"] == "by-goal"
    assert "no split is named, so it is by-goal" in caplog.text
    caplog.clear()
    published = run(*told, "--split", path, "--out", tmp_path / "published")
    split = json.loads(published.out)["split"]
    assert (split["train_recipes"], split["test_recipes"]) == (90, 30)
    assert split["published"]["file"] == "targets.json"
    assert "so it is by-goal" not in caplog.text
    wrong = run(*told, "--split", "by-gaol", "--out", tmp_path / "wrong")
    assert wrong.code == 1
    assert "by-goal" in wrong.err
