"""The file of games that were played in words: a header and a line for each, on the disk before the next begins."""

import logging
import os
from pathlib import Path
from typing import TypeVar

import msgspec

from wordcraft_kg.apps.text_agents.records import GamesHeader, PlayedTask, PlayedWorld
from wordcraft_kg.base.artefacts import read_large_file, write_atomically
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.base.records import as_lines, parse_lines, parse_record

Played = TypeVar("Played", PlayedTask, PlayedWorld)


def open_games(path: Path, header: GamesHeader, kind: type[Played]) -> list[Played]:
    """Begin a file, or read the existing one to go on with it; a torn last line is dropped.

    Raises:
        ArtefactError: if the file is not of this kind or damaged.
        GraphMismatchError: if its games were played on another graph or split.
        ConfigError: if they were played by another player or other settings. The file is unchanged in all these cases.
    """
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, as_lines([header]), durable=True)
        return []
    data = read_large_file(path)
    whole = data[: data.rfind(b"\n") + 1]
    first, _, rest = whole.partition(b"\n")
    found = parse_record(first, GamesHeader, f"{path}, line 1,")
    if not rest and found != header:  # nothing was played yet
        write_atomically(path, as_lines([header]), durable=True)
        return []
    _check(path, found, header)
    played = parse_lines(rest, kind, f"{path} (after line 1)")
    if len(whole) < len(data):
        logging.getLogger(__name__).warning(
            "%s ended in a torn line, which was dropped; its game is played again", path
        )
        os.truncate(path, len(whole))
    return played


def read_games(path: Path) -> tuple[GamesHeader, list[PlayedTask] | list[PlayedWorld]]:
    """Read a file without changing it; a torn last line is left out.

    Raises:
        ArtefactError: if it is missing, not of this kind, or damaged.
    """
    data = read_large_file(path)
    first, _, rest = data[: data.rfind(b"\n") + 1].partition(b"\n")
    header, where = parse_record(first, GamesHeader, f"{path}, line 1,"), f"{path} (after line 1)"
    if header.settings.is_open_ended:
        return header, parse_lines(rest, PlayedWorld, where)
    return header, parse_lines(rest, PlayedTask, where)


def append_game(path: Path, played: PlayedTask | PlayedWorld) -> None:
    """Add a line; it is on the disk when this returns."""
    with path.open("ab") as file:
        file.write(as_lines([played])[0].encode())
        file.flush()
        os.fsync(file.fileno())


def _check(path: Path, found: GamesHeader, wanted: GamesHeader) -> None:
    for name in ("graph_hash", "split_hash"):
        began, asked = getattr(found.settings, name), getattr(wanted.settings, name)
        if began != asked:
            raise GraphMismatchError(
                f"'{path}' holds games on a {name.removesuffix('_hash')} with hash {began[:12]}, and this is "
                f"{asked[:12]}. Choose another `out`."
            )
    if found.player != wanted.player:
        raise ConfigError(f"'{path}' holds games of '{found.player}', not of '{wanted.player}'. Choose another `out`.")
    if found.settings.is_open_ended != wanted.settings.is_open_ended:
        what, asked = _played(found), _played(wanted)
        raise ConfigError(f"'{path}' holds games of {what}, and this command plays {asked}. Choose another `out`.")
    for field in msgspec.structs.fields(found.settings):
        began, asked = getattr(found.settings, field.name), getattr(wanted.settings, field.name)
        if began != asked:
            raise ConfigError(
                f"'{path}' holds games with `{field.name}` {_given(began)}, and this command has {_given(asked)}. "
                "Choose another `out`, or give the same settings."
            )


def _played(header: GamesHeader) -> str:
    return "the open-ended world" if header.settings.is_open_ended else "crafting tasks"


def _given(value: object) -> str:
    """Return a setting as a user would write it."""
    if value is None:
        return "none"
    return ",".join(value) if isinstance(value, tuple) else str(value)
