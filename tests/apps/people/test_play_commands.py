"""Play by hand and the paper's protocol as a user runs them: scripted input, resuming, bad input."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from wordcraft_kg.apps.people.protocol import HumanProtocol, episode_seed
from wordcraft_kg.apps.people.terminal import Terminal
from wordcraft_kg.base.records import as_values
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.graphs.folder import open_graph

Run = Callable[..., Any]
PROTOCOL = ("play", "kitchen", "--protocol", "paper")
ROOT = Path(__file__).parents[3]


@pytest.fixture
def typed(run: Run, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run a command with lines on stdin, which then ends."""

    def typed(text: str, *arguments: object) -> Any:
        monkeypatch.setattr(sys, "stdin", io.StringIO(text))
        return run(*arguments)

    return typed


def solution(graph: str, number: int, **settings: Any) -> tuple[list[str], WordCraftEnv]:
    """The words of the first plan of an episode's task, pick by pick, and its environment."""
    env = WordCraftEnv(graph, **settings)
    env.reset(seed=episode_seed(0, env.config.part, number))
    return [word for recipe in env.task.plans[0] for word in recipe[:2]], env


def without_seconds(path: Path) -> list[dict[str, Any]]:
    """The lines of a session's file, apart from how long each answer took."""
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [{key: value for key, value in line.items() if key != "seconds"} for line in lines]


def refused(outcome: Any, kind: str) -> str:
    """The message of a command that was refused: one line, of this kind of error, and no game."""
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.kind == kind
    assert outcome.err.startswith("error: ")
    assert "Traceback" not in outcome.err
    return outcome.err


# --- free play -------------------------------------------------------------------------------------------------------


def test_a_goal_is_made_by_typing_the_words_of_the_plan(typed: Run):
    words, env = solution("kitchen", 1, part="all")
    outcome = typed("\n".join(words) + "\n", "play", "kitchen", "--episodes", "1", "--seed", "0")
    assert (outcome.code, outcome.err) == (0, "")
    assert f"Make: {env.task.goal}" in outcome.out
    assert f"You made {env.task.goal}." in outcome.out
    assert "The plan: " + " + ".join(words) in outcome.out
    assert outcome.out.splitlines()[-1] == "goals made: 1 of 1   the same tasks again: --seed 0"


def test_a_deeper_task_brings_what_is_made_to_the_table(typed: Run):
    words, _ = solution("kitchen", 1, part="train", depth=2, num_distractors=3, max_attempts=3)
    settings = {"depth": 2, "distractors": 3, "part": "train", "attempts": 3, "seed": 0, "episodes": 1}
    options = (word for name, value in settings.items() for word in (f"--{name}", value))
    outcome = typed("\n".join(words) + "\n", "play", "kitchen", *options, "--json")
    assert outcome.out.count("\n") == 1
    assert json.loads(outcome.out) == {"graph": "kitchen", "successes": 1} | settings
    for shown in ("attempts left: 3", "attempts left: 2", f"hand: {words[0]}", "You made"):
        assert shown in outcome.err


def test_a_goal_that_was_not_made_is_followed_by_a_plan(typed: Run):
    outcome = typed("1\n1\n", "play", "kitchen", "--episodes", "1", "--seed", "2")
    assert "was not made." in outcome.out
    assert "plan" in outcome.out
    assert outcome.out.splitlines()[-1] == "goals made: 0 of 1   the same tasks again: --seed 2"


def test_the_same_seed_poses_the_same_tasks_whatever_was_answered(typed: Run):
    def goals(text: str, seed: int) -> list[str]:
        shown = typed(text, "play", "kitchen", "--seed", seed, "--attempts", "2", "--episodes", "4").out
        return [line.partition("   (made")[0] for line in shown.splitlines() if "Make: " in line]

    assert len(goals("1\n" * 16, 3)) == 4
    assert goals("1\n" * 16, 3) == goals("2\n1\n" * 8, 3)
    assert goals("1\n" * 16, 3) != goals("1\n" * 16, 4)


