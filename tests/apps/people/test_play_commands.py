"""Play by hand and the paper's protocol as a user runs them: scripted input, resuming, bad input."""

import io
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.apps.people.stored import refused
from wordcraft_kg.apps.people.protocol import HumanProtocol, episode_seed
from wordcraft_kg.base.records import as_values
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.graphs.folder import open_graph

Run = Callable[..., Any]
PLAY = ("play", "kitchen")
ONCE = (*PLAY, "--episodes", "1", "--seed")
PROTOCOL = (*PLAY, "--protocol", "paper")
WORLD = ("play", "everyday", "--open-ended")
GOOD = ["water", "earth", "air", "air"]  # mud and wind
ALL = ["1", "2"] * 80  # answers to all tasks of the protocol
ROOT = Path(__file__).parents[3]


@pytest.fixture
def typed(run: Run, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run a command with lines on stdin, which then ends."""

    def typed(lines: Sequence[str], *arguments: object) -> Any:
        monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in lines)))
        return run(*arguments)

    return typed


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of a session or game."""
    return tmp_path / "new" / "human.jsonl"


def solution(number: int, **settings: Any) -> tuple[list[str], WordCraftEnv]:
    """The words of the first plan of an episode's task, pick by pick, and its environment."""
    env = WordCraftEnv("kitchen", **settings)
    env.reset(seed=episode_seed(0, env.config.part, number))
    return [word for recipe in env.task.plans[0] for word in recipe[:2]], env


def without_seconds(path: Path) -> list[dict[str, Any]]:
    """The lines of a session's file, apart from how long each answer took."""
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [{key: value for key, value in line.items() if key != "seconds"} for line in lines]


def test_a_goal_is_made_by_typing_the_words_of_the_plan(typed: Run):
    words, env = solution(1, part="all")
    outcome = typed(words, *ONCE, "0")
    assert (outcome.code, outcome.err) == (0, "")
    for shown in (f"Goal: {env.task.goal}", f"You made the goal: {env.task.goal}.", "Solution: " + " + ".join(words)):
        assert shown in outcome.out
    assert outcome.out.splitlines()[-1] == "goals made: 1 of 1   to repeat these tasks: --seed 0"


def test_a_deeper_task_brings_what_is_made_to_the_table(typed: Run):
    words, _ = solution(1, part="train", depth=2, num_distractors=3, max_attempts=3)
    settings = {"depth": 2, "distractors": 3, "part": "train", "attempts": 3, "seed": 0, "episodes": 1}
    options = (word for name, value in settings.items() for word in (f"--{name}", value))
    outcome = typed(words, *PLAY, *options, "--json")
    assert outcome.out.count("\n") == 1
    assert json.loads(outcome.out) == {"graph": "kitchen", "successes": 1} | settings
    for shown in ("attempts left: 3", "attempts left: 2", f"first item: {words[0]}", "You made the goal"):
        assert shown in outcome.err


def test_a_goal_that_was_not_made_is_followed_by_a_plan(typed: Run):
    shown = typed(["1", "1"], *ONCE, "2").out
    end = r"You did not make .*\.\n.*olution.*\ngoals made: 0 of 1   to repeat these tasks: --seed 2\n$"
    assert re.search(end, shown)


def test_the_same_seed_poses_the_same_tasks_whatever_was_answered(typed: Run):
    def goals(lines: list[str], seed: int) -> list[str]:
        shown = typed(lines, *PLAY, "--seed", seed, "--attempts", "2", "--episodes", "4").out
        return [line.partition("   (goals made")[0] for line in shown.splitlines() if "Goal: " in line]

    assert len(goals(["1"] * 16, 3)) == 4
    assert goals(["1"] * 16, 3) == goals(["2", "1"] * 8, 3) != goals(["1"] * 16, 4)


@pytest.mark.parametrize("bad", ["0", "-1", "11", "x" * 5_000, "²", "", "  ", "\ufffd", "zzz", "?"])
def test_bad_input_is_asked_again_and_changes_nothing(typed: Run, bad: str):
    words, _ = solution(1, part="all")
    shown = typed([bad, words[0], bad, bad, words[1]], *ONCE, "0").out
    assert "You made the goal" in shown
    assert shown.count("Select two items" if bad == "?" else "expected 1 to 10") == 3 + (bad == "?")
    assert "attempts left: 0" not in shown


@pytest.mark.parametrize("lines", [[], ["q"], ["Q"], ["1", "q"], ["1"], [" q "]])
def test_q_or_the_end_of_the_input_ends_the_game_in_good_order(typed: Run, lines: list[str]):
    outcome = typed(lines, *PLAY, "--seed", "7")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.splitlines()[-1] == "goals made: 0 of 0   to repeat these tasks: --seed 7"


def test_the_game_fits_80_columns(typed: Run):
    outcome = typed(["?", "zzz", "1", "2"], "play", "everyday", "--distractors", "40", "--episodes", "1")
    assert max(map(len, outcome.out.splitlines())) <= 80


def test_input_that_is_not_text_is_bad_input():
    command, environment = [sys.executable, "-m", "wordcraft_kg"], os.environ | {"PYTHONIOENCODING": "utf-8:strict"}
    text = b"\xff\xfe\n1\n1"
    done = subprocess.run([*command, *ONCE, "2"], input=text, capture_output=True, cwd=ROOT, env=environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"expected 1 to 10" in done.stdout
    assert done.stdout.endswith(b"goals made: 0 of 1   to repeat these tasks: --seed 2\n")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--seed -1", "seed -1"),
        ("--episodes -1", "--episodes -1"),
        ("--depth 3 --attempts 2", "--attempts 2: expected a whole number, 3 to"),
        ("--distractors 79", "--distractors 79"),
        ("--base water", "--base water: tasks have no base; add --open-ended"),
        ("--open-ended --depth 2", "--open-ended has no tasks"),
        ("--open-ended --seed 0", "--open-ended has no tasks"),
        ("--open-ended --protocol paper --out x.jsonl", "--open-ended has no tasks"),
        ("--open-ended --attempts 0", "--attempts 0"),
        ("--open-ended --base flour --out x.jsonl", "--base flour: nothing new can be made"),
        ("--out x.jsonl", "--protocol paper"),
        ("--protocol paper", "--out"),
        ("--protocol paper --out x.jsonl --depth 2", "fixes depth"),
        ("--protocol paper --out x.jsonl --episodes 2", "fixes depth"),
        ("--protocol paper --out x.jsonl --part test", "fixes depth"),
        ("--protocol paper --out x.jsonl --attempts 2", "fixes depth"),
        ("--protocol paper --out x.jsonl --seed -1", "seed -1"),
    ],
)
def test_options_that_cannot_be_are_one_line(typed: Run, tmp_path: Path, monkeypatch, options: str, message: str):
    monkeypatch.chdir(tmp_path)
    assert message in refused(typed([], *PLAY, *options.split()))
    assert list(tmp_path.iterdir()) == []


