"""A program that plays by text beside the scripted players of `evaluate-agent`."""

import errno
import json
import os
import shlex
import sys
from pathlib import Path

import pytest

from wordcraft_kg.apps.text_agents.results import GAMES_FILE, evaluation_of, read_games
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.runs.run_folder import locked

FIRST_TWO = "import sys\nfor line in sys.stdin: print('1 + 2', flush=True)"
DIES = "for _ in range(5): input(); print('1 + 2', flush=True)\n"
PYTHON = shlex.quote(sys.executable)
GAMES = Path("distractors-2", GAMES_FILE)


@pytest.fixture
def play(run, tmp_path, monkeypatch):
    """Let a program play on the kitchen, into the folder `out`, in an empty working folder."""
    monkeypatch.chdir(tmp_path)
    Path("player.py").write_text(FIRST_TWO)

    def evaluate(*options, limit=12, seeds=1, player="player.py", out="out"):
        return run(
            *("evaluate-agent", "kitchen", "--player", f"program:{PYTHON} {player}"),
            *("--distractors", "2", "--distractor-seeds", seeds, "--limit", limit),
            *(("--out", out) if out else ()),
            *options,
        )

    return evaluate


@pytest.fixture
def games(tmp_path):
    return tmp_path / "out" / GAMES


def lines_of(path):
    return path.read_text(encoding="utf-8").splitlines(keepends=True)


def row_of(outcome):
    rows = json.loads(outcome.out)["rows"]
    (row,) = (row for row in rows if row["player"] == "player.py")
    return row


def test_a_program_plays_the_tables_of_all_others_and_its_row_is_that_of_its_games(play, games):
    row = row_of(play("--json", limit=100))
    _, played, _ = read_games(games)
    world = World.open("kitchen", WordCraftConfig(part="test", num_distractors=2))
    success = evaluation_of(played, world.groups).metrics()
    assert (row["success"], row["low"], row["high"]) == (
        success.mean,
        success.ci_low,
        success.ci_high,
    )
    before = lines_of(games)
    assert len(before) == 64
    assert row_of(play("--json", limit=100)) == row  # plays nothing again
    assert lines_of(games) == before


def test_a_full_disk_keeps_the_finished_games_and_says_so(play, games, monkeypatch):
    def full(file):
        if os.fstat(file).st_size > 5_000:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("os.fsync", full)
    outcome = play()
    assert (outcome.code, outcome.out) == (1, "")
    assert "No space left" in outcome.err
    assert "Finished games are in out; repeat the command to continue." in outcome.err
    assert "Nothing was changed" not in outcome.err
    assert len(lines_of(games)) > 2


def test_an_evaluation_that_stopped_goes_on_and_ends_as_if_it_had_not(play, games, caplog):
    Path("player.py").write_text(DIES)
    outcome = play()
    assert (outcome.code, outcome.out, outcome.kind) == (1, "", "PlayerError")
    assert "has ended before the last game was over" in outcome.err
    assert "Finished games are in out; repeat the command to continue." in outcome.err
    assert len(lines_of(games)) == 6
    with games.open("a") as file:
        file.write('{"task": 1')  # torn
    Path("player.py").write_text(FIRST_TWO)
    play()
    assert "torn line" in caplog.text
    play(out="other")
    assert games.read_bytes() == Path("other", GAMES).read_bytes()


def test_an_evaluation_killed_before_its_header_begins_anew(play, games):
    play(limit=2)
    before = lines_of(games)
    games.write_text("", encoding="utf-8")
    outcome = play(limit=2)
    assert (outcome.code, lines_of(games)) == (0, before)


@pytest.mark.parametrize(
    ("player", "options", "fragment"),
    [
        ("program:no-such-program --key sk-123", (), "'no-such-program' cannot be started"),
        ("program:cat", ("--timeout", "0"), "--timeout 0"),
        ("program:cat", ("--seed", "3"), "--player has the tables of seed 0"),
        ("program:", (), "expected program:COMMAND"),
        ("inspect:log.eval", (), "expected program:COMMAND"),
    ],
)
def test_bad_input_is_refused_and_nothing_is_written(refused, tmp_path, player, options, fragment):
    out = tmp_path / "games"
    command = ("evaluate-agent", "kitchen", "--player", player, "--out", out)
    assert "sk-123" not in refused(*command, *options, says=fragment)
    assert not out.exists()


def test_games_of_another_player_or_other_settings_are_not_mixed(play, games):
    assert play(limit=3).code == 0
    before = lines_of(games)
    Path("other.py").write_text(FIRST_TWO)
    for changes, fragment in (
        ({"limit": 4}, "--tasks 3, and this command has 4"),
        ({"limit": 3, "seeds": 2}, "--distractor-seeds 1, and this command has 2"),
        ({"limit": 3, "player": "other.py"}, "holds games with --player player.py"),
    ):
        outcome = play(**changes)
        assert (outcome.code, outcome.out, fragment in outcome.err) == (1, "", True)
        assert lines_of(games) == before


@pytest.mark.parametrize(
    ("edit", "fragment"),
    [
        (lambda lines: [*lines, lines[1]], "line 4, is damaged: the game is a duplicate"),
        (
            lambda lines: [lines[0], lines[1].replace('"task": 0', '"task": 5')],
            "line 2, is damaged",
        ),
        (
            lambda lines: [lines[0], lines[1].replace('"actions": 2', f'"actions": {2**63}')],
            "is damaged: Expected",
        ),
    ],
)
def test_repeated_unknown_and_impossible_games_are_refused_and_kept(play, games, edit, fragment):
    play(limit=2)
    edited = edit(lines_of(games))
    games.write_text("".join(edited), encoding="utf-8")
    outcome = play(limit=2)
    assert (outcome.code, fragment in outcome.err) == (1, True)
    assert lines_of(games) == edited


def test_a_folder_in_which_another_process_plays_is_left_alone(play, games):
    play(limit=2)
    before = lines_of(games)
    with locked(games.parent):
        outcome = play(limit=2)
    assert (outcome.code, "is being written by another process" in outcome.err) == (1, True)
    assert lines_of(games) == before


def test_a_program_without_a_folder_has_one_below_text_agents(play, tmp_path):
    assert play(limit=1, out=None).code == 0
    assert [path.relative_to(tmp_path) for path in tmp_path.rglob(GAMES_FILE)] == [
        Path("text-agents", "player.py", GAMES)
    ]
