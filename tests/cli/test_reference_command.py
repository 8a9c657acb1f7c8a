"""``reference`` as a user runs it, and the pack beside ``compare`` and ``discover``."""

import json

import msgspec
import pytest

from wordcraft_kg.agents.outcomes import Success
from wordcraft_kg.apps.people.protocol import HumanProtocol
from wordcraft_kg.apps.people.session_file import append_answer, open_session
from wordcraft_kg.apps.text_agents import result_reader
from wordcraft_kg.apps.text_agents.records import RESULT_FILE, PlayedSettings, TextResult
from wordcraft_kg.base.records import read_record
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation import reference
from wordcraft_kg.evaluation.reference import (
    FORMAT,
    Figure,
    OpenPlay,
    PlayedGraph,
    ReferencePack,
    ReferenceRow,
    TaskPlay,
)
from wordcraft_kg.graphs import open_graph

DEPTH_1 = TaskPlay("test", 1, 1)


def row(player, kind, figures, **more):
    return ReferenceRow(
        **(
            {
                "player": player,
                "kind": kind,
                "measure": "success",
                "figures": {column: Figure(value) for column, value in figures.items()},
                "origin": "ours",
                "source": "a command",
                "play": DEPTH_1,
            }
            | more
        )
    )


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
    found = ReferencePack(format=FORMAT, title="kitchen", rows=rows, graph=PlayedGraph.of(opened))
    real = [one for one in reference.read_packs() if one.graph is None]
    monkeypatch.setattr(reference, "packs", lambda: (found, *real))
    return found


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder of two seeds of an agent of the kitchen."""
    from wordcraft_kg.cli import main

    out = tmp_path_factory.mktemp("runs") / "plain"
    small = ("--steps", "640", "--batch-size", "16", "--eval-every", "0", "--key-size", "8", "--value-size", "8")
    arguments = ("train-agent", "kitchen", *small, "--distractors", "2", "--seeds", "0,1", "--out", str(out), "-q")
    assert main(arguments) == 0
    return out


def session(path, *, right, wrong, graph="kitchen", distractors=4):
    """Write the session of a person who makes some goals of test tasks and then fails at some."""
    protocol = HumanProtocol(graph, distractors, tasks=right + wrong)
    opened = open_session(path, protocol)
    for number, (part, turn) in enumerate(protocol.turns):
        task = protocol.task(part, turn)
        plan = task.plans[0]
        slots = task.table.index(plan.ingredient_a), task.table.index(plan.ingredient_b)
        fails = number % (right + wrong) >= right
        opened = append_answer(path, opened, protocol.answer(task, (slots[0], slots[0]) if fails else slots, 1.0))
    return path


def test_a_graph_without_a_pack_is_measured_as_baselines_does(printed, run):
    found = printed("reference", "kitchen", "--distractors", "1,4")
    assert (found["pack"], found["measured"], found["columns"]) == (None, [1, 4], [1, 4])
    expected = printed("evaluate-agent", "kitchen", "--distractors", "1,4")["rows"]
    of = {(one["player"], str(one["distractors"])): one for one in expected}
    figures = {(one["player"], column): value for one in found["rows"] for column, value in one["figures"].items()}
    assert figures.keys() == of.keys()
    for key, value in figures.items():
        assert value["value"] == pytest.approx(of[key]["success"], abs=1e-6)
        assert value["low"] == pytest.approx(of[key]["low"], abs=1e-6)
    text = run("reference", "kitchen", "--distractors", "1,4")
    assert text.code == 0
    assert "measured now: scripted players with 1, 4 distractors" in text.out
    assert "the pack does not have this graph and split" in text.out
    assert "with 1 distractor, because" in run("reference", "kitchen", "--distractors", "1").out


def test_ours_and_the_literature_are_apart_and_each_of_the_latter_has_a_source(run, pack):
    lines = run("reference", "kitchen", "--distractors", "1,4").out.splitlines()
    first, second = (next(n for n, line in enumerate(lines) if line.startswith(start)) for start in ("Meas", "From"))
    assert first < second
    ours, theirs = "\n".join(lines[first:second]), "\n".join(lines[second:])
    assert "our agent" in ours
    assert "gpt-4o-mini" not in ours
    assert "gpt-4o-mini agent [2]" in theirs
    assert "[2] Sarukkai" in theirs
    assert "our agent" not in theirs
    assert "measured now" not in theirs
    assert "[1] 5 seeds, 1,000 steps" in theirs


def test_what_the_pack_does_not_have_is_measured_and_the_rest_is_not(printed, run, pack):
    found = printed("reference", "kitchen", "--distractors", "4,2")
    assert (found["pack"], found["measured"]) == ("kitchen", [2])
    rows = {one["player"]: one for one in found["rows"]}
    assert rows["random"]["figures"]["4"]["value"] == 0.444
    assert 0 < rows["random"]["figures"]["2"]["value"] < 0.4
    assert rows["our agent"]["figures"].keys() == {"4"}
    assert "of depth 2" not in rows
    assert next(iter(rows)) == "random"
    assert "has no figures for 2 distractors" in run("reference", "kitchen", "--distractors", "4,2").out


def test_the_pack_is_not_used_for_another_split(printed, run, pack, tmp_path):
    assert run("build-graph", "kitchen", "--seed", "5", "--out", tmp_path / "graph").code == 0
    found = printed("reference", tmp_path / "graph", "--distractors", "1")
    assert (found["pack"], found["measured"]) == (None, [1])


def test_open_ended_play_stands_beside_people_and_language_models(printed, run, pack):
    found = printed("reference", "kitchen", "--open-ended")
    assert [one["player"] for one in found["rows"]] == ["explorer"]
    text = run("reference", "kitchen", "--open-ended").out
    people = next(line for line in text.splitlines() if "people, Little Alchemy 2" in line)
    assert people.split()[-5:] == ["5", "9.95", "14.05", "23.47", "35.96"]
    assert "192 new combinations after 500 attempts" in text
    assert "Success" not in text


def test_open_ended_play_from_another_base_is_measured(printed, pack):
    base = pack.rows[-1].play.base
    found = printed("reference", "kitchen", "--open-ended", "--base", ",".join(base[1:]))
    assert found["measured"] == [1, 10, 20, 50, 100]
    assert {"random", "random-no-repeat", "greedy", "empowerment"} == {one["player"] for one in found["rows"]}
    assert found["play"]["base"] == list(base[1:])


def test_an_agent_beside_has_the_figures_of_its_evaluation(printed, run, pack, runs):
    found = printed("reference", "kitchen", "--distractors", "1,4", "--beside", runs)
    (own,) = (one for one in found["rows"] if one["origin"] == "beside")
    assert (own["player"], own["seeds"]) == ("plain", 2)
    of_seeds = [printed("evaluate-agent", runs / f"seed-{seed}", "--distractors", "1,4")["success"] for seed in (0, 1)]
    for amount in ("1", "4"):
        mean = sum(one[amount]["mean"] for one in of_seeds) / 2
        assert own["figures"][amount]["value"] == pytest.approx(mean, abs=1e-6)
        assert own["figures"][amount]["low"] <= mean <= own["figures"][amount]["high"]
    assert "plain (yours)" in run("reference", "kitchen", "--distractors", "1,4", "--beside", runs).out


def test_people_beside_have_the_share_of_their_right_answers(printed, pack, tmp_path):
    path = session(tmp_path / "one.jsonl", right=3, wrong=2)
    found = printed("reference", "kitchen", "--distractors", "1,4", "--beside", path)
    (own,) = (one for one in found["rows"] if one["origin"] == "beside")
    assert (own["kind"], own["people"], own["figures"].keys()) == ("people", 1, {"4"})
    assert own["figures"]["4"]["value"] == 0.6
    assert "one person" in own["interval"]


def result(folder, settings, success=None, known=None):
    """Write the result of a text agent."""
    found = TextResult(
        player="parrot",
        settings=settings,
        games=10,
        success=success,
        outcomes={},
        known=known or {},
        refused=3,
        lost=2,
        look_ups=0,
    )
    folder.mkdir()
    (folder / "result.json").write_bytes(msgspec.json.encode(found))
    return folder


def test_results_of_players_that_use_words_are_one_row_by_distractors(printed, refused, run, pack, tmp_path):
    world = World("kitchen", WordCraftConfig(part="test", num_distractors=4))
    few = Success(mean=0.3, ci_low=0.2, ci_high=0.4, tasks=63, draws=1, by_plan=0.3, picks=2.0)
    many = msgspec.structs.replace(few, mean=0.5, ci_high=0.6)
    folders = (
        result(tmp_path / "four", PlayedSettings.of_tasks(world), few),
        result(tmp_path / "one", PlayedSettings.of_tasks(world.variant(num_distractors=1)), many),
    )
    asked = ("reference", "kitchen", "--distractors", "1,4")
    values = printed(*asked, "--beside", folders[0], "--beside", folders[1])
    (own,) = (one for one in values["rows"] if one["origin"] == "beside")
    assert {at: found["value"] for at, found in own["figures"].items()} == {"4": 0.3, "1": 0.5}
    assert (own["player"], own["tasks"], own["draws"]) == ("parrot", 63, 1)
    assert "2 attempts lost by messages" in run(*asked, "--beside", folders[0]).out
    command = ("reference", "kitchen", "--distractors", "2", "--beside", folders[0])
    refused(*command, says="has 4 distractors, which are no column of the table")
    assert "give --part test --depth 1, or leave it out" in run(*asked, "--depth", "2", "--beside", folders[0]).err
    assert run("reference", "everyday", "--distractors", "4", "--beside", folders[0]).kind == "GraphMismatchError"
    more = PlayedSettings.of_tasks(world.variant(max_attempts=3), tasks=50)
    tries = result(tmp_path / "tries", more, few)
    assert "give --part test --depth 1 --attempts 3" in run(*asked, "--beside", tries).err
    done = run(*asked, "--attempts", 3, "--beside", tries)
    assert "test tasks of depth 1, 3 attempts" in done.out
    assert "an even sample of 63 tasks, 2 attempts lost" in done.out
    assert "is of crafting tasks" in run("reference", "kitchen", "--open-ended", "--beside", folders[0]).err


def test_a_player_that_has_played_the_same_twice_has_two_rows(printed, pack, tmp_path):
    world = World("kitchen", WordCraftConfig(part="test", num_distractors=4))
    one = Success(mean=0.3, ci_low=0.2, ci_high=0.4, tasks=63, draws=1, by_plan=0.3, picks=2.0)
    settings = PlayedSettings.of_tasks(world)
    folders = [
        result(tmp_path / "first", settings, one),
        result(tmp_path / "second", settings, msgspec.structs.replace(one, mean=0.35)),
        result(tmp_path / "other", PlayedSettings.of_tasks(world.variant(num_distractors=1)), one),
    ]
    beside = [option for folder in folders for option in ("--beside", folder)]
    values = printed("reference", "kitchen", "--distractors", "1,4", *beside)
    own = [row for row in values["rows"] if row["origin"] == "beside"]
    assert [{at: found["value"] for at, found in row["figures"].items()} for row in own] == [
        {"4": 0.3, "1": 0.3},
        {"4": 0.35},
    ]


def test_a_log_of_inspect_is_the_row_of_a_language_model(printed, pack, tmp_path, monkeypatch):
    env = OpenEndedEnv("kitchen", max_attempts=10)
    settings = PlayedSettings.of_world(env, open_graph("kitchen").split)
    folder = result(tmp_path / "as-a-folder", settings, known={1: 5.0, 10: 7.0})
    log = tmp_path / "log.eval"
    log.write_bytes(b"")
    # Logs have tests of their own, which need Inspect AI.
    as_a_log = {log: read_record(folder / RESULT_FILE, TextResult)}
    monkeypatch.setattr(result_reader, "read_inspect_log", as_a_log.get)
    values = printed("reference", "kitchen", "--open-ended", "--beside", log)
    (own,) = (one for one in values["rows"] if one["origin"] == "beside")
    assert (own["kind"], own["source"], own["figures"]["10"]["value"]) == ("language model", str(log), 7.0)


def test_a_player_that_uses_words_stands_in_open_ended_play(printed, run, pack, tmp_path):
    env = OpenEndedEnv("kitchen", max_attempts=20)
    settings = PlayedSettings.of_world(env, open_graph("kitchen").split)
    folder = result(tmp_path / "open", settings, known={1: 5.5, 10: 7.25, 20: 9.0})
    values = printed("reference", "kitchen", "--open-ended", "--beside", folder)
    (own,) = (one for one in values["rows"] if one["origin"] == "beside")
    assert {at: found["value"] for at, found in own["figures"].items()} == {"1": 5.5, "10": 7.25, "20": 9.0}
    assert own["runs"] == 10
    base = pack.rows[-1].play.base
    other = run("reference", "kitchen", "--open-ended", "--base", ",".join(base[1:]), "--beside", folder)
    assert "and the table is about play from" in other.err
    assert "add --open-ended" in run("reference", "kitchen", "--beside", folder).err


def test_bad_input_says_what_would_be_understood(refused, pack, runs, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.txt").write_text("hello")
    (tmp_path / "graph").mkdir()
    (tmp_path / "graph" / "graph.json").write_text("{}")
    other = session(tmp_path / "other.jsonl", right=1, wrong=0, graph="everyday")
    few = session(tmp_path / "few.jsonl", right=1, wrong=0, distractors=3)
    cases = (
        (("--beside", tmp_path / "empty"), "is an empty folder; expected a run folder of 'train-agent'"),
        (("--beside", tmp_path / "text.txt"), "is a file; expected a run folder of 'train-agent'"),
        (("--beside", tmp_path / "nowhere"), "does not exist; expected a run folder of 'train-agent'"),
        (("--beside", tmp_path / "graph"), "is a graph folder; expected a run folder of 'train-agent'"),
        (("--beside", other), "is of graph 917cafc4ad20, and the table of 43fe37e2e912"),
        (("--beside", few, "--distractors", "1,4"), "it is of 3 distractors"),
        (("--beside", runs, "--depth", "2"), "is of test tasks of depth 1 with 1 attempt, and the table"),
        (("--distractors", "x"), "expected whole numbers, such as 1,2,8."),
        (("--distractors", "79"), "--distractors 79: kitchen has 80 entities"),
        (("--depth", "0"), "--depth 0: expected a whole number, 1 to 5."),
        (("--base", "water"), "--base is about open-ended play"),
        (("--open-ended", "--distractors", "1"), "--open-ended has no tasks"),
        (("--open-ended", "--part", "train"), "--open-ended has no tasks"),
        (("--open-ended", "--attempts", "7"), "--open-ended has no tasks"),
        (("--open-ended", "--beside", runs), "expected a result of 'evaluate-text', a file of 'mcp --out', or a log"),
    )
    for arguments, says in cases:
        refused("reference", "kitchen", *arguments, says=says)


def test_a_run_of_another_graph_is_refused(refused, runs):
    refused(
        "reference", "everyday", "--beside", runs, says="was trained on graph 43fe37e2e912", kind="GraphMismatchError"
    )


def test_a_report_of_agents_shows_the_pack_apart_and_has_the_same_figures(run, runs, monkeypatch, tmp_path, pack):
    arguments = ("compare", runs, "--distractors", "1,4", "--draws", 1, "--episodes", 0)
    with_pack = run(*arguments, "--out", tmp_path / "with")
    assert with_pack.code == 0, with_pack.err
    assert "for comparison: wordcraft-kg reference kitchen --part test --depth 1 --distractors 1,4" in with_pack.out
    monkeypatch.setattr(reference, "packs", lambda: ())
    without = run(*arguments, "--out", tmp_path / "without")
    assert "for comparison" not in without.out
    reports = [json.loads((tmp_path / name / "report.json").read_text()) for name in ("with", "without")]
    assert [one["player"] for one in reports[0].pop("references")] == ["our agent"]
    assert reports[1].pop("references") == []
    assert reports[0] == reports[1]
    page, plain = ((tmp_path / name / "index.html").read_text() for name in ("with", "without"))
    assert "For comparison" in page
    assert "our agent" in page
    assert "For comparison" not in plain


def test_the_page_of_discover_shows_what_did_not_play(printed, tmp_path, pack):
    small = ("discover", "kitchen", "--runs", 2, "--players", "random", "--out", tmp_path / "page.html")
    values = printed(*small)
    players = [one["player"] for one in values["references"]]
    assert players[0] == "explorer"
    assert "people, Little Alchemy 2" not in players  # it is in the table already
    assert {"people, Tiny Alchemy", "o1"} <= set(players)
    page = (tmp_path / "page.html").read_text()
    assert "explorer" in page
    assert "192 new combinations after 500 attempts" in page


def test_an_agent_by_other_rules_gets_no_rows_of_the_pack(pack):
    from wordcraft_kg.agents.config import TaskConfig

    assert reference.play_of(TaskConfig(distractor_policy="no_shortcut"), "test") is None
    assert pack.rows_of(TaskPlay("test", 1, 3)) == ()
    assert msgspec.structs.replace(pack.rows[0]).at([4]).figures.keys() == {"4"}


def test_the_page_has_the_table_with_ours_and_others_apart(refused, run, pack, tmp_path):
    page = tmp_path / "page.html"
    done = run("reference", "kitchen", "--distractors", "1,4", "--out", page)
    assert done.code == 0, done.err
    assert f"wrote {page}" in done.out
    ours, theirs = page.read_text().split("From the literature, in other environments")
    assert "our agent" in ours
    assert "gpt-4o-mini" not in ours
    assert "gpt-4o-mini" in theirs
    assert "arXiv 2505.00234" in theirs
    refused("reference", "kitchen", "--distractors", "1,4", "--out", page, kind="OutputExistsError")
    assert run("reference", "kitchen", "--open-ended", "--out", page, "--force").code == 0
