"""The reference pack: published results to compare players and agents with, from this package or the literature."""

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
FORMAT = "wordcraft-kg references 1"
Kind = Literal[
    "chance",
    "words",
    "knowledge graph",
    "scorer",
    "oracle",
    "agent",
    "people",
    "language model",
    "other",
]
Measure = Literal["success", "entities known", "new combinations"]
"""Share of solved tasks; entities known after n attempts; pairs with a new result in n attempts."""
Origin = Literal["ours", "literature", "external"]
"""Measured by this package, taken from a publication, or given by the user."""
Estimate = tuple[float, float | None, float | None]
TRAINED_WITH = "trained with"
"""Agent setting: distractor count in training."""
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
        graph, split = opened.graph, opened.split
        return cls(graph.name, graph.hash, split.config.kind, split.config.seed, split.hash)


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
    """A player's results under one condition: a row in a comparison table.

    Attributes:
        player: the player's name.
        kind: kind of the player.
        measure: unit of the results.
        figures: results by distractor count (for success) or attempt count (for open-ended play).
        origin: measured by this package, taken from a publication, or given by the user.
        source: a command, a publication, or the user's folder or file.
        play: crafting tasks or open-ended play; None for results from the literature.
        interval: interval level and method, in words; empty without intervals.
        tasks: number of tasks; None if not recorded.
        distractor_seeds: tables per task, with different random distractors; None if not recorded.
        seeds: number of training runs; None for players without training.
        runs: number of runs in open-ended play; None on tasks.
        people: number of people; None for other players.
        settings: settings that the results depend on, by name.
        environment: of the literature: the environment, and how this package differs.
        year: of the literature: year of the publication.
        notes: further remarks.
    """

    player: str
    kind: Kind
    measure: Measure
    figures: Annotated[dict[str, MeasuredValue], msgspec.Meta(min_length=1)]
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
        """Return the row with results for these distractor counts (or attempts) only, perhaps without any."""
        kept = {
            str(column): self.figures[str(column)]
            for column in columns
            if str(column) in self.figures
        }
        return msgspec.structs.replace(self, figures=kept)

    def shown(self, column: int) -> str:
        """Format a cell by its column: result and interval, such as ``0.50 [0.45, 0.55]``; empty without a result."""
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

    def shown_by_plan(self, column: int) -> str:
        """Format the success by the task's own recipe for a distractor count; empty if not measured."""
        figure = self.figures.get(str(column))
        return (
            ""
            if figure is None or figure.by_plan is None
            else f"{figure.by_plan:.{_DIGITS['success']}f}"
        )

    @property
    def in_words(self) -> str:
        """All results with their conditions as text, for a table that lacks columns for these results."""
        figures = {int(column): self.shown(int(column)) for column in self.figures}
        if self.measure == "success":
            return ", ".join(
                f"{shown} with {counted(column, 'distractor')}" for column, shown in figures.items()
            )
        return ", ".join(
            f"{shown} {self.measure} after {counted(at, 'attempt')}"
            for at, shown in figures.items()
        )

    def fits(self, measure: Measure, columns: Sequence[int]) -> bool:
        """Return whether a table of ``measure`` with these columns shows a result; published success never fits."""
        is_comparable = self.measure == measure and (
            self.origin != "literature" or measure != "success"
        )
        return is_comparable and any(map(self.shown, columns))

    @property
    def remark(self) -> str:
        """Remark on the player as text: training settings, number of people, and notes."""
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
        """Citation as text: a publication's source, environment and notes."""
        environment = f"{self.environment[:1].upper()}{self.environment[1:]}"
        return ". ".join(part for part in (self.source, environment, self.notes) if part)


