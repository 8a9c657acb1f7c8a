"""Text agents' records: settings, games and results."""

from typing import Any, Literal

from wordcraft_kg.agents.outcomes import Success, TerminationReason
from wordcraft_kg.apps.text_agents.settings import LOOK_UPS, MAX_INVALID, KnowledgeKind
from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.words import prompt_hash
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import TrainedOn
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.tasks import TaskPart

GamesFormat = Literal["wordcraft-kg text games 1"]
RESULT_FILE, GAMES_FILE = "result.json", "games.jsonl"


class PlayedSettings(Record, frozen=True, kw_only=True):
    """Game settings with hashes; results with equal settings are comparable.

    See :class:`~wordcraft_kg.apps.text_agents.settings.EvaluationSettings` for other attributes.

    Attributes:
        part: None in the open-ended world, like depth and distractors.
        base: initial entities in the open-ended world; empty for tasks.
        scorer: the scorer's weights hash.
        kg: the scorer's training triples.
        prompt_hash: prompt hash, see :func:`~wordcraft_kg.envs.words.prompt_hash`.
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

    @property
    def is_open_ended(self) -> bool:
        """Whether the games are in the open-ended world."""
        return self.part is None

    @classmethod
    def of_tasks(cls, world: World, **rules: Any) -> "PlayedSettings":
        """Return the settings for a world's tasks; ``rules`` are all remaining fields."""
        config = world.config
        amounts = {"depth": config.depth, "distractors": config.num_distractors, "attempts": config.attempts}
        return cls._of(world.graph, world.split, part=config.part, **amounts, **rules)

    @classmethod
    def of_world(cls, env: OpenEndedEnv, split: Split, **rules: Any) -> "PlayedSettings":
        """Return the settings for an open-ended world; ``rules`` are all remaining fields."""
        rules |= {"part": None, "depth": None, "distractors": None, "attempts": env.max_attempts}
        return cls._of(env.graph, split, base=env.graph.labels(env.discovery.base), **rules)

    @classmethod
    def _of(cls, graph: RecipeGraph, split: Split, **rules: Any) -> "PlayedSettings":
        if rules.get("knowledge", "none") == "none":
            rules["look_ups"] = 0
        rules = {"prompt_hash": prompt_hash(), **rules}  # a server has more prompts
        return cls(graph=graph.name, graph_hash=graph.hash, split_hash=split.hash, **rules)


class GamesHeader(Record, frozen=True, kw_only=True):
    """First ``games.jsonl`` line, before the games."""

    format: GamesFormat = "wordcraft-kg text games 1"
    player: str
    settings: PlayedSettings


class PlayedTask(Record, frozen=True, kw_only=True):
    """A played task: a ``games.jsonl`` line.

    Attributes:
        task: task index in the part.
        distractor_seed: distractor seed.
        table: initial labels on the table.
        by_plan: whether a plan's last pair made the goal.
        actions: picks until the end.
        last: the last combined pair; None after a lost attempt.
        invalid_actions: invalid messages.
        lost_attempts: attempts lost by invalid messages.
        look_ups: look-ups in the game.
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


class PlayedWorld(Record, frozen=True, kw_only=True):
    """A game in the open-ended world: a ``games.jsonl`` line; see :class:`PlayedTask` for the last four fields.

    Attributes:
        game: game index.
        known_after: known entities after each attempt.
        repeated: attempts with an already tried pair.
    """

    game: Count
    known_after: tuple[Count, ...]
    repeated: Count
    invalid_actions: Count
    lost_attempts: Count
    look_ups: Count
    messages: tuple[str, ...]


class TextResult(Record, frozen=True, kw_only=True):
    """``result.json``: a text agent's figures; see :class:`PlayedTask` for the last three fields.

    Attributes:
        player: player's name, such as a script or language model.
        success: success on tasks; None in the open-ended world.
        outcomes: termination reason shares; empty in the open-ended world.
        known: mean number of known entities by attempts; empty for tasks.
    """

    format: Literal["wordcraft-kg text result 1"] = "wordcraft-kg text result 1"
    player: str
    settings: PlayedSettings
    games: Count
    success: Success | None
    outcomes: dict[TerminationReason, Share]
    known: dict[int, float]
    invalid_actions: Count
    lost_attempts: Count
    look_ups: Count
