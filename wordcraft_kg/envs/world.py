"""The world behind an environment: tasks, outcomes of pairs, distractors and sizes.

Environments, engines and evaluations share it, so that all play the same game.
"""

from collections.abc import Callable, Hashable, Iterable, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.graphs import (
    Entity,
    GraphLike,
    Ids,
    OpenedGraph,
    RecipeGraph,
    Split,
    TaskSet,
    frozen,
    make_tasks,
    open_graph,
)
from wordcraft_kg.graphs.recipe_graph import outcomes_of
from wordcraft_kg.graphs.tasks import SolutionSearch

_T = TypeVar("_T")


def _derived_from(*settings: str) -> Callable[[Callable[["World"], _T]], _T]:
    """Declare a property of a world that depends only on its recipes and these settings.

    It is computed once for all variants with equal values, when first read.
    """

    def declare(make: Callable[["World"], _T]) -> Any:
        def get(world: "World") -> Any:
            values = (getattr(world.config, name) for name in settings)
            return world.shared((make.__name__, *values), lambda: make(world))

        return property(get, doc=make.__doc__)

    return declare


_TASKS = ("part", "depth", "num_tasks", "task_seed")


class World:
    """A recipe graph, a split and environment settings, and all that follows from them; immutable.

    The world of the part ``train`` is that of the train recipes alone: tasks, tables and results
    are the same whatever the held-out recipes make. A held-out pair makes nothing there, or what
    train recipes make of it, and stands on tables as often as any pair: kept off, it would be told
    by its absence (docs/explanation/leaks.md). All other parts have all recipes.

    Engines, environments, evaluators and reports take a world instead of building one. Variants of
    a world share everything that the changed settings do not affect, such as tasks and look-up
    tables.

    Attributes:
        opened: the graph and the split, with the source.
        graph: the recipe graph; :attr:`usable` recipes make something.
        split: train, valid and test recipes.
        config: the settings.
        nothing: the id for an empty slot or no selection, equal to the number of entities.
        max_results: largest number of results of a pair.
        max_distractors: largest number of distractors that the graph's entities allow for every
            task.
        num_given: entities on each starting table, whatever the task: the starting ingredients of
            the largest plan, and the distractors.
        has_combine: whether recipes may have other sizes than two, so that the last action is to
            combine the selected entities.
        num_entity_slots: slots for entities, fixed: ``num_given``, and room for all results of all
            attempts.
        num_slots: number of actions: slots for entities, and one more to combine.

    Example:
        >>> world = World.open("kitchen", WordCraftConfig(num_distractors=8))
        >>> world.variant(part="test").graph is world.graph
        True
    """

    def __init__(
        self,
        opened: OpenedGraph,
        config: WordCraftConfig,
        tasks: TaskSet | None = None,
        *,
        derived: dict[Hashable, Any] | None = None,
    ):
        """Make the tasks.

        Args:
            opened: the graph and its split; :meth:`open` takes names and files.
            config: the settings.
            tasks: tasks instead of those that the settings describe; None to make these.
            derived: what a world with other settings shares, see :meth:`variant`; None for nothing.

        Raises:
            ConfigError: if the graph has too few entities for so many distractors.
            TaskError: if there is no task.
        """
        self.opened = opened
        self.graph: RecipeGraph = opened.graph
        self.split: Split = opened.split
        self._derived: dict[Hashable, Any] = {} if derived is None else derived
        self.config = config
        # Given tasks take the place in which made tasks would be kept.
        if tasks is not None:
            settings = (getattr(config, name) for name in _TASKS)
            self.shared(("tasks", *settings), lambda: tasks)
        self.nothing = self.graph.num_entities
        self.max_results = max(map(len, self.outcomes.values()), default=1)
        self.num_given = self.graph.most_leaves(config.depth) + config.num_distractors
        self.num_entity_slots = self.num_given + self.max_results * config.attempts
        self.has_combine = not self.graph.has_pairs_only
        self.num_slots = self.num_entity_slots + self.has_combine
        self.max_distractors = int(self._num_free.min())
        if config.num_distractors > self.max_distractors:
            raise ConfigError(
                f"`num_distractors` {config.num_distractors}: {self.graph.name} has "
                f"{self.nothing} entities, of which a task needs up to "
                f"{self.nothing - self.max_distractors}; expected at most {self.max_distractors}."
            )

    @classmethod
    def open(cls, graph: "GraphLike | World", config: WordCraftConfig) -> "World":
        """Open a graph and make the tasks.

        Args:
            graph: the graph, or another world, with which this world shares what their settings do
                not change.
            config: the settings.

        Raises:
            ConfigError: as the constructor, or for a value that is no graph.
            TaskError: if there is no task.
            RecipeFileError: if ``graph`` names no graph folder, file or known book, or the book
                cannot be read.
            ArtefactError: if ``graph`` is a folder without a graph, or a damaged one.
        """
        if isinstance(graph, World):
            return cls(graph.opened, config, derived=graph._derived)
        return cls(open_graph(graph), config)

    @classmethod
    def of(cls, graph: "GraphLike | World", settings: Mapping[str, Any]) -> "World":
        """Return the world that an environment's arguments describe: a given world, or a new one.

        Raises:
            ConfigError: for settings next to a given world, which has settings; or as the
                constructors of the world and its settings.
            TaskError: if the graph has no such task.
            RecipeFileError: if ``graph`` names no graph folder, file or known book, or the book
                cannot be read.
            ArtefactError: if ``graph`` is a folder without a graph, or a damaged one.
        """
        if not isinstance(graph, World):
            return cls.open(graph, WordCraftConfig.of(settings))
        if settings:
            arguments = ", ".join(f"{name}={value!r}" for name, value in settings.items())
            raise ConfigError(
                f"a world has its own settings; pass world.variant({arguments}) and no settings."
            )
        return graph

    def variant(self, **changes: Any) -> "World":
        """Return a world with some changed settings, which shares all that they do not affect.

        Raises:
            ConfigError: for an unknown setting, or as the constructor.
            TaskError: if there is no task.
        """
        return World.open(self, self.config.variant(**changes))

    def shared(self, name: Hashable, make: Callable[[], _T]) -> _T:
        """Return a value that all engines of this world and of its variants share.

        Args:
            name: a name that says everything that the value depends on, except the recipes that
                make something.
            make: makes the value, once.
        """
        key = (name, self.has_train_recipes_only)
        if key not in self._derived:
            self._derived[key] = make()
        value: _T = self._derived[key]
        return value

    def __deepcopy__(self, memo: dict[int, Any]) -> "World":
        # Gymnasium copies the arguments of an environment whenever its spec is read; immutable, a
        # world may be shared, and a copy of a large graph would be slow.
        return self

    @property
    def has_train_recipes_only(self) -> bool:
        """Whether held-out pairs make nothing: in training, unless it pays for them."""
        return self.config.part == "train" and not self.config.pays_held_out

    @_derived_from()
    def usable(self) -> NDArray[np.bool_]:
        """The recipes that make something, shape (num_recipes,), bool."""
        if self.has_train_recipes_only:
            return self.split.is_in("train")
        return np.ones(self.graph.num_recipes, dtype=bool)

    @_derived_from()
    def search(self) -> SolutionSearch:
        """The search for plans by :attr:`usable` recipes."""
        return SolutionSearch(self.graph, self.usable)

    @_derived_from(*_TASKS)
    def tasks(self) -> TaskSet:
        """The tasks from which episodes are drawn."""
        config = self.config
        return make_tasks(
            self.graph,
            config.depth,
            None if config.part == "all" else self.split,
            config.part,
            limit=config.num_tasks,
            seed=config.task_seed,
            search=self.search,
        )

    @_derived_from(*_TASKS, "num_distractors")
    def num_drawn(self) -> Ids:
        """Number of distractors of each task, shape (N,), one more for each ingredient it lacks.

        A plan that uses an entity twice has fewer starting ingredients than the largest plan of its
        depth; without further distractors, the size of its table would tell. Only a book with
        hardly more entities than a plan needs cannot fill its tables.
        """
        num_lacking = (self.tasks.starts == self.nothing).sum(axis=1)
        return frozen(np.minimum(self.config.num_distractors + num_lacking, self._num_free))

    @_derived_from(*_TASKS)
    def _num_free(self) -> Ids:
        """Number of entities that may be distractors, by task, shape (N,)."""
        # Never distractors: the goal, the starting ingredients and the intermediates of the plans.
        plan_ids = np.concatenate([self.tasks.starts, self.tasks.intermediates], axis=1)
        num_needed = 1 + (plan_ids != self.nothing).sum(axis=1)
        return frozen(self.nothing - num_needed)

    @_derived_from(*_TASKS)
    def groups(self) -> Ids:
        """Each task's resampling group, shape (N,).

        It is the split's group of the recipe that makes the goal. Tasks of a group were held out
        together and are alike, so an interval resamples whole groups. If several plans end in
        different recipes, the first plan counts.
        """
        last_recipes = [plans[0][-1] for plans in self.tasks.plans]
        return frozen(self.split.groups[last_recipes])

    @_derived_from()
    def outcomes(self) -> Mapping[tuple[int, ...], tuple[int, ...]]:
        """Results by ingredient ids, both ascending: by pairs, or by larger sets."""
        if self.usable.all():
            return self.graph.outcomes
        return outcomes_of(self.graph.sets[self.usable], self.nothing)

    @_derived_from("distractor_weighting")
    def distractor_weights(self) -> Ids:
        """Each entity's weight as a distractor, shape (E,), int64."""
        weights = np.ones(self.nothing, dtype=np.int64)
        if self.config.distractor_weighting == "use":
            # Train recipes only: weights by all recipes would reveal which entities test recipes
            # use.
            weights += self.split.train_uses
        return frozen(weights)

    def without_nothing(self, ids: Iterable[int]) -> list[int]:
        """Return the ids of entities among padded ids, in their order."""
        return [int(entity) for entity in ids if entity < self.nothing]

    def checked_table(self, table: Iterable[Entity], most: int) -> list[int]:
        """Return the ids of a table's entities.

        Args:
            table: labels or ids, in slot order.
            most: largest number of entities.

        Raises:
            UnknownEntityError: for an entity outside the graph.
            ConfigError: if the table is empty, too large, or holds an entity twice.
        """
        ids = [self.graph.id_of(entity) for entity in table]
        if not 1 <= len(ids) <= most:
            raise ConfigError(f"`table` of {len(ids)} entities: expected 1 to {most}.")
        # Twice the same entity would have two slots with one meaning.
        if len(set(ids)) < len(ids):
            twice = next(entity for place, entity in enumerate(ids) if entity in ids[:place])
            raise ConfigError(
                f"`table` holds '{self.graph.entities[twice]}' twice: expected different entities."
            )
        return ids
