"""Crafting tasks: make a goal from starting ingredients, with a known least number of attempts.

An *attempt* combines two entities at hand, or as many as a recipe has ingredients; all results
become entities at hand, and nothing is used up. A *plan* is a set of attempts that makes the goal.
A task at depth n has a plan with n attempts whose leaves are exactly the starting ingredients, and
no plan with fewer attempts. Plans of train tasks are those of the train recipes, plans of all other
tasks those of all recipes; :mod:`~wordcraft_kg.graphs.task_search` finds such tasks.
"""

import hashlib
import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base import TaskError, quoted
from wordcraft_kg.graphs.arrays import Ids, frozen, padded
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.splits import Split

Rows = tuple[int, ...]
"""A plan: rows in ``graph.sets`` in order of execution."""
TaskPart = Literal["all", "train", "valid", "test"]
"""Part of a split that tasks belong to; all: whatever recipes their plans use."""
TaskWeighting = Literal["task", "goal"]
"""Sampling: all tasks alike, or goals alike and then the tasks of a goal alike."""


@dataclass(frozen=True)
class CraftingTask:
    """A crafting task, by labels.

    Attributes:
        goal: the entity to make.
        start: starting ingredients, sorted.
        depth: fewest attempts that make the goal.
        plans: all plans with ``depth`` attempts, each as recipes in execution order. A plan may
            have more recipes than attempts: one attempt gives two recipes if both results are
            needed.
    """

    goal: str
    start: tuple[str, ...]
    depth: int
    plans: tuple[tuple[Recipe, ...], ...]


