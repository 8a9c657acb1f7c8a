"""Programs that play by the line protocol, good and bad ones."""

import json
import os
import re
import shlex
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from wordcraft_kg.apps.text_agents.conversation import Conversation
from wordcraft_kg.apps.text_agents.plays import DiscoveryGames
from wordcraft_kg.apps.text_agents.text_players import MOST_CHARACTERS, LinePlayer, name_of
from wordcraft_kg.base.errors import ConfigError, PlayerError

ORACLE = """
import json, sys
from wordcraft_kg.graphs.library import open_book
recipes = open_book("kitchen").recipes
for line in sys.stdin:
    game = json.loads(line)
    goal, table = game["goal"], {*game["table"]}
    pairs = [(a, b) for a, b, result in recipes if result == goal and {a, b} <= table]
    print(" + ".join(pairs[0]), flush=True)
"""


def program(code):
    return f"{shlex.quote(sys.executable)} -c {shlex.quote(code)}"


def let_play(player, game, **rules):
    talk = Conversation(game, **rules)
    while not talk.is_over:
        talk.hear(player.answer(talk))
    return talk


def test_a_program_plays_game_after_game_in_one_process(games):
    with LinePlayer(program(ORACLE)) as player:
        for task in range(10):
            talk = let_play(player, games.game(task))
            assert (talk.game.is_made, talk.invalid_actions) == (True, 0)


def test_a_line_has_all_that_a_program_needs(games, opened_kitchen, tmp_path):
    log, first = tmp_path / "log", games.game(0)
    echo = (
        f"import sys\nfor line in sys.stdin: open({str(log)!r}, 'a').write(line); print('1 1', "
        "flush=True)"
    )
    text, labels = Conversation(first).opening, list(first.labels)
    open_ended = DiscoveryGames(opened_kitchen, attempts=2)
    with LinePlayer(program(echo)) as player:
        for game in (first, games.game(1), open_ended.game()):
            let_play(player, game, max_invalid=0)
    lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    expected = {
        "game": 1,
        "new": True,
        "text": text,
        "goal": first.goal,
        "table": labels,
        "attempts_left": 1,
    }
    assert lines[0] == expected
    assert [(line["game"], line["new"]) for line in lines] == [
        (1, True),
        (2, True),
        (3, True),
        (3, False),
    ]
    assert [(line["goal"], line["attempts_left"]) for line in lines[2:]] == [(None, 2), (None, 1)]
    assert " -> " in lines[3]["text"]


@pytest.mark.parametrize(
    ("code", "fragment"),
    [
        ("import time; time.sleep(60)", "did not answer within 0.5 seconds"),
        ("import sys; sys.stdin.read()", "did not answer within 0.5 seconds"),
        ("import sys; sys.exit(3)", "has ended with exit code 3"),
        ("input()", "has ended before the last game"),
        ("import sys; input(); print('x' * 10**7)", f"more than {MOST_CHARACTERS:,} bytes"),
        ("import os\nos.write(1, bytes(10**6))", f"more than {MOST_CHARACTERS:,} bytes"),
        ("while True: print('1 1', flush=True)", "wrote extra lines"),
        ("while True: input(); print('1 1'); print('1 1', flush=True)", "wrote extra lines"),
    ],
)
def test_a_program_that_breaks_the_protocol_is_an_error(games, code, fragment):
    def play():
        for task in range(3):
            let_play(player, games.game(task))
            time.sleep(0.2)  # additional lines may take a moment

    with (
        pytest.raises(PlayerError, match=fragment) as error,
        LinePlayer(program(code), timeout=0.5) as player,
    ):
        play()
    assert player._process.poll() is not None
    assert str(error.value).startswith("player 'python")


def test_a_program_that_never_reads_is_an_error():
    """A program that never reads is an error after the timeout for lines of any length."""
    never = program("import time; time.sleep(60)")
    with (
        pytest.raises(PlayerError, match=r"did not answer within 0\.5"),
        LinePlayer(never, timeout=0.5) as player,
    ):
        player.ask("x" * 10**6)  # more than a pipe holds
    assert player._process.poll() is not None


@pytest.mark.parametrize(
    "then", ["import time; time.sleep(60)", "input(); print('1 1', flush=True)", ""]
)
def test_processes_that_a_program_has_started_end_with_it(tmp_path, then):
    pid = tmp_path / "pid"
    child = (
        "subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'], "
        f"stdout=open({str(pid)!r}, 'w'))"
    )
    code = (
        f"import subprocess, sys\nchild = {child}\nopen({str(pid)!r}, "
        f"'w').write(str(child.pid))\n{then}"
    )
    with suppress(PlayerError), LinePlayer(program(code), timeout=1.5) as player:
        player.ask("{}")
    stat, until = Path("/proc", pid.read_text(), "stat"), time.monotonic() + 5
    while is_alive := stat.exists() and stat.read_text().split()[2] != "Z":
        assert time.monotonic() < until
    assert not is_alive