def test_the_first_pick_can_be_put_back(typed: Run):
    words, _ = solution(1, part="all")
    shown = typed(["u", "1", "u", "2", "UNDO", *words], *ONCE, "0").out
    assert "There is no selection to undo." in shown
    assert shown.count("Undone: ") == 2
    assert "You made the goal" in shown


def test_the_tally_goes_along_with_the_game(typed: Run):
    words = [word for number in (1, 2) for word in solution(number, part="all")[0]]
    shown = typed([*words, "1", "1", "1", "1", "q"], *PLAY, "--seed", "0").out
    headings = [line.partition("   ")[2] for line in shown.splitlines() if "Goal: " in line]
    assert headings[:4] == ["", "(goals made: 1 of 1)", "(goals made: 2 of 2)", "(goals made: 2 of 3)"]
    assert "3 of 7. Goal: " in typed(["1"] * 5, *PLAY, "--seed", "0", "--episodes", "7").out


def test_another_session_has_other_tasks_and_says_how_to_have_them_again(typed: Run):
    command = (*PLAY, "--episodes", "3")
    first, second = (typed(["1"] * 6, *command).out for _ in range(2))
    seed = first.split("--seed ")[1].strip()
    assert seed != second.split("--seed ")[1].strip()
    assert typed(["1"] * 6, *command, "--seed", seed).out == first
    assert 0 <= json.loads(typed([], *PLAY, "--json").out)["seed"] < 1_000_000


