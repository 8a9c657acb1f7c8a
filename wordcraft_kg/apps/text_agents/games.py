"""Games by entity labels: a crafting task with a fixed table, or an open-ended game."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Any

from wordcraft_kg.base import ActionError, EpisodeError, counted
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.envs.words import PROMPTS, combined, numbered, prompt_text, results_of
from wordcraft_kg.graphs import Split, TaskSet

Picks = tuple[str, ...]
"""Labels of the combined entities: two, or a set where recipes have other sizes."""


class Game(ABC):
    """Base class for games: an attempt combines two of :attr:`labels`, or more.

    Attributes:
        most_picks: most entities of an attempt, where recipes have other sizes than two; 0 for
            pairs.
        goal: label of the entity to make; None in the open-ended world.
        tasks: the tasks of which this game has one; None in the open-ended world.
        task: index of the game's task; -1 in the open-ended world.
        split: the split of the recipes.
        graph: the recipe graph.
        rules: prompt text with the rules.
        pairs: labels of the combined pairs or sets so far; None for a lost attempt.
        is_made: whether the goal was made.
        by_plan: whether the last pair of one of the task's plans made it.
        reward: sum of the environment's rewards so far: 1 for the goal, and shaped rewards if the
            world has some; 0 in the open-ended world.
    """

    goal: str | None = None
    tasks: TaskSet | None = None
    task = -1
    is_made = False
    by_plan = False
    reward = 0.0
    most_picks = 0

    def __init__(self, split: Split, aim: str):
        """Begin a game; ``aim`` is the key for the prompt text about the aim, such as ``goal``."""
        self.split = split
        self.graph = split.graph
        self.rules = f"{self.text('rules', most=self.most_picks)} {self.text(aim)}"
        self.pairs: list[Picks | None] = []
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
        if self._is_ended:
            return prompt_text("ended")
        return self._termination() or self._ongoing()

    def text(self, name: str, **values: object) -> str:
        """Return a text of the game's prompts."""
        return prompt_text(name, sets=self.most_picks > 0, **values)

    def combine(self, *places: int) -> str:
        """Make an attempt with two entities, or a set, by index in :attr:`labels`.

        Returns:
            A sentence with the result.

        Raises:
            ActionError: for another number of entities than the game takes.
            EpisodeError: if the game is over.
        """
        self._check()
        fewest, most = (1, self.most_picks) if self.most_picks else (2, 2)
        if not fewest <= len(places) <= most:
            expected = f"{fewest} to {most}" if fewest < most else "two"
            raise ActionError(f"{counted(len(places), 'item')}: expected {expected}.")
        # By label, and before the attempt, which may change the numbers.
        self.pairs.append(tuple(map(self.labels.__getitem__, places)))
        return self._combine(*places)

    def lose_attempt(self) -> None:
        """Use up an attempt without combining entities.

        Raises:
            EpisodeError: if the game is over.
        """
        self._check()
        self.pairs.append(None)
        self._lose()

    def end(self) -> None:
        """Give up a game that is not over."""
        self._is_ended = True

    def _check(self) -> None:
        if self.is_over:
            raise EpisodeError("the game is over; start a new game.")

    @abstractmethod
    def _entities(self) -> Iterable[int]:
        """Return the ids of :attr:`labels`."""

    @abstractmethod
    def _termination(self) -> str | None:
        """Return the outcome by the rules as a text; None while an attempt is possible."""

    @abstractmethod
    def _ongoing(self) -> str:
        """Return the prompt with the state before the end."""

    @abstractmethod
    def _combine(self, *places: int) -> str:
        """Make an attempt; return a sentence with the result."""

    @abstractmethod
    def _lose(self) -> None:
        """Use up an attempt."""


class TaskGame(Game):
    """A game on a task: make the goal from the entities on the table.

    Attributes:
        goal: label of the entity to make.
        world: graph, tasks and settings.
        tasks: the world's tasks.
        task: index of the game's task.
        distractor_seed: seed of the distractors on the table.
        start: labels on the table at the start, in slot order.
        actions: number of actions, as agent evaluation counts them: two for an attempt with a pair,
            one for an attempt that was lost by invalid messages.
    """

    goal: str
    tasks: TaskSet

    def __init__(self, env: WordCraftEnv, task: int, distractor_seed: int, table: Iterable[int]):
        """Begin a game.

        Args:
            env: the environment; no other game may use it.
            task: index of the task.
            distractor_seed: seed of the distractors.
            table: ids on the starting table, in slot order.

        Raises:
            ConfigError: if there is no such task.
        """
        if env.world.has_combine:
            self.most_picks = env.world.graph.most_ingredients
        super().__init__(env.world.split, "goal")
        self.world = env.world
        self.tasks = env.tasks
        self.task = task
        self.distractor_seed = distractor_seed
        self._env = env
        env.reset(options={"task": task, "table": table})
        self.goal = self.graph.entities[env.state.goal]
        self.start = self.labels
        self.actions = 0
        self._tried: set[tuple[str, ...]] = set()

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

    def _combine(self, *places: int) -> str:
        pair = tuple(map(self.labels.__getitem__, places))
        # An attempt is an action for each entity, and one to combine a set, unless it is largest.
        combine = (self.world.num_slots - 1,) if 0 < self.most_picks > len(places) else ()
        for action in (*places, *combine):
            info = self._step(action)
        self.is_made = info["outcome"] == "goal"
        self.by_plan = info["by_plan"]
        text = combined(pair, results_of(self.world, *pair))
        # The order of a pair has no meaning.
        key = tuple(sorted(pair))
        if key in self._tried:
            text += prompt_text("tried")
        self._tried.add(key)
        return text

    def _lose(self) -> None:
        # An empty slot ends the attempt with this action, as for an agent that picks one.
        self._step(len(self._env.state.table))

    def _step(self, action: int) -> dict[str, Any]:
        """Take an action of the environment; return what it says about it."""
        _, reward, *_, info = self._env.step(action)
        self.reward += float(reward)
        self.actions += 1
        return info


class DiscoveryGame(Game):
    """A game in the open-ended world: discover as many entities as possible.

    Attributes:
        number: number of the game, from 0.
        known_after: number of known entities after each attempt so far.
    """

    def __init__(self, split: Split, discovery: Discovery, attempts: int, number: int):
        """Begin a game; no other game may use ``discovery``."""
        super().__init__(split, "discover")
        self.number = number
        self._discovery = discovery
        self._attempts = attempts
        self.known_after: list[int] = []

    @property
    def attempts_left(self) -> int:
        """Attempts left, including the current attempt."""
        return self._attempts - len(self.known_after)

    def _entities(self) -> list[int]:
        return [*self._discovery.known]

    def _termination(self) -> str | None:
        if self._discovery.is_complete:
            return prompt_text("all_known")
        count = counted(len(self._entities()), "item")
        return None if self.attempts_left else prompt_text("no_attempt_left", known=count)

    def _ongoing(self) -> str:
        labels = self.labels
        return prompt_text(
            "world", known=len(labels), table=numbered(labels), attempts_left=self.attempts_left
        )

    def _combine(self, *places: int) -> str:
        pair = tuple(map(self._entities().__getitem__, places))
        new_ids, is_repeated = self._discovery.combine(*pair)
        self._lose()
        new_labels = self.graph.labels(new_ids)
        text = combined(self.graph.labels(pair), new_labels, PROMPTS["nothing_new"])
        return text + prompt_text("tried") if is_repeated else text

    def _lose(self) -> None:
        self.known_after.append(len(self._entities()))
