"""Resumable evaluation: each finished game is written to disk before the next game starts."""

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
from wordcraft_kg.base.artefacts import dump_json, sha256_of, write_atomically
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.base.progress import steps
from wordcraft_kg.base.records import as_lines, as_values, read_record
from wordcraft_kg.runs.folder import locked

_HASHES = {"graph_hash": "the graph's hash", "split_hash": "the split's hash"}
_Speaker = Callable[[Conversation], Callable[[str], str]]
"""A player: maps a conversation to the function that answers its prompts."""


def play_all(player: str, speak: _Speaker, play: Play, folder: Path) -> TextResult:
    """Evaluate a player in all games, and write games and result to a folder; continue an interrupted evaluation.

    ``speak`` maps a conversation to the function that answers the prompts. Damaged or changed games, or a folder in use
    by another process, are an ArtefactError; for other players or settings see :func:`open_games`.
    """
    path, settings = folder / GAMES_FILE, play.settings
    tasks = chosen_tasks(play.games.world, settings.tasks).tolist() if isinstance(play.games, TaskGames) else [0]
    missing = dict.fromkeys(
        (task, distractor_seed) for distractor_seed in range(settings.distractor_seeds) for task in tasks
    )
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder, "written"):
        if path.is_symlink():
            raise ArtefactError(f"{path} is a link; expected a file. Choose another `out`.")
        played = open_games(path, GamesHeader(player=player, settings=settings))
        for line, one in enumerate(played, 2):
            key = (one.task, one.distractor_seed) if isinstance(one, PlayedTask) else (0, one.game)
            if key not in missing:
                raise ArtefactError(
                    f"{path}, line {line}, is damaged: the game is a duplicate, or not part of the evaluation. "
                    "Remove the line."
                )
            del missing[key]
        if (kept := folder / RESULT_FILE).is_file() and read_record(kept, TextResult).games_hash != sha256_of(path):
            raise ArtefactError(
                f"{path} was changed after {RESULT_FILE} was written. Restore a copy, or play again with --force."
            )
        for task, distractor_seed in steps("playing", missing):
            talk = play.begin(task, distractor_seed)
            played.append(record_of(talk, converse(talk, speak(talk)), distractor_seed))
            append_game(path, played[-1])
        result = msgspec.structs.replace(result_of(player, settings, played), games_hash=sha256_of(path))
        write_atomically(folder / RESULT_FILE, dump_json(as_values(result)))
    return result


def open_games(path: Path, header: GamesHeader) -> list[PlayedTask | PlayedWorld]:
    """Create a games file with this header, or return the games in an existing file without an incomplete last line.

    A damaged file is an ArtefactError, another graph or split a GraphMismatchError, and another player or setting a
    ConfigError. The file is unchanged on errors.
    """
    line = as_lines([header])[0].encode()
    if not path.exists():
        path.touch()
    with path.open("rb") as file:
        start = file.read(len(line))
    if start == line or not line.startswith(start):  # else empty, or killed while the header was written
        kept, played, torn = read_games(path)
        if played or kept == header:
            _check_header(path, kept, header)
            if torn:
                text = "%s ended in a torn line, which was dropped; the game is played again"
                logging.getLogger(__name__).warning(text, path)
                os.truncate(path, path.stat().st_size - len(torn))
            return [*played]
    _write(path, "wb", line)
    return []


def append_game(path: Path, played: PlayedTask | PlayedWorld) -> None:
    """Append the record of a game to a games file and flush to disk; the file is unchanged on an OSError."""
    size = path.stat().st_size
    try:
        _write(path, "ab", as_lines([played])[0].encode())
    except OSError:
        with suppress(OSError):
            os.truncate(path, size)
        raise


def _write(path: Path, mode: str, line: bytes) -> None:
    with path.open(mode) as file:
        file.write(line)
        file.flush()
        os.fsync(file.fileno())


def _check_header(path: Path, kept: GamesHeader, own: GamesHeader) -> None:
    if kept.player != own.player:
        raise ConfigError(
            f"'{path}' holds games by '{kept.player}', and the player is '{own.player}'. Choose another `out`."
        )
    names = [field.name for field in msgspec.structs.fields(kept.settings)]
    for name in sorted(names, key=_HASHES.__contains__, reverse=True):
        before, now = (_given(getattr(header.settings, name)) for header in (kept, own))
        if before != now:
            kind = GraphMismatchError if name in _HASHES else ConfigError
            raise kind(
                f"'{path}' holds games with {_HASHES.get(name, f'`{name}`')} {before}, and this command has {now}. "
                "Choose another `out`, or use the same settings."
            )


def _given(value: object) -> str:
    if value is None:
        return "none"
    return ",".join(value) if isinstance(value, tuple) else str(value)