BAD = ("0", "-1", "11", "x" * 5_000, "²", "", "  ", "\ufffd", "zzz", "?")


@pytest.mark.parametrize("bad", BAD)
def test_bad_input_is_asked_again_and_changes_nothing(typed: Run, bad: str):
    words, _ = solution("kitchen", 1, part="all")
    text = f"{bad}\n{words[0]}\n{bad}\n{bad}\n{words[1]}\n"
    outcome = typed(text, "play", "kitchen", "--episodes", "1", "--seed", "0")
    assert "You made" in outcome.out
    assert outcome.out.count("number of a thing" if bad == "?" else "expected 1 to 10") == 3 + (bad == "?")
    assert "attempts left: 0" not in outcome.out


def test_thousands_of_bad_lines_are_answered_one_by_one(typed: Run):
    outcome = typed("zzz\n" * 3_000, "play", "kitchen")
    assert outcome.code == 0
    assert outcome.out.count("'zzz': expected 1 to 10") == 3_000


@pytest.mark.parametrize("text", ["", "q\n", "Q", "1\nq\n", "1\n", "1"])
def test_q_or_the_end_of_the_input_ends_the_game_in_good_order(typed: Run, text: str):
    outcome = typed(text, "play", "kitchen", "--seed", "7")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.splitlines()[-1] == "goals made: 0 of 0   the same tasks again: --seed 7"


def test_the_game_fits_80_columns(typed: Run):
    outcome = typed("?\nzzz\n1\n2\n", "play", "everyday", "--distractors", "40", "--episodes", "1")
    assert max(map(len, outcome.out.splitlines())) <= 80


def test_input_that_is_not_text_is_bad_input():
    command = [sys.executable, "-m", "wordcraft_kg", "play", "kitchen", "--episodes", "1", "--seed", "2"]
    environment = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}
    done = subprocess.run(command, input=b"\xff\xfe\n1\n1\n", capture_output=True, cwd=ROOT, env=environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"expected 1 to 10" in done.stdout
    assert done.stdout.endswith(b"goals made: 0 of 1   the same tasks again: --seed 2\n")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--seed", "-1"), "seed -1"),
        (("--episodes", "-1"), "--episodes -1"),
        (("--depth", "3", "--attempts", "2"), "--attempts 2: expected a whole number, 3 to"),
        (("--distractors", "79"), "--distractors 79"),
        (("--base", "water"), "--base water: tasks have no base; add --open-ended"),
        (("--open-ended", "--depth", "2"), "--open-ended has no tasks"),
        (("--open-ended", "--seed", "0"), "--open-ended has no tasks"),
        (("--open-ended", "--protocol", "paper", "--out", "x.jsonl"), "--open-ended has no tasks"),
        (("--open-ended", "--attempts", "0"), "--attempts 0"),
        (("--open-ended", "--base", "flour", "--out", "x.jsonl"), "--base flour: nothing new can be made"),
        (("--out", "x.jsonl"), "--protocol paper"),
        (("--protocol", "paper"), "--out"),
        (("--protocol", "paper", "--out", "x.jsonl", "--depth", "2"), "fixes depth"),
        (("--protocol", "paper", "--out", "x.jsonl", "--episodes", "2"), "fixes depth"),
        (("--protocol", "paper", "--out", "x.jsonl", "--part", "test"), "fixes depth"),
        (("--protocol", "paper", "--out", "x.jsonl", "--attempts", "2"), "fixes depth"),
        (("--protocol", "paper", "--out", "x.jsonl", "--seed", "-1"), "seed -1"),
    ],
)
def test_options_that_cannot_be_are_one_line(
    typed: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], message: str
):
    monkeypatch.chdir(tmp_path)
    assert message in refused(typed("", "play", "kitchen", *options), "ConfigError")
    assert list(tmp_path.iterdir()) == []


