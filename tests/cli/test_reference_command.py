"""``reference`` as a user runs it, and the pack beside ``compare`` and ``discover``."""

import json

import pytest
from graph_folders import write_graph

from wordcraft_kg import TaskConfig, WordCraftConfig, World, open_graph
from wordcraft_kg.apps.people.config import StudyConfig
from wordcraft_kg.apps.people.study import HumanStudy, kept_answers
from wordcraft_kg.apps.text_agents import result_reader
from wordcraft_kg.apps.text_agents.records import (
    GAMES_FILE,
    GamesHeader,
    PlayedSettings,
    TaskGameRecord,
    WorldGameRecord,
)
from wordcraft_kg.apps.text_agents.results import chosen_tasks, read_games, result_of
from wordcraft_kg.base.records import as_lines
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.evaluation import reference
from wordcraft_kg.evaluation.reference import (
    MeasuredValue,
    OpenPlay,
    PlayedGraph,
    ReferencePack,
    ReferenceRow,
    TaskPlay,
)

DEPTH_1 = TaskPlay("test", 1, 1)
TWO = ("reference", "kitchen", "--distractors", "1,4")
OPEN = ("reference", "kitchen", "--open-ended")


def row(player, kind, figures, **more):
    figures = {column: MeasuredValue(value) for column, value in figures.items()}
    settings = {
        "measure": "success",
        "origin": "ours",
        "source": "a command",
        "play": DEPTH_1,
    } | more
    return ReferenceRow(player=player, kind=kind, figures=figures, **settings)


def own(values):
    """The rows of a table that are the user's."""
    return [row for row in values["rows"] if row["origin"] == "external"]


def figures(row):
    return {column: figure["value"] for column, figure in row["figures"].items()}


@pytest.fixture
def pack(monkeypatch):
    """A pack that has the kitchen, with figures that nobody would measure."""
    opened = open_graph("kitchen")
    base = OpenPlay(opened.graph.base)
    rows = (
        row("random", "chance", {"1": 0.111, "4": 0.444}),
        row("recipe oracle", "oracle", {"1": 0.999, "4": 0.998}),
        row("our agent", "agent", {"1": 0.777, "4": 0.666}, seeds=5, settings={"steps": "1,000"}),
        row("of depth 2", "agent", {"1": 0.5}, play=TaskPlay("test", 2, 2)),
        row("explorer", "other", {"1": 5.5, "10": 6.25}, measure="entities known", play=base),
    )
    found = ReferencePack(
        format=reference.FORMAT, title="kitchen", rows=rows, graph=PlayedGraph.of(opened)
    )
    real = [one for one in reference.read_packs() if one.graph is None]
    monkeypatch.setattr(reference, "_packs", lambda: (found, *real))
    return found


def person(path, *, right, wrong, graph="kitchen", distractors=4):
    """Write the study of a person who makes some goals of test tasks and then fails at some."""
    study = HumanStudy(graph, StudyConfig(tasks=right + wrong, distractors=(distractors,), forms=1))
    with kept_answers(path, study) as answers:
        person = answers.begin("somebody", study.cells)
        for number, task in enumerate(study.tasks(person.cell)):
            plan = task.plans[0]
            slots = task.table.index(plan.ingredient_a), task.table.index(plan.ingredient_b)
            fails = number % (right + wrong) >= right
            answers.show(person, task.part, task.number, 1.0)
            given = (slots[0], slots[0]) if fails else slots
            answers.add(person, study.protocol(person.cell).answer(task, given, 1.0))
    return path


@pytest.mark.slow
def test_a_graph_without_a_pack_is_measured_as_baselines_does(printed, run):
    values = printed(*TWO)
    assert (values["pack"], values["measured"], values["columns"]) == (None, [1, 4], [1, 4])
    measured = {
        (one["player"], at): found for one in values["rows"] for at, found in one["figures"].items()
    }
    expected = printed("evaluate-agent", "kitchen", "--distractors", "1,4")["rows"]
    assert measured.keys() == {(one["player"], str(one["distractors"])) for one in expected}
    for one in expected:
        found = measured[one["player"], str(one["distractors"])]
        assert (found["value"], found["low"]) == pytest.approx(
            (one["success"], one["low"]), abs=1e-6
        )
    text = run(*TWO).out
    assert "measured now: scripted players with 1, 4 distractors" in text
    assert "the pack does not have this graph and split" in text
    assert "with 1 distractor, because" in run(*TWO[:3], "1").out


