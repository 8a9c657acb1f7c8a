"""The reference pack: published figures of players and agents, of this package and of the literature."""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from wordcraft_kg.agents.config import TaskConfig
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Count, Hash, Record, read_record
from wordcraft_kg.base.wording import counted
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.tasks import TaskPart

PACK = Path(__file__).parent / "references"
"""Folder of the pack."""
FORMAT = "wordcraft-kg references 1"
Kind = Literal["chance", "knowledge graph", "oracle", "agent", "people", "language model", "other"]
"""Kind of a player."""
Measure = Literal["success", "entities known", "new combinations"]
"""Share of solved tasks; entities known after n attempts; pairs with a new result in n attempts."""
Origin = Literal["ours", "literature", "beside"]
"""Measured by this package, taken from a publication, or given by the user."""
Estimate = tuple[float, float | None, float | None]
"""A value, and the ends of its interval."""
TRAINED_WITH = "trained with"
"""Setting of an agent: number of distractors in training."""
_DIGITS = {"success": 3, "entities known": 1, "new combinations": 0}


class PlayedGraph(Record, frozen=True):
    """A graph and its split."""

    name: str
    hash: Hash
    kind: str
    split_seed: int
    split: Hash

    @classmethod
    def of(cls, opened: OpenedGraph) -> "PlayedGraph":
        """Return the record of an opened graph."""
        graph, split = opened.graph, opened.split
        return cls(graph.name, graph.hash, split.config.kind, split.config.seed, split.hash)


class TaskPlay(Record, frozen=True, tag="tasks"):
    """Crafting tasks; other settings are the defaults of :class:`~wordcraft_kg.envs.config.WordCraftConfig`."""

    part: TaskPart
    depth: Annotated[int, msgspec.Meta(ge=1)]
    attempts: Annotated[int, msgspec.Meta(ge=1)]


class OpenPlay(Record, frozen=True, tag="open-ended"):
    """Open-ended play; ``base`` has the labels known at the start, in alphabetical order."""

    base: tuple[str, ...]


class Figure(Record, frozen=True, omit_defaults=True):
    """A value, and the ends of its interval or None."""

    value: float
    low: float | None = None
    high: float | None = None


class ReferenceRow(Record, frozen=True, kw_only=True, omit_defaults=True):
    """The figures of one player under one condition.

    Attributes:
        figures: by distractor count (success) or attempt count (other measures).
        source: command, publication, or folder or file of the user.
        play: None in the literature.
        interval: interval kind; empty without intervals.
        distractor_seeds: distractor draws per task.
        seeds: training count.
        runs: run count of open-ended play.
        settings: player settings by name.
        environment: publication environment, and its differences to this package.
        year: publication year.
        notes: further remarks.
    """

    player: str
    kind: Kind
    measure: Measure
    figures: Annotated[dict[str, Figure], msgspec.Meta(min_length=1)]
    origin: Origin
    source: Annotated[str, msgspec.Meta(min_length=1)]
    play: TaskPlay | OpenPlay | None = None
    interval: str = ""
    tasks: Count | None = None
    distractor_seeds: Count | None = None
    seeds: Count | None = None
    runs: Count | None = None
    people: Count | None = None
    settings: dict[str, str] = msgspec.field(default_factory=dict)
    environment: str = ""
    year: Count | None = None
    notes: str = ""

    def at(self, columns: Iterable[int]) -> "ReferenceRow":
        """Return the row with the figures of these columns only; there may be none."""
        kept = {str(column): self.figures[str(column)] for column in columns if str(column) in self.figures}
        return msgspec.structs.replace(self, figures=kept)

    def shown(self, column: int) -> str:
        """Format the figure of a column with its interval; empty without a figure."""
        figure = self.figures.get(str(column))
        if figure is None:
            return ""
        if self.origin == "literature":  # as printed
            return f"{figure.value:g}"
        digits = _DIGITS[self.measure]
        value = f"{figure.value:.{digits}f}"
        if figure.low is None or figure.high is None or figure.low == figure.high:
            return value
        return f"{value} [{figure.low:.{digits}f}, {figure.high:.{digits}f}]"

    @property
    def in_words(self) -> str:
        """All figures with their conditions, for a table of other columns."""
        figures = {int(column): self.shown(int(column)) for column in self.figures}
        if self.measure == "success":
            return ", ".join(f"{shown} with {counted(column, 'distractor')}" for column, shown in figures.items())
        return ", ".join(f"{shown} {self.measure} after {counted(at, 'attempt')}" for at, shown in figures.items())

    def fits(self, measure: Measure) -> bool:
        """Return whether a table of this measure has columns for the figures; success in the literature has none."""
        return self.measure == measure and (self.origin != "literature" or measure != "success")

    @property
    def remark(self) -> str:
        """Training of an agent, number of people, and notes, for rows of this package and the user."""
        settings = dict(self.settings)
        steps, trained_with = settings.pop("steps", ""), settings.pop(TRAINED_WITH, "")
        parts = [
            counted(self.seeds, "seed") if self.seeds else "",
            f"{steps} steps" if steps else "",
            f"trained with {trained_with}" if trained_with else "",
            *(f"{name} {value}" for name, value in settings.items()),
            counted(self.people, "person", "people") if self.people else "",
            self.notes,
        ]
        return ", ".join(part for part in parts if part)

    @property
    def reference(self) -> str:
        """Source, environment and notes of a publication."""
        environment = f"{self.environment[:1].upper()}{self.environment[1:]}"
        return ". ".join(part for part in (self.source, environment, self.notes) if part)


