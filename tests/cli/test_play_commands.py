"""Play by hand and the paper's protocol as a user runs them: scripted input, resuming, bad input."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from wordcraft_kg.agents.human import HumanProtocol, episode_seed, results_of, table_labels
from wordcraft_kg.envs.wordcraft import WordCraftEnv

Run = Callable[..., Any]
PROTOCOL = ("play", "kitchen", "--protocol", "paper")
ROOT = Path(__file__).parents[2]


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
    words, env = solution("kitchen", 1, part="all", num_distractors=4)
    outcome = typed("\n".join(words) + "\n", "play", "kitchen", "--episodes", "1")
    assert (outcome.code, outcome.err) == (0, "")
    assert f"Make: {env.task.goal}" in outcome.out
    assert f"You made {env.task.goal}." in outcome.out
    assert "The plan: " + " + ".join(words) in outcome.out
    assert outcome.out.splitlines()[-1] == "episodes played: 1   goal made: 1"


def test_a_deeper_task_brings_what_is_made_to_the_table(typed: Run):
    words, _ = solution("kitchen", 1, part="train", depth=2, num_distractors=3, max_attempts=3)
    options = ("--depth", "2", "--attempts", "3", "--part", "train", "--distractors", "3", "--episodes", "1")
    outcome = typed("\n".join(words) + "\n", "play", "kitchen", *options, "--json")
    values = json.loads(outcome.out)
    assert outcome.out.count("\n") == 1
    assert values == {
        "graph": "kitchen",
        "depth": 2,
        "distractors": 3,
        "part": "train",
        "attempts": 3,
        "seed": 0,
        "episodes": 1,
        "successes": 1,
    }
    for shown in ("attempts left: 3", "attempts left: 2", f"hand: {words[0]}", "You made"):
        assert shown in outcome.err


def test_a_goal_that_was_not_made_is_followed_by_a_plan(typed: Run):
    outcome = typed("1\n1\n", "play", "kitchen", "--episodes", "1", "--seed", "2")
    assert "was not made." in outcome.out
    assert "plan" in outcome.out
    assert outcome.out.splitlines()[-1] == "episodes played: 1   goal made: 0"


def test_the_same_seed_poses_the_same_tasks_whatever_was_answered(typed: Run):
    def goals(text: str, seed: int) -> list[str]:
        shown = typed(text, "play", "kitchen", "--seed", seed, "--attempts", "2", "--episodes", "4").out
        return [line for line in shown.splitlines() if "Make: " in line]

    assert len(goals("1\n" * 16, 3)) == 4
    assert goals("1\n" * 16, 3) == goals("2\n1\n" * 8, 3)
    assert goals("1\n" * 16, 3) != goals("1\n" * 16, 4)


BAD = ("0", "-1", "7", "x" * 5_000, "²", "", "  ", "\ufffd", "zzz", "?")


@pytest.mark.parametrize("bad", BAD)
def test_bad_input_is_asked_again_and_changes_nothing(typed: Run, bad: str):
    words, _ = solution("kitchen", 1, part="all", num_distractors=4)
    text = f"{bad}\n{words[0]}\n{bad}\n{bad}\n{words[1]}\n"
    outcome = typed(text, "play", "kitchen", "--episodes", "1")
    assert "You made" in outcome.out
    assert outcome.out.count("number of a thing" if bad == "?" else "expected 1 to 6") == 3 + (bad == "?")
    assert "attempts left: 0" not in outcome.out


def test_thousands_of_bad_lines_are_answered_one_by_one(typed: Run):
    outcome = typed("zzz\n" * 3_000, "play", "kitchen")
    assert outcome.code == 0
    assert outcome.out.count("'zzz': expected 1 to 6") == 3_000


@pytest.mark.parametrize("text", ["", "q\n", "Q", "1\nq\n", "1\n", "1"])
def test_q_or_the_end_of_the_input_ends_the_game_in_good_order(typed: Run, text: str):
    outcome = typed(text, "play", "kitchen")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.splitlines()[-1] == "episodes played: 0   goal made: 0"


def test_the_game_fits_80_columns(typed: Run):
    outcome = typed("?\nzzz\n1\n2\n", "play", "everyday", "--distractors", "40", "--episodes", "1")
    assert max(map(len, outcome.out.splitlines())) <= 80


def test_input_that_is_not_text_is_bad_input():
    command = [sys.executable, "-m", "wordcraft_kg", "play", "kitchen", "--episodes", "1"]
    environment = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}
    done = subprocess.run(command, input=b"\xff\xfe\n1\n2\n", capture_output=True, cwd=ROOT, env=environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"expected 1 to 6" in done.stdout
    assert done.stdout.endswith(b"episodes played: 1   goal made: 0\n")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--seed", "-1"), "seed -1"),
        (("--episodes", "-1"), "--episodes -1"),
        (("--depth", "3", "--attempts", "2"), "--attempts 2: expected a whole number, 3 to"),
        (("--distractors", "79"), "--distractors 79"),
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
    assert header == protocol.header
    for row in rows:
        env, observation = protocol.pose(row["part"], row["number"])
        table = table_labels(env, observation)
        made = results_of(env, *table[:2])
        assert row == {
            "part": row["part"],
            "number": row["number"],
            "goal": env.task.goal,
            "table": list(table),
            "picks": list(table[:2]),
            "made": list(made),
            "success": env.task.goal in made,
        }
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
    assert json.loads(outcome.out) == {
        "out": str(tmp_path / "human.jsonl"),
        "answered": 75,
        "tasks": 80,
        "finished": False,
    }
    outcome = typed("", *PROTOCOL, "--out", tmp_path / "human.jsonl")
    assert "Continuing after 75 answers" in outcome.out
    assert outcome.out.splitlines()[-1].startswith("answered 75 of 80; the same command continues")


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
    assert "directory" in refused(typed("1\n1\n", *PROTOCOL, "--out", tmp_path), "IsADirectoryError")


def test_a_graph_without_test_tasks_is_refused_before_anything_is_written(typed: Run, tmp_path: Path):
    book = tmp_path / "tiny.csv"
    book.write_text("ingredient_a,ingredient_b,result\na,b,c\n")
    command = ("play", book, "--protocol", "paper", "--distractors", "0", "--out", tmp_path / "human.jsonl")
    assert "test part" in refused(typed("1\n1\n", *command), "TaskError")
    assert list(tmp_path.iterdir()) == [book]


def test_ctrl_c_ends_with_130_and_says_what_is_kept(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def lines() -> Iterator[str]:
        yield from ["1\n"] * 5
        raise KeyboardInterrupt

    typing, stdin = lines(), io.StringIO()
    monkeypatch.setattr(stdin, "readline", lambda: next(typing))
    monkeypatch.setattr(sys, "stdin", stdin)
    outcome = run(*PROTOCOL, "--out", tmp_path / "human.jsonl")
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
    outcome = run("human-summary", *files, "--json")
    values = json.loads(outcome.out)
    assert outcome.out.count("\n") == 1
    successes = [row["success"] for file in files for row in without_seconds(file)[1:] if row["part"] == "test"]
    test = values["parts"]["test"]
    assert (test["answered"], test["successes"]) == (80, sum(successes))
    text = run("human-summary", *files).out
    assert "kitchen, 8 distractors; sessions: 2, finished: 2" in text
    assert f"{sum(successes)} of 80 right, rate {test['rate']:.3f} [{test['interval'][0]:.3f}, " in text


def test_human_summary_of_no_answers_says_so(typed: Run, run: Run, tmp_path: Path):
    typed("", *PROTOCOL, "--out", tmp_path / "human.jsonl")
    assert run("human-summary", tmp_path / "human.jsonl").out.count("no answers") == 2


def test_human_summary_refuses_what_it_cannot_sum_up(typed: Run, run: Run, tmp_path: Path):
    one, two, torn = (tmp_path / name for name in ("one.jsonl", "two.jsonl", "torn.jsonl"))
    typed("1\n" * 4, *PROTOCOL, "--out", one)
    typed("1\n" * 4, *PROTOCOL, "--distractors", "1", "--out", two)
    torn.write_bytes(one.read_bytes()[:-3])
    assert "num_distractors" in refused(run("human-summary", one, two), "ConfigError")
    assert "same answers" in refused(run("human-summary", one, one), "ArtefactError")
    assert "torn line" in refused(run("human-summary", torn), "ArtefactError")
    assert "nowhere" in refused(run("human-summary", tmp_path / "nowhere"), "FileNotFoundError")
    assert "at least one" in refused(run("human-summary"), "ConfigError")
