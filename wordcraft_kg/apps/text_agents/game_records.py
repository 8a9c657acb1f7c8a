"""Records in the files of text agents: settings, games and results."""

from typing import Literal

from wordcraft_kg.agents.agent_records import TerminationReason
from wordcraft_kg.apps.text_agents.settings import LOOK_UPS, MAX_INVALID, KnowledgeKind
from wordcraft_kg.base.records import Count, Hash, Record
from wordcraft_kg.graphs import TaskPart, TrainedOn

GamesFormat = Literal["wordcraft-kg text games 2"]
GAMES_FILE = "games.jsonl"


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


class GamesHeader(Record, frozen=True, kw_only=True):
    """The first line in a ``games.jsonl`` file, before the games.

    Attributes:
        format: format of the file.
        player: the player's name, such as a program's or a language model's.
        settings: settings of all games in the file.
    """

    format: GamesFormat = "wordcraft-kg text games 2"
    player: str
    settings: PlayedSettings


class GameRecord(Record, frozen=True, kw_only=True):
    """A finished game: a line in ``games.jsonl``.

    Attributes:
        task: index of the task in its part; 0 in the open-ended world.
        distractor_seed: seed of the distractors on the table, or number of the open-ended game.
        goal: label of the entity to make; None in the open-ended world.
        table: labels at the start, in slot order; empty in the open-ended world.
        success: whether the goal was made.
        by_plan: whether a plan's last pair made the goal.
        actions: number of actions (choices of an entity) in a task until the end.
        termination: how a game on a task ended, as agent evaluation says it.
        known_after: number of known entities after each attempt in the open-ended world.
        repeated: number of attempts there with a pair that had been tried before.
        invalid_actions: number of messages that were not understood.
        lost_attempts: number of attempts lost by them.
        look_ups: number of entities that were looked up.
        messages: all prompts and answers in turn; empty in Inspect's logs, which have their own.
        pairs: labels of all combined pairs or sets in turn, None for a lost attempt.
    """

    task: Count = 0
    distractor_seed: Count = 0
    goal: str | None = None
    table: tuple[str, ...] = ()
    success: bool = False
    by_plan: bool = False
    actions: Count = 0
    termination: TerminationReason | None = None
    known_after: tuple[Count, ...] = ()
    repeated: Count = 0
    invalid_actions: Count = 0
    lost_attempts: Count = 0
    look_ups: Count = 0
    messages: tuple[str, ...] = ()
    pairs: tuple[tuple[str, ...] | None, ...]
