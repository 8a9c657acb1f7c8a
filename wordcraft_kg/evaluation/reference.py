"""Other results to compare with: published ones, and recorded games of people and text agents.

Published results are of this package and of the literature. An app registers a
:class:`GameReader` of its format of games by an entry point in the group
``wordcraft_kg.result_readers``.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from wordcraft_kg.agents.config import TaskConfig
from wordcraft_kg.base.artefacts import what_is
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.base.extras import Registry
from wordcraft_kg.base.records import Count, Hash, Record, read_record
from wordcraft_kg.base.wording import counted
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.tasks import TaskPart

PACK = Path(__file__).parent / "references"
Measure = Literal["success", "entities known", "new combinations"]
"""Share of solved tasks; entities known after n attempts; pairs with a new result in n attempts."""
# As many digits as intervals of a hundred runs and some thousand episodes support.
_DIGITS = {"success": 3, "entities known": 1, "new combinations": 0}


class PlayedGraph(Record, frozen=True):
    """Identity of a recipe graph and its split.

    Attributes:
        name: name of the graph.
        hash: content hash of the graph.
        kind: kind of the split.
        split_seed: seed of the split.
        split: content hash of the split.
    """

    name: str
    hash: Hash
    kind: str
    split_seed: int
    split: Hash

    @classmethod
    def of(cls, opened: OpenedGraph) -> "PlayedGraph":
        """Return the identity of an opened graph and its split."""
        graph = opened.graph
        split = opened.split
        return cls(graph.name, graph.hash, split.config.kind, split.config.seed, split.hash)

    @property
    def in_words(self) -> str:
        """Graph and split as text, with the first digits of the hashes."""
        split = f"{self.kind} split {self.split[:12]}, seed {self.split_seed}"
        return f"{self.name} {self.hash[:12]}, {split}"


class TaskPlay(Record, frozen=True, tag="tasks"):
    """The condition of a result on crafting tasks.

    Other settings are the defaults of :class:`~wordcraft_kg.envs.config.WordCraftConfig`.

    Attributes:
        part: split part with the tasks.
        depth: fewest attempts that solve a task.
        attempts: attempts in an episode.
    """

    part: TaskPart
    depth: Annotated[int, msgspec.Meta(ge=1)]
    attempts: Annotated[int, msgspec.Meta(ge=1)]


class OpenPlay(Record, frozen=True, tag="open-ended"):
    """The condition of a result in open-ended play (without a goal).

    Attributes:
        base: sorted labels of the entities known at the start.
    """

    base: tuple[str, ...]


class MeasuredValue(Record, frozen=True, omit_defaults=True):
    """A measured value.

    Attributes:
        value: the value, in the unit of the row's measure.
        low, high: bounds of the interval; None without an interval.
        by_plan: success by the task's own recipes; None if not measured.
    """

    value: float
    low: float | None = None
    high: float | None = None
    by_plan: float | None = None


class ReferenceRow(Record, frozen=True, kw_only=True, omit_defaults=True):
    """A player's published results under one condition.

    Attributes:
        player: the player's name.
        kind: kind of the player, such as agent or people.
        measure: unit of the results.
        figures: results by distractor count (for success) or attempt count (for open-ended play).
        reference: the command that measured the results, or the publication with its environment.
        play: crafting tasks or open-ended play; None for results from the literature, which are of
            other tasks or games.
        interval: interval level and method, in words; empty without intervals.
        remark: seeds, steps and settings of a training, or other remarks.
    """

    player: str
    kind: str
    measure: Measure
    figures: Annotated[dict[str, MeasuredValue], msgspec.Meta(min_length=1)]
    reference: Annotated[str, msgspec.Meta(min_length=1)]
    play: TaskPlay | OpenPlay | None = None
    interval: str = ""
    remark: str = ""

    def shown(self, column: int) -> str:
        """Format the result of a column with its interval, such as ``0.50 [0.45, 0.55]``.

        The text is empty without a result.
        """
        figure = self.figures.get(str(column))
        if figure is None:
            return ""
        # Published values keep their digits: further ones would suggest a precision that they lack.
        if self.play is None:
            return f"{figure.value:g}"
        digits = _DIGITS[self.measure]
        value = f"{figure.value:.{digits}f}"
        # Bounds are equal where no resample differs, as for an oracle: an interval would say
        # nothing.
        if figure.low is None or figure.high is None or figure.low == figure.high:
            return value
        return f"{value} [{figure.low:.{digits}f}, {figure.high:.{digits}f}]"

    def shown_by_plan(self, column: int) -> str:
        """Format the success by the task's own recipes for a distractor count; empty if unknown."""
        figure = self.figures.get(str(column))
        if figure is None or figure.by_plan is None:
            return ""
        return f"{figure.by_plan:.{_DIGITS['success']}f}"

    @property
    def in_words(self) -> str:
        """All results with their conditions as text, for a table that lacks these columns."""
        parts = []
        for column in map(int, self.figures):
            if self.measure == "success":
                parts.append(f"{self.shown(column)} with {counted(column, 'distractor')}")
            else:
                after = counted(column, "attempt")
                parts.append(f"{self.shown(column)} {self.measure} after {after}")
        return ", ".join(parts)

    def fits(self, measure: Measure, columns: Sequence[int]) -> bool:
        """Return whether a table of ``measure`` with these columns shows a result.

        Published success never fits: its conditions differ in more than the distractors.
        """
        is_published_success = self.play is None and measure == "success"
        is_comparable = self.measure == measure and not is_published_success
        return is_comparable and any(map(self.shown, columns))


