"""Settings of text agents' games; without heavy imports, for the command line."""

from typing import Literal

from wordcraft_kg.base import Count, Hash, Record
from wordcraft_kg.graphs import TaskPart, TrainedOn

LookUps = Literal["none", "partial"]
"""Look-up source: nothing, or the train recipes."""
KnowledgeKind = Literal["none", "partial", "scorer"]
"""Look-up source outside of the benchmark: these, or a trained scorer's best links."""
MAX_INVALID = 3
"""Consecutive invalid messages without cost: a model may correct its form, but not try for ever."""
LOOK_UPS = 10
"""Look-ups in a game."""
TIMEOUT = 60.0
"""Seconds that a program has for an answer."""
ATTEMPTS = 100
"""Attempts in an open-ended game."""


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
        scorer: hash of the weights of the scorer that answers look-ups; None without one.
        kg: training triples of this scorer (full or partial); None without one.
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
    knowledge: KnowledgeKind = "none"
    scorer: Hash | None = None
    kg: TrainedOn | None = None
    look_ups: Count = LOOK_UPS
    max_invalid: Count = MAX_INVALID
    prompt_hash: Hash
    track: str | None = None
    answer_grammar: Count

    @property
    def is_open_ended(self) -> bool:
        """Whether the games are in the open-ended world."""
        return self.part is None
