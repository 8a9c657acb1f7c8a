"""Results from the games of an MCP server, whose clients choose their tasks."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from wordcraft_kg.apps.text_agents.conversation import Conversation, converse
from wordcraft_kg.apps.text_agents.games import DiscoveryGames, Game, TaskGames
from wordcraft_kg.apps.text_agents.playing import append_game, open_games
from wordcraft_kg.apps.text_agents.records import GamesHeader, PlayedSettings, PlayedTask, PlayedWorld
from wordcraft_kg.apps.text_agents.results import read_games_result, record_of, result_of
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "games.jsonl"


def play(game: Game, answer: str, number: int = 0) -> PlayedTask | PlayedWorld:
    talk = Conversation(game)
    return record_of(talk, converse(talk, lambda _: answer), number)


def all_tasks(games: TaskGames, *answers: str) -> list[PlayedTask]:
    return [play(games.begin(task), answer) for task in range(len(games.world.tasks)) for answer in answers]


def write(path: Path, settings: PlayedSettings, lines: Sequence[PlayedTask | PlayedWorld]) -> None:
    open_games(path, GamesHeader(player="MCP clients", settings=settings))
    for line in lines:
        append_game(path, line)


def test_all_tasks_make_the_result_and_the_first_game_of_a_task_counts(kitchen: OpenedGraph, games, path: Path):
    lines, settings = all_tasks(games, "1 2")[::-1], PlayedSettings.of_tasks(games.world)
    write(path, settings, lines + all_tasks(games, "1 3", "2 3"))
    before = path.read_bytes() + b'{"torn'
    path.write_bytes(before)
    result = read_games_result(path, kitchen)
    assert result == result_of("MCP clients", settings, lines)
    assert 0 < result.success.mean < 1
    assert path.read_bytes() == before


def test_a_figure_over_selected_tasks_is_refused(kitchen: OpenedGraph, games: TaskGames, path: Path):
    count, settings = len(games.world.tasks), PlayedSettings.of_tasks(games.world)
    write(path, settings, [*all_tasks(games, "1 2"), play(games.begin(0, draw=1), "1 2")])
    with pytest.raises(ConfigError, match=f"holds {count + 1} of the {2 * count} games of its test tasks"):
        read_games_result(path, kitchen)
    with pytest.raises(GraphMismatchError):
        read_games_result(path, open_graph("paper-examples"))


def test_games_in_the_open_ended_world_count_all(kitchen: OpenedGraph, path: Path):
    worlds = DiscoveryGames(kitchen, attempts=3)
    settings = PlayedSettings.of_world(worlds.env, kitchen.split)
    write(path, settings, [])
    with pytest.raises(ConfigError, match="holds no game that is over"):
        read_games_result(path, kitchen)
    write(path, settings, [play(worlds.begin(), answer, number) for number, answer in enumerate(("1 2", "2 3"))])
    result = read_games_result(path, kitchen)
    assert (result.games, result.settings.draws, result.success) == (2, 2, None)
    assert result.known[3] >= len(settings.base)


def test_a_file_of_games_is_a_row_of_the_reference_table(run, kitchen: OpenedGraph, games: TaskGames, path: Path):
    write(path, PlayedSettings.of_tasks(games.world), all_tasks(games, "1 2"))
    outcome = run("reference", "kitchen", "--distractors", "3", "--beside", path)
    success = read_games_result(path, kitchen).success
    assert outcome.code == 0, outcome.err
    (line,) = (line for line in outcome.out.splitlines() if "MCP clients" in line)
    assert f"{success.mean:.3f} [{success.ci_low:.3f}, {success.ci_high:.3f}]" in line
