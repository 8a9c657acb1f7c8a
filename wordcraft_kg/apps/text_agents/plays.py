"""Games to play, by their settings, by a number, or by a name.

A name such as ``everyday-train-2-8-17-0`` says everything that a game depends on: graph, part,
depth, number of distractors, task and distractor seed. So a game of a data set, of a server and of
a file of conversations is the same game if its name is the same.

The difficulty of the built-in book's tasks was measured by three players. Its file has a line for
each task of the benchmark's splits and depths: the number of tables, out of five with eight
distractors, on which it was solved by nearest words, by a learner after a short training, and by a
planner. ``data/make_difficulty.py`` measures and writes it.
"""

import copy
import csv
import gzip
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.apps.text_agents.conversation import Conversation, Facts, known_recipes
from wordcraft_kg.apps.text_agents.games import DiscoveryGame, Game, TaskGame
from wordcraft_kg.apps.text_agents.settings import (
    ATTEMPTS,
    LOOK_UPS,
    KnowledgeKind,
    LookUps,
    PlayedSettings,
)
from wordcraft_kg.base import (
    MAX_SIZE,
    ConfigError,
    counted,
    number_in,
    whole,
)
from wordcraft_kg.base.labels import ANSWER_GRAMMAR
from wordcraft_kg.envs.draws import EvaluationTables
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.envs.words import prompt_hash
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import MAX_ATTEMPTS, WordCraftConfig
from wordcraft_kg.graphs import MAX_DEPTH, Entity, Ids, OpenedGraph, TaskPart, open_graph

DIFFICULTY_FILE = Path(__file__).parent / "difficulty.csv.gz"
DIFFICULTY_COLUMNS = ("split", "goal", "start", "words", "learner", "planner")
MEASURED_TABLES = 5
"""Tables of a task on which each player was measured."""


