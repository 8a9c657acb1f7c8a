import errno
import json
import os
import shlex
import sys
from pathlib import Path

import msgspec
import pytest

from wordcraft_kg.apps.text_agents import results
from wordcraft_kg.apps.text_agents.records import GAMES_FILE
from wordcraft_kg.apps.text_agents.results import groups_of, read_games, result_of
from wordcraft_kg.graphs import open_graph
from wordcraft_kg.runs.run_folder import locked

FIRST_TWO = "import sys\nfor line in sys.stdin: print('1 + 2', flush=True)"
PYTHON = shlex.quote(sys.executable)
PLAYER = f"{PYTHON} -c {shlex.quote(FIRST_TWO)}"
OPEN = ("--open-ended", "--attempts", "2", "--distractor-seeds", "2")


@pytest.fixture
def play(run, tmp_path, monkeypatch):
    """Let a player play on the kitchen, into the folder `out`, in an empty working folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *options, player=PLAYER, out="out": run(
        "evaluate-text", "kitchen", "--player", player, *(("--out", out) if out else ()), *options
    )


@pytest.fixture
def games(tmp_path):
    return tmp_path / "out" / GAMES_FILE


def result_in(folder):
    header, played, _ = read_games(Path(folder, GAMES_FILE))
    groups = groups_of(open_graph("kitchen"), header.settings)
    return result_of(header.player, header.settings, played, groups)


def lines_of(path):
    return path.read_text(encoding="utf-8").splitlines(keepends=True)


def test_a_program_plays_all_tasks_and_the_result_is_the_view(play, games):
    outcome = play("--distractors", "2")
    assert outcome.code == 0, outcome.err
    success = result_in("out").success
    lines = outcome.out.splitlines()
    assert f"{success.mean:.3f} [{success.ci_low:.3f}, {success.ci_high:.3f}]" in lines[1]
    assert "63 test tasks of depth 1, 2 distractors, 1 distractor seed each" in lines[2]
    assert lines[-1] == "wrote out/"
    before = lines_of(games)
    assert len(before) == 64
    assert sum(json.loads(line)["success"] for line in before[1:]) == round(success.mean * 63)
    again = play("--distractors", "2", "--json")  # plays nothing again
    assert json.loads(again.out)["result"] == json.loads(msgspec.json.encode(result_in("out")))
    assert lines_of(games) == before


def test_a_full_disk_keeps_the_finished_games_and_says_so(play, games, monkeypatch):
    write = results._write

    def full(path, mode, line):
        if path.stat().st_size > 2_000:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(path, mode, line)

    monkeypatch.setattr(results, "_write", full)
    outcome = play("--tasks", "12")
    assert (outcome.code, outcome.out) == (1, "")
    assert "No space left" in outcome.err
    assert "Finished games are in out; repeat the command to continue." in outcome.err
    assert "Nothing was changed" not in outcome.err
    assert len(lines_of(games)) > 2


def test_an_evaluation_that_stopped_goes_on_and_ends_as_if_it_had_not(play, games, caplog):
    Path("dies.py").write_text("for _ in range(5): input(); print('1 + 2', flush=True)\n")
    Path("lives.py").write_text(FIRST_TWO)
    options = ("--tasks", "12", "--name", "somebody")
    outcome = play(*options, player=f"{PYTHON} dies.py")
    assert (outcome.code, outcome.out, outcome.kind) == (1, "", "PlayerError")
    assert "has ended before the last game was over" in outcome.err
    assert "Finished games are in out; repeat the command to continue." in outcome.err
    assert len(lines_of(games)) == 6
    with games.open("a") as file:
        file.write('{"task": 1')  # torn
    play(*options, player=f"{PYTHON} lives.py")
    assert "torn line" in caplog.text
    play(*options, player=f"{PYTHON} lives.py", out="other")
    assert games.read_bytes() == Path("other", GAMES_FILE).read_bytes()


@pytest.mark.parametrize(
    "size", [0, 200, *(pytest.param(size, marks=pytest.mark.slow) for size in (1, -1))]
)
def test_an_evaluation_killed_in_its_header_begins_anew(play, games, size):
    """An evaluation that was killed while the header was written begins anew."""
    play("--tasks", "2")
    before = lines_of(games)
    games.write_text(before[0][:size], encoding="utf-8")
    outcome = play("--tasks", "2")
    assert (outcome.code, lines_of(games)) == (0, before)


def test_the_open_ended_world_is_played_as_often_as_configured(play):
    result = json.loads(
        play("--open-ended", "--attempts", "5", "--distractor-seeds", "2", "--json").out
    )["result"]
    assert (result["games"], result["success"], result["settings"]["part"]) == (2, None, None)
    assert [*result["known"]] == ["1", "5"]
    assert result["known"]["5"] >= len(result["settings"]["base"])


@pytest.mark.parametrize(
    ("arguments", "setting", "fragment"),
    [
        (["kitchn"], "", "Did you mean 'kitchen'"),
        (["kitchen", "--depth", "0"], "depth", "expected a whole number, 1 to 5"),
        (["kitchen", "--attempts", "0"], "attempts", "expected a whole number, 1 to 1000"),
        (
            ["kitchen", "--distractor-seeds", "0"],
            "distractor_seeds",
            "expected a whole number, 1 or more",
        ),
        (["kitchen", "--tasks", "0"], "tasks", "expected a whole number, 1 or more"),
        (["kitchen", "--max_invalid", "-1"], "max_invalid", "expected a whole number, 0 or more"),
        (["kitchen", "--timeout", "0"], "timeout", "--timeout 0"),
        (["kitchen", "--base", "water"], "base", "needs --open-ended"),
        (["kitchen", "--open-ended", "--depth", "2"], "open_ended", "no tasks"),
        (["kitchen", "--knowledge", "scorer"], "knowledge", "add the model folder"),
        (["kitchen", "--scorer", "somewhere"], "scorer", "a scorer needs --knowledge scorer"),
        (
            ["kitchen", "--player", "no-such-program --key sk-123"],
            "",
            "player 'no-such-program' cannot be started",
        ),
    ],
)
def test_bad_input_is_refused_and_nothing_is_written(run, tmp_path, arguments, setting, fragment):
    player = [] if "--player" in arguments else ["--player", PLAYER]
    outcome = run("evaluate-text", *arguments, *player, "--out", tmp_path / "words")
    assert (outcome.code, outcome.out, outcome.setting, fragment in outcome.err) == (
        1,
        "",
        setting,
        True,
    )
    assert not [word for word in ("Traceback", "sk-123") if word in outcome.err]
    assert not (tmp_path / "words").exists()


def test_games_of_another_player_or_other_settings_are_not_mixed(play, games):
    assert play("--tasks", "3").code == 0
    before = lines_of(games)
    for options, fragment in (
        (("--tasks", "3", "--name", "other"), "holds games by"),
        (("--tasks", "3", "--distractors", "2"), "--distractors 8, and this command has 2"),
        (("--tasks", "4"), "--tasks 3, and this command has 4"),
        (("--open-ended",), "--part test, and this command has none"),
        ((), "--tasks 3, and this command has none"),
    ):
        outcome = play(*options)
        assert (outcome.code, outcome.out, fragment in outcome.err) == (1, "", True)
        assert lines_of(games) == before
    assert play("--tasks", "3", "--distractors", "2", "--force").code == 0
    assert lines_of(games) != before


def test_forced_games_replace_earlier_ones_once_they_are_complete(play, games):
    Path("dies.py").write_text("for _ in range(5): input(); print('1 + 2', flush=True)\n")
    Path("lives.py").write_text(FIRST_TWO)
    options = ("--tasks", "12", "--name", "somebody")
    assert play(*options, player=f"{PYTHON} lives.py").code == 0
    before = lines_of(games)
    outcome = play(*options, "--force", player=f"{PYTHON} dies.py")
    assert (outcome.code, lines_of(games)) == (1, before)
    new = games.parent / "replacement" / GAMES_FILE
    assert len(lines_of(new)) == 6
    assert play(*options, "--force", player=f"{PYTHON} lives.py").code == 0
    assert (lines_of(games), new.parent.exists()) == (before, False)


@pytest.mark.parametrize(
    ("options", "edit", "fragment"),
    [
        ((), lambda lines: [*lines, lines[1]], "line 4, is damaged: the game is a duplicate"),
        (
            (),
            lambda lines: [lines[0], lines[1].replace('"task": 0', '"task": 5')],
            "line 2, is damaged",
        ),
        (OPEN, lambda lines: [*lines, lines[1]], "line 4, is damaged: the game is a duplicate"),
        (
            (),
            lambda lines: [lines[0], lines[1].replace('"actions": 2', f'"actions": {2**63}')],
            "is damaged: Expected",
        ),
    ],
)
def test_repeated_unknown_and_impossible_games_are_refused_and_kept(
    play, games, options, edit, fragment
):
    options = options or ("--tasks", "2")
    play(*options)
    edited = edit(lines_of(games))
    games.write_text("".join(edited), encoding="utf-8")
    outcome = play(*options)
    assert (outcome.code, fragment in outcome.err) == (1, True)
    assert lines_of(games) == edited


def test_games_in_another_order_have_the_same_result(play, games):
    play("--tasks", "9")
    before, (header, *lines) = result_in("out"), lines_of(games)
    games.write_text("".join([header, *reversed(lines)]), encoding="utf-8")
    assert play("--tasks", "9").code == 0
    assert result_in("out") == before


def test_a_folder_in_which_another_process_plays_is_left_alone(play, games):
    play("--tasks", "2")
    before = lines_of(games)
    with locked(games.parent):
        for more in ([], ["--force"]):
            outcome = play("--tasks", "2", *more)
            assert (outcome.code, "is being written by another process" in outcome.err) == (1, True)
    assert lines_of(games) == before


@pytest.mark.parametrize(
    ("name", "folder"),
    [("lab/model-1.5", "lab-model-1.5"), ("../../up", "-..-up"), ("..", "player"), ("été", "été")],
)
def test_a_name_with_slashes_names_one_folder_and_none_elsewhere(play, tmp_path, name, folder):
    assert play("--tasks", "1", "--name", name, out=None).code == 0
    assert [path.parent.relative_to(tmp_path) for path in tmp_path.rglob(GAMES_FILE)] == [
        Path("text-agents", folder)
    ]
    assert result_in(Path("text-agents", folder)).player == name


@pytest.mark.parametrize("name", ["", "  ", "two\nlines", "\x1b[31mred", "x" * 101])
def test_a_name_that_cannot_stand_in_a_table_is_refused(play, tmp_path, name):
    outcome = play("--name", name, out=None)
    assert (outcome.code, "--name" in outcome.err, [*tmp_path.iterdir()]) == (1, True, [])


def test_a_folder_of_something_else_is_left_alone(play):
    Path("mine").mkdir()
    Path("mine/thesis.txt").write_text("years")
    Path("file").write_text("x")
    for out in ("mine", "file"):
        outcome = play("--force", out=out)
        assert (outcome.code, outcome.kind) == (1, "OutputExistsError")
    assert [path.name for path in Path("mine").iterdir()] == ["thesis.txt"]
