"""The reference pack: its files are sound, are what the package measures, and keep ours and others
apart."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from wordcraft_kg import (
    RecipesConfig,
    RecipeScorerConfig,
    TaskConfig,
    WordCraftConfig,
    World,
    open_graph,
    open_model,
)
from wordcraft_kg.agents.discovery import HUMAN_CURVE
from wordcraft_kg.agents.players import play_all, random_distinct
from wordcraft_kg.base import registry
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.evaluation import result_readers
from wordcraft_kg.evaluation.discovery import view_discovery
from wordcraft_kg.evaluation.reference import (
    PACK,
    OpenPlay,
    TaskPlay,
    literature,
    metrics_of,
    pack_of,
    play_of,
    read_pack,
    read_packs,
)
from wordcraft_kg.evaluation.reference_table import scorer_rows
from wordcraft_kg.evaluation.result_readers import ResultReader, external_rows

DEPTH_1 = TaskPlay("test", 1, 1)


@pytest.fixture(scope="module")
def everyday():
    return open_graph("everyday")


def test_the_files_of_the_pack_are_sound_and_small():
    assert {path.stem for path in PACK.glob("*.json")} >= {
        "everyday",
        "little-alchemy-2",
        "literature",
    }
    assert all(pack.rows for pack in read_packs())
    assert sum(path.stat().st_size for path in PACK.iterdir()) <= 100_000


def test_the_pack_has_everyday_as_the_package_builds_it_now(everyday):
    pack = pack_of(everyday.graph.hash, everyday.split.hash)
    assert pack.title == "everyday"
    for distractors in (1, 2, 8):
        kinds = {row.kind for row in pack.rows_of(DEPTH_1, [distractors])}
        assert kinds >= {"chance", "words", "knowledge graph", "oracle", "scorer", "agent"}
    assert {row.player for row in pack.rows_of(OpenPlay(("air", "earth", "fire", "water")))} >= {
        "random",
        "greedy",
    }


def test_another_split_has_no_rows_and_open_ended_play_needs_none(everyday):
    assert pack_of(everyday.graph.hash, "0" * 64) is None
    assert pack_of("0" * 64, None) is None
    assert pack_of(everyday.graph.hash, None) is not None


def test_another_distribution_adds_a_reader_of_results(everyday, monkeypatch, tmp_path):
    row = pack_of(everyday.graph.hash, None).rows[0]
    reader = ResultReader("a folder of mine", lambda path: path == tmp_path, lambda *_: [row])
    monkeypatch.setattr(
        registry, "entry_points", lambda group: [SimpleNamespace(name=group, load=lambda: reader)]
    )
    monkeypatch.setattr(
        result_readers, "READERS", registry.Registry("theirs", {"agents": result_readers.AGENTS})
    )
    assert external_rows(everyday, DEPTH_1, [1], [tmp_path]) == (row,)
    with pytest.raises(ConfigError, match="a folder of mine"):
        external_rows(everyday, DEPTH_1, [1], [tmp_path / "other"])


def row_of(play, player):
    (row,) = (
        row for row in read_pack(PACK / "everyday.json").rows_of(play) if row.player == player
    )
    return row


def test_a_scripted_player_has_exactly_the_figure_of_the_pack(everyday):
    world = World(everyday, WordCraftConfig(part="test", num_distractors=2))
    (measured,) = play_all(world, {"random, distinct": random_distinct}, [2])
    row = row_of(DEPTH_1, "random, distinct")
    expected = metrics_of(
        {2: (measured.success, measured.low, measured.high)}, {2: measured.by_plan}
    )
    assert row.figures["2"] == expected["2"]
    assert measured.episodes == row.tasks * row.distractor_seeds


@pytest.mark.slow
def test_a_scorer_without_an_agent_has_rows_by_links_and_by_recipes(opened_kitchen, recipes_folder):
    model = open_model(recipes_folder)
    by_links, by_recipes = scorer_rows(opened_kitchen, DEPTH_1, (1, 8), "alone", model)
    assert [by_links.player, by_recipes.player] == [
        "alone, u+v, self edges dropped",
        "alone, w, best pair",
    ]
    assert by_links.kind == by_recipes.kind == "scorer"
    for column in (1, 8):
        assert 0 < float(by_recipes.shown_by_plan(column)) <= by_recipes.figures[str(column)].value
    without = replace(model.history, config=RecipesConfig("kitchen", RecipeScorerConfig(kg="none")))
    (unseen, _) = scorer_rows(
        opened_kitchen, DEPTH_1, (1,), "alone", replace(model, history=without)
    )
    assert (by_links.notes, unseen.notes) == ("", "learned no recipe of this graph")


@pytest.mark.slow
def test_a_model_folder_of_the_user_has_the_rows_of_its_scorer_alone(
    opened_kitchen, recipes_folder, everyday
):
    rows = external_rows(opened_kitchen, DEPTH_1, (2,), [recipes_folder])
    expected = scorer_rows(
        opened_kitchen, DEPTH_1, (2,), recipes_folder.name, open_model(recipes_folder)
    )
    assert [(row.player, row.figures) for row in rows] == [
        (row.player, row.figures) for row in expected
    ]
    assert {row.origin for row in rows} == {"external"}
    with pytest.raises(GraphMismatchError, match="was trained on graph"):
        external_rows(everyday, DEPTH_1, (2,), [recipes_folder])


def test_open_ended_play_has_exactly_the_figures_of_the_pack(everyday):
    view, _ = view_discovery(everyday.graph, ["random"])
    row = row_of(OpenPlay(view.base), "random")
    means = {mark: round(known.mean, 6) for mark, known in view.players["random"].items()}
    assert means == {mark: figure.value for mark, figure in row.figures.items()}


def test_agents_of_little_alchemy_2_are_those_of_the_committed_studies():
    pack = read_pack(PACK / "little-alchemy-2.json")
    results = json.loads(
        (Path(__file__).parents[2] / "docs/results/knowledge-little-alchemy-2.json").read_text()
    )
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
            assert row.seeds == len(success)


def test_people_are_the_same_in_the_pack_and_in_discover():
    (people,) = (
        row for row in literature(["entities known"]) if row.player == "people, Little Alchemy 2"
    )
    assert {int(at): found.value for at, found in people.figures.items()} == HUMAN_CURVE


def test_every_published_row_has_its_game_and_source():
    """Every row of the literature says what was played and where it is printed."""
    rows = literature(["success", "entities known", "new combinations"])
    assert {row.kind for row in rows} == {"people", "language model"}
    for row in rows:
        assert row.environment
        assert str(row.year) in row.source
        assert row.play is None


@pytest.mark.parametrize(
    ("file", "wrong", "says"),
    [
        ("everyday", lambda row: row.update(score=1), "unknown field 'score'"),
        ("everyday", lambda row: row.update(figures={}), "Expected 'object' of length >= 1"),
        ("everyday", lambda row: row.update(origin="literature"), "row 1, 'random', has a graph"),
        ("everyday", lambda row: row.pop("play"), "row 1, 'random', has a graph"),
        (
            "everyday",
            lambda row: row.update(measure="entities known"),
            "which does not fit its play",
        ),
        ("everyday", lambda row: row["figures"]["1"].update(value=1.5), "a success outside 0 to 1"),
        (
            "everyday",
            lambda row: row["figures"]["1"].update(low=0.9, high=0.1),
            "without two ordered ends",
        ),
        ("everyday", lambda row: row["figures"]["1"].pop("high"), "without two ordered ends"),
        ("everyday", lambda row: row.pop("interval"), "no interval kind for the interval at 1"),
        (
            "everyday",
            lambda row: row["figures"].update(many={"value": 0}),
            "'many', which is not a",
        ),
        ("literature", lambda row: row.update(origin="ours"), "has no graph"),
        ("literature", lambda row: row.pop("year"), "has no graph"),
        ("literature", lambda row: row.pop("environment"), "has no graph"),
        ("literature", lambda row: row.update(source=""), "Expected 'str' of length >= 1"),
    ],
)
def test_a_damaged_file_is_an_error_that_names_it(tmp_path, file, wrong, says):
    pack = json.loads((PACK / f"{file}.json").read_text())
    wrong(pack["rows"][0])
    path = tmp_path / f"{file}.json"
    path.write_text(json.dumps(pack))
    with pytest.raises(ArtefactError, match=r"is damaged") as error:
        read_packs(tmp_path)
    assert str(path) in str(error.value)
    assert says in str(error.value).replace("`", "'")


def test_rows_are_about_the_usual_rules_only():
    assert play_of(TaskConfig(depth=2, distractors=3), "train") == TaskPlay("train", 2, 2)
    assert play_of(TaskConfig(max_attempts=4, reward="official"), "test") == TaskPlay("test", 1, 4)
    assert play_of(TaskConfig(distractor_weighting="uniform"), "test") is None
    assert play_of(TaskConfig(ambiguity="last"), "test") is None