@pytest.mark.parametrize(
    ("lines", "command", "kept", "message"),
    [
        (["1"] * 3, (*PLAY, "--seed", "2"), None, "goals made: 0 of 1   to repeat these tasks: --seed 2\n"),
        ([*GOOD, "air"], (*WORLD, "--out"), 3, "known items: 7 of 1177 (2 discovered) after 2 of 100 attempts; "),
        (["1"] * 5, (*PROTOCOL, "--out"), 3, "2 answers are saved in"),
    ],
)
def test_ctrl_c_ends_the_line_and_shows_the_tally(run: Run, path: Path, monkeypatch, lines, command, kept, message):
    def typing() -> Iterator[str]:
        yield from (f"{line}\n" for line in lines)
        raise KeyboardInterrupt

    reading, stdin = typing(), io.StringIO()
    monkeypatch.setattr(stdin, "readline", lambda: next(reading))
    monkeypatch.setattr(sys, "stdin", stdin)
    outcome = run(*command, *([path] if kept else []))
    assert outcome.code == 130
    assert outcome.out.endswith(" > \n")
    assert outcome.err.startswith(f"interrupted; {message}")
    assert kept is None or (path.read_bytes().count(b"\n") == kept and str(path) in outcome.err)


def test_the_open_ended_world_is_discovered_by_typing_names(typed: Run):
    outcome = typed([*GOOD, "air", "air", "mud", "time", "l"], *WORLD)
    assert (outcome.code, outcome.err) == (0, "")
    for shown in ("water + earth -> mud", "air + air -> wind", "air + air -> nothing new (already tried)", "  7 wind"):
        assert shown in outcome.out
    graph = open_graph("everyday").graph
    made = graph.labels(graph.results("mud", "time"))
    discovered = 2 + len(set(made) - {"mud", "wind"})
    assert outcome.out.splitlines()[-2:] == [
        f"known items: {5 + discovered} of 1177 ({discovered} discovered) after 4 of 100 attempts",
        f"attempts without a new item: {1 + (not made)}, repeated pairs: 1",
    ]


def test_the_game_is_that_of_the_environment(typed: Run):
    values = json.loads(typed(GOOD, *WORLD, "--attempts", "2", "--json").out)
    env = OpenEndedEnv("everyday", max_attempts=2)
    env.reset()
    for one, other in (GOOD[:2], GOOD[2:]):
        *_, info = env.step([env.graph.id_of(one), env.graph.id_of(other)])
    assert info["outcome"] == "out_of_attempts"
    assert (values["known"], values["reachable"]) == (info["known"], env.discovery.reachable)
    assert (values["discovered"], values["attempts"], values["attempted"]) == (["mud", "wind"], 2, 2)


def test_the_game_ends_when_everything_is_known(typed: Run, tmp_path: Path):
    book = tmp_path / "book.csv"
    book.write_text("ingredient_a,ingredient_b,result\na,b,c\nc,c,d\n")
    command = ("play", book, "--open-ended", "--base", "a,b", "--json")
    values = json.loads(typed(["a", "b", "c", "c", "this is not read any more"], *command).out)
    assert (values["base"], values["known"], values["attempted"]) == (["a", "b"], 4, 2)


