"""The reference pack: results to compare players with, from this package or the literature."""

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
from wordcraft_kg.models.policies.sources import shown_setting

PACK = Path(__file__).parent / "references"
# A later format gets another number, so that an older package refuses the file with a reason.
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
# A value, with the lower and the upper bound of its interval or None for both.
Estimate = tuple[float, float | None, float | None]
TRAINED_WITH = "trained with"
"""Agent setting: distractor count in training."""
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
        """Return the row with results for these columns only, perhaps without any."""
        names = map(str, columns)
        kept = {name: self.figures[name] for name in names if name in self.figures}
        return msgspec.structs.replace(self, figures=kept)

    def shown(self, column: int) -> str:
        """Format the result of a column with its interval, such as ``0.50 [0.45, 0.55]``.

        The text is empty without a result.
        """
        figure = self.figures.get(str(column))
        if figure is None:
            return ""
        # Published values keep their digits: further ones would suggest a precision that they lack.
        if self.origin == "literature":
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
        is_published_success = self.origin == "literature" and measure == "success"
        is_comparable = self.measure == measure and not is_published_success
        return is_comparable and any(map(self.shown, columns))

    @property
    def remark(self) -> str:
        """Remark on the player as text: training settings, number of people, and notes."""
        settings = dict(self.settings)
        # These two are words of a sentence; further settings are name and value.
        steps = settings.pop("steps", "")
        trained_with = settings.pop(TRAINED_WITH, "")
        parts = [
            counted(self.seeds, "seed") if self.seeds else "",
            f"{steps} steps" if steps else "",
            f"trained with {trained_with}" if trained_with else "",
            *(f"{name} {shown_setting(name, value)}" for name, value in settings.items()),
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
        """Return the rows under a condition, with results for ``columns`` if these are given."""
        rows = tuple(row for row in self.rows if row.play == play)
        if columns is None:
            return rows
        wanted = list(columns)
        selected = [row.at(wanted) for row in rows]
        return tuple(row for row in selected if row.figures)


def read_pack(path: Path) -> ReferencePack:
    """Read a file in the reference pack.

    Raises:
        ArtefactError: if the file is missing or damaged, or a row contradicts itself; the message
            names the row.
    """
    pack = read_record(path, ReferencePack)
    for number, row in enumerate(pack.rows, 1):
        wrong = _contradiction(pack, row)
        if wrong:
            raise ArtefactError(
                f"{path} is damaged: row {number}, '{row.player}', {wrong}. Restore a copy."
            )
    return pack


def read_packs(folder: Path = PACK) -> tuple[ReferencePack, ...]:
    """Read all reference files in a folder with :func:`read_pack`, in the order of the names.

    Raises:
        ArtefactError: if a file is damaged, or a row contradicts itself.
    """
    return tuple(read_pack(path) for path in sorted(folder.glob("*.json")))


# Read once a process: several commands and pages look rows up, and the files do not change.
@cache
def _packs() -> tuple[ReferencePack, ...]:
    return read_packs()


def pack_of(graph: Hash, split: Hash | None) -> ReferencePack | None:
    """Return the reference pack for a graph and split; None without one.

    Graph and split are content hashes; None as a split is any split.
    """
    for pack in _packs():
        played = pack.graph
        if played is not None and played.hash == graph and split in (None, played.split):
            return pack
    return None


def literature(measures: Sequence[Measure]) -> tuple[ReferenceRow, ...]:
    """Return the results from the literature that have one of these measures."""
    rows: list[ReferenceRow] = []
    for pack in _packs():
        if pack.graph is None:
            rows += [row for row in pack.rows if row.measure in measures]
    return tuple(rows)


def play_of(tasks: TaskConfig, part: TaskPart) -> TaskPlay | None:
    """Return the condition of agents with these task settings.

    The number of distractors is a column, so any number fits.

    Returns:
        The condition; None for rules that differ from the defaults, which no row of a pack is
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


def metrics_of(
    values: Mapping[int, Estimate], by_plan: Mapping[int, float] | None = None
) -> dict[str, MeasuredValue]:
    """Convert values to results rounded to six digits.

    Args:
        values: value, lower and upper bound, by distractor count or attempt count.
        by_plan: success by the task's own recipes, by distractor count; None if not measured.
    """
    own = by_plan or {}

    def rounded(value: float | None) -> float | None:
        return None if value is None else round(value, 6)

    results = {}
    for column, (value, low, high) in values.items():
        results[str(column)] = MeasuredValue(
            value=round(value, 6),
            low=rounded(low),
            high=rounded(high),
            by_plan=rounded(own.get(column)),
        )
    return results


def _contradiction(pack: ReferencePack, row: ReferenceRow) -> str:
    if pack.graph is None:
        if row.origin != "literature" or not row.environment or row.year is None:
            expected = "a row from the literature with an 'environment' and a 'year'"
            return f"has no graph; expected {expected}"
    elif row.origin != "ours" or row.play is None:
        return "has a graph; expected origin 'ours' and the tasks in 'play'"
    elif (row.measure == "success") != isinstance(row.play, TaskPlay):
        return f"has the measure '{row.measure}', which does not fit its play"
    for column, figure in row.figures.items():
        fault = _fault(row, column, figure)
        if fault:
            return fault
    return ""


def _fault(row: ReferenceRow, column: str, figure: MeasuredValue) -> str:
    ends = [end for end in (figure.low, figure.high) if end is not None]
    own = figure.value if figure.by_plan is None else figure.by_plan
    # ASCII as well, because isdigit() is true for digits of other scripts, which int() reads, too.
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
