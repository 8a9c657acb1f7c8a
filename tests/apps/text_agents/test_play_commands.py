"""Play by hand as a user runs it: scripted input, bad input."""

import io
import json
import re
import sys
from collections.abc import Callable
from typing import Any

import pytest

from tests.apps.people.stored import refused
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.graphs.graph_folder import open_graph

Run = Callable[..., Any]
PLAY = ("play", "kitchen")
ONCE = (*PLAY, "--seed")
WORLD = ("play", "everyday", "--open-ended")
GOOD = ["water + earth", "air, air"]  # mud and wind


@pytest.fixture
def typed(run, monkeypatch):
    """Run a command with lines on stdin, which then ends."""

    def typed(lines, *arguments):
        monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in lines)))
        return run(*arguments)

    return typed


def solution(typed, *options):
    """The goal of the first task, and the pairs of the plan that is shown after the game is lost."""
    shown = typed(["1 1"] * 5, *ONCE, "0", *options, "--json").err
    goal = re.search("Goal: (.+)", shown)
    plan = re.search("olutions?: (.+)", shown)
    return goal[1], re.findall(r"(\S+ \+ \S+) ->", plan[1])


def test_a_goal_is_made_by_typing_the_words_of_the_plan(typed):
    goal, words = solution(typed)
    outcome = typed(words, *ONCE, "0")
    assert (outcome.code, outcome.err) == (0, "")
    for shown in (
        f"Goal: {goal}",
        f"You made the goal: {goal}.",
        f"Solution: {words[0]}",
    ):
        assert shown in outcome.out
    assert outcome.out.splitlines()[-1] == "goals made: 1 of 1   to repeat these tasks: --seed 0"


def test_a_deeper_task_brings_what_is_made_to_the_table(typed):
    settings = {"depth": 2, "distractors": 3, "part": "train", "attempts": 3}
    options = [word for name, value in settings.items() for word in (f"--{name}", value)]
    _, words = solution(typed, *options)
    outcome = typed(words, *ONCE, "0", *options, "--json")
    assert outcome.out.count("\n") == 1
    assert json.loads(outcome.out) == {"successes": 1, "seed": 0, "episodes": 1}
    for shown in ("Attempts left: 3", "Attempts left: 2", f"{words[0]} -> ", "You made the goal"):
        assert shown in outcome.err


def test_a_goal_that_was_not_made_is_followed_by_a_plan(typed):
    shown = typed(["1 1"], *ONCE, "2").out
    assert re.search(r"You did not make .*\.\n.*olution.*\n\n2\.\n", shown)
    assert shown.endswith("goals made: 0 of 1   to repeat these tasks: --seed 2\n")


def test_the_same_seed_poses_the_same_tasks_whatever_was_answered(typed):
    def goals(lines, seed):
        shown = typed(lines, *PLAY, "--seed", seed, "--attempts", "2").out
        return list(dict.fromkeys(re.findall("Goal: .+", shown)))[:4]

    assert len(goals(["1 1"] * 8, 3)) == 4
    assert goals(["1 1"] * 8, 3) == goals(["2 1"] * 8, 3) != goals(["1 1"] * 8, 4)


@pytest.mark.parametrize(
    "bad", ["0 1", "1", "11 1", "x" * 5_000, "²", "", "  ", "\ufffd", "zzz", "?", "Help"]
)
def test_bad_input_is_asked_again_and_changes_nothing(typed, bad):
    _, words = solution(typed)
    shown = typed([bad, bad, bad, *words], *ONCE, "0").out
    assert "You made the goal" in shown
    is_help = bad in ("?", "Help")
    told = "An item is its number, its name, or the start" if is_help else "Invalid answer: "
    assert re.sub(r"\s+", " ", shown).count(told) == 3 + is_help
    # The list of items, which may be long, is not repeated after a mistake.
    assert shown.partition("olution")[0].count("Table: ") == 1


@pytest.mark.parametrize("lines", [[], ["quit"], ["Q"], ["1", "q"], ["1"], [" q "]])
def test_q_or_the_end_of_the_input_ends_the_game_in_good_order(typed, lines):
    outcome = typed(lines, *PLAY, "--seed", "7")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.splitlines()[-1] == "goals made: 0 of 0   to repeat these tasks: --seed 7"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--seed -1", "seed -1"),
        ("--depth 3 --attempts 2", "--attempts 2: expected a whole number, 3 to"),
        ("--distractors 79", "--distractors 79"),
        ("--open-ended --depth 2", "--open-ended has no tasks"),
        ("--open-ended --seed 0", "--open-ended has no tasks"),
        ("--open-ended --attempts 0", "--attempts 0"),
        ("--export game.html --depth 2", "--browser and --export have their own tasks"),
        ("--port 9000", "--host and --port are for a server; add --browser"),
    ],
)
def test_options_that_cannot_be_are_one_line(typed, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    assert message in refused(typed([], *PLAY, *options.split()))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("lines", "command", "message"),
    [
        (
            ["1 1", "1"],
            (*PLAY, "--seed", "2"),
            "goals made: 0 of 1   to repeat these tasks: --seed 2\n",
        ),
        ([*GOOD, "air"], WORLD, "known items: 7 of 1177 after 2 attempts\n"),
    ],
)
def test_ctrl_c_ends_the_line_and_shows_the_tally(run, monkeypatch, lines, command, message):
    def typing():
        yield from (f"{line}\n" for line in lines)
        raise KeyboardInterrupt

    reading, stdin = typing(), io.StringIO()
    monkeypatch.setattr(stdin, "readline", lambda: next(reading))
    monkeypatch.setattr(sys, "stdin", stdin)
    outcome = run(*command)
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.endswith(f"> \n{message}")


def test_the_open_ended_world_is_discovered_by_typing_names(typed):
    outcome = typed([*GOOD, "air + air", "mud, time"], *WORLD)
    assert (outcome.code, outcome.err) == (0, "")
    for shown in (
        "water + earth -> mud",
        "air + air -> wind",
        "air + air -> nothing new (already tried)",
        "7 wind",
    ):
        assert shown in outcome.out.replace("\n", " ")
    graph = open_graph("everyday").graph
    made = graph.labels(graph.results("mud", "time"))
    discovered = 2 + len(set(made) - {"mud", "wind"})
    assert outcome.out.splitlines()[-1] == f"known items: {5 + discovered} of 1177 after 4 attempts"


def test_the_game_is_that_of_players(typed):
    values = json.loads(typed(GOOD, *WORLD, "--attempts", "2", "--json").out)
    graph = open_graph("everyday").graph
    game = Discovery(graph)
    for one, other in (("water", "earth"), ("air", "air")):
        game.combine(graph.id_of(one), graph.id_of(other))
    assert (values["known"], values["reachable"]) == (len(game.known), game.reachable)
    assert (values["discovered"], values["attempted"]) == (["mud", "wind"], 2)
