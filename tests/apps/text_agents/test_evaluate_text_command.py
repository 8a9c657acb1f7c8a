import json
import shlex
import sys
from pathlib import Path

import pytest

from wordcraft_kg.apps.text_agents.records import GAMES_FILE, RESULT_FILE, TextResult
from wordcraft_kg.base.records import read_record
from wordcraft_kg.runs.folder import locked

FIRST_TWO = "import sys\nfor line in sys.stdin: print('1 + 2', flush=True)"
PLAYER = f"{shlex.quote(sys.executable)} -c {shlex.quote(FIRST_TWO)}"


def read_result(folder: Path) -> TextResult:
    return read_record(folder / RESULT_FILE, TextResult)


@pytest.fixture
def play(run, tmp_path):
    """Let the player play on the kitchen, into the folder `out` of the test."""
    return lambda *options: run("evaluate-text", "kitchen", "--player", PLAYER, "--out", tmp_path / "out", *options)


def games_of(folder: Path) -> list[str]:
    return (folder / GAMES_FILE).read_text(encoding="utf-8").splitlines()


def test_a_program_plays_all_tasks_and_the_result_is_the_view(play, tmp_path):
    folder = tmp_path / "out"
    outcome = play("--distractors", "2")
    assert outcome.code == 0, outcome.err
    found = read_result(folder).success
    lines = outcome.out.splitlines()
    assert f"{found.mean:.3f} [{found.ci_low:.3f}, {found.ci_high:.3f}]" in lines[1]
    assert "63 test tasks of depth 1, 2 distractors, 1 draw each" in lines[2]
    tasks = "--part test --depth 1 --distractors 2"
    assert lines[-1].endswith(f"next: wordcraft-kg reference kitchen {tasks} --beside {folder}")
    games = games_of(folder)
    assert len(games) == 64
    assert sum(json.loads(line)["success"] for line in games[1:]) == round(found.mean * 63)
    again = play("--distractors", "2", "--json")  # everything is there: nothing is played again
    assert json.loads(again.out)["result"] == json.loads((folder / RESULT_FILE).read_text(encoding="utf-8"))
    assert games_of(folder) == games


def test_an_evaluation_that_stopped_goes_on_and_ends_as_if_it_had_not(run, tmp_path, caplog):
    dies = tmp_path / "dies.py"
    dies.write_text("for _ in range(5): input(); print('1 + 2', flush=True)\n")
    lives = tmp_path / "lives.py"
    lives.write_text(FIRST_TWO)
    python = shlex.quote(sys.executable)
    first, other = tmp_path / "first", tmp_path / "other"
    common = ("evaluate-text", "kitchen", "--tasks", "12", "--name", "somebody")
    outcome = run(*common, "--player", f"{python} {dies}", "--out", first)
    assert (outcome.code, outcome.out, outcome.kind) == (1, "", "PlayerError")
    assert "has ended before the last game was over: expected it to read lines until its input ends." in outcome.err
    assert f"The games so far are in {first}; the same command goes on." in outcome.err
    assert len(games_of(first)) == 6
    with (first / GAMES_FILE).open("a") as file:
        file.write('{"task": 1')  # torn
    run(*common, "--player", f"{python} {lives}", "--out", first)
    assert "torn line" in caplog.text
    run(*common, "--player", f"{python} {lives}", "--out", other)
    assert (first / RESULT_FILE).read_bytes() == (other / RESULT_FILE).read_bytes()
    assert games_of(first) == games_of(other)


def test_the_open_ended_world_is_played_as_often_as_asked(play):
    result = json.loads(play("--open-ended", "--attempts", "5", "--draws", "2", "--json").out)["result"]
    assert (result["games"], result["success"], result["settings"]["part"]) == (2, None, None)
    assert [*result["known"]] == ["1", "5"]
    assert result["known"]["5"] >= len(result["settings"]["base"])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["kitchn"], "Did you mean 'kitchen'"),
        (["kitchen", "--depth", "0"], "--depth 0: expected a whole number, 1 to 5."),
        (["kitchen", "--attempts", "0"], "--attempts 0: expected a whole number, 1 to 1000."),
        (["kitchen", "--draws", "0"], "--draws 0: expected a whole number, 1 or more."),
        (["kitchen", "--tasks", "0"], "--tasks 0: expected a whole number, 1 or more."),
        (["kitchen", "--refusals", "-1"], "--refusals -1: expected a whole number, 0 or more."),
        (["kitchen", "--timeout", "0"], "--timeout 0"),
        (["kitchen", "--base", "water"], "tasks have no base; add --open-ended"),
        (["kitchen", "--open-ended", "--depth", "2"], "--open-ended has no tasks"),
        (["kitchen", "--knowledge", "scorer"], "--knowledge scorer: name the scorer's model folder"),
        (["kitchen", "--scorer", "somewhere"], "only --knowledge scorer asks one"),
        (["kitchen", "--player", "no-such-program --key sk-123"], "player 'no-such-program' cannot be started"),
    ],
)
def test_bad_input_is_refused_and_nothing_is_written(run, tmp_path, arguments, says):
    player = [] if "--player" in arguments else ["--player", PLAYER]
    outcome = run("evaluate-text", *arguments, *player, "--out", tmp_path / "words")
    assert (outcome.code, outcome.out, says in outcome.err) == (1, "", True)
    assert not [word for word in ("Traceback", "sk-123") if word in outcome.err]
    assert not (tmp_path / "words").exists()


