"""Games in words: a task at a table of the evaluation, or the open-ended world, each played by labels."""

import copy
from collections.abc import Iterable
from typing import Protocol

from wordcraft_kg.base.errors import EpisodeError
from wordcraft_kg.envs.evaluation_tables import EvaluationTables
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.envs.words import combined, numbered, results_of, told
from wordcraft_kg.envs.world import GraphLike, World
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph
from wordcraft_kg.graphs.tasks import TaskSet


class Game(Protocol):
    """A game that can be played in words. An attempt is given by places in :attr:`labels`.

    Attributes:
        graph: the recipe graph.
        task: number of the game's task among :attr:`tasks`.
    """

    graph: RecipeGraph
    task: int

    @property
    def tasks(self) -> TaskSet | None:
        """The tasks that the game's task is one of; None in the open-ended world, which has none."""
        ...

    @property
    def rules(self) -> str:
        """What is played, in words."""
        ...

    @property
    def labels(self) -> tuple[str, ...]:
        """What can be combined, in the order of its numbers."""
        ...

    @property
    def attempts_left(self) -> int:
        """Attempts left, the current one included."""
        ...

    @property
    def is_over(self) -> bool:
        """Whether no further attempt is possible."""
        ...

    @property
    def state(self) -> str:
        """The state in words; once the game is over, how it ended."""
        ...

    def combine(self, one: int, other: int) -> str:
        """Make an attempt; return in words what came of it.

        Raises:
            EpisodeError: if the game is over.
        """
        ...

    def lose_attempt(self) -> None:
        """Use an attempt up for nothing.

        Raises:
            EpisodeError: if the game is over.
        """
        ...

    def end(self) -> None:
        """Give the game up, whatever attempts are left."""
        ...


class TaskGame:
    """A crafting task at one of the evaluation's tables.

    Attributes:
        graph: the recipe graph.
        tasks: the tasks of the world.
        task: number of the task among them.
        draw: number of the draw of distractors.
        goal: what is to be made.
        start: what is on the table at the beginning.
        is_made: whether the goal was made.
        by_plan: whether the last pair of one of the task's plans made it.
        picks: picks so far, as the evaluation of agents counts them.
        last: the last pair that was combined, None before the first and after a lost attempt.
    """

    def __init__(self, env: WordCraftEnv, tables: EvaluationTables, task: int, draw: int):
        """Begin a game; ``env`` is its own from now on."""
        self.graph = env.world.graph
        self.tasks, self.task, self.draw = env.tasks, task, draw
        self._env = env
        self._observation, _ = env.reset(options={"task": task, "table": tables.table(task, draw)})
        self.goal = self.graph.entities[env.state.goal]
        self.start = self.labels
        self.is_made = self.by_plan = self._is_ended = False
        self.picks = 0
        self.last: tuple[str, str] | None = None
        self._tried: set[tuple[str, ...]] = set()

    @property
    def rules(self) -> str:
        """What is played, in words."""
        return told("rules") + " " + told("goal")

    @property
    def labels(self) -> tuple[str, ...]:
        """What is on the table, slot by slot."""
        return self.graph.labels(self._env.state.table)

    @property
    def attempts_left(self) -> int:
        """Attempts left, the current one included."""
        return self._env.state.attempts_left

    @property
    def is_over(self) -> bool:
        """Whether the goal was made, no attempt is left, or the game was given up."""
        return self._is_ended or self._env.state.outcome != "in_progress"

    @property
    def state(self) -> str:
        """Goal, table and attempts left; once the game is over, how it ended."""
        if not self.is_over:
            return told("task", goal=self.goal, table=numbered(self.labels), attempts_left=self.attempts_left)
        return told("ended" if self._is_ended else "goal_made" if self.is_made else "not_made", goal=self.goal)

    def combine(self, one: int, other: int) -> str:
        """Make an attempt; return in words what came of it.

        Raises:
            EpisodeError: if the game is over.
        """
        self._check()
        table = self.labels
        pair = table[one], table[other]
        self._env.step(one)
        *_, info = self._env.step(other)
        self.picks += 2
        self.last = pair
        self.is_made, self.by_plan = info["outcome"] == "goal", info["by_plan"]
        key = tuple(sorted(pair))
        text = combined(pair, results_of(self._env, *pair)) + (told("tried") if key in self._tried else "")
        self._tried.add(key)
        return text

    def lose_attempt(self) -> None:
        """Use an attempt up for nothing, as picking an empty slot does.

        Raises:
            EpisodeError: if the game is over.
        """
        self._check()
        self._env.step(len(self._env.state.table))
        self.picks += 1
        self.last = None

    def end(self) -> None:
        """Give the game up, whatever attempts are left."""
        self._is_ended = not self.is_over or self._is_ended

    def _check(self) -> None:
        if self.is_over:
            raise EpisodeError("the game is over; begin another one.")


