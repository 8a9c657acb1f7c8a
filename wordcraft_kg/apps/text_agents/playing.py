"""Letting a player play many games, each saved as soon as it is over."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from wordcraft_kg.apps.text_agents.conversation import Conversation, converse
from wordcraft_kg.apps.text_agents.evaluation import chosen_tasks, result_of_tasks, result_of_worlds
from wordcraft_kg.apps.text_agents.games import DiscoveryGames, TaskGames
from wordcraft_kg.apps.text_agents.games_file import append_game, open_games
from wordcraft_kg.apps.text_agents.knowledge import Knowledge
from wordcraft_kg.apps.text_agents.played import played_task, played_world
from wordcraft_kg.apps.text_agents.records import (
    GAMES_FILE,
    RESULT_FILE,
    GamesHeader,
    PlayedTask,
    PlayedWorld,
    WordsResult,
    WordsSettings,
)
from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.progress import steps
from wordcraft_kg.base.records import as_values
from wordcraft_kg.runs.folder import locked

Speaker = Callable[[Conversation], Callable[[str], str]]
"""A player: for a conversation at its beginning, what answers to what is told."""


def play_tasks(
    player: str,
    speak: Speaker,
    games: TaskGames,
    settings: WordsSettings,
    folder: Path,
    knowledge: Knowledge | None = None,
) -> WordsResult:
    """Let a player play the tasks that settings name, go on where a folder's games end, and write the result there.

    Args:
        player: what the player calls itself.
        speak: the player.
        games: the tasks.
        settings: draws, number of tasks and rules; those of the world of the games.
        folder: folder of the games and the result.
        knowledge: what the player may look up.

    Raises:
        ArtefactError: if the folder's games are damaged, or another process plays there.
        ConfigError: if they are of another player or other settings.
        GraphMismatchError: if they are of another graph or split.
    """
    path = folder / GAMES_FILE
    tasks = chosen_tasks(games.world, settings.tasks).tolist()
    missing = dict.fromkeys((task, draw) for draw in range(settings.draws) for task in tasks)
    with _alone(folder):
        played = open_games(path, GamesHeader(player=player, settings=settings), PlayedTask)
        for number, one in enumerate(played, 2):
            is_asked = (one.task, one.draw) in missing
            if wrong := _contradiction(one, games) if is_asked else "is there twice, or not asked for":
                raise ArtefactError(
                    f"{path}, line {number}, is damaged: task {one.task} with draw {one.draw} {wrong}. Remove the "
                    "line; what is missing then is played again."
                )
            del missing[one.task, one.draw]
        for task, draw in steps("playing", missing):
            talk = _conversation(games.begin(task, draw), knowledge, settings)
            done = played_task(talk, converse(talk, speak(talk)))
            append_game(path, done)
            played.append(done)
        return _written(folder, result_of_tasks(player, settings, games.world, played))


def play_worlds(
    player: str,
    speak: Speaker,
    games: DiscoveryGames,
    settings: WordsSettings,
    folder: Path,
    knowledge: Knowledge | None = None,
) -> WordsResult:
    """Let a player play the open-ended world ``settings.draws`` times; like :func:`play_tasks`."""
    path = folder / GAMES_FILE
    missing = dict.fromkeys(range(settings.draws))
    with _alone(folder):
        played = open_games(path, GamesHeader(player=player, settings=settings), PlayedWorld)
        for line, one in enumerate(played, 2):
            if one.game not in missing:
                raise ArtefactError(
                    f"{path}, line {line}, is damaged: game {one.game} is there twice, or not asked for. Remove the "
                    "line; what is missing then is played again."
                )
            del missing[one.game]
        for number in steps("playing", missing):
            talk = _conversation(games.begin(), knowledge, settings)
            done = played_world(talk, number, converse(talk, speak(talk)))
            append_game(path, done)
            played.append(done)
        return _written(folder, result_of_worlds(player, settings, played))


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep others from adding games to a folder meanwhile: two that play at once would play the same ones."""
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder, "written"):
        yield


def _contradiction(played: PlayedTask, games: TaskGames) -> str:
    """Say what is wrong with a game that was read, nothing if it can be one of these."""
    goal = games.world.tasks[played.task].goal
    if played.goal != goal:
        return f"is to make {goal}, not {played.goal}"
    if played.success != (played.ending == "goal") or (played.by_plan and not played.success):
        return "was made and not made"
    return ""


def _conversation(game: Any, knowledge: Knowledge | None, settings: WordsSettings) -> Conversation:
    return Conversation(game, knowledge, refusals=settings.refusals, look_ups=settings.look_ups)


def _written(folder: Path, result: WordsResult) -> WordsResult:
    write_atomically(folder / RESULT_FILE, dump_json(as_values(result)))
    return result
