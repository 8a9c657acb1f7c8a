"""Games by entity labels: a crafting task at an evaluation table, or a game in the open-ended world."""

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence

from wordcraft_kg.base.errors import EpisodeError
from wordcraft_kg.base.settings import whole
from wordcraft_kg.base.wording import counted
from wordcraft_kg.envs.evaluation_tables import EvaluationTables
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.envs.words import PROMPTS, combined, numbered, prompt_text, results_of
from wordcraft_kg.envs.world import GraphLike, World
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph
from wordcraft_kg.graphs.tasks import TaskSet

Pair = tuple[str, str]
Table = Callable[[int, int], list[int]]
"""A function from a task (index) and a distractor seed to the ids on the starting table, in slot order."""


class Game(ABC):
    """Base class for games: an attempt combines two of :attr:`labels`; a lost attempt is None in ``pairs``."""

    goal: str | None = None
    tasks: TaskSet | None = None
    task = -1

    def __init__(self, graph: RecipeGraph, aim: str):
        """Begin a game; ``aim`` is the key for the prompt text about the aim, such as ``goal``."""
        self.graph = graph
        self.rules = f"{prompt_text('rules')} {prompt_text(aim)}"
        self.pairs: list[Pair | None] = []
        self._is_ended = False

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the entities that can be combined, in the order of their numbers."""
        return self.graph.labels(self._entities())

    @property
    @abstractmethod
    def attempts_left(self) -> int:
        """Attempts left, including the current attempt."""

    @property
    def is_over(self) -> bool:
        """Whether no further attempt is possible."""
        return self._is_ended or self._termination() is not None

    @property
    def state(self) -> str:
        """Prompt with the current state; after the end, the outcome."""
        return prompt_text("ended") if self._is_ended else self._termination() or self._ongoing()

    def combine(self, one: int, other: int) -> str:
        """Make an attempt with two entities, by index in :attr:`labels`; describe the result in a sentence."""
        self._check()
        table = self.labels
        self.pairs.append((table[one], table[other]))
        return self._combine(one, other)

    def lose_attempt(self) -> None:
        """Use up an attempt without combining entities."""
        self._check()
        self.pairs.append(None)
        self._lose()

    def end(self) -> None:
        """Give up the game, with or without attempts left."""
        self._is_ended = not self.is_over or self._is_ended

    def _check(self) -> None:
        if self.is_over:
            raise EpisodeError("the game is over; start a new game.")

    @abstractmethod
    def _entities(self) -> Iterable[int]: ...

    @abstractmethod
    def _termination(self) -> str | None: ...

    @abstractmethod
    def _ongoing(self) -> str: ...

    @abstractmethod
    def _combine(self, one: int, other: int) -> str: ...

    @abstractmethod
    def _lose(self) -> None: ...


class TaskGame(Game):
    """A game for a task: make the goal from the labels ``start``; an attempt lost by invalid messages is one action."""

    goal: str
    tasks: TaskSet

    def __init__(self, env: WordCraftEnv, table: Table, task: int, distractor_seed: int):
        """Begin a task with the table for a distractor seed; no other game may use ``env``."""
        super().__init__(env.world.graph, "goal")
        self.tasks, self.task, self.distractor_seed = env.tasks, task, distractor_seed
        self._env = env
        env.reset(options={"task": task, "table": table(task, distractor_seed)})
        self.goal = self.graph.entities[env.state.goal]
        self.start, self.attempts = self.labels, env.world.config.attempts
        self.is_made = self.by_plan = False
        self.actions = 0
        self._tried: set[tuple[str, ...]] = set()

    @property
    def last(self) -> Pair | None:
        """Labels of the last combined pair; None initially and after a lost attempt."""
        return self.pairs[-1] if self.pairs else None

    @property
    def attempts_left(self) -> int:
        """Attempts left, including the current attempt."""
        return self._env.state.attempts_left

    def _entities(self) -> Iterable[int]:
        return self._env.state.table

    def _termination(self) -> str | None:
        if self._env.state.outcome == "in_progress":
            return None
        return prompt_text("goal_made" if self.is_made else "not_made", goal=self.goal)

    def _ongoing(self) -> str:
        return prompt_text(
            "task", goal=self.goal, table=numbered(self.labels), attempts_left=self.attempts_left
        )

    def _combine(self, one: int, other: int) -> str:
        table = self.labels
        pair = table[one], table[other]
        self._env.step(one)
        *_, info = self._env.step(other)
        self.actions += 2
        self.is_made, self.by_plan = info["outcome"] == "goal", info["by_plan"]
        key = tuple(sorted(pair))
        text = combined(pair, results_of(self._env, *pair)) + (
            prompt_text("tried") if key in self._tried else ""
        )
        self._tried.add(key)
        return text

    def _lose(self) -> None:
        self._env.step(len(self._env.state.table))  # picks an empty slot
        self.actions += 1


class TaskGames:
    """A factory for independent games: all tasks in a world, by default with the tables of agent evaluation."""

    def __init__(self, world: World, table: Table | None = None):
        self.world, self.graph = world, world.graph
        self._env, self._table = WordCraftEnv(world), table or EvaluationTables(world).table

    def begin(self, task: int = 0, distractor_seed: int = 0) -> TaskGame:
        """Begin a game on a task (index) with the distractors for this seed; a ConfigError if there is no such task."""
        return TaskGame(copy.copy(self._env), self._table, task, distractor_seed)


class DiscoveryGame(Game):
    """An open-ended game, perhaps with a number in a track; ``known_after`` counts entities by attempt."""

    def __init__(self, env: OpenEndedEnv, number: int | None = None):
        """Begin a game; no other game may use ``env``."""
        super().__init__(env.graph, "discover")
        self.number = number
        self._env = env
        env.reset()
        self.known_after: list[int] = []
        self.repeated = 0

    @property
    def attempts_left(self) -> int:
        """Attempts left, including the current attempt."""
        return self._env.max_attempts - len(self.known_after)

    def _entities(self) -> list[int]:
        return [*self._env.discovery.known]

    def _termination(self) -> str | None:
        if self._env.discovery.is_complete:
            return prompt_text("all_known")
        known = counted(len(self._entities()), "item")
        return None if self.attempts_left else prompt_text("no_attempt_left", known=known)

    def _ongoing(self) -> str:
        table, known = numbered(self.labels), len(self._entities())
        return prompt_text("world", known=known, table=table, attempts_left=self.attempts_left)

    def _combine(self, one: int, other: int) -> str:
        known = self._entities()
        pair = known[one], known[other]
        *_, info = self._env.step([*pair])
        self.known_after.append(len(self._entities()))
        self.repeated += info["repeated"]
        text = combined(
            self.graph.labels(pair), self.graph.labels(info["new_entities"]), PROMPTS["nothing_new"]
        )
        return text + (prompt_text("tried") if info["repeated"] else "")

    def _lose(self) -> None:
        unknown = next(
            entity
            for entity in range(self.graph.num_entities)
            if entity not in self._env.discovery.known
        )
        self._env.step([unknown, unknown])  # an illegal action, which wastes the attempt
        self.known_after.append(len(self._entities()))


class DiscoveryGames:
    """A factory for independent open-ended games, perhaps with the base in a benchmark's ``orders``."""

    def __init__(
        self,
        graph: GraphLike,
        *,
        attempts: int = 100,
        base: Iterable[Entity] | None = None,
        orders: Sequence[tuple[int, ...]] = (),
    ):
        self.env = OpenEndedEnv(graph, max_attempts=attempts, base=base)
        self.graph, self.orders = self.env.graph, orders

    def begin(self, task: int = 0, distractor_seed: int = 0) -> DiscoveryGame:
        """Begin a game; the task is ignored, and the seed is the number of the game in ``orders``, if any."""
        env = copy.copy(self.env)
        env.discovery = copy.copy(self.env.discovery)
        if self.orders:
            env.discovery.base = self.orders[
                whole("game", distractor_seed, 0, len(self.orders) - 1)
            ]
        return DiscoveryGame(env, distractor_seed if self.orders else None)