class ReferencePack(Record, frozen=True, omit_defaults=True):
    """A file of the pack: rows of a graph and split, with package versions, or of the literature (no graph)."""

    format: Literal["wordcraft-kg references 1"]
    title: str
    rows: tuple[ReferenceRow, ...]
    graph: PlayedGraph | None = None
    versions: dict[str, str] = msgspec.field(default_factory=dict)

    def rows_of(self, play: TaskPlay | OpenPlay, columns: Iterable[int] | None = None) -> tuple[ReferenceRow, ...]:
        """Return the rows of a condition, with the figures of ``columns`` only if given."""
        rows = tuple(row for row in self.rows if row.play == play)
        if columns is None:
            return rows
        wanted = list(columns)
        return tuple(kept for row in rows if (kept := row.at(wanted)).figures)


def read_pack(path: Path) -> ReferencePack:
    """Read a file of the pack; ArtefactError for a missing or damaged file or a contradictory row."""
    pack = read_record(path, ReferencePack)
    for number, row in enumerate(pack.rows, 1):
        if wrong := _contradiction(pack, row):
            raise ArtefactError(f"{path} is damaged: row {number}, '{row.player}', {wrong}. Restore a copy.")
    return pack


def read_packs(folder: Path = PACK) -> tuple[ReferencePack, ...]:
    """Read all files of a folder with :func:`read_pack`, in the order of names."""
    return tuple(read_pack(path) for path in sorted(folder.glob("*.json")))


@cache
def _packs() -> tuple[ReferencePack, ...]:
    """Return the files of the package."""
    return read_packs()


def pack_of(graph: Hash, split: Hash | None) -> ReferencePack | None:
    """Return the pack of a graph and split (None: any split), or None."""
    for pack in _packs():
        if pack.graph is not None and pack.graph.hash == graph and split in (None, pack.graph.split):
            return pack
    return None


def literature(measures: Sequence[Measure]) -> tuple[ReferenceRow, ...]:
    """Return the rows of the literature with one of these measures."""
    return tuple(row for pack in _packs() if pack.graph is None for row in pack.rows if row.measure in measures)


def play_of(tasks: TaskConfig, part: TaskPart) -> TaskPlay | None:
    """Return the play of agents with these settings; None for rules other than those of the pack.

    Rewards and the distractor count may differ from the defaults.
    """
    config, usual = tasks.environment(part), WordCraftConfig
    rules = ("distractor_weighting", "distractor_policy", "ambiguity", "task_weighting")
    if any(getattr(config, name) != getattr(usual, name) for name in rules):
        return None
    return TaskPlay(part, config.depth, config.attempts)


def figures_of(values: Mapping[int, Estimate]) -> dict[str, Figure]:
    """Return figures by column, rounded to six digits."""
    return {
        str(column): Figure(round(value, 6), *(None if end is None else round(end, 6) for end in bounds))
        for column, (value, *bounds) in values.items()
    }


def _contradiction(pack: ReferencePack, row: ReferenceRow) -> str:
    """Return the fault of a row, or an empty text."""
    if pack.graph is None:
        if row.origin != "literature" or not row.environment or row.year is None:
            return "is of no graph, so it has to be of the literature, with an 'environment' and a 'year'"
    elif row.origin != "ours" or row.play is None:
        return "is of a graph, so it has to be ours, and to say what was played"
    elif (row.measure == "success") != isinstance(row.play, TaskPlay):
        return f"has the measure '{row.measure}' of another kind of play"
    return next(filter(None, (_fault(row, column, found) for column, found in row.figures.items())), "")


def _fault(row: ReferenceRow, column: str, found: Figure) -> str:
    ends = [end for end in (found.low, found.high) if end is not None]
    if not (column.isascii() and column.isdigit()):
        return f"has the column '{column}', which is not a number"
    if len(ends) == 1 or ends != sorted(ends):
        return f"has at {column} an interval without two ends in their order"
    if ends and not row.interval:
        return f"does not say what the interval at {column} is"
    if row.measure == "success" and not all(0 <= value <= 1 for value in (found.value, *ends)):
        return f"has at {column} a success outside of 0 to 1"
    return ""