@pytest.mark.parametrize("count", range(7))
def test_a_game_goes_on_from_its_file(typed: Run, tmp_path: Path, path: Path, count: int):
    lines, whole, game = [*GOOD, "mud", "wind"], tmp_path / "whole.jsonl", (*WORLD, "--attempts", "3", "--out")
    expected = json.loads(typed(lines, *game, whole, "--json").out)
    typed(lines[:count], *game, path)
    kept = count - count % 2  # the first pick of an attempt is not kept
    assert json.loads(typed(lines[kept:], *game, path, "--json").out) == expected | {"out": str(path)}
    assert path.read_bytes() == whole.read_bytes()
    assert f"{path} is complete; nothing was changed." in typed(["1", "1"], *game, path).out
    assert path.read_bytes() == whole.read_bytes()


def test_a_game_on_other_terms_or_a_damaged_one_is_refused_and_stays(typed: Run, path: Path):
    again = (*WORLD, "--out", path)
    typed(GOOD, *again)
    before = path.read_bytes()
    assert "attempts 100, but this command has 7" in refused(typed([], *again, "--attempts", "7"))
    assert "base" in refused(typed([], *again, "--base", "air,earth"))
    refused(typed([], *PLAY, "--open-ended", "--out", path), "GraphMismatchError")
    assert path.read_bytes() == before
    for line in ('{"actions": ["mud", "dragon"]}', '{"actions": ["mud"]}', "{}", "no line of a game"):
        path.write_bytes(before + line.encode() + b"\n")
        assert "damaged" in refused(typed([], *again), "ArtefactError")
    path.write_text("my notes\n")
    assert "damaged" in refused(typed([], *again), "ArtefactError")
    assert path.read_text() == "my notes\n"


def test_a_torn_last_line_of_a_game_is_dropped(typed: Run, path: Path, caplog: pytest.LogCaptureFixture):
    typed(GOOD, *WORLD, "--out", path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-5])
    assert "Resuming after 1 attempts" in typed([], *WORLD, "--out", path).out
    assert "torn" in caplog.text
    typed(GOOD[2:], *WORLD, "--out", path)
    assert path.read_bytes() == whole


def test_a_beginning_that_many_things_have_names_only_some(typed: Run):
    shown = typed(["a"], "play", "everyday", "--distractors", "300", "--seed", "0").out
    line = next(line for line in shown.splitlines() if "is ambiguous" in line)
    assert line.count("(") == 8
    assert re.search(r" and \d+ more\. Write more of the name", line)


def test_the_protocol_shows_the_answer_of_train_tasks_only(typed: Run, path: Path):
    outcome = typed(ALL, *PROTOCOL, "--out", path)
    assert (outcome.code, outcome.err) == (0, "")
    learning, testing = outcome.out.split("The test begins")
    assert learning.count("solution: ") == len(re.findall("(?:in)?correct: ", learning)) == 40
    *tasks, result = testing.splitlines()
    assert not re.search("->|correct", "\n".join(tasks))
    rows = without_seconds(path)
    right = {part: sum(row["success"] for row in rows[1:] if row["part"] == part) for part in ("train", "test")}
    assert result.startswith(f"correct: train {right['train']} of 40, test {right['test']} of 40")


def test_the_lines_are_the_tasks_and_what_was_picked(typed: Run, path: Path):
    outcome = typed(ALL, *PROTOCOL, "--distractors", "1", "--seed", "5", "--out", path, "--json")
    protocol = HumanProtocol("kitchen", 1, seed=5)
    header, *rows = without_seconds(path)
    assert header == as_values(protocol.header)
    for row in rows:
        expected = as_values(protocol.answer(protocol.task(row["part"], row["number"]), (0, 1), 0.0))
        assert row | {"seconds": 0.0} == expected
        assert row["actions"] == row["table"][:2]
    values = json.loads(outcome.out)
    assert (values["answered"], values["finished"], values["out"]) == (80, True, str(path))