def test_ours_and_the_literature_are_apart_in_the_text(run, pack):
    """Ours and the literature are apart in the text and each of the latter has a source."""
    ours, theirs = run(*TWO).out.split("\nFrom the literature")
    assert "our agent" in ours
    assert "gpt-4o-mini" not in ours
    for part in ("gpt-4o-mini agent [2]", "[2] Sarukkai", "[1] 5 seeds, 1,000 steps"):
        assert part in theirs
    assert "our agent" not in theirs
    assert "measured now" not in theirs


def test_figures_that_the_pack_lacks_are_measured_and_the_rest_is_not(printed, run, pack, tmp_path):
    values = printed(*TWO[:3], "4,2")
    assert (values["pack"], values["measured"]) == ("kitchen", [2])
    rows = {one["player"]: one for one in values["rows"]}
    assert rows["random"]["figures"]["4"]["value"] == 0.444
    assert 0 < rows["random"]["figures"]["2"]["value"] < 0.4
    assert rows["our agent"]["figures"].keys() == {"4"}
    assert "of depth 2" not in rows
    assert next(iter(rows)) == "random"
    assert "has no results for 2 distractors" in run(*TWO[:3], "4,2").out
    write_graph(tmp_path / "graph", seed=5)
    values = printed("reference", tmp_path / "graph", "--distractors", "1")
    assert (values["pack"], values["measured"]) == (None, [1])
    assert reference.play_of(TaskConfig(distractor_policy="no_shortcut"), "test") is None
    assert pack.rows_of(TaskPlay("test", 1, 3)) == ()


@pytest.mark.slow
def test_open_ended_play_stands_beside_people_and_language_models(printed, run, pack):
    assert printed(*OPEN)["rows"][-1]["player"] == "explorer"
    text = run(*OPEN).out
    people = next(line for line in text.splitlines() if "people, Little Alchemy 2" in line)
    assert people.split()[-5:] == ["5", "9.95", "14.05", "23.47", "35.96"]
    assert "192 new combinations after 500 attempts" in text
    assert (
        "o1 [5], language model: 177 entities known after 500 attempts\n" in text
    )  # no column is at 500
    assert "Success" not in text


@pytest.mark.slow
def test_open_ended_play_from_another_base_is_measured(printed, pack):
    base = pack.rows[-1].play.base
    values = printed(*OPEN, "--base", ",".join(base[1:]))
    assert values["measured"] == [1, 10, 20, 50, 100]
    assert {"random", "random-no-repeat", "greedy", "empowerment"} == {
        one["player"] for one in values["rows"]
    }
    assert values["play"]["base"] == list(base[1:])


def test_an_agent_beside_has_the_figures_of_its_evaluation(printed, run, pack, world):
    (row,) = own(printed(*TWO, "--external-results", world / "plain"))
    assert (row["player"], row["seeds"]) == ("plain", 2)
    seeds = (world / "plain" / "seed-0", world / "plain" / "seed-1")
    of_seeds = [
        printed("evaluate-agent", seed, "--distractors", "1,4")["success"] for seed in seeds
    ]
    for amount in ("1", "4"):
        mean = sum(one[amount]["mean"] for one in of_seeds) / 2
        figure = row["figures"][amount]
        assert figure["value"] == pytest.approx(mean, abs=1e-6)
        assert figure["low"] <= mean <= figure["high"]
    assert "plain (yours)" in run(*TWO, "--external-results", world / "plain").out


def test_people_beside_have_the_share_of_their_right_answers(printed, pack, tmp_path):
    (row,) = own(printed(*TWO, "--external-results", person(tmp_path / "one", right=3, wrong=2)))
    assert (row["kind"], row["people"], figures(row)) == ("people", 1, {"4": 0.6})
    assert "one person" in row["interval"]


@pytest.fixture
def kitchen_world():
    return World("kitchen", WordCraftConfig(part="test", num_distractors=4))