@dataclass(frozen=True, eq=False)
class TaskSet:
    """Crafting tasks at one depth in a part of a split, as arrays; equal if the content is equal.

    Attributes:
        graph: the recipe graph of all tasks.
        depth: fewest attempts that make the goal, the same for all tasks.
        part: part of the split that the tasks belong to, or ``all``.
        goals: shape (N,), entity ids.
        starts: shape (N, L), starting ingredient ids, ascending, padded with ``num_entities``; L is
            :meth:`~wordcraft_kg.graphs.recipe_graph.RecipeGraph.most_leaves`, ``depth + 1`` for
            pairs.
        plans: each task's shortest plans, as rows in ``graph.sets``.
        is_complete: whether all tasks are included; otherwise the tasks were drawn at random.
        mixed: number of tasks that are neither train, valid nor test tasks by all recipes, because
            their plans use recipes from several parts (when drawing: among the tasks met so far); 0
            for train tasks.
    """

    graph: RecipeGraph
    depth: int
    part: TaskPart
    goals: Ids
    starts: Ids
    plans: tuple[tuple[Rows, ...], ...]
    is_complete: bool
    mixed: int

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TaskSet):
            return NotImplemented
        # Plans end in their goal, so plans and starts suffice.
        return self._content() == other._content()

    def __hash__(self) -> int:
        return hash(self._content())

    def _content(self) -> tuple[object, ...]:
        # Bytes, because arrays are neither hashable nor equal as a whole.
        return (
            self.graph,
            self.depth,
            self.part,
            self.starts.tobytes(),
            self.plans,
            self.is_complete,
            self.mixed,
        )

    def __len__(self) -> int:
        return len(self.goals)

    def __getitem__(self, index: int) -> CraftingTask:
        graph = self.graph
        # Starting ingredients are padded with num_entities.
        start = [entity for entity in self.starts[index].tolist() if entity < graph.num_entities]
        plans = [graph.recipe_labels(graph.sets[list(rows)]) for rows in self.plans[index]]
        return CraftingTask(
            graph.entities[self.goals[index]],
            graph.labels(start),
            self.depth,
            tuple(map(tuple, plans)),
        )

    def __iter__(self) -> Iterator[CraftingTask]:
        return (self[index] for index in range(len(self)))

    @cached_property
    def hash(self) -> str:
        """SHA-256 hash of the tasks in order, in hexadecimal."""
        head = f"{self.graph.hash} {self.depth} {self.part} {self.plans}"
        digest = hashlib.sha256(head.encode())
        digest.update(self.starts.tobytes())
        return digest.hexdigest()

    @cached_property
    def uses_twice(self) -> NDArray[np.bool_]:
        """Whether all plans of a task use an entity twice, shape (N,): its start is shorter."""
        pair_of = self.graph.pair_of_recipe.tolist()
        # Each attempt but the last puts one entity, its result, in the place of its ingredients.
        num_leaves = (self.graph.sizes - 1).tolist()
        fewest = []
        for plans in self.plans:
            # An attempt may give several recipes of a plan, and takes its ingredients once.
            attempts = [{pair_of[row]: num_leaves[row] for row in plan} for plan in plans]
            fewest.append(1 + min(sum(leaves.values()) for leaves in attempts))
        num_starts = np.sum(self.starts != self.graph.num_entities, axis=1)
        return np.asarray(num_starts < np.array(fewest, dtype=np.int64))

    @cached_property
    def intermediates(self) -> Ids:
        """Ids of intermediate results in each task's plans, shape (N, I), ascending.

        Padded with ``num_entities``, which is no entity.
        """
        result_of = self.graph.sets[:, -1].tolist()
        intermediates = []
        for plans in self.plans:
            # A plan ends in its goal; all results before are intermediate.
            steps = itertools.chain.from_iterable(plan[:-1] for plan in plans)
            results = {result_of[row] for row in steps}
            intermediates.append(sorted(results))
        return frozen(padded(intermediates, self.graph.num_entities))

    @cached_property
    def final_pairs(self) -> Ids:
        """Numbers of the pairs or sets that make each task's goal in a plan, shape (N, F).

        Ascending, padded with -1, which is no pair.
        """
        pair_of = self.graph.pair_of_recipe.tolist()
        final = []
        for plans in self.plans:
            pairs = {pair_of[plan[-1]] for plan in plans}
            final.append(sorted(pairs))
        return frozen(padded(final, -1))

    def groups_in(self, split: Split) -> Ids:
        """Return each task's resampling group, shape (N,).

        It is the split's group of the recipe that makes the goal.

        Tasks of a group were held out together and are alike, so an interval resamples whole
        groups. If several plans end in different recipes, the first plan counts.

        Args:
            split: the split from which the tasks' part comes.

        Raises:
            SplitError: for a split by kind, if the graph has no kinds of recipes.
        """
        last_recipes = [plans[0][-1] for plans in self.plans]
        return frozen(split.groups[last_recipes])

    def weights(self, weighting: TaskWeighting = "task") -> NDArray[np.float64]:
        """Return sampling probabilities, shape (N,), that sum to 1.

        Args:
            weighting: uniform over tasks, or over goals and then over the tasks of a goal.
        """
        if weighting == "task":
            return np.full(len(self), 1 / max(len(self), 1))
        _, goal, tasks_of_goal = np.unique(self.goals, return_inverse=True, return_counts=True)
        return 1 / (len(tasks_of_goal) * tasks_of_goal[goal])


def replay(
    graph: RecipeGraph,
    start: Iterable[Entity],
    plan: Iterable[Recipe],
) -> frozenset[str]:
    """Execute a plan and return what is at hand afterwards.

    Args:
        graph: the recipe graph.
        start: entities at hand at the start, by id or label.
        plan: recipes in order of execution.

    Returns:
        Labels; all results of an attempt are at hand from then on, and nothing is used up.

    Raises:
        TaskError: if a recipe needs an entity that is not at hand, or is not in the graph.
        UnknownEntityError: if the graph has no such entity.
    """
    at_hand = {graph.entities[graph.id_of(entity)] for entity in start}
    for recipe in plan:
        missing = set(recipe.ingredients) - at_hand
        # Before the check below, so that an unknown entity is named as such.
        results = graph.labels(graph.results(*recipe.ingredients))
        if missing:
            names = ", ".join(map(quoted, sorted(missing)))
            raise TaskError(f"{recipe}: {names} is not at hand.")
        if recipe.result not in results:
            raise TaskError(f"{recipe}: there is no such recipe.")
        at_hand.update(results)
    return frozenset(at_hand)