def test_a_program_does_not_see_keys_of_the_environment(monkeypatch, tmp_path):
    keys = ("HF_TOKEN", "OPENAI_API_KEY", "AWS_SECRET_ACCESS_KEY", "GITHUB_TOKEN", "MY_PASSWORD")
    for key in keys:
        monkeypatch.setenv(key, "secret")
    monkeypatch.setenv("HTTPS_PROXY", "http://me:secret@example.org")
    monkeypatch.setenv("HTTP_PROXY", "http://example.org:3128")
    monkeypatch.setenv("WORDCRAFT_KG_DATA", str(tmp_path))
    code = "import json, os; input(); print(json.dumps(dict(os.environ)), flush=True)"
    with LinePlayer(program(code)) as player:
        seen = json.loads(player.ask("{}"))
    assert "secret" not in str(seen)
    assert seen["PATH"] == os.environ["PATH"]
    assert seen["HTTP_PROXY"] == "http://example.org:3128"
    assert seen["WORDCRAFT_KG_DATA"] == str(tmp_path)


def test_a_json_string_is_an_answer_of_several_lines(games):
    """Quotes around an answer of one line, and a half of a character, are read as before."""
    for written, said in (
        (r'"Let me think.\n1 + 2\nIt may work."', "Let me think.\n1 + 2\nIt may work."),
        ('"1" + "2"', '"1" + "2"'),
        (r'"\ud800 + 2"', "? + 2"),
    ):
        code = f"for _ in open(0): print({written!r}, flush=True)"
        with LinePlayer(f"{shlex.quote(sys.executable)} -c {shlex.quote(code)}") as player:
            assert player.answer(Conversation(games.game())) == said


def test_bytes_outside_utf_8_are_an_invalid_answer(games):
    code = "import os\nwhile True: input(); os.write(1, bytes([255, 254, 10]))"
    with LinePlayer(program(code)) as player:
        talk = let_play(player, games.game(0))
    assert (talk.lost_attempts, talk.game.is_made) == (1, False)


def test_a_command_that_cannot_be_started_is_refused_without_its_arguments():
    with pytest.raises(PlayerError, match="player 'no-such-program' cannot be started") as error:
        LinePlayer("no-such-program --key sk-123")
    assert "sk-123" not in str(error.value)
    for command, timeout, fragment in (
        ("", 1, "is empty"),
        ("a\0", 1, "NUL"),
        ("python 'x", 1, "No closing quotation"),
        ("cat", 0, "0"),
    ):
        with pytest.raises(ConfigError, match=fragment):
            LinePlayer(command, timeout=timeout)


def test_a_player_is_called_after_its_script_and_never_after_an_option(tmp_path):
    script = tmp_path / "mine.py"
    script.touch()
    assert name_of(["python3.11", "-u", str(script), "--key", "sk-123"]) == "mine.py"
    assert name_of(["python", "-m", "mine", "--key=sk-123"]) == "python"
    assert name_of(["/usr/bin/ollama", "run", "sk-123"]) == "ollama"


@pytest.mark.parametrize(
    "script", [pytest.param("line_player.py", marks=pytest.mark.slow), "chat_player.py"]
)
def test_the_examples_play(games, script, chat_server):
    path = Path(__file__).parents[3] / "examples" / script
    arguments = ["small", chat_server] if script == "chat_player.py" else []
    with LinePlayer(shlex.join([sys.executable, str(path), *arguments])) as player:
        assert player.name == script
        for task in range(3):
            talk = let_play(player, games.game(task))
            assert (talk.invalid_actions, talk.game.attempts_left) == (0, 0)


@pytest.mark.parametrize(
    ("address", "says"),
    [
        (
            lambda server: "http://127.0.0.1:9/v1",
            r"no server at http://127\.0\.0\.1:9/v1 \(.*refused",
        ),
        (lambda server: server.removesuffix("/v1"), "answers with HTTP Error 404"),
        (lambda server: "nonsense", "nonsense gives no answer of a chat server"),
    ],
)
def test_the_example_says_in_a_line_that_no_chat_server_answers(chat_server, address, says):
    path = Path(__file__).parents[3] / "examples" / "chat_player.py"
    done = subprocess.run(
        [sys.executable, str(path), "small", address(chat_server)],
        input='{"new": true, "text": "Goal: dough"}\n',
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert re.search(says, done.stderr)