class TaskGames:
    """The tasks of a world as games, each at the tables at which agents are evaluated; many may go on at once.

    Attributes:
        world: graph, tasks and settings.

    Example:
        >>> games = TaskGames(World("kitchen", WordCraftConfig(part="test", num_distractors=2)))
        >>> game = games.begin(task=0)
        >>> len(game.labels), game.goal == games.world.tasks[0].goal
        (4, True)
    """

    def __init__(self, world: World):
        """Take a world; what all games share is prepared once."""
        self.world = world
        self._env, self._tables = WordCraftEnv(world), EvaluationTables(world)

    def begin(self, task: int, draw: int = 0) -> TaskGame:
        """Begin a game.

        Args:
            task: number of the task among those of the world.
            draw: number of the draw of distractors.

        Raises:
            ConfigError: if there is no such task or draw.
        """
        return TaskGame(copy.copy(self._env), self._tables, task, draw)


class DiscoveryGame:
    """A game in the open-ended world.

    Attributes:
        graph: the recipe graph.
        known_after: how many entities were known after each attempt so far.
        repeated: attempts with a pair that had been tried before.
    """

    tasks, task = None, -1

    def __init__(self, env: OpenEndedEnv):
        """Begin a game; ``env`` is its own from now on."""
        self.graph, self._env = env.graph, env
        env.reset()
        self.known_after: list[int] = []
        self.repeated = 0
        self._left, self._is_ended = env.max_attempts, False

    @property
    def rules(self) -> str:
        """What is played, in words."""
        return told("rules") + " " + told("discover")

    @property
    def labels(self) -> tuple[str, ...]:
        """What is known, in the order of discovery."""
        return self.graph.labels(self._env.discovery.known)

    @property
    def attempts_left(self) -> int:
        """Attempts left, the current one included."""
        return self._left

    @property
    def is_over(self) -> bool:
        """Whether everything is known, no attempt is left, or the game was given up."""
        return self._is_ended or not self._left or self._env.discovery.is_complete

    @property
    def state(self) -> str:
        """What is known, and the attempts left; once the game is over, how it ended."""
        known = len(self._env.discovery.known)
        if self._is_ended:
            return told("ended")
        if self._env.discovery.is_complete:
            return told("all_known")
        if not self._left:
            return told("no_attempt_left", known=known)
        return told("world", known=known, table=numbered(self.labels), attempts_left=self._left)

    def combine(self, one: int, other: int) -> str:
        """Make an attempt; return in words what came of it.

        Raises:
            EpisodeError: if the game is over.
        """
        self._check()
        known = [*self._env.discovery.known]
        *_, info = self._env.step([known[one], known[other]])
        self._count()
        self.repeated += info["repeated"]
        pair = self.graph.labels((known[one], known[other]))
        text = combined(pair, self.graph.labels(info["new_entities"]), "nothing new")
        return text + (told("tried") if info["repeated"] else "")

    def lose_attempt(self) -> None:
        """Use an attempt up for nothing.

        Raises:
            EpisodeError: if the game is over.
        """
        self._check()
        unknown = next(entity for entity in range(self.graph.num_entities) if entity not in self._env.discovery.known)
        self._env.step([unknown, unknown])  # which an environment that wastes illegal actions does not make
        self._count()

    def end(self) -> None:
        """Give the game up, whatever attempts are left."""
        self._is_ended = not self.is_over or self._is_ended

    def _count(self) -> None:
        self._left -= 1
        self.known_after.append(len(self._env.discovery.known))

    def _check(self) -> None:
        if self.is_over:
            raise EpisodeError("the game is over; begin another one.")


class DiscoveryGames:
    """Games in the open-ended world of one graph, which is the same for all; many may go on at once.

    Attributes:
        env: what a game begins from.
    """

    def __init__(self, graph: GraphLike, *, attempts: int = 100, base: Iterable[Entity] | None = None):
        """Open the graph; what all games share is prepared once.

        Raises:
            ConfigError: for a value out of range, or a base from which nothing can be made.
        """
        self.env = OpenEndedEnv(graph, max_attempts=attempts, base=base)

    def begin(self) -> DiscoveryGame:
        """Begin a game."""
        env = copy.copy(self.env)
        env.discovery = copy.copy(self.env.discovery)
        return DiscoveryGame(env)
