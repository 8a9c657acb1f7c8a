"""Programs that play by the line protocol, good and bad ones."""

import json
import shlex
import sys
import time
from pathlib import Path

import pytest

from wordcraft_kg.apps.text_agents.conversation import Conversation, converse
from wordcraft_kg.apps.text_agents.games import DiscoveryGames, Game, TaskGames
from wordcraft_kg.apps.text_agents.line_player import MOST_CHARACTERS, LinePlayer, name_of
from wordcraft_kg.base.errors import ConfigError, PlayerError
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World

ORACLE = """
import json, sys
from wordcraft_kg.graphs.library import open_book
makes = {}
for a, b, result in open_book("kitchen").recipes:
    makes.setdefault(result, []).append((a, b))
for line in sys.stdin:
    told = json.loads(line)
    pair = next(pair for pair in makes[told["goal"]] if {*pair} <= {*told["table"]})
    print(*pair, sep=" + ", flush=True)
"""


def program(code: str) -> str:
    return f"{shlex.quote(sys.executable)} -c {shlex.quote(code)}"


@pytest.fixture(scope="module")
def games() -> TaskGames:
    return TaskGames(World("kitchen", WordCraftConfig(part="test", num_distractors=3)))


def let_play(player: LinePlayer, game: Game, **rules: int) -> Conversation:
    talk = Conversation(game, **rules)
    converse(talk, player.speaker(talk))
    return talk


def test_a_program_plays_game_after_game_in_one_process(games: TaskGames):
    with LinePlayer(program(ORACLE)) as player:
        for task in range(10):
            talk = let_play(player, games.begin(task))
            assert (talk.game.is_made, talk.refused) == (True, 0)


def test_a_line_holds_all_that_a_program_needs(games: TaskGames, tmp_path: Path):
    heard = tmp_path / "heard"
    echo = f"import sys\nfor line in sys.stdin: open({str(heard)!r}, 'a').write(line); print('1 1', flush=True)"
    with LinePlayer(program(echo)) as player:
        for game in (games.begin(0), games.begin(1), DiscoveryGames("kitchen", attempts=2).begin()):
            let_play(player, game, refusals=0)
    first, second, third, fourth = map(json.loads, heard.read_text(encoding="utf-8").splitlines())
    assert first == {
        "game": 1,
        "new": True,
        "text": Conversation(games.begin(0)).opening,
        "goal": games.begin(0).goal,
        "table": list(games.begin(0).labels),
        "attempts_left": 1,
    }
    assert [line["game"] for line in (second, third, fourth)] == [2, 3, 3]
    assert [line["new"] for line in (second, third, fourth)] == [True, True, False]
    assert (third["goal"], third["attempts_left"], fourth["attempts_left"]) == (None, 2, 1)
    assert " -> " in fourth["text"]


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("import time; time.sleep(60)", "did not answer within 0.5 seconds"),
        ("import sys; sys.stdin.read()", "did not answer within 0.5 seconds"),
        ("import sys; sys.exit(3)", "has ended with exit code 3 before the last game was over"),
        ("input()", "has ended before the last game was over"),
        ("import sys; input(); print('x' * 10**7)", f"a line of more than {MOST_CHARACTERS:,} bytes"),
        ("import os\nos.write(1, bytes(10**6))", f"a line of more than {MOST_CHARACTERS:,} bytes"),
        ("while True: print('1 1', flush=True)", "wrote more lines than it was asked for"),
        ("while True: input(); print('1 1'); print('1 1', flush=True)", "wrote more lines than it was asked for"),
    ],
)
def test_a_program_that_does_not_keep_to_the_protocol_is_told_what_is_expected(games: TaskGames, code: str, said: str):
    def play() -> None:
        for task in range(3):
            let_play(player, games.begin(task))
            time.sleep(0.2)  # what was written too much may take a moment

    with pytest.raises(PlayerError, match=said) as error, LinePlayer(program(code), timeout=0.5) as player:
        play()
    assert player._process.poll() is not None
    assert str(error.value).startswith("player 'python")


def test_a_program_that_never_reads_is_told_after_the_time_however_long_a_line_is():
    never = program("import time; time.sleep(60)")
    with pytest.raises(PlayerError, match=r"did not answer within 0\.5"), LinePlayer(never, timeout=0.5) as player:
        player.ask("x" * 10**6)  # more than a pipe holds
    assert player._process.poll() is not None


def test_bytes_that_are_no_text_are_an_answer_that_is_not_understood(games: TaskGames):
    code = "import os\nwhile True: input(); os.write(1, bytes([255, 254, 10]))"
    with LinePlayer(program(code)) as player:
        talk = let_play(player, games.begin(0))
    assert (talk.lost, talk.game.is_made) == (1, False)


def test_a_command_that_cannot_be_started_is_refused_without_its_arguments():
    with pytest.raises(PlayerError, match="player 'no-such-program' cannot be started") as error:
        LinePlayer("no-such-program --key sk-123")
    assert "sk-123" not in str(error.value)
    for command, said in (("", "is empty"), ("python 'x", "No closing quotation")):
        with pytest.raises(ConfigError, match=said):
            LinePlayer(command)
    with pytest.raises(ConfigError, match="timeout"):
        LinePlayer("cat", timeout=0)


def test_a_player_is_called_after_its_script_and_never_after_an_option(tmp_path: Path):
    script = tmp_path / "mine.py"
    script.touch()
    assert name_of(["python3.11", "-u", str(script), "--key", "sk-123"]) == "mine.py"
    assert name_of(["python", "-m", "mine", "--key=sk-123"]) == "python"
    assert name_of(["/usr/bin/ollama", "run", "sk-123"]) == "ollama"


@pytest.mark.parametrize("script", ["line_player.py", "chat_player.py"])
def test_the_examples_play(games: TaskGames, script: str, chat_server: str):
    path = Path(__file__).parents[3] / "examples" / script
    arguments = ["small", chat_server] if script == "chat_player.py" else []
    with LinePlayer(shlex.join([sys.executable, str(path), *arguments])) as player:
        assert player.name == script
        for task in range(3):
            talk = let_play(player, games.begin(task))
            assert (talk.refused, talk.game.attempts_left) == (0, 0)
