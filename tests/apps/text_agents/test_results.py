"""What a server has kept of games that players chose themselves."""

from pathlib import Path

import pytest

from wordcraft_kg.apps.text_agents.conversation import Conversation, converse
from wordcraft_kg.apps.text_agents.games import DiscoveryGames, TaskGames
from wordcraft_kg.apps.text_agents.playing import append_game, open_games
from wordcraft_kg.apps.text_agents.records import GamesHeader, PlayedSettings, PlayedTask
from wordcraft_kg.apps.text_agents.results import read_games_result, record_of, result_of
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph


@pytest.fixture(scope="module")
def games(kitchen: OpenedGraph) -> TaskGames:
    return TaskGames(World(kitchen, WordCraftConfig(part="test", num_distractors=1)))


def played(games: TaskGames, task: int, said: str, draw: int = 0) -> PlayedTask:
    talk = Conversation(games.begin(task, draw))
    return record_of(talk, converse(talk, lambda _: said))


def file_of(path: Path, games: TaskGames, lines: list[PlayedTask]) -> GamesHeader:
    header = GamesHeader(player="MCP clients", settings=PlayedSettings.of_tasks(games.world))
    open_games(path, header)
    for line in lines:
        append_game(path, line)
    return header


def test_all_tasks_make_the_result_and_a_task_counts_as_it_was_played_first(
    kitchen: OpenedGraph, games: TaskGames, tmp_path: Path
):
    path = tmp_path / "games.jsonl"
    lines = [played(games, task, "1 2") for task in reversed(range(len(games.world.tasks)))]
    better = [played(games, one.task, said) for one in lines for said in ("1 3", "2 3")]
    header = file_of(path, games, lines + better)
    before = path.read_bytes() + b'{"torn'
    path.write_bytes(before)
    found = read_games_result(path, kitchen)
    assert found == result_of("MCP clients", header.settings, lines)
    assert 0 < found.success.mean < 1
    assert path.read_bytes() == before


def test_a_figure_over_chosen_tasks_is_refused(kitchen: OpenedGraph, games: TaskGames, tmp_path: Path):
    path = tmp_path / "games.jsonl"
    count = len(games.world.tasks)
    file_of(path, games, [played(games, task, "1 2") for task in range(count)] + [played(games, 0, "1 2", draw=1)])
    with pytest.raises(ConfigError, match=f"holds {count + 1} of the {2 * count} games of its test tasks"):
        read_games_result(path, kitchen)
    with pytest.raises(GraphMismatchError):
        read_games_result(path, open_graph("paper-examples"))


def test_games_in_the_open_ended_world_count_all(kitchen: OpenedGraph, tmp_path: Path):
    path, worlds = tmp_path / "games.jsonl", DiscoveryGames(kitchen, attempts=3)
    settings = PlayedSettings.of_world(worlds.env, kitchen.split)
    open_games(path, GamesHeader(player="MCP clients", settings=settings))
    with pytest.raises(ConfigError, match="holds no game that is over"):
        read_games_result(path, kitchen)
    for number, said in enumerate(("1 2", "2 3")):
        talk = Conversation(worlds.begin())
        append_game(path, record_of(talk, converse(talk, lambda _, said=said: said), number))
    found = read_games_result(path, kitchen)
    assert (found.games, found.settings.draws, found.success) == (2, 2, None)
    assert found.known[3] >= len(settings.base)


def test_such_a_file_stands_beside_the_reference_pack(run, kitchen: OpenedGraph, games: TaskGames, tmp_path: Path):
    path = tmp_path / "games.jsonl"
    file_of(path, games, [played(games, task, "1 2") for task in range(len(games.world.tasks))])
    outcome = run("reference", "kitchen", "--distractors", "1", "--beside", path)
    success = read_games_result(path, kitchen).success
    assert outcome.code == 0, outcome.err
    (line,) = (line for line in outcome.out.splitlines() if "MCP clients" in line)
    assert f"{success.mean:.3f} [{success.ci_low:.3f}, {success.ci_high:.3f}]" in line