def settings_of(world, **others):
    return PlayedSettings.of(world, world.split, **others)


def result(folder, settings, played):
    """Write the games of a text agent."""
    folder.mkdir()
    lines = as_lines([GamesHeader(player="parrot", settings=settings), *played])
    (folder / GAMES_FILE).write_text("".join(lines), encoding="utf-8")
    return folder


COUNTS = {"invalid_actions": 4, "lost_attempts": 1, "look_ups": 0, "messages": (), "pairs": ()}


def tasks_made(number, world, most=None):
    """Games on tasks in which the first goals are made."""
    about = {"goal": "", "table": (), "actions": 2, "distractor_seed": 0, "last": None, **COUNTS}
    return [
        TaskGameRecord(
            task=task,
            success=made,
            by_plan=made,
            termination="goal" if made else "no_recipe",
            **about,
        )
        for place, task in enumerate(chosen_tasks(world, most).tolist())
        for made in [place < number]
    ]


def test_results_of_text_agents_are_one_row_by_distractors(
    printed, refused, run, pack, kitchen_world, tmp_path
):
    four = result(tmp_path / "four", settings_of(kitchen_world), tasks_made(21, kitchen_world))
    other = settings_of(kitchen_world.variant(num_distractors=1))
    one = result(tmp_path / "one", other, tasks_made(42, kitchen_world))
    (row,) = own(printed(*TWO, "--external-results", four, "--external-results", one))
    assert figures(row) == {"4": 0.333333, "1": 0.666667}
    assert (row["player"], row["tasks"], row["distractor_seeds"]) == ("parrot", 63, 1)
    assert "63 attempts lost by invalid actions" in run(*TWO, "--external-results", four).out
    refused(
        *TWO[:3], "2", "--external-results", four, says="has 4 distractors, but the columns are 2"
    )
    refused(
        *TWO,
        "--depth",
        "2",
        "--external-results",
        four,
        says="add --part test --depth 1, or remove",
    )
    refused(
        "reference", "everyday", *TWO[2:], "--external-results", four, kind="GraphMismatchError"
    )
    refused(*OPEN, "--external-results", four, says="was recorded on tasks")


@pytest.mark.slow
def test_results_with_several_attempts_are_compared_with_as_many_only(
    refused, run, pack, kitchen_world, tmp_path
):
    settings = settings_of(kitchen_world.variant(max_attempts=3), tasks=50)
    tries = result(tmp_path / "tries", settings, tasks_made(15, kitchen_world, 50))
    refused(*TWO, "--external-results", tries, says="add --part test --depth 1 --attempts 3")
    text = run(*TWO, "--attempts", 3, "--external-results", tries).out
    assert "test tasks of depth 1, 3 attempts" in text
    assert "an even sample of 50 tasks, 50 attempts lost" in text


def test_a_player_that_has_played_the_same_twice_has_two_rows(
    printed, pack, kitchen_world, tmp_path
):
    settings = settings_of(kitchen_world)
    other = settings_of(kitchen_world.variant(num_distractors=1))
    played = {"first": (settings, 7), "second": (settings, 9), "other": (other, 7)}
    folders = [
        result(tmp_path / name, one, tasks_made(made, kitchen_world))
        for name, (one, made) in played.items()
    ]
    rows = own(
        printed(*TWO, *(option for folder in folders for option in ("--external-results", folder)))
    )
    assert [figures(row) for row in rows] == [{"4": 0.111111, "1": 0.111111}, {"4": 0.142857}]