class ReferencePack(Record, frozen=True, omit_defaults=True):
    """A file of published results: for a graph and split, or from the literature.

    Attributes:
        format: name and version of the format.
        title: name for readers.
        rows: the results.
        graph: graph and split of the results; None for the literature.
        versions: package versions that measured the results.
    """

    format: Literal["wordcraft-kg references 1"]
    title: str
    rows: tuple[ReferenceRow, ...]
    graph: PlayedGraph | None = None
    versions: dict[str, str] = msgspec.field(default_factory=dict)


# Read once a process: several commands and pages look rows up, and the files do not change.
@cache
def read_packs() -> tuple[ReferencePack, ...]:
    """Read all files of published results, in the order of their names."""
    return tuple(read_record(path, ReferencePack) for path in sorted(PACK.glob("*.json")))


def reference_rows(
    graph: Hash,
    split: Hash | None,
    play: TaskPlay | OpenPlay,
    columns: Iterable[int] | None = None,
) -> tuple[ReferenceRow, ...]:
    """Return the results of this package for a graph and split under a condition.

    Args:
        graph: content hash of the graph.
        split: content hash of the split; None for any split.
        play: crafting tasks or open-ended play.
        columns: distractor or attempt counts of the results; None for all.
    """
    rows = []
    names = None if columns is None else set(map(str, columns))
    for pack in read_packs():
        if pack.graph is None or pack.graph.hash != graph or split not in (None, pack.graph.split):
            continue
        for row in pack.rows:
            figures = {at: row.figures[at] for at in row.figures if names is None or at in names}
            if row.play == play and figures:
                rows.append(msgspec.structs.replace(row, figures=figures))
    return tuple(rows)


def literature(measures: Sequence[Measure]) -> tuple[ReferenceRow, ...]:
    """Return the results from the literature that have one of these measures."""
    rows: list[ReferenceRow] = []
    for pack in read_packs():
        if pack.graph is None:
            rows += [row for row in pack.rows if row.measure in measures]
    return tuple(rows)


def play_of(tasks: TaskConfig, part: TaskPart) -> TaskPlay | None:
    """Return the condition of agents with these task settings.

    The number of distractors is a column, so any number fits.

    Returns:
        The condition; None for rules that differ from the defaults, which no published row is
        about.

    Raises:
        ConfigError: for an unknown part.
    """
    config = tasks.environment(part)
    # Rewards do not matter: success counts goals.
    rules = ("distractor_weighting", "distractor_policy", "ambiguity", "task_weighting")
    for name in rules:
        if getattr(config, name) != getattr(WordCraftConfig, name):
            return None
    return TaskPlay(part, config.depth, config.attempts)


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
    pairs: tuple[tuple[str, ...] | None, ...]
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
