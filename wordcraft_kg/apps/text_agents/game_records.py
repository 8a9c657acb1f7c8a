"""Records in the files of text agents: settings, games and results."""

from typing import Any, Literal, Self

from wordcraft_kg.agents.agent_records import TerminationReason
from wordcraft_kg.apps.text_agents.settings import LOOK_UPS, MAX_INVALID, KnowledgeKind
from wordcraft_kg.base.labels import ANSWER_GRAMMAR
from wordcraft_kg.base.records import Count, Hash, Record
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.words import prompt_hash
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import Split, TaskPart, TrainedOn

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

    @classmethod
    def of(cls, world: World | OpenEndedEnv, split: Split, **others: Any) -> Self:
        """Return the settings of tasks or open-ended games.

        Args:
            world: the world of the tasks, or the open-ended environment.
            split: the split of the graph, whose train recipes look-ups know.
            others: further fields, such as ``look_ups``; they win over the fields made here.
        """
        fields: dict[str, Any] = {
            "graph": world.graph.name,
            "graph_hash": world.graph.hash,
            "split_hash": split.hash,
            "prompt_hash": prompt_hash(sets=isinstance(world, World) and world.has_combine),
            "answer_grammar": ANSWER_GRAMMAR,
        }
        if isinstance(world, OpenEndedEnv):
            fields |= {
                "part": None,
                "depth": None,
                "distractors": None,
                "attempts": world.max_attempts,
                "base": world.graph.labels(world.discovery.base),
            }
        else:
            config = world.config
            fields |= {
                "part": config.part,
                "depth": config.depth,
                "distractors": config.num_distractors,
                "attempts": config.attempts,
            }
        # Without a source the number means nothing; equal games have equal settings.
        if others.get("knowledge", "none") == "none":
            others["look_ups"] = 0
        # A server has other prompts, so another hash may be among the others.
        return cls(**(fields | others))


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