def test_each_answer_is_on_the_disk_before_the_next_task_is_shown(run: Run, path: Path, monkeypatch):
    synced: list[int] = []
    fsync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda file: (fsync(file), synced.append(os.fstat(file).st_size)))

    class Player(io.StringIO):
        asked = 0

        def readline(self, size: int | None = -1) -> str:  # type: ignore[override]
            assert path.read_bytes().count(b"\n") == 1 + self.asked // 2
            assert self.asked < 2 or synced[-1] == path.stat().st_size
            self.asked += 1
            return "1\n" if self.asked <= 100 else ""

    monkeypatch.setattr(sys, "stdin", Player())
    assert run(*PROTOCOL, "--out", path).code == 0
    assert len(synced) == 50


@pytest.mark.parametrize("pieces", [[1], [2, 3], [81, 79], [80, 80], [160]])
def test_a_session_broken_off_goes_on_where_it_was(typed: Run, tmp_path: Path, path: Path, pieces: list[int]):
    typed(["1"] * 160, *PROTOCOL, "--out", tmp_path / "whole.jsonl")
    for count in pieces:
        assert typed(["1"] * count + ["q"], *PROTOCOL, "--out", path).code == 0
    typed(["1"] * 160, *PROTOCOL, "--out", path)
    assert without_seconds(path) == without_seconds(tmp_path / "whole.jsonl")


def test_an_unfinished_session_says_how_to_go_on_and_not_how_many_test_tasks_were_right(typed: Run, path: Path):
    values = json.loads(typed(["1"] * 150, *PROTOCOL, "--out", path, "--json").out)
    assert values == {"out": str(path), "answered": 75, "tasks": 80, "finished": False}
    shown = typed([], *PROTOCOL, "--out", path).out
    assert "Resuming after 75 answers" in shown
    assert shown.splitlines()[-1].startswith("answered 75 of 80; repeat the command to resume")


def test_a_session_keeps_the_seed_that_it_began_with(typed: Run, tmp_path: Path, path: Path):
    typed(["1", "1"], *PROTOCOL, "--out", path, "--seed", "5")
    assert typed(["1", "1"], *PROTOCOL, "--out", path).code == 0
    assert (without_seconds(path)[0]["seed"], len(without_seconds(path))) == (5, 3)
    assert "seed" in refused(typed(["1", "1"], *PROTOCOL, "--out", path, "--seed", "1"))
    typed(["1", "1"], *PROTOCOL, "--out", tmp_path / "other.jsonl")
    assert without_seconds(tmp_path / "other.jsonl")[0]["seed"] == 0


def test_a_finished_file_says_so_and_stays(typed: Run, path: Path):
    typed(ALL, *PROTOCOL, "--out", path)
    before = path.read_bytes()
    outcome = typed(["1", "1"], *PROTOCOL, "--out", path)
    assert outcome.code == 0
    assert "is complete; nothing was changed" in outcome.out
    assert "Goal:" not in outcome.out
    assert path.read_bytes() == before


def test_a_graph_without_test_tasks_is_refused_before_anything_is_written(typed: Run, tmp_path: Path):
    book = tmp_path / "tiny.csv"
    book.write_text("ingredient_a,ingredient_b,result\na,b,c\n")
    command = ("play", book, "--protocol", "paper", "--distractors", "0", "--out", tmp_path / "human.jsonl")
    assert "test part" in refused(typed(["1", "1"], *command), "TaskError")
    assert list(tmp_path.iterdir()) == [book]


def test_human_summary_of_no_answers_says_so(typed: Run, run: Run, path: Path):
    typed([], *PROTOCOL, "--out", path)
    assert run("people", "summary", path).out.count("no answers") == 2


def test_human_summary_refuses_what_it_cannot_sum_up(typed: Run, run: Run, path: Path):
    typed(["1"] * 4, *PROTOCOL, "--out", path)
    assert "given twice" in refused(run("people", "summary", path, path))
    assert "at least one" in refused(run("people", "summary"))
    path.write_bytes(path.read_bytes()[:-3])
    for file in (path, path.parent, path.with_name("nowhere")):
        refused(run("people", "summary", file), "ArtefactError")