def test_games_of_another_player_or_other_settings_are_not_mixed(play, tmp_path):
    assert play("--tasks", "3").code == 0
    before = games_of(tmp_path / "out")
    for options, says in (
        (("--tasks", "3", "--name", "other"), "holds games of"),
        (("--tasks", "3", "--distractors", "2"), "holds games with --distractors 8, and this command has 2"),
        (("--tasks", "4"), "holds games with --tasks 3, and this command has 4"),
        (("--open-ended",), "holds games with --part test, and this command has none"),
        ((), "holds games with --tasks 3, and this command has none"),
    ):
        outcome = play(*options)
        assert (outcome.code, outcome.out, says in outcome.err) == (1, "", True)
        assert games_of(tmp_path / "out") == before
    assert play("--tasks", "3", "--distractors", "2", "--force").code == 0
    assert games_of(tmp_path / "out") != before


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (lambda lines: [*lines, lines[1]], "line 4, is damaged: task 0 with draw 0 is there twice, or not asked for"),
        (lambda lines: [lines[0], lines[1].replace('"task": 0', '"task": 5')], "task 5 with draw 0 is there twice, or"),
        (lambda lines: [lines[0], lines[1].replace('"goal": "', '"goal": "un')], "is to make"),
        (lambda lines: [lines[0], lines[1].replace('"success": false', '"success": true')], "was made and not made"),
    ],
)
def test_games_that_contradict_the_tasks_are_refused_and_kept(play, tmp_path, edit, says):
    play("--tasks", "2")
    path = tmp_path / "out" / GAMES_FILE
    edited = "".join(edit(path.read_text(encoding="utf-8").splitlines(keepends=True)))
    path.write_text(edited, encoding="utf-8")
    outcome = play("--tasks", "2")
    assert (outcome.code, says in outcome.err) == (1, True)
    assert path.read_text(encoding="utf-8") == edited


def test_games_in_another_order_have_the_same_result(play, tmp_path):
    play("--tasks", "9")
    path, before = tmp_path / "out" / GAMES_FILE, read_result(tmp_path / "out")
    header, *games = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join([header, *reversed(games)]), encoding="utf-8")
    assert play("--tasks", "9").code == 0
    assert read_result(tmp_path / "out") == before


def test_games_in_the_open_ended_world_are_not_counted_twice(play, tmp_path):
    options = ("--open-ended", "--attempts", "2", "--draws", "2")
    play(*options)
    path = tmp_path / "out" / GAMES_FILE
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join([*lines, lines[1]]), encoding="utf-8")
    outcome = play(*options)
    assert (outcome.code, "line 4, is damaged: game 0 is there twice" in outcome.err) == (1, True)


def test_a_folder_in_which_another_process_plays_is_left_alone(play, tmp_path):
    play("--tasks", "2")
    before = games_of(tmp_path / "out")
    with locked(tmp_path / "out"):
        for more in ([], ["--force"]):
            outcome = play("--tasks", "2", *more)
            assert (outcome.code, "is being written by another process" in outcome.err) == (1, True)
    assert games_of(tmp_path / "out") == before


@pytest.mark.parametrize(
    ("name", "folder"),
    [("lab/model-1.5", "lab-model-1.5"), ("../../up", "-..-up"), ("..", "player"), ("été", "été")],
)
def test_a_name_with_slashes_names_one_folder_and_none_elsewhere(run, tmp_path, monkeypatch, name, folder):
    monkeypatch.chdir(tmp_path)
    assert run("evaluate-text", "kitchen", "--player", PLAYER, "--tasks", "1", "--name", name).code == 0
    assert [path.relative_to(tmp_path) for path in tmp_path.rglob(RESULT_FILE)] == [
        Path("text-agents", folder, RESULT_FILE)
    ]
    assert read_result(tmp_path / "text-agents" / folder).player == name


@pytest.mark.parametrize("name", ["", "  ", "two\nlines", "\x1b[31mred", "x" * 101])
def test_a_name_that_cannot_stand_in_a_table_is_refused(run, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    outcome = run("evaluate-text", "kitchen", "--player", PLAYER, "--name", name)
    assert (outcome.code, "--name" in outcome.err, [*tmp_path.iterdir()]) == (1, True, [])


def test_a_folder_of_something_else_is_left_alone(run, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years")
    (tmp_path / "file").write_text("x")
    for out in ("mine", "file"):
        outcome = run("evaluate-text", "kitchen", "--player", PLAYER, "--out", tmp_path / out, "--force")
        assert (outcome.code, outcome.kind) == (1, "OutputExistsError")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thesis.txt"]
