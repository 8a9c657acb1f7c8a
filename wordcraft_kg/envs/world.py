"""The world behind an environment: tasks, outcomes, distractors and sizes."""

from collections.abc import Callable, Hashable, Mapping
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.graphs.arrays import Ids, frozen, padded
from wordcraft_kg.graphs.folder import OpenedGraph, default_split, open_graph
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.task_search import PlanSearch, make_tasks
from wordcraft_kg.graphs.tasks import TaskSet

GraphLike = str | Path | RecipeGraph | OpenedGraph
"""A graph folder, a book's file or name, a graph (with the default split) or an opened graph."""
SHORTCUT_TRIES = 1_000
_T = TypeVar("_T")


def open_world_graph(graph: GraphLike) -> OpenedGraph:
    """Open a graph with the split, for an environment."""
    if isinstance(graph, OpenedGraph):
        return graph
    if isinstance(graph, RecipeGraph):
        return OpenedGraph(graph, default_split(graph), graph.name)
    if not isinstance(graph, str | Path):
        raise ConfigError(
            f"`graph` {graph!r}: expected a graph folder, a book's file or name, a RecipeGraph or an OpenedGraph."
        )
    return open_graph(graph)


def _derived_from(*settings: str) -> Callable[[Callable[["World"], _T]], _T]:
    """Declare a property that depends only on these settings, computed once for all variants with equal values."""

    def declare(make: Callable[["World"], _T]) -> Any:
        def get(world: "World") -> Any:
            key = (make.__name__, *(getattr(world.config, name) for name in settings))
            if key not in world._derived:
                world._derived[key] = make(world)
            return world._derived[key]

        return property(get, doc=make.__doc__)

    return declare


_TASKS = ("part", "depth", "task_weighting", "num_tasks", "task_seed")


