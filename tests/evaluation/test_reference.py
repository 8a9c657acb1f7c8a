"""Published results: they are what the package measures, and keep ours and others apart."""

import json
import zipfile
from pathlib import Path

import pytest

from wordcraft_kg import TaskConfig, WordCraftConfig, World, open_graph
from wordcraft_kg.agents.discovery import HUMAN_CURVE
from wordcraft_kg.agents.evaluation import play_all
from wordcraft_kg.agents.players import random_distinct
from wordcraft_kg.evaluation.discovery import view_discovery
from wordcraft_kg.evaluation.reference import (
    PACK,
    OpenPlay,
    TaskPlay,
    literature,
    play_of,
    read_packs,
    reference_rows,
)

DEPTH_1 = TaskPlay("test", 1, 1)


@pytest.fixture(scope="module")
def everyday():
    return open_graph("everyday")


def rows_of(opened, play, columns=None):
    return reference_rows(opened.graph.hash, opened.split.hash, play, columns)


def test_the_files_are_sound_and_small():
    for pack in read_packs():
        for row in pack.rows:
            # Ours have the tasks that they were measured on; the literature's are of other tasks.
            assert (row.play is None) == (pack.graph is None), row
            if row.play is not None:
                assert (row.measure == "success") == isinstance(row.play, TaskPlay), row
            for column, figure in row.figures.items():
                ends = (0 if figure.low is None else figure.low, figure.value, figure.high)
                assert int(column) >= 0
                assert (figure.low is None) == (figure.high is None) == (not row.interval), row
                assert figure.high is None or ends[0] <= ends[1] <= ends[2], row
                assert row.measure != "success" or 0 <= figure.value <= 1, row
                assert figure.by_plan is None or 0 <= figure.by_plan <= figure.value, row
    assert sum(path.stat().st_size for path in PACK.iterdir()) <= 100_000


def test_everyday_as_the_package_builds_it_now_has_rows_of_all_kinds(everyday):
    for distractors in (1, 2, 8):
        kinds = {row.kind for row in rows_of(everyday, DEPTH_1, [distractors])}
        assert kinds >= {"chance", "words", "knowledge graph", "oracle", "scorer", "agent"}
    base = OpenPlay(("air", "earth", "fire", "water"))
    assert {"random", "greedy"} <= {row.player for row in rows_of(everyday, base)}


def test_another_split_has_no_rows_and_open_ended_play_needs_none(everyday):
    graph = everyday.graph.hash
    assert reference_rows(graph, "0" * 64, DEPTH_1) == ()
    assert reference_rows("0" * 64, None, DEPTH_1) == ()
    assert reference_rows(graph, None, DEPTH_1) == rows_of(everyday, DEPTH_1)
    assert reference_rows(graph, None, DEPTH_1, [77]) == ()


def row_of(opened, play, player):
    (row,) = (row for row in rows_of(opened, play) if row.player == player)
    return row


def test_a_scripted_player_has_exactly_the_published_figure(everyday):
    world = World(everyday, WordCraftConfig(part="test", num_distractors=2))
    (measured,) = play_all(world, {"random, distinct": random_distinct}, [2])
    figure = row_of(everyday, DEPTH_1, "random, distinct").figures["2"]
    expected = (measured.success, measured.low, measured.high, measured.by_plan)
    assert (figure.value, figure.low, figure.high, figure.by_plan) == tuple(
        round(value, 6) for value in expected
    )


def test_open_ended_play_has_exactly_the_published_figures(everyday):
    view, _ = view_discovery(everyday.graph, ["random"])
    row = row_of(everyday, OpenPlay(view.base), "random")
    means = {mark: round(known.mean, 6) for mark, known in view.players["random"].items()}
    assert means == {mark: figure.value for mark, figure in row.figures.items()}


def test_agents_of_little_alchemy_2_are_those_of_the_committed_studies():
    (pack,) = (pack for pack in read_packs() if pack.title == "little-alchemy-2")
    with zipfile.ZipFile(Path(__file__).parents[2] / "docs/results.zip") as archive:
        results = json.loads(archive.read("knowledge-little-alchemy-2.json"))
    assert {"hash": pack.graph.hash, "split": pack.graph.split}.items() <= results["graphs"][
        0
    ].items()
    for variant in ("partial, u v", "partial, u v w"):
        (row,) = (row for row in pack.rows if row.player == variant)
        for distractors in (1, 8):
            of = {"variant": variant, "values": {"distractors": distractors}}
            success = [
                run["success"]["test"] for run in results["runs"] if of.items() <= run.items()
            ]
            assert row.figures[str(distractors)].value == pytest.approx(
                sum(success) / len(success), abs=2e-6
            )
            assert row.remark.startswith(f"{len(success)} seeds")


def test_people_are_the_same_in_the_literature_and_in_discover():
    (people,) = (
        row for row in literature(["entities known"]) if row.player == "people, Little Alchemy 2"
    )
    assert {int(at): found.value for at, found in people.figures.items()} == HUMAN_CURVE


def test_results_from_the_literature_are_of_people_and_language_models():
    rows = literature(["success", "entities known", "new combinations"])
    assert {row.kind for row in rows} == {"people", "language model"}


def test_rows_are_about_the_usual_rules_only():
    assert play_of(TaskConfig(depth=2, distractors=3), "train") == TaskPlay("train", 2, 2)
    assert play_of(TaskConfig(max_attempts=4, reward="official"), "test") == TaskPlay("test", 1, 4)
    assert play_of(TaskConfig(distractor_weighting="uniform"), "test") is None
    assert play_of(TaskConfig(distractor_policy="no_shortcut"), "test") is None
    assert play_of(TaskConfig(ambiguity="last"), "test") is None