def test_the_first_pick_can_be_put_back(typed: Run):
    words, _ = solution("kitchen", 1, part="all")
    text = "\n".join(["u", "1", "u", "2", "UNDO", *words])
    outcome = typed(text + "\n", "play", "kitchen", "--episodes", "1", "--seed", "0")
    assert "Nothing to put back: the hand is empty." in outcome.out
    assert outcome.out.count(" is put back.") == 2
    assert "You made" in outcome.out


def test_the_tally_goes_along_with_the_game(typed: Run):
    words = [word for number in (1, 2) for word in solution("kitchen", number, part="all")[0]]
    command = ("play", "kitchen", "--seed", "0")
    shown = typed("\n".join([*words, "1", "1", "1", "1", "q"]) + "\n", *command).out
    headings = [line for line in shown.splitlines() if "Make: " in line]
    so_far = [line.partition("   ")[2] for line in headings[:4]]
    assert so_far == ["", "(made 1 of 1)", "(made 2 of 2)", "(made 2 of 3)"]
    assert "3 of 7. Make: " in typed("1\n" * 5, *command, "--episodes", "7").out


def test_another_session_has_other_tasks_and_says_how_to_have_them_again(typed: Run):
    first, second = (typed("1\n1\n" * 3, "play", "kitchen", "--episodes", "3").out for _ in range(2))
    seed = first.split("--seed ")[1].strip()
    assert seed != second.split("--seed ")[1].strip()
    assert typed("1\n1\n" * 3, "play", "kitchen", "--episodes", "3", "--seed", seed).out == first
    drawn = json.loads(typed("", "play", "kitchen", "--json").out)["seed"]
    assert 0 <= drawn < 1_000_000


def stopped_by_ctrl_c(run: Run, monkeypatch: pytest.MonkeyPatch, typed: list[str], *command: object) -> Any:
    """Run a command, type lines, and press Ctrl-C."""

    def lines() -> Iterator[str]:
        yield from (f"{line}\n" for line in typed)
        raise KeyboardInterrupt

    typing, stdin = lines(), io.StringIO()
    monkeypatch.setattr(stdin, "readline", lambda: next(typing))
    monkeypatch.setattr(sys, "stdin", stdin)
    return run(*command)


def test_ctrl_c_ends_the_line_and_shows_the_tally(run: Run, monkeypatch: pytest.MonkeyPatch):
    outcome = stopped_by_ctrl_c(run, monkeypatch, ["1", "1", "1"], "play", "kitchen", "--seed", "2")
    assert outcome.code == 130
    assert outcome.out.endswith(" > \n")
    assert outcome.err == "interrupted; goals made: 0 of 1   the same tasks again: --seed 2\n"


class Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("variables", "shown"),
    [
        ({}, "\x1b[32mmade\x1b[0m"),
        ({"NO_COLOR": ""}, "\x1b[32mmade\x1b[0m"),
        ({"NO_COLOR": "1"}, "made"),
        ({"TERM": "dumb"}, "made"),
    ],
)
def test_colours_are_for_terminals_that_want_them(
    monkeypatch: pytest.MonkeyPatch, variables: dict[str, str], shown: str
):
    for name in ("NO_COLOR", "TERM"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert Terminal(Screen()).styled("made", "good") == shown
    assert Terminal(io.StringIO()).styled("made", "good") == "made"


# --- the open-ended world --------------------------------------------------------------------------------------------

WORLD = ("play", "everyday", "--open-ended")
GOOD = ["water", "earth", "air", "air"]  # mud and wind


def test_the_open_ended_world_is_discovered_by_typing_names(typed: Run):
    outcome = typed("\n".join([*GOOD, "air", "air", "mud", "time", "l"]) + "\n", *WORLD)
    assert (outcome.code, outcome.err) == (0, "")
    for shown in ("water + earth -> mud", "air + air -> wind", "air + air -> nothing new (tried before)", "  7 wind"):
        assert shown in outcome.out
    tally = outcome.out.splitlines()[-2:]
    made = graph_results("everyday", "mud", "time")
    discovered = 2 + len(set(made) - {"mud", "wind"})
    assert tally[0] == (f"known: {5 + discovered} of 739, {discovered} of them discovered, after 4 of 100 attempts")
    assert tally[1] == f"attempts with nothing new: {1 + (not made)}, pairs tried before: 1, hints: 0"


def graph_results(graph: str, one: str, other: str) -> tuple[str, ...]:
    opened = open_graph(graph).graph
    return opened.labels(opened.results(one, other))


def test_the_game_is_that_of_the_environment(typed: Run):
    values = json.loads(typed("\n".join(GOOD) + "\n", *WORLD, "--attempts", "2", "--json").out)
    env = OpenEndedEnv("everyday", max_attempts=2)
    env.reset()
    for one, other in (GOOD[:2], GOOD[2:]):
        *_, info = env.step([env.graph.id_of(one), env.graph.id_of(other)])
    assert info["outcome"] == "out_of_attempts"
    assert (values["known"], values["reachable"]) == (info["known"], env.discovery.reachable)
    assert values["discovered"] == ["mud", "wind"]
    assert (values["attempts"], values["attempted"]) == (2, 2)


def test_the_game_ends_when_everything_is_known(typed: Run, tmp_path: Path):
    book = tmp_path / "book.csv"
    book.write_text("ingredient_a,ingredient_b,result\na,b,c\nc,c,d\n")
    text = "h\nh\na\nb\nh\nc\nc\nthis is not read any more\n"
    values = json.loads(typed(text, "play", book, "--open-ended", "--base", "a,b", "--json").out)
    assert (values["base"], values["known"], values["attempted"], values["hints"]) == (["a", "b"], 4, 2, 3)


def test_a_hint_names_one_thing_and_then_the_pair_which_makes_something_new(typed: Run):
    shown = typed("h\nh\n", *WORLD).out
    one = shown.split("Something new can be made with ")[1].split(".")[0]
    pair = next(line for line in shown.splitlines() if "makes something new" in line).split(" > ")[-1]
    first, other = pair.removesuffix(" makes something new.").split(" + ")
    assert first == one
    outcome = typed(f"h\nh\n{first}\n{other}\n", *WORLD, "--json")
    values = json.loads(outcome.out)
    assert (values["hints"], values["fruitless"]) == (2, 0)
    assert values["known"] > 5


@pytest.mark.parametrize("count", range(7))
def test_a_game_goes_on_from_its_file(typed: Run, tmp_path: Path, count: int):
    lines = ["h", *GOOD, "h", "mud", "wind"]
    whole, path = tmp_path / "whole.jsonl", tmp_path / "pieces.jsonl"
    game = (*WORLD, "--attempts", "3")
    expected = json.loads(typed("\n".join(lines) + "\n", *game, "--out", whole, "--json").out)
    done = min(count, len(lines))
    kept = done - (done in (2, 4, 7))  # the first pick of an attempt is not kept
    typed("".join(f"{line}\n" for line in lines[:done]), *game, "--out", path)
    outcome = typed("".join(f"{line}\n" for line in lines[kept:]), *game, "--out", path, "--json")
    assert json.loads(outcome.out) == expected | {"out": str(path)}
    assert path.read_bytes() == whole.read_bytes()
    again = typed("1\n1\n", *game, "--out", path)
    assert f"{path} is finished; nothing was changed." in again.out
    assert path.read_bytes() == whole.read_bytes()


def test_a_game_on_other_terms_or_a_damaged_one_is_refused_and_stays(typed: Run, tmp_path: Path):
    path = tmp_path / "game.jsonl"
    typed("\n".join(GOOD) + "\n", *WORLD, "--out", path)
    before = path.read_bytes()
    again = (*WORLD, "--out", path)
    assert "--attempts 100, and this command has 7" in refused(typed("", *again, "--attempts", "7"), "ConfigError")
    assert "--base" in refused(typed("", *again, "--base", "air,earth"), "ConfigError")
    other = ("play", "kitchen", "--open-ended", "--out", path)
    assert "was played on graph" in refused(typed("", *other), "GraphMismatchError")
    assert path.read_bytes() == before
    for line in ('{"picks": ["mud", "dragon"], "is_hint": false}', '{"picks": ["mud"]}', "{}", "no line of a game"):
        path.write_bytes(before + line.encode() + b"\n")
        assert "damaged" in refused(typed("", *again), "ArtefactError")
    path.write_text("my notes\n")
    assert "damaged" in refused(typed("", *again), "ArtefactError")
    assert path.read_text() == "my notes\n"


def test_a_torn_last_line_of_a_game_is_dropped(typed: Run, tmp_path: Path, caplog: pytest.LogCaptureFixture):
    path = tmp_path / "game.jsonl"
    typed("\n".join(GOOD) + "\n", *WORLD, "--out", path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-5])
    assert "Continuing after 1 attempts" in typed("", *WORLD, "--out", path).out
    assert "torn" in caplog.text
    typed("\n".join(GOOD[2:]) + "\n", *WORLD, "--out", path)
    assert path.read_bytes() == whole