class ReferencePack(Record, frozen=True, omit_defaults=True):
    """A file in the reference pack: results for a graph and split, or results from the literature.

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

    def rows_of(
        self, play: TaskPlay | OpenPlay, columns: Iterable[int] | None = None
    ) -> tuple[ReferenceRow, ...]:
        """Return the results under a condition; ``columns`` selects distractor counts (or attempts) if given."""
        rows = tuple(row for row in self.rows if row.play == play)
        if columns is None:
            return rows
        wanted = list(columns)
        return tuple(kept for row in rows if (kept := row.at(wanted)).figures)


def read_pack(path: Path) -> ReferencePack:
    """Read a file in the reference pack.

    Raises:
        ArtefactError: if the file is missing or damaged, or a row contradicts itself; the message
            names the row.
    """
    pack = read_record(path, ReferencePack)
    for number, row in enumerate(pack.rows, 1):
        if wrong := _contradiction(pack, row):
            raise ArtefactError(
                f"{path} is damaged: row {number}, '{row.player}', {wrong}. Restore a copy."
            )
    return pack


def read_packs(folder: Path = PACK) -> tuple[ReferencePack, ...]:
    """Read all reference files in a folder with :func:`read_pack`, in the order of the file names."""
    return tuple(read_pack(path) for path in sorted(folder.glob("*.json")))


@cache
def _packs() -> tuple[ReferencePack, ...]:
    return read_packs()


def pack_of(graph: Hash, split: Hash | None) -> ReferencePack | None:
    """Return the published results for a graph and split, given by content hash (None: any split), or None."""
    for pack in _packs():
        if (
            pack.graph is not None
            and pack.graph.hash == graph
            and split in (None, pack.graph.split)
        ):
            return pack
    return None


def literature(measures: Sequence[Measure]) -> tuple[ReferenceRow, ...]:
    """Return the results from the literature that have one of these measures."""
    return tuple(
        row
        for pack in _packs()
        if pack.graph is None
        for row in pack.rows
        if row.measure in measures
    )


def play_of(tasks: TaskConfig, part: TaskPart) -> TaskPlay | None:
    """Return the condition of agents with these task settings.

    The number of distractors is a column, so any number fits.

    Returns:
        The condition; None for rules that differ from the defaults, which no row of a pack is
        about.
    """
    config, usual = tasks.environment(part), WordCraftConfig
    rules = ("distractor_weighting", "distractor_policy", "ambiguity", "task_weighting")
    if any(getattr(config, name) != getattr(usual, name) for name in rules):
        return None
    return TaskPlay(part, config.depth, config.attempts)


def figures_of(
    values: Mapping[int, Estimate], by_plan: Mapping[int, float] | None = None
) -> dict[str, MeasuredValue]:
    """Convert values with bounds, by distractor count (or attempts), to results rounded to six digits."""
    own = by_plan or {}

    def rounded(value: float | None) -> float | None:
        return None if value is None else round(value, 6)

    return {
        str(column): MeasuredValue(
            round(value, 6), rounded(low), rounded(high), rounded(own.get(column))
        )
        for column, (value, low, high) in values.items()
    }


def _contradiction(pack: ReferencePack, row: ReferenceRow) -> str:
    if pack.graph is None:
        if row.origin != "literature" or not row.environment or row.year is None:
            return "has no graph; expected a row from the literature with an 'environment' and a 'year'"
    elif row.origin != "ours" or row.play is None:
        return "has a graph; expected origin 'ours' and the tasks in 'play'"
    elif (row.measure == "success") != isinstance(row.play, TaskPlay):
        return f"has the measure '{row.measure}', which does not fit its play"
    return next(
        filter(None, (_fault(row, column, figure) for column, figure in row.figures.items())), ""
    )


def _fault(row: ReferenceRow, column: str, figure: MeasuredValue) -> str:
    ends = [end for end in (figure.low, figure.high) if end is not None]
    own = figure.value if figure.by_plan is None else figure.by_plan
    if not (column.isascii() and column.isdigit()):
        return f"has the column '{column}', which is not a number"
    if len(ends) == 1 or ends != sorted(ends):
        return f"has an interval without two ordered ends at {column}"
    if ends and not row.interval:
        return f"has no interval kind for the interval at {column}"
    if row.measure == "success" and not all(0 <= value <= 1 for value in (figure.value, *ends)):
        return f"has a success outside 0 to 1 at {column}"
    if not 0 <= own <= figure.value:
        return f"has more success by its own recipes than in all at {column}"
    return ""
