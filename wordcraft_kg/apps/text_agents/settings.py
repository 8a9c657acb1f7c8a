"""Settings for text agents' games; without heavy imports, for the command line."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from wordcraft_kg.base import MAX_SIZE, ConfigError, Count, Hash, Record, whole
from wordcraft_kg.cli.console import Flag, split_labels
from wordcraft_kg.envs.world_config import MAX_ATTEMPTS, WordCraftConfig
from wordcraft_kg.graphs import MAX_DEPTH, TaskPart

LookUps = Literal["none", "partial"]
"""Look-up source: nothing, or the train recipes."""
MAX_INVALID = 3
"""Consecutive invalid messages without cost: a model may correct its form, but not try for ever."""
LOOK_UPS = 10
"""Look-ups in a game."""
TIMEOUT = 60.0
"""Seconds that a program has for an answer."""
ATTEMPTS = 100
"""Attempts in an open-ended game."""


def _labels(kind: Any, tokens: Sequence[Any]) -> list[str]:
    return split_labels([token.value for token in tokens])


@dataclass(frozen=True)
class GameSettings:
    """Games for text agents: tasks or the open-ended world, and the look-up source.

    Attributes:
        part: tasks to play: train, valid, test or all.
        depth: fewest attempts that solve a task, 1 to 5.
        distractors: entities on the table that no plan needs.
        attempts: attempts in a game. Default: depth; 100 in the open-ended world.
        open_ended: discover as many entities as possible from the base, without tasks.
        base: comma-separated initial entities in the open-ended world. Default: the graph's base.
        knowledge: look-up source: none, or partial (train recipes that do not make the goal from
            the table).
        look_ups: look-ups in a game.

    Raises:
        ConfigError: for a value out of range, or incompatible settings.
    """

    part: TaskPart = "test"
    depth: int = WordCraftConfig.depth
    distractors: int = WordCraftConfig.num_distractors
    attempts: int | None = None
    open_ended: Flag = False
    # Split at commas: the parser itself would take the whole text for one label.
    base: Annotated[
        list[str] | None,
        Parameter(negative=(), consume_multiple=False, converter=_labels, accepts_keys=False),
    ] = None
    knowledge: LookUps = "none"
    look_ups: int = LOOK_UPS

    def __post_init__(self) -> None:
        # Checked here, because Python code and Inspect make settings without the command line.
        whole("depth", self.depth, 1, MAX_DEPTH)
        whole("distractors", self.distractors, 0, MAX_SIZE)
        if self.base is not None and not self.open_ended:
            raise ConfigError(f"`base` {','.join(self.base)}: a base needs `open_ended`.")
        if self.open_ended:
            for name in ("part", "depth", "distractors"):
                # The class has the default: another value was given by the user.
                if getattr(self, name) != getattr(type(self), name):
                    raise ConfigError(f"`open_ended` has no tasks; omit `{name}`.")
        if self.attempts is not None:
            # With fewer attempts than its depth, a task cannot be solved.
            fewest = 1 if self.open_ended else self.depth
            max_attempts = MAX_SIZE if self.open_ended else MAX_ATTEMPTS
            whole("attempts", self.attempts, fewest, max_attempts)


class PlayedSettings(Record, frozen=True, kw_only=True):
    """Game settings as recorded with games; results with equal settings are comparable.

    Attributes:
        graph: name of the graph.
        graph_hash: content hash of the graph.
        split_hash: content hash of the split.
        part: part of the tasks; None in the open-ended world.
        depth: fewest attempts that solve a task; None in the open-ended world.
        distractors: entities on each table that no plan needs; None in the open-ended world.
        attempts: attempts in a game.
        base: labels of the entities at the start of open-ended games; empty for tasks.
        distractor_seeds: distractor seeds per task, or number of open-ended games.
        tasks: number of tasks, evenly spaced over the part; None for all.
        knowledge: source of look-ups.
        look_ups: look-ups in a game; 0 without a source.
        max_invalid: consecutive invalid messages without cost.
        prompt_hash: hash of all prompt texts, see :func:`~wordcraft_kg.envs.words.prompt_hash`.
        track: name of a benchmark's track; None if the games are on no track.
        answer_grammar: version of the rules by which answers were read
            (``wordcraft_kg.base.answers``).
    """

    graph: str
    graph_hash: Hash
    split_hash: Hash
    part: TaskPart | None
    depth: Count | None
    distractors: Count | None
    attempts: Count
    base: tuple[str, ...] = ()
    distractor_seeds: Count = 1
    tasks: Count | None = None
    knowledge: LookUps = "none"
    look_ups: Count = LOOK_UPS
    max_invalid: Count = MAX_INVALID
    prompt_hash: Hash
    track: str | None = None
    answer_grammar: Count

    @property
    def is_open_ended(self) -> bool:
        """Whether the games are in the open-ended world."""
        return self.part is None
