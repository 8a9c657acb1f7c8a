"""Published results beside those of ``compare`` and ``discover``."""

import json

import pytest

from wordcraft_kg import open_graph
from wordcraft_kg.evaluation import reference
from wordcraft_kg.evaluation.reference import (
    MeasuredValue,
    OpenPlay,
    PlayedGraph,
    ReferencePack,
    ReferenceRow,
    TaskPlay,
)


def row(player, kind, figures, play, **more):
    figures = {column: MeasuredValue(value) for column, value in figures.items()}
    settings = {"measure": "success", "reference": "a command"} | more
    return ReferenceRow(player=player, kind=kind, figures=figures, play=play, **settings)


@pytest.fixture
def pack(monkeypatch):
    """Published results of the kitchen that nobody would measure."""
    opened = open_graph("kitchen")
    tasks = TaskPlay("test", 1, 1)
    base = OpenPlay(opened.graph.base)
    rows = (
        row("random", "chance", {"1": 0.111, "4": 0.444}, tasks),
        row("our agent", "agent", {"1": 0.777, "2": 0.666}, tasks, remark="5 seeds"),
        row("with two", "agent", {"2": 0.5}, tasks),
        row("of depth 2", "agent", {"1": 0.5}, TaskPlay("test", 2, 2)),
        row("explorer", "other", {"1": 5.5, "10": 6.25}, base, measure="entities known"),
    )
    found = ReferencePack(
        format="wordcraft-kg references 1",
        title="kitchen",
        rows=rows,
        graph=PlayedGraph.of(opened),
    )
    theirs = [one for one in reference.read_packs() if one.graph is None]
    monkeypatch.setattr(reference, "read_packs", lambda: (found, *theirs))


def test_compare_shows_published_agents_apart_and_has_the_same_figures(
    run, world, monkeypatch, tmp_path, pack
):
    command = ("compare", world / "plain", "--distractors", "1,4")
    command += ("--distractor-seeds", 1, "--episodes", 0)
    text = run(*command, "--out", tmp_path / "with").out
    assert "published, on these tasks with 1, 4 distractors\n  our agent  agent  0.777  -\n" in text
    monkeypatch.setattr(reference, "read_packs", lambda: ())
    assert "published, on" not in run(*command, "--out", tmp_path / "without").out
    reports = [
        json.loads((tmp_path / name / "report.json").read_text()) for name in ("with", "without")
    ]
    assert [one["player"] for one in reports[0].pop("references")] == ["our agent"]
    assert reports[1].pop("references") == []
    assert reports[0] == reports[1]
    page, plain = ((tmp_path / name / "index.html").read_text() for name in ("with", "without"))
    assert "For comparison" in page
    assert "5 seeds" in page
    assert "For comparison" not in plain
