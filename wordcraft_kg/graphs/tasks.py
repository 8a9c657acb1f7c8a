"""Crafting tasks: make a goal entity from starting ingredients, with a known least number of attempts.

An *attempt* combines two entities at hand; all results become entities at hand, and nothing is used up. A *plan* is a
set of attempts that makes the goal. A task at depth n has a plan with n attempts from all starting ingredients, and no
shorter plan; :mod:`~wordcraft_kg.graphs.task_search` finds such tasks.
"""

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.errors import TaskError
from wordcraft_kg.graphs.arrays import Ids, frozen, padded
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.splits import Split

Rows = tuple[int, ...]
"""A plan: rows in ``graph.recipes`` in order of execution."""
TaskPart = Literal["all", "train", "valid", "test"]
TaskWeighting = Literal["task", "goal"]


@dataclass(frozen=True)
class Task:
    """A crafting task, by labels: make a goal from starting ingredients (sorted) in ``depth`` attempts or more.

    ``plans`` are all plans with ``depth`` attempts, each as recipes in execution order; an attempt may contribute two
    recipes if both results are needed.
    """

    goal: str
    start: tuple[str, ...]
    depth: int
    plans: tuple[tuple[Recipe, ...], ...]


@dataclass(frozen=True, eq=False)
class TaskSet:
    """Crafting tasks at one depth in a part of a split, as arrays; equal if the content is equal.

    Attributes:
        depth: fewest attempts that make the goal.
        goals: shape (N,), entity ids.
        starts: shape (N, depth + 1), starting ingredient ids, ascending, padded with ``num_entities``.
        plans: each task's shortest plans, as rows in ``graph.recipes``.
        is_complete: whether all tasks are included; otherwise the tasks were drawn at random.
        mixed: number of tasks in no part, because the plans use recipes from several parts (when drawing: among the
            tasks encountered).
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

    def __getitem__(self, index: int) -> Task:
        graph = self.graph
        start = [entity for entity in self.starts[index].tolist() if entity < graph.num_entities]
        plans = tuple(
            tuple(graph.recipe_labels(graph.recipes[list(rows)])) for rows in self.plans[index]
        )
        return Task(graph.entities[self.goals[index]], graph.labels(start), self.depth, plans)

    def __iter__(self) -> Iterator[Task]:
        return (self[index] for index in range(len(self)))

    @cached_property
    def hash(self) -> str:
        """SHA-256 hash of the tasks in order, in hexadecimal."""
        known = hashlib.sha256(f"{self.graph.hash} {self.depth} {self.part} {self.plans}".encode())
        known.update(self.starts.tobytes())
        return known.hexdigest()

    @cached_property
    def intermediates(self) -> Ids:
        """Ids of intermediate results in each task's plans, padded with ``num_entities``, shape (N, I)."""
        made = self.graph.recipes[:, 2].tolist()
        rows = [sorted({made[row] for plan in plans for row in plan[:-1]}) for plans in self.plans]
        return frozen(padded(rows, self.graph.num_entities))

    @cached_property
    def final_pairs(self) -> Ids:
        """Numbers of the ingredient pairs that make each task's goal in a plan, shape (N, F), padded with -1."""
        pair = self.graph.pair_of_recipe.tolist()
        return frozen(
            padded([sorted({pair[plan[-1]] for plan in plans}) for plans in self.plans], -1)
        )

    def groups_in(self, split: Split) -> Ids:
        """Return each task's resampling group, shape (N,): the split's group of the recipe that makes the goal.

        Tasks of a group were held out together and are alike, so an interval resamples whole groups. If several plans
        end in different recipes, the first plan counts.
        """
        return frozen(split.groups[[plans[0][-1] for plans in self.plans]])

    def weights(self, weighting: TaskWeighting = "task") -> NDArray[np.float64]:
        """Return sampling probabilities (N,): uniform over tasks, or over goals and then over a goal's tasks."""
        if weighting == "task":
            return np.full(len(self), 1 / max(len(self), 1))
        _, goal, count = np.unique(self.goals, return_inverse=True, return_counts=True)
        return 1 / (len(count) * count[goal])


def replay(graph: RecipeGraph, start: Iterable[Entity], plan: Iterable[Recipe]) -> frozenset[str]:
    """Execute a plan and return the labels of all entities at hand afterwards; TaskError for an impossible step."""
    at_hand = {graph.entities[graph.id_of(entity)] for entity in start}
    for recipe in plan:
        missing = {recipe.ingredient_a, recipe.ingredient_b} - at_hand
        results = graph.labels(graph.results(recipe.ingredient_a, recipe.ingredient_b))
        if missing or recipe.result not in results:
            reason = (
                f"{', '.join(sorted(missing))} is not at hand"
                if missing
                else "there is no such recipe"
            )
            raise TaskError(
                f"{recipe.ingredient_a} + {recipe.ingredient_b} -> {recipe.result}: {reason}."
            )
        at_hand.update(results)
    return frozenset(at_hand)