def test_ctrl_c_in_the_open_ended_world_shows_the_tally(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    path = tmp_path / "game.jsonl"
    outcome = stopped_by_ctrl_c(run, monkeypatch, [*GOOD, "air"], *WORLD, "--out", path)
    assert outcome.code == 130
    assert outcome.err.startswith("interrupted; known: 7 of 739, 2 of them discovered, after 2 of 100 attempts; ")
    assert f"the same command goes on with {path}" in outcome.err
    assert path.read_bytes().count(b"\n") == 3


def test_a_beginning_that_many_things_have_names_only_some(typed: Run):
    shown = typed("a\n", "play", "everyday", "--distractors", "300", "--seed", "0").out
    line = next(line for line in shown.splitlines() if "could be" in line)
    assert line.count("(") == 8
    assert re.search(r" and \d+ more; write more of the word", line)


# --- protocol --------------------------------------------------------------------------------------------------------


def test_the_protocol_shows_the_answer_of_train_tasks_only(typed: Run, tmp_path: Path):
    path = tmp_path / "new" / "human.jsonl"
    outcome = typed("1\n2\n" * 80, *PROTOCOL, "--out", path)
    assert (outcome.code, outcome.err) == (0, "")
    learning, testing = outcome.out.split("The test begins")
    assert learning.count("answer: ") == 40
    assert learning.count("wrong: ") + learning.count("right: ") == 40
    *tasks, result = testing.splitlines()
    assert "->" not in "\n".join(tasks)
    assert "right" not in "\n".join(tasks)
    rows = without_seconds(path)
    right = {part: sum(row["success"] for row in rows[1:] if row["part"] == part) for part in ("train", "test")}
    assert result.startswith(f"right: train {right['train']} of 40, test {right['test']} of 40")


def test_the_lines_are_the_tasks_and_what_was_picked(typed: Run, tmp_path: Path):
    path = tmp_path / "human.jsonl"
    outcome = typed("1\n2\n" * 80, *PROTOCOL, "--distractors", "1", "--seed", "5", "--out", path, "--json")
    protocol = HumanProtocol("kitchen", 1, seed=5)
    header, *rows = without_seconds(path)
    assert header == as_values(protocol.header)
    for row in rows:
        expected = as_values(protocol.answer(protocol.task(row["part"], row["number"]), (0, 1), 0.0))
        assert row | {"seconds": 0.0} == expected
        assert row["picks"] == row["table"][:2]
    values = json.loads(outcome.out)
    assert (values["answered"], values["finished"], values["out"]) == (80, True, str(path))


def test_each_answer_is_on_the_disk_before_the_next_task_is_shown(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "human.jsonl"
    synced: list[int] = []
    fsync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda file: (fsync(file), synced.append(os.fstat(file).st_size)))

    class Player(io.StringIO):
        asked = 0

        def readline(self, size: int | None = -1) -> str:  # type: ignore[override]
            lines = path.read_bytes().count(b"\n")
            assert lines == 1 + self.asked // 2
            assert self.asked < 2 or synced[-1] == path.stat().st_size
            self.asked += 1
            return "1\n" if self.asked <= 100 else ""

    monkeypatch.setattr(sys, "stdin", Player())
    assert run(*PROTOCOL, "--out", path).code == 0
    assert len(synced) == 50


@pytest.mark.parametrize("pieces", [[1], [2, 3], [81, 79], [80, 80], [160]])
def test_a_session_broken_off_goes_on_where_it_was(typed: Run, tmp_path: Path, pieces: list[int]):
    whole, path = tmp_path / "whole.jsonl", tmp_path / "pieces.jsonl"
    typed("1\n" * 160, *PROTOCOL, "--out", whole)
    for count in pieces:
        outcome = typed("1\n" * count + "q\n", *PROTOCOL, "--out", path)
        assert outcome.code == 0
    typed("1\n" * 160, *PROTOCOL, "--out", path)
    assert without_seconds(path) == without_seconds(whole)


def test_an_unfinished_session_says_how_to_go_on_and_not_how_many_test_tasks_were_right(typed: Run, tmp_path: Path):
    outcome = typed("1\n" * 150, *PROTOCOL, "--out", tmp_path / "human.jsonl", "--json")
    found = {"out": str(tmp_path / "human.jsonl"), "answered": 75, "tasks": 80, "finished": False}
    assert json.loads(outcome.out) == found
    outcome = typed("", *PROTOCOL, "--out", tmp_path / "human.jsonl")
    assert "Continuing after 75 answers" in outcome.out
    assert outcome.out.splitlines()[-1].startswith("answered 75 of 80; the same command continues")


def test_a_session_keeps_the_seed_that_it_began_with(typed: Run, tmp_path: Path):
    path = tmp_path / "human.jsonl"
    typed("1\n1\n", *PROTOCOL, "--out", path, "--seed", "5")
    assert typed("1\n1\n", *PROTOCOL, "--out", path).code == 0
    assert json.loads(path.read_text().splitlines()[0])["seed"] == 5
    assert len(without_seconds(path)) == 3
    typed("1\n1\n", *PROTOCOL, "--out", tmp_path / "new.jsonl")
    assert json.loads((tmp_path / "new.jsonl").read_text().splitlines()[0])["seed"] == 0


def test_a_finished_file_says_so_and_stays(typed: Run, tmp_path: Path):
    path = tmp_path / "human.jsonl"
    typed("1\n" * 160, *PROTOCOL, "--out", path)
    before = path.read_bytes()
    outcome = typed("1\n1\n", *PROTOCOL, "--out", path)
    assert outcome.code == 0
    assert "is finished; nothing was changed" in outcome.out
    assert "Make:" not in outcome.out
    assert path.read_bytes() == before


def test_a_file_that_is_something_else_or_of_another_session_is_refused_and_stays(typed: Run, tmp_path: Path):
    path = tmp_path / "human.jsonl"
    path.write_text("mine\n")
    assert "Nothing was changed" in refused(typed("1\n1\n", *PROTOCOL, "--out", path), "ArtefactError")
    assert path.read_text() == "mine\n"
    path.unlink()
    typed("1\n1\n", *PROTOCOL, "--out", path)
    before = path.read_bytes()
    assert "seed" in refused(typed("1\n1\n", *PROTOCOL, "--out", path, "--seed", "1"), "ConfigError")
    other = ("play", "everyday", "--protocol", "paper", "--out", path)
    assert "graph_hash" in refused(typed("1\n1\n", *other), "GraphMismatchError")
    assert path.read_bytes() == before
    assert "is not a file" in refused(typed("1\n1\n", *PROTOCOL, "--out", tmp_path), "ArtefactError")


def test_a_graph_without_test_tasks_is_refused_before_anything_is_written(typed: Run, tmp_path: Path):
    book = tmp_path / "tiny.csv"
    book.write_text("ingredient_a,ingredient_b,result\na,b,c\n")
    command = ("play", book, "--protocol", "paper", "--distractors", "0", "--out", tmp_path / "human.jsonl")
    assert "test part" in refused(typed("1\n1\n", *command), "TaskError")
    assert list(tmp_path.iterdir()) == [book]


def test_ctrl_c_ends_with_130_and_says_what_is_kept(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    outcome = stopped_by_ctrl_c(run, monkeypatch, ["1"] * 5, *PROTOCOL, "--out", tmp_path / "human.jsonl")
    assert outcome.code == 130
    assert "interrupted; 2 answers are in" in outcome.err
    assert len(without_seconds(tmp_path / "human.jsonl")) == 3


def test_a_killed_session_goes_on_as_if_it_had_not_been(typed: Run, tmp_path: Path, caplog: pytest.LogCaptureFixture):
    path = tmp_path / "human.jsonl"
    command = [sys.executable, "-m", "wordcraft_kg", *PROTOCOL, "--out", str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, cwd=ROOT) as process:
        assert process.stdin is not None
        process.stdin.write(b"1\n" * 91)  # 45 answers, and one thing in hand
        process.stdin.flush()
        deadline = time.monotonic() + 60
        while not path.exists() or path.read_bytes().count(b"\n") < 46:
            assert time.monotonic() < deadline
            assert process.poll() is None
            time.sleep(0.02)
        process.kill()
    assert process.returncode == -signal.SIGKILL
    with path.open("ab") as file:
        file.write(b'{"part": "test", "num')  # what a kill in the middle of a write leaves
    outcome = typed("1\n" * 160, *PROTOCOL, "--out", path)
    assert "Continuing after 45 answers" in outcome.out
    assert "torn" in caplog.text
    typed("1\n" * 160, *PROTOCOL, "--out", tmp_path / "whole.jsonl")
    assert without_seconds(path) == without_seconds(tmp_path / "whole.jsonl")


# --- summary ---------------------------------------------------------------------------------------------------------


def test_human_summary_shows_rates_with_intervals(typed: Run, run: Run, tmp_path: Path):
    for seed in ("0", "1"):
        typed("1\n2\n" * 80, *PROTOCOL, "--seed", seed, "--out", tmp_path / f"{seed}.jsonl")
    files = (tmp_path / "0.jsonl", tmp_path / "1.jsonl")
    outcome = run("people", "summary", *files, "--json")
    values = json.loads(outcome.out)
    assert outcome.out.count("\n") == 1
    successes = [row["success"] for file in files for row in without_seconds(file)[1:] if row["part"] == "test"]
    test = values["conditions"][0]["parts"]["test"]
    assert (test["answered"], test["successes"]) == (80, sum(successes))
    text = run("people", "summary", *files).out
    assert "kitchen; sessions: 2, finished: 2" in text
    assert f"{sum(successes)} of 80 right, rate {test['rate']:.3f} [{test['interval'][0]:.3f}, " in text


def test_human_summary_of_no_answers_says_so(typed: Run, run: Run, tmp_path: Path):
    typed("", *PROTOCOL, "--out", tmp_path / "human.jsonl")
    assert run("people", "summary", tmp_path / "human.jsonl").out.count("no answers") == 2


def test_human_summary_refuses_what_it_cannot_sum_up(typed: Run, run: Run, tmp_path: Path):
    one, two, torn = (tmp_path / name for name in ("one.jsonl", "two.jsonl", "torn.jsonl"))
    typed("1\n" * 4, *PROTOCOL, "--out", one)
    typed("1\n" * 4, "play", "everyday", *PROTOCOL[2:], "--out", two)
    torn.write_bytes(one.read_bytes()[:-3])
    (tmp_path / "copy.jsonl").write_bytes(one.read_bytes())
    for files, message, kind in (
        ((one, two), "graph_hash", "GraphMismatchError"),
        ((one, tmp_path / "copy.jsonl"), "same answers", "ArtefactError"),
        ((one, one), "given twice", "ConfigError"),
        ((torn,), "torn line", "ArtefactError"),
        ((tmp_path / "nowhere",), "nowhere", "ArtefactError"),
        ((), "at least one", "ConfigError"),
    ):
        assert message in refused(run("people", "summary", *files), kind)