class World:
    """A recipe graph, a split and environment settings, with the tasks and look-up tables derived from them; immutable.

    Variants of a world share everything that the changed settings do not affect. All recipes of the graph apply in
    every part.

    Attributes:
        nothing: the id for an empty slot or no selection, equal to the number of entities.
        max_results: largest number of results of a pair.
        max_distractors: largest number of distractors that the graph's entities allow for every task.
        num_slots: table size: starting ingredients, distractors, and room for all results of all attempts.

    Example:
        >>> world = World("kitchen", WordCraftConfig(num_distractors=8))
        >>> world.variant(part="test").graph is world.graph
        True
    """

    def __init__(
        self, graph: "GraphLike | World", config: WordCraftConfig, tasks: TaskSet | None = None
    ):
        """Open the graph, or share another world's graph; make the tasks (TaskError if there is none) unless given."""
        opened = graph if isinstance(graph, World) else open_world_graph(graph)
        self.graph: RecipeGraph = opened.graph
        self.split: Split = opened.split
        self._derived: dict[Hashable, Any] = graph._derived if isinstance(graph, World) else {}
        self.config = config
        if tasks is not None:
            self._derived[("tasks", *(getattr(config, name) for name in _TASKS))] = tasks
        self.nothing = self.graph.num_entities
        self.max_results = (
            1 if config.ambiguity == "last" else int(np.diff(self.graph.pair_starts).max(initial=1))
        )
        self.num_slots = (
            config.depth + 1 + config.num_distractors + self.max_results * config.attempts
        )
        # Never distractors: the goal, the starting ingredients and the intermediates of the plans.
        needed = (
            np.concatenate([self.tasks.starts, self.tasks.intermediates], axis=1) != self.nothing
        )
        reserved = 1 + int(needed.sum(axis=1).max())
        self.max_distractors = self.nothing - reserved
        if config.distractor_policy == "no_train_shortcut" and self.split.is_in("train").all():
            raise ConfigError(
                f"`distractor_policy` 'no_train_shortcut': {self.graph.name} has no split, so all recipes are train "
                "recipes; give a graph with a split (`build-graph`), or `distractor_policy` no_shortcut."
            )
        if config.num_distractors > self.max_distractors:
            raise ConfigError(
                f"`num_distractors` {config.num_distractors}: {self.graph.name} has {self.nothing} entities, of which "
                f"a task needs up to {reserved}; expected at most {self.max_distractors}."
            )

    @classmethod
    def of(cls, graph: "GraphLike | World", settings: Mapping[str, Any]) -> "World":
        """Return the given world, or a new world; settings next to a given world raise a :class:`ConfigError`."""
        if not isinstance(graph, World):
            return cls(graph, WordCraftConfig.of(settings))
        if settings:
            given = ", ".join(f"{name}={value!r}" for name, value in settings.items())
            raise ConfigError(
                f"a world has its own settings; pass world.variant({given}) and no settings."
            )
        return graph

    def variant(self, **changes: Any) -> "World":
        """Return a world with the same graph and some changed settings."""
        return World(self, self.config.variant(**changes))

    def __deepcopy__(self, memo: dict[int, Any]) -> "World":
        return self  # gymnasium copies the arguments of an environment whenever its spec is read

    @_derived_from()
    def search(self) -> PlanSearch:
        """The graph's :class:`~wordcraft_kg.graphs.task_search.PlanSearch`."""
        return PlanSearch(self.graph)

    @_derived_from("distractor_policy")
    def shortcut_search(self) -> PlanSearch:
        """The search for ways that no distractor may open: by all recipes, or by train recipes."""
        by_train = self.config.distractor_policy == "no_train_shortcut"
        return PlanSearch(self.graph, self.split.is_in("train")) if by_train else self.search

    @_derived_from(*_TASKS)
    def tasks(self) -> TaskSet:
        """The tasks from which episodes are drawn."""
        config = self.config
        return make_tasks(
            self.graph,
            config.depth,
            None if config.part == "all" else self.split,
            config.part,
            weighting=config.task_weighting,
            limit=config.num_tasks,
            seed=config.task_seed,
            search=self.search,
        )

    @_derived_from(*_TASKS)
    def groups(self) -> Ids:
        """Each task's resampling group, shape (N,), see :meth:`~wordcraft_kg.graphs.tasks.TaskSet.groups_in`."""
        return self.tasks.groups_in(self.split)

    @_derived_from("ambiguity")
    def outcomes(self) -> Mapping[tuple[int, int], tuple[int, ...]]:
        """Results by pair of ids ``(a, b)`` with ``a <= b``, ascending."""
        outcomes = self.graph.outcomes
        if self.config.ambiguity == "last":
            return {pair: results[-1:] for pair, results in outcomes.items()}
        return outcomes

    @_derived_from("distractor_weighting")
    def distractor_weights(self) -> Ids:
        """Each entity's weight as a distractor, shape (E,), int64."""
        weights = np.ones(self.nothing, dtype=np.int64)
        if self.config.distractor_weighting == "use":
            a, b, _ = self.split.recipes("train").T
            users = np.concatenate([a, b[b != a]])
            weights += np.bincount(users, minlength=self.nothing)
        return frozen(weights)

    @_derived_from("distractor_policy", "part")
    def guarded_recipes(self) -> NDArray[np.bool_]:
        """A mask of guarded recipes: no distractor may complete one that makes the goal. Shape (num_recipes,).

        With the policy ``no_shortcut`` all recipes are guarded, with ``no_train_shortcut`` the train recipes. In the
        train part the held-out recipes are always guarded, so that training never shows a test pair with the goal.
        """
        in_train = self.split.is_in("train")
        guarded = {
            "any": np.zeros_like(in_train),
            "no_shortcut": np.ones_like(in_train),
            "no_train_shortcut": in_train,
        }
        by_policy = guarded[self.config.distractor_policy]
        return by_policy | ~in_train if self.config.part == "train" else by_policy

    @_derived_from(*_TASKS, "attempts", "ambiguity", "distractor_policy")
    def makeable(self) -> Ids:
        """Ids makeable from N tasks before the last attempt, padded; empty without :attr:`guarded_recipes`."""
        rows: list[list[int]] = []
        outcomes = self.outcomes
        for start in (
            self.tasks.starts.tolist() if self.guarded_recipes.any() else [[]] * len(self.tasks)
        ):
            at_hand = {entity for entity in start if entity < self.nothing}
            made: set[int] = set()
            for _ in range(self.config.attempts - 1):
                pairs = combinations_with_replacement(sorted(at_hand | made), 2)
                more = (
                    {result for pair in pairs for result in outcomes.get(pair, ())} - at_hand - made
                )
                if not more:
                    break
                made |= more
            rows.append(sorted(made))
        return frozen(padded(rows, self.nothing))

    def has_shortcut(self, task: int, distractors: list[int]) -> bool:
        """Return whether distractors (ids) open a further way to a task's goal, as the distractor policy counts."""
        start = frozenset(
            entity for entity in self.tasks.starts[task].tolist() if entity < self.nothing
        )
        goal, attempts, search = (
            int(self.tasks.goals[task]),
            self.config.attempts,
            self.shortcut_search,
        )
        return search.ways(goal, start.union(distractors), attempts) != search.ways(
            goal, start, attempts
        )

    def check_tries(self, tries: int, task: int) -> None:
        """Raise a ConfigError after too many samples of distractors that open an additional way to the goal."""
        if tries > SHORTCUT_TRIES:
            raise ConfigError(
                f"`num_distractors` {self.config.num_distractors}: found no distractors without a shortcut to "
                f"'{self.graph.entities[self.tasks.goals[task]]}' in {SHORTCUT_TRIES} tries; "
                "take fewer, or `distractor_policy` any."
            )
