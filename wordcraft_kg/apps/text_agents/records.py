"""Records in the files of text agents: settings, games and results."""

from typing import Any, Literal, Self

from wordcraft_kg.agents.outcomes import Success, TerminationReason
from wordcraft_kg.apps.text_agents.settings import LOOK_UPS, MAX_INVALID, KnowledgeKind
from wordcraft_kg.base.labels import ANSWER_GRAMMAR
from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.words import prompt_hash
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import TrainedOn
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.tasks import TaskPart

GamesFormat = Literal["wordcraft-kg text games 1"]
GAMES_FILE = "games.jsonl"


class PlayedSettings(Record, frozen=True, kw_only=True):
    """Game settings as recorded with games, including hashes; results with equal settings are comparable.

    See :class:`~wordcraft_kg.apps.text_agents.settings.EvaluationSettings` for other attributes.

    Attributes:
        part: None in the open-ended world, like depth and distractors.
        prompt_hash: hash of all prompt texts, see :func:`~wordcraft_kg.envs.words.prompt_hash`.
        track: name of a benchmark's track, if the games are on its tasks.
        answer_grammar: version of the rules by which answers were read (``wordcraft_kg.base.answers``); 1 in files of
            earlier versions and on frozen tracks.
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
    answer_grammar: Count = 1

    @property
    def is_open_ended(self) -> bool:
        """Whether the games are in the open-ended world."""
        return self.part is None

    @classmethod
    def of(cls, world: World | OpenEndedEnv, split: Split, **others: Any) -> Self:
        """Return the settings of tasks or open-ended games; ``others`` are further fields, such as ``look_ups``."""
        own: dict[str, Any] = {"part": None, "depth": None, "distractors": None}
        if isinstance(world, OpenEndedEnv):
            own |= {
                "attempts": world.max_attempts,
                "base": world.graph.labels(world.discovery.base),
            }
        else:
            config = world.config
            own = {
                "part": config.part,
                "depth": config.depth,
                "distractors": config.num_distractors,
            }
            own["attempts"] = config.attempts
        if others.get("knowledge", "none") == "none":
            others["look_ups"] = 0
        hashes = {
            "graph_hash": world.graph.hash,
            "split_hash": split.hash,
            "prompt_hash": prompt_hash(),
        }
        return cls(
            **{
                "graph": world.graph.name,
                "answer_grammar": ANSWER_GRAMMAR,
                **hashes,
                **own,
                **others,
            }
        )  # a server has another prompt hash


class GamesHeader(Record, frozen=True, kw_only=True):
    """The first line in a ``games.jsonl`` file, before the games: file format, player and settings."""

    format: GamesFormat = "wordcraft-kg text games 1"
    player: str
    settings: PlayedSettings


class PlayedTask(Record, frozen=True, kw_only=True):
    """A finished game on a crafting task: a line in ``games.jsonl``.

    Attributes:
        table: labels on the table at the start.
        by_plan: whether a plan's last pair made the goal.
        actions: number of actions (choices of an entity) until the end.
        last: labels of the last combined pair; None after a lost attempt.
        pairs: labels of all combined pairs in turn, None for a lost attempt; empty in files of earlier versions.
        invalid_actions, lost_attempts: numbers of invalid messages, and of attempts lost by them.
        messages: all prompts and answers in turn.
    """

    task: Count
    distractor_seed: Count
    goal: str
    table: tuple[str, ...]
    success: bool
    by_plan: bool
    actions: Count
    termination: TerminationReason
    last: tuple[str, str] | None
    invalid_actions: Count
    lost_attempts: Count
    look_ups: Count
    messages: tuple[str, ...]
    pairs: tuple[tuple[str, str] | None, ...] = ()


class PlayedWorld(Record, frozen=True, kw_only=True):
    """A finished open-ended game: a line in ``games.jsonl``; for the last fields see :class:`PlayedTask`."""

    game: Count
    known_after: tuple[Count, ...]
    repeated: Count
    invalid_actions: Count
    lost_attempts: Count
    look_ups: Count
    messages: tuple[str, ...]
    pairs: tuple[tuple[str, str] | None, ...] = ()


class TextResult(Record, frozen=True, kw_only=True):
    """Metrics over all games: on tasks ``success``, in the open-ended world mean known entities by attempts."""

    player: str
    settings: PlayedSettings
    games: Count
    success: Success | None
    outcomes: dict[TerminationReason, Share]
    known: dict[Count, float]
    invalid_actions: Count
    lost_attempts: Count
    look_ups: Count
