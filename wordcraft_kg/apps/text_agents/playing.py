"""Many games of one player, each on the disk before the next begins, so that an interrupted evaluation goes on."""

import logging
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import msgspec

from wordcraft_kg.apps.text_agents.conversation import Conversation, Play, converse
from wordcraft_kg.apps.text_agents.games import TaskGames
from wordcraft_kg.apps.text_agents.records import (
    GAMES_FILE,
    RESULT_FILE,
    GamesHeader,
    PlayedTask,
    PlayedWorld,
    TextResult,
)
from wordcraft_kg.apps.text_agents.results import chosen_tasks, read_games, record_of, result_of
from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.base.progress import steps
from wordcraft_kg.base.records import as_lines, as_values
from wordcraft_kg.runs.folder import locked

HASHES = {"graph_hash": "the graph's hash", "split_hash": "the split's hash"}
Speaker = Callable[[Conversation], Callable[[str], str]]
"""A player: returns the function that answers the prompts of a conversation."""


def play_all(player: str, speak: Speaker, play: Play, folder: Path) -> TextResult:
    """Let a player play the games that settings ask for, continue a folder's games, and write the result there.

    Args:
        player: name of the player.
        speak: the player.
        play: the games.
        folder: folder of the games and the result.

    Raises:
        ArtefactError: if the folder's games are damaged, or another process plays there.
        ConfigError: if they are of another player or other settings.
        GraphMismatchError: if they are of another graph or split.
    """
    path, settings = folder / GAMES_FILE, play.settings
    tasks = chosen_tasks(play.games.world, settings.tasks).tolist() if isinstance(play.games, TaskGames) else [0]
    missing = dict.fromkeys((task, draw) for draw in range(settings.draws) for task in tasks)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder, "written"):
        played = open_games(path, GamesHeader(player=player, settings=settings))
        for line, one in enumerate(played, 2):
            _check_game(f"{path}, line {line},", one, play, missing)
        for task, draw in steps("playing", missing):
            talk = play.begin(task, draw)
            played.append(record_of(talk, converse(talk, speak(talk)), draw))
            append_game(path, played[-1])
        result = result_of(player, settings, played)
        write_atomically(folder / RESULT_FILE, dump_json(as_values(result)))
    return result


def _check_game(where: str, one: PlayedTask | PlayedWorld, play: Play, missing: dict[tuple[int, int], None]) -> None:
    """Remove a game that was read from the missing ones, and refuse one that cannot be among them."""
    if isinstance(one, PlayedTask):
        name, key = f"task {one.task} with draw {one.draw}", (one.task, one.draw)
    else:
        name, key = f"game {one.game}", (0, one.game)
    wrong = "is there twice, or not asked for"
    if key in missing:
        del missing[key]
        wrong = _contradiction(one, play) if isinstance(one, PlayedTask) else ""
    if wrong:
        raise ArtefactError(
            f"{where} is damaged: {name} {wrong}. Remove the line; what is missing then is played again."
        )


def _contradiction(played: PlayedTask, play: Play) -> str:
    """Return how a game contradicts its task or itself; empty if it does not."""
    assert isinstance(play.games, TaskGames)
    goal = play.games.world.tasks[played.task].goal
    if played.goal != goal:
        return f"is to make {goal}, not {played.goal}"
    if played.success != (played.ending == "goal") or (played.by_plan and not played.success):
        return "was made and not made"
    return ""


def open_games(path: Path, header: GamesHeader) -> list[PlayedTask | PlayedWorld]:
    """Begin a file of games, or read the existing one to continue it; a torn last line is dropped.

    Raises:
        ArtefactError: if the file is of another kind or damaged.
        GraphMismatchError: if its games were played on another graph or split.
        ConfigError: if they were played by another player or with other settings. The file is unchanged on errors.
    """
    if not path.exists() or not path.stat().st_size:
        _write(path, "wb", header)
        return []
    found, played, torn = read_games(path)
    if not played and found != header:
        _write(path, "wb", header)
        return []
    _check_header(path, found, header)
    if torn:
        logging.getLogger(__name__).warning(
            "%s ended in a torn line, which was dropped; its game is played again", path
        )
        os.truncate(path, path.stat().st_size - len(torn))
    return [*played]


def append_game(path: Path, played: PlayedTask | PlayedWorld) -> None:
    """Add a line, which is on the disk when this returns; the file is unchanged on errors.

    Raises:
        OSError: if it cannot be written.
    """
    size = path.stat().st_size
    try:
        _write(path, "ab", played)
    except OSError:
        with suppress(OSError):
            os.truncate(path, size)
        raise


def _write(path: Path, mode: str, record: GamesHeader | PlayedTask | PlayedWorld) -> None:
    with path.open(mode) as file:
        file.write(as_lines([record])[0].encode())
        file.flush()
        os.fsync(file.fileno())


def _check_header(path: Path, found: GamesHeader, wanted: GamesHeader) -> None:
    if found.player != wanted.player:
        raise ConfigError(f"'{path}' holds games of '{found.player}', not of '{wanted.player}'. Choose another `out`.")
    names = [field.name for field in msgspec.structs.fields(found.settings)]
    for name in sorted(names, key=HASHES.__contains__, reverse=True):
        began, asked = (_given(getattr(header.settings, name)) for header in (found, wanted))
        if began != asked:
            kind = GraphMismatchError if name in HASHES else ConfigError
            raise kind(
                f"'{path}' holds games with {HASHES.get(name, f'`{name}`')} {began}, and this command has {asked}. "
                "Choose another `out`, or give the same settings."
            )


def _given(value: object) -> str:
    """Return a setting as a user writes it."""
    if value is None:
        return "none"
    return ",".join(value) if isinstance(value, tuple) else str(value)
