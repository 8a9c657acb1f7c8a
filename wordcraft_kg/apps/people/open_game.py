"""A person's game in the open-ended world: the file from which it goes on, and its hints."""

import logging
import os
from pathlib import Path
from typing import Literal

from wordcraft_kg.base.artefacts import read_small_file, write_atomically
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.base.records import Count, Hash, Record, as_lines, parse_lines, parse_record
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.graphs.recipe_graph import RecipeGraph


class GameHeader(Record):
    """The first line of a game's file: what it is played on; nothing about the person or the machine."""

    format: Literal["wordcraft-kg open-ended game 1"]
    graph: str
    graph_hash: Hash
    base: tuple[str, ...]
    attempts: Count


class GameMove(Record):
    """A further line: two entities that were combined or, in a hint, named."""

    picks: tuple[str, str]
    is_hint: bool = False


def open_game(path: Path, header: GameHeader) -> list[GameMove]:
    """Begin a game's file, or read the existing one to go on with it; a torn last line is dropped.

    Raises:
        ArtefactError: if the file is not of this kind or damaged.
        GraphMismatchError: if it was played on another graph.
        ConfigError: if it began with another base or number of attempts. The file is unchanged in all these cases.
    """
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, as_lines([header]))
        return []
    data = read_small_file(path)
    whole = data[: data.rfind(b"\n") + 1]
    first, _, rest = whole.partition(b"\n")
    found = parse_record(first, GameHeader, f"{path}, line 1,")
    if found.graph_hash != header.graph_hash:
        raise GraphMismatchError(
            f"'{path}' was played on graph {found.graph_hash[:12]}, and this is {header.graph_hash[:12]}."
        )
    for name in ("base", "attempts"):
        began, wanted = getattr(found, name), getattr(header, name)
        if began != wanted:
            raise ConfigError(f"'{path}' began with `{name}` {began}, and this command has {wanted}.")
    moves = parse_lines(rest, GameMove, f"{path} (after line 1)")
    if len(whole) < len(data):
        logging.getLogger(__name__).warning("%s ended in a torn line, which was dropped.", path)
        os.truncate(path, len(whole))
    return moves


def append_move(path: Path, move: GameMove) -> None:
    """Add a line to a game's file; it is on the disk when this returns."""
    with path.open("ab") as file:
        file.write(as_lines([move])[0].encode())
        file.flush()
        os.fsync(file.fileno())


def productive_pair(graph: RecipeGraph, discovery: Discovery) -> tuple[int, int] | None:
    """Return the pair of known entities that could have been combined first, of those that make something new."""
    place = {entity: number for number, entity in enumerate(discovery.known)}
    pairs = (
        (a, b)
        for (a, b), results in graph.outcomes.items()
        if a in place and b in place and any(result not in place for result in results)
    )
    return min(pairs, key=lambda pair: sorted((place[pair[0]], place[pair[1]]), reverse=True), default=None)
