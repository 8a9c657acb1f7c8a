"""What is recorded of players that use words: each game, and the result of many."""

from pathlib import Path
from typing import Any, Literal

from wordcraft_kg.agents.outcomes import Ending, Success
from wordcraft_kg.apps.text_agents.config import LOOK_UPS, REFUSALS, KnowledgeKind
from wordcraft_kg.base.records import Count, Hash, Record, Share, read_record
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.words import texts_hash
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import Taught
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.tasks import TaskPart

GamesFormat = Literal["wordcraft-kg games in words 1"]
RESULT_FILE, GAMES_FILE = "result.json", "games.jsonl"


class WordsSettings(Record, frozen=True, kw_only=True):
    """What a player was asked, and under which rules; results with equal settings can be compared.

    Attributes:
        graph: name of the graph.
        graph_hash: its content hash.
        split_hash: that of its split.
        part: part of the tasks; None in the open-ended world.
        depth: depth of the tasks; None in the open-ended world.
        distractors: distractors on each table; None in the open-ended world.
        attempts: attempts in a game.
        base: what is known at the start of the open-ended world; empty for tasks.
        draws: draws of distractors of each task, or games in the open-ended world.
        tasks: the most tasks that are played, evenly spaced; None for all.
        knowledge: what the player may look up.
        scorer: hash of the weights of the scorer that it asks, if it does.
        kg: what that scorer was trained on.
        look_ups: how often it may in a game.
        refusals: how often in a row a message that is not understood costs nothing.
        texts: hash of what players are told, see :func:`~wordcraft_kg.envs.words.texts_hash`.
    """

    graph: str
    graph_hash: Hash
    split_hash: Hash
    part: TaskPart | None
    depth: Count | None
    distractors: Count | None
    attempts: Count
    base: tuple[str, ...] = ()
    draws: Count = 1
    tasks: Count | None = None
    knowledge: KnowledgeKind = "none"
    scorer: Hash | None = None
    kg: Taught | None = None
    look_ups: Count = LOOK_UPS
    refusals: Count = REFUSALS
    texts: Hash

    @property
    def is_open_ended(self) -> bool:
        """Whether it is the open-ended world."""
        return self.part is None

    @classmethod
    def of_tasks(cls, world: World, **rules: Any) -> "WordsSettings":
        """Return the settings of the tasks of a world; ``rules`` are draws, tasks, knowledge and so on."""
        config = world.config
        return cls._of(
            world.graph,
            world.split,
            part=config.part,
            depth=config.depth,
            distractors=config.num_distractors,
            attempts=config.attempts,
            **rules,
        )

    @classmethod
    def of_world(cls, env: OpenEndedEnv, split: Split, **rules: Any) -> "WordsSettings":
        """Return the settings of the open-ended world of a graph; ``rules`` are draws, knowledge and so on."""
        base = env.graph.labels(env.discovery.base)
        return cls._of(
            env.graph, split, part=None, depth=None, distractors=None, attempts=env.max_attempts, base=base, **rules
        )

    @classmethod
    def _of(cls, graph: RecipeGraph, split: Split, **rules: Any) -> "WordsSettings":
        if rules.get("knowledge", "none") == "none":
            rules["look_ups"] = 0
        rules = {"texts": texts_hash(), **rules}  # other texts may be told besides
        return cls(graph=graph.name, graph_hash=graph.hash, split_hash=split.hash, **rules)


class GamesHeader(Record, frozen=True, kw_only=True):
    """The first line of ``games.jsonl``; the others are games.

    Attributes:
        player: what the player calls itself.
        settings: what it was asked.
    """

    format: GamesFormat = "wordcraft-kg games in words 1"
    player: str
    settings: WordsSettings


class PlayedTask(Record, frozen=True, kw_only=True):
    """A task that was played: a line of ``games.jsonl``.

    Attributes:
        task: number of the task among those of its part.
        draw: number of the draw of distractors.
        goal: what was to be made.
        table: what was on the table at the beginning.
        success: whether it was made.
        by_plan: whether the last pair of a plan made it.
        picks: picks until the end.
        ending: how the game ended.
        last: the last pair that was combined; None if the last attempt was lost.
        refused: messages that were not understood.
        lost: attempts lost by them.
        look_ups: things that were looked up.
        messages: everything that was told and said in turn.
    """

    task: Count
    draw: Count
    goal: str
    table: tuple[str, ...]
    success: bool
    by_plan: bool
    picks: Count
    ending: Ending
    last: tuple[str, str] | None
    refused: Count
    lost: Count
    look_ups: Count
    messages: tuple[str, ...]


class PlayedWorld(Record, frozen=True, kw_only=True):
    """A game in the open-ended world: a line of ``games.jsonl``.

    Attributes:
        game: number of the game.
        known_after: how many entities were known after each attempt.
        repeated: attempts with a pair that had been tried before.
        refused: messages that were not understood.
        lost: attempts lost by them.
        look_ups: things that were looked up.
        messages: everything that was told and said in turn.
    """

    game: Count
    known_after: tuple[Count, ...]
    repeated: Count
    refused: Count
    lost: Count
    look_ups: Count
    messages: tuple[str, ...]


class WordsResult(Record, frozen=True, kw_only=True):
    """``result.json``: how a player that uses words did.

    Attributes:
        player: what the player calls itself, such as its command or a language model's name.
        settings: what it was asked.
        games: number of games.
        success: success on the tasks; None in the open-ended world.
        outcomes: shares of the endings; empty in the open-ended world.
        known: mean number of entities known after some numbers of attempts; empty for tasks.
        refused: messages that were not understood.
        lost: attempts lost by them.
        look_ups: things that were looked up.
    """

    format: Literal["wordcraft-kg words 1"] = "wordcraft-kg words 1"
    player: str
    settings: WordsSettings
    games: Count
    success: Success | None
    outcomes: dict[Ending, Share]
    known: dict[int, float]
    refused: Count
    lost: Count
    look_ups: Count


def read_words_result(folder: Path) -> WordsResult:
    """Read the result of a player that uses words.

    Raises:
        ArtefactError: if it is missing or damaged.
    """
    return read_record(folder / RESULT_FILE, WordsResult)