def chosen_tasks(
    world: World, limit: int | None, difficulty: tuple[float, float] | None = None
) -> Ids:
    """Return the indices of the tasks to play, shape (T,), ascending.

    Tasks are evenly spaced, because enumerated tasks are sorted by goal: the first ones would be of
    few goals. Nothing is drawn, so all players get the same tasks.

    Args:
        world: the world.
        limit: number of tasks; None for all.
        difficulty: least and largest difficulty of the tasks, see
            :func:`tasks_within`; None for all.

    Raises:
        ConfigError: for a number below 1, or a range of difficulty in which no task was measured.
    """
    tasks = np.arange(len(world.tasks))
    if difficulty is not None:
        tasks = tasks_within(world, difficulty)
    number = len(tasks)
    limit = number if limit is None else min(whole("tasks", limit, 1, MAX_SIZE), number)
    return tasks[np.arange(limit) * number // limit]


def task_keys(world: World) -> Iterator[tuple[str, ...]]:
    """Yield the key of each task in the file: split, goal and starting ingredients, by id."""
    split = world.split.hash[:12]
    for goal, start in zip(world.tasks.goals.tolist(), world.tasks.starts.tolist(), strict=True):
        yield split, str(goal), " ".join(map(str, start))


def measured_success(world: World) -> NDArray[np.float64]:
    """Return the success of words, learner and planner on each task, shape (T, 3), from 0 to 1.

    It is that with eight distractors, whatever the world's number.

    Raises:
        ConfigError: if a task was not measured.
    """
    counts = [_measured().get(key) for key in task_keys(world)]
    if None in counts:
        raise ConfigError(
            f"`difficulty`: {counts.count(None):,} of {len(counts):,} tasks of "
            f"{world.graph.name} were not measured; expected tasks of depth 1 or 2 of everyday, or "
            "of depth 1 of its split by-goal. data/make_difficulty.py measures tasks."
        )
    return np.array(counts) / MEASURED_TABLES


def tasks_within(world: World, limits: tuple[float, float]) -> Ids:
    """Return the indices of the tasks whose difficulty is in a range, ascending.

    The difficulty of a task is the share of games that the three players lose, each counted alike.

    Args:
        world: the world of the tasks.
        limits: least and largest difficulty, from 0 to 1.

    Raises:
        ConfigError: for another range, a task that was not measured, or if no task is left.
    """
    if not isinstance(limits, tuple | list) or len(limits) != 2:
        raise ConfigError(f"`difficulty` {limits!r}: expected two shares such as (.2, .8).")
    low, high = limits
    number_in("difficulty", low, 0, 1, "a share from 0 to 1")
    number_in("difficulty", high, low, 1, f"a share from {low:g} to 1")
    difficulty = 1 - measured_success(world).mean(axis=1)
    tasks = np.flatnonzero((difficulty >= low) & (difficulty <= high))
    if not len(tasks):
        raise ConfigError(f"`difficulty` {low:g}:{high:g} leaves no task; expected a wider range.")
    return tasks


def read_range(text: str | None) -> tuple[float, float] | None:
    """Parse a range of difficulty such as ``.2:.8``; None for none.

    Raises:
        ConfigError: for other text.
    """
    if text is None:
        return None
    low, _, high = text.partition(":")
    try:
        return float(low), float(high)
    except ValueError:
        raise ConfigError(f"`difficulty` '{text}': expected a range such as .2:.8.") from None


@cache
def _measured() -> dict[tuple[str, ...], list[int]]:
    """Return the counts of solved tables by task."""
    with gzip.open(DIFFICULTY_FILE, "rt", encoding="utf-8") as file:
        _, *rows = csv.reader(file)
    return {tuple(row[:3]): list(map(int, row[3:])) for row in rows}


TableOf = Callable[[int, int], list[int]]
"""From a task (index) and a distractor seed to the ids on the starting table, in slot order."""


class Play(ABC):
    """Base class for games with settings and facts to look up; many games may go on at once.

    Attributes:
        settings: settings as recorded with each game.
        has_sets: whether recipes may have other sizes than two.
    """

    _world: World | None = None

    def __init__(
        self,
        opened: OpenedGraph,
        *,
        knowledge: KnowledgeKind = "none",
        scorer: Path | None = None,
        look_ups: int = LOOK_UPS,
        **fields: Any,
    ):
        """Describe the games.

        Args:
            opened: graph and split.
            knowledge: look-up source.
            scorer: model folder, for ``knowledge`` scorer.
            look_ups: look-ups in a game.
            fields: further fields of
                :class:`~wordcraft_kg.apps.text_agents.settings.PlayedSettings`.

        Raises:
            ConfigError: for another look-up source, or a number out of range.
            ArtefactError: if the scorer's folder is unfinished or damaged.
            GraphMismatchError: if the scorer is of another graph or split.
            LeakError: if a scorer would reveal its train recipes on train tasks.
        """
        self._opened = opened
        self._knowledge: Facts = known_recipes
        self.has_sets = not opened.graph.has_pairs_only
        whole("look_ups", look_ups, 0, MAX_SIZE)
        choices = get_args(LookUps) if scorer is None else ("scorer",)
        if knowledge not in choices:
            raise ConfigError(
                f"`knowledge` {knowledge!r:.60} with `scorer` {scorer}: expected scorer with a "
                "model folder, or none or partial without."
            )
        if scorer is not None:
            # Here, because it loads torch.
            from wordcraft_kg.apps.text_agents.likely_links import LikelyLinks, open_scorer

            model = open_scorer(scorer, opened)
            tasks = self._world.tasks if self._world else None
            # A leak found here costs no game.
            self._knowledge = LikelyLinks(model.scorer, opened.graph, tasks)
            fields |= {"scorer": model.run.outputs["model.safetensors"], "kg": model.kg}
        self.settings = PlayedSettings(
            graph=opened.graph.name,
            graph_hash=opened.graph.hash,
            split_hash=opened.split.hash,
            prompt_hash=prompt_hash(sets=self.has_sets),
            answer_grammar=ANSWER_GRAMMAR,
            knowledge=knowledge,
            # Without a source the number means nothing; equal games have equal settings.
            look_ups=0 if knowledge == "none" else look_ups,
            **fields,
        )

    @property
    def world(self) -> World:
        """The world of the tasks; raises ConfigError for open-ended games."""
        if self._world is None:
            raise ConfigError(
                f"the open-ended games of {self.settings.track or self.settings.graph} have "
                "neither tasks nor a reward; expected games on tasks."
            )
        return self._world

    @abstractmethod
    def game(self, task: int = 0, distractor_seed: int = 0) -> Game:
        """Begin a game on a task (index) with the distractors for this seed.

        In the open-ended world the task is ignored, and the seed is the number of the game.

        Raises:
            ConfigError: if there is no such task or seed.
        """

    def begin(self, task: int = 0, distractor_seed: int = 0) -> Conversation:
        """Begin a game as a conversation under its name, see :meth:`game`."""
        rules = self.settings
        game = self.game(task, distractor_seed)
        talk = Conversation(
            game,
            max_invalid=rules.max_invalid,
            look_ups=rules.look_ups,
            knowledge=self._knowledge,
        )
        talk.name = self.name(task, distractor_seed)
        return talk

    def name(self, task: int, distractor_seed: int = 0) -> str:
        """Return a game's name, such as ``everyday-train-2-8-17-0``."""
        rules = self.settings
        # A track numbers its tasks anew: its third task is another than the third of the part.
        games = rules.track or f"{rules.graph}-{rules.part}-{rules.depth}-{rules.distractors}"
        return f"{games}-{task}-{distractor_seed}"


class TaskGames(Play):
    """Games on all tasks in a world.

    Example:
        >>> world = World.open("kitchen", WordCraftConfig(part="test", num_distractors=2))
        >>> game = TaskGames(world).game(task=0)
        >>> len(game.labels), game.goal == world.tasks[0].goal
        (4, True)
    """

    def __init__(self, world: World, *, table: TableOf | None = None, **rules: Any):
        """Take a world.

        Args:
            world: graph, tasks and settings.
            table: the starting tables; None for those of agent evaluation.
            rules: look-ups as in :class:`Play`, and further fields of the played settings.
        """
        self._world = world
        self._env = WordCraftEnv(world)
        self._table = table or EvaluationTables(world).table
        config = world.config
        super().__init__(
            world.opened,
            part=config.part,
            depth=config.depth,
            distractors=config.num_distractors,
            attempts=config.attempts,
            **rules,
        )

    def game(self, task: int = 0, distractor_seed: int = 0) -> TaskGame:  # noqa: D102
        # A shallow copy shares the world, which never changes; `reset` makes the state anew.
        return TaskGame(
            copy.copy(self._env), task, distractor_seed, self._table(task, distractor_seed)
        )


class DiscoveryGames(Play):
    """Open-ended games.

    Attributes:
        discovery: the state in which each game begins.
    """

    def __init__(
        self,
        opened: OpenedGraph,
        *,
        attempts: int | None = None,
        base: Iterable[Entity] | None = None,
        orders: Sequence[tuple[int, ...]] = (),
        **rules: Any,
    ):
        """Take a graph.

        Args:
            opened: the graph and its split.
            attempts: attempts in a game; None for :data:`ATTEMPTS`.
            base: entities (ids or labels) that are known at the start; None for the graph's base.
            orders: for each game of a track the base (ids) in the order in which players see it;
                empty outside of tracks.
            rules: look-ups as in :class:`Play`, and further fields of the played settings.

        Raises:
            ConfigError: for a base from which nothing can be made, or a number out of range.
            GraphError: if a recipe has another number of ingredients than two.
        """
        self.discovery = Discovery(opened.graph, base)
        self._orders = orders
        super().__init__(
            opened,
            part=None,
            depth=None,
            distractors=None,
            attempts=ATTEMPTS if attempts is None else whole("attempts", attempts, 1, MAX_SIZE),
            base=opened.graph.labels(self.discovery.base),
            **rules,
        )

    def game(self, task: int = 0, distractor_seed: int = 0) -> DiscoveryGame:  # noqa: D102
        # The discovery changes with every attempt, so each game has its own.
        discovery = copy.copy(self.discovery)
        if self._orders:
            number = whole("game", distractor_seed, 0, len(self._orders) - 1)
            discovery.base = self._orders[number]
        discovery.restart()
        return DiscoveryGame(self._opened.split, discovery, self.settings.attempts, distractor_seed)


# At most nine digits: a text of digits could be a number of any size.
_SEED = re.compile("[0-9]{1,9}")


def open_play(
    graph: str,
    part: TaskPart,
    depth: int,
    distractors: int,
    attempts: int | None = None,
    reward: str = "sparse",
    knowledge: KnowledgeKind = "none",
    look_ups: int = LOOK_UPS,
    **rules: Any,
) -> TaskGames:
    """Open the games with these settings.

    Args:
        graph: graph folder, recipe book file, or name of a built-in book.
        part: tasks of the split: train, valid, test or all.
        depth: fewest attempts that solve a task.
        distractors: entities on the table that no plan needs.
        attempts: attempts in a game; None for the depth.
        reward: a name in :data:`~wordcraft_kg.envs.world_config.REWARDS`.
        knowledge: what can be looked up.
        look_ups: look-ups in a game.
        rules: the scorer, and further fields of the played settings.

    Returns:
        The games.

    Raises:
        ConfigError: for a value out of range.
        TaskError: if the graph has no task for these settings.
        RecipeFileError: if there is no such graph, or a book cannot be read.
        ArtefactError: if a graph folder or the scorer's folder is damaged.
        GraphMismatchError, LeakError: for a scorer that does not fit, as :class:`Play`.
    """
    whole("depth", depth, 1, MAX_DEPTH)
    whole("distractors", distractors, 0, MAX_SIZE)
    if attempts is not None:
        # With fewer attempts than its depth, a task cannot be solved.
        whole("attempts", attempts, depth, MAX_ATTEMPTS)
    config = WordCraftConfig(part, depth, distractors, attempts, reward)
    return TaskGames(
        World(open_graph(graph), config), knowledge=knowledge, look_ups=look_ups, **rules
    )


def tool_opening(talk: Conversation) -> str:
    """Return the first message to a player with tools: rules, the offer of look-ups, the state."""
    lines = [talk.game.rules, "Use the tool `combine` for each attempt."]
    if talk.offers_look_ups:
        limit = counted(talk.offers_look_ups, "look-up")
        lines.append(f"The tool `look_up` shows known recipes; there are {limit}.")
    return "\n".join([*lines, "", talk.game.state])


class GameList:
    """The games that a server offers: for each part its tasks in order, counted from 0.

    Attributes:
        plays: for each offered part the games, one :class:`Play` for each depth and number of
            distractors. The offered tasks of a part are numbered through all of them.
        is_track: whether the games are of a benchmark's track.

    Example:
        >>> games = GameList({"train": [open_play("kitchen", "train", 1, 2)]})
        >>> play, task = games.at("train", 5)
        >>> play.name(task), games.named("kitchen-train-1-2-5-7")[1:]
        ('kitchen-train-1-2-5-0', (5, 7))
    """

    def __init__(
        self, plays: Mapping[str, Sequence[Play]], difficulty: tuple[float, float] | None = None
    ):
        """Take the games, or those of them whose tasks have a measured difficulty in a range."""
        self.plays = plays
        self.is_track = any(play.settings.track for play in chain.from_iterable(plays.values()))
        self._tasks: dict[str, list[tuple[Play, int]]] = {}
        for part, of_part in plays.items():
            tasks = self._tasks[part] = []
            for play in of_part:
                numbers = chosen_tasks(play.world, None, difficulty).tolist()
                tasks += [(play, task) for task in numbers]
        offered = chain.from_iterable(self._tasks.values())
        self._by_name = {play.name(task): (play, task) for play, task in offered}

    def count(self, part: str) -> int:
        """Return the number of tasks of a part; raises ConfigError for a part that is not there."""
        return len(self._of_part(part))

    def at(self, part: str, index: int) -> tuple[Play, int]:
        """Return the games and the task in them with an index in a part.

        Args:
            part: the part of the tasks.
            index: number of the task in this part, from 0.

        Raises:
            ConfigError: for a part that is not offered, or an index out of range.
        """
        return self._of_part(part)[whole("index", index, 0, self.count(part) - 1)]

    def named(self, name: Any) -> tuple[Play, int, int]:
        """Return the games, the task in them and the distractor seed of a game with a name.

        Raises:
            ConfigError: for another text, or a game that is not offered.
        """
        # The name comes from outside, and errors show its beginning alone.
        task_name, _, seed = name.rpartition("-") if isinstance(name, str) else ("", "", "")
        first_name = f"{task_name}-0"
        if first_name in self._by_name and _SEED.fullmatch(seed):
            return *self._by_name[first_name], int(seed)
        raise ConfigError(
            f"`task_id` {name!r:.60} is no game of this server; expected a graph, a part, a "
            "depth, a number of distractors and a task that it has, such as "
            f"'{next(iter(self._by_name))}'."
        )

    def _of_part(self, part: Any) -> list[tuple[Play, int]]:
        if not isinstance(part, str) or part not in self.plays:
            raise ConfigError(
                f"the part {part!r:.60} is not offered here; expected {', '.join(self.plays)}. "
                "Tasks of another part are for another use: those of the part test measure what "
                "was learned on the part train."
            )
        return self._tasks[part]
