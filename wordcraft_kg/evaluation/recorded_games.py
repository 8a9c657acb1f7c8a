"""Recorded games of people and text agents on crafting tasks, in the formats of the apps.

An app registers a :class:`GameReader` by an entry point in the group
``wordcraft_kg.result_readers``.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from wordcraft_kg.base.artefacts import what_is
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.tasks import TaskPart


class TableGame(Record):
    """A player's recorded game on a crafting task, by labels.

    Attributes:
        player: the player's name.
        kind: kind of the player, such as people or language model.
        part: split part with the task.
        depth: fewest attempts that solve the task.
        goal: label of the goal.
        table: entities on the table at the start.
        pairs: combined pairs in turn; None for a lost attempt.
        success: whether the player made the goal.
    """

    player: str
    kind: str
    part: TaskPart
    depth: Count
    goal: str
    table: tuple[str, ...]
    pairs: tuple[tuple[str, str] | None, ...]
    success: bool


@dataclass(frozen=True)
class GameReader:
    """Functions that read recorded games in a certain file format.

    Attributes:
        expected: description of the format, for the error about an unknown path.
        knows: return whether a path, which need not exist, has this format.
        games: return the games on tasks from a path. Raises GraphMismatchError for another graph or
            split, and ArtefactError for a damaged file.
    """

    expected: str
    knows: Callable[[Path], bool]
    games: Callable[[Path, OpenedGraph], Iterable[TableGame]]


READERS: Registry[GameReader] = Registry("wordcraft_kg.result_readers", {})


def read_table_games(opened: OpenedGraph, path: Path) -> tuple[TableGame, ...]:
    """Return recorded games on a graph's tasks.

    Args:
        opened: the graph and its split.
        path: file or folder with the games, of any kind that a reader knows.

    Raises:
        ConfigError: if no reader knows the path, or it has no games on tasks.
        ArtefactError: if it is damaged, or names entities that the graph does not have.
        GraphMismatchError: if the games are of another graph or split.
    """
    readers = list(READERS.values())
    reader = next((reader for reader in readers if reader.knows(path)), None)
    if reader is None:
        expected = ", ".join(reader.expected for reader in readers)
        raise ConfigError(f"'{path}' {what_is(path)}; expected {expected}.")
    games = tuple(reader.games(path, opened))
    if not games:
        raise ConfigError(f"'{path}' has no games on tasks.")
    # The hash in the file may be right and a label still wrong, if the file was edited.
    labels: set[str] = set()
    for game in games:
        labels.update((game.goal, *game.table))
    unknown = labels.difference(opened.graph.entities)
    if unknown:
        raise ArtefactError(
            f"'{path}' is damaged: {opened.graph.name} has no entity '{min(unknown)}'."
        )
    return games


def begins_with(path: Path, form: str) -> bool:
    """Return whether a path is a file that names the format ``form`` in the first line."""
    if not path.is_file():
        return False
    # Bounded: a file of another kind may be a single line of many gigabytes.
    with path.open("rb") as file:
        return form.encode() in file.readline(10_000)


def check_hash(path: Path, name: str, has: str, wanted: str) -> None:
    """Check that results are of the expected graph or split.

    Args:
        path: the results' path, for the error.
        name: graph or split, in words.
        has: hash in the results.
        wanted: hash of the graph or split that the user gave.

    Raises:
        GraphMismatchError: if the hashes differ.
    """
    if has != wanted:
        raise GraphMismatchError(
            f"'{path}' was played on {name} {has[:12]}, but GRAPH has {wanted[:12]}. Use the graph "
            "of the result."
        )