@pytest.mark.slow
def test_an_open_ended_result_is_a_row_and_so_is_a_log_of_inspect(
    printed, refused, pack, tmp_path, monkeypatch
):
    env = OpenEndedEnv("kitchen", max_attempts=20)
    played = [
        WorldGameRecord(game=game, known_after=(9 + game,) * 9 + (11,) * 2, repeated=0, **COUNTS)
        for game in range(2)
    ]
    settings = PlayedSettings.of(env, open_graph("kitchen").split, distractor_seeds=2)
    folder = result(tmp_path / "open", settings, played)
    (row,) = own(printed(*OPEN, "--external-results", folder))
    assert (figures(row), row["runs"]) == ({"1": 9.5, "10": 11, "20": 11}, 2)
    other = ",".join(pack.rows[-1].play.base[1:])
    refused(
        *OPEN, "--base", other, "--external-results", folder, says="expected open-ended mode from"
    )
    refused("reference", "kitchen", "--external-results", folder, says="add --open-ended")
    log = tmp_path / "log.eval"
    log.write_bytes(b"")
    # Logs have their own tests, which need Inspect AI.
    header, played, _ = read_games(folder / GAMES_FILE)
    monkeypatch.setattr(
        result_reader, "read_inspect_log", {log: result_of("", header.settings, played)}.get
    )
    (row,) = own(printed(*OPEN, "--external-results", log))
    assert (row["kind"], row["source"], figures(row)["1"]) == ("language model", str(log), 9.5)


@pytest.mark.parametrize(
    ("make", "options", "says"),
    [
        (
            lambda path: path.mkdir(),
            "",
            "is an empty folder; expected a run folder of 'train-agent'",
        ),
        (
            lambda path: path.write_text("hello"),
            "",
            "is a file; expected a run folder of 'train-agent'",
        ),
        (
            lambda path: person(path, right=1, wrong=0, graph="everyday"),
            "",
            "was played on graph 82dcde20aeb1, but",
        ),
        (
            lambda path: person(path, right=1, wrong=0, distractors=3),
            "--distractors 1,4",
            "tasks with 3 distractors",
        ),
    ],
    ids=["empty folder", "text", "another graph", "other distractors"],
)
def test_results_that_the_table_cannot_show_are_refused(
    refused, pack, tmp_path, make, options, says
):
    make(tmp_path / "one")
    refused(
        "reference", "kitchen", *options.split(), "--external-results", tmp_path / "one", says=says
    )


def test_a_report_of_agents_shows_the_pack_apart_and_has_the_same_figures(
    run, world, monkeypatch, tmp_path, pack
):
    command = (
        "compare",
        world / "plain",
        "--distractors",
        "1,4",
        "--distractor-seeds",
        1,
        "--episodes",
        0,
    )
    options = "--part test --depth 1 --distractors 1,4"
    with_pack = run(*command, "--out", tmp_path / "with")
    assert f"for comparison: wordcraft-kg reference {world / 'graph'} {options}" in with_pack.out
    monkeypatch.setattr(reference, "_packs", lambda: ())
    assert "for comparison" not in run(*command, "--out", tmp_path / "without").out
    reports = [
        json.loads((tmp_path / name / "report.json").read_text()) for name in ("with", "without")
    ]
    assert [one["player"] for one in reports[0].pop("references")] == ["our agent"]
    assert reports[1].pop("references") == []
    assert reports[0] == reports[1]
    page, plain = ((tmp_path / name / "index.html").read_text() for name in ("with", "without"))
    assert "For comparison" in page
    assert "our agent" in page
    assert "For comparison" not in plain


def test_the_page_of_discover_shows_players_from_elsewhere(printed, tmp_path, pack):
    page = tmp_path / "page.html"
    values = printed("discover", "kitchen", "--runs", 2, "--players", "random", "--out", page)
    players = [one["player"] for one in values["references"]]
    assert players[0] == "explorer"
    assert "people, Little Alchemy 2" not in players  # it is in the table already
    assert {"people, Tiny Alchemy", "o1"} <= set(players)
    assert "explorer" in page.read_text()
    assert "192 new combinations after 500 attempts" in page.read_text()


@pytest.mark.slow
def test_the_page_has_the_table_with_ours_and_others_apart(refused, run, pack, tmp_path):
    page = tmp_path / "page.html"
    assert f"wrote {page}" in run(*TWO, "--out", page).out
    ours, theirs = page.read_text().split("From the literature, in other environments")
    assert "our agent" in ours
    assert "gpt-4o-mini" not in ours
    assert "gpt-4o-mini" in theirs
    assert "arXiv 2505.00234" in theirs
    refused(*TWO, "--out", page, kind="OutputExistsError")
    assert run(*OPEN, "--out", page, "--force").code == 0
