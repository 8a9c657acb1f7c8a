"""What the readable and the batched environment have in common: tasks, outcomes of pairs, distractors, sizes."""

from functools import cached_property
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.errors import ConfigError
from wordcraft_kg.graphs.arrays import Ids, frozen, padded
from wordcraft_kg.graphs.folder import OpenedGraph, default_split, open_graph
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.tasks import TaskSet, all_ways, make_tasks

GraphLike = str | Path | RecipeGraph | OpenedGraph
"""A graph folder, a book's file or name, a graph (split by recipe with the default settings), or an opened graph."""


def open_world_graph(graph: GraphLike) -> OpenedGraph:
    """Return the graph and split that an environment was given."""
    if isinstance(graph, OpenedGraph):
        return graph
    if isinstance(graph, RecipeGraph):
        return OpenedGraph(graph, default_split(graph), graph.name)
    if not isinstance(graph, str | Path):
        raise ConfigError(
            f"graph {graph!r}: expected a graph folder, a book's file or name, a RecipeGraph or an OpenedGraph."
        )
    return open_graph(graph)


SHORTCUT_TRIES = 1_000


class World:
    """A graph, its split and the settings of an environment, and what follows from them.

    Attributes:
        graph: the recipe graph; its whole book is in force, whatever the part.
        split: its split.
        config: the settings.
        tasks: the tasks to draw from.
        nothing: id of nothing, the number of entities.
        max_results: most results of a pair.
        num_slots: size of the table, fixed: starting ingredients, distractors, room for all results of all attempts.
    """

    def __init__(self, graph: GraphLike, config: WordCraftConfig):
        """Open the graph and make its tasks.

        Raises:
            ConfigError: if the graph has too few entities for so many distractors.
            TaskError: if it has no such task.
        """
        opened = open_world_graph(graph)
        self.graph, self.split, self.config = opened.graph, opened.split, config
        self.tasks: TaskSet = make_tasks(
            self.graph,
            config.depth,
            None if config.part == "all" else self.split,
            config.part,
            weighting=config.task_weighting,
            limit=config.num_tasks,
            seed=config.task_seed,
        )
        self.nothing = self.graph.num_entities
        sizes = np.diff(self.graph.pair_starts)
        self.max_results = 1 if config.ambiguity == "last" else int(sizes.max())
        self.num_slots = config.depth + 1 + config.num_distractors + self.max_results * config.attempts
        reserved = 1 + config.depth + 1 + self.tasks.intermediates.shape[1]
        if config.num_distractors > self.nothing - reserved:
            raise ConfigError(
                f"num_distractors {config.num_distractors}: {self.graph.name} has {self.nothing} entities, of which a "
                f"task may need {reserved}; expected at most {max(self.nothing - reserved, 0)}."
            )

    @cached_property
    def outcomes(self) -> dict[tuple[int, int], tuple[int, ...]]:
        """Results of each pair ``(a, b)`` with ``a <= b``, ascending."""
        outcomes = self.graph.outcomes
        if self.config.ambiguity == "last":
            return {pair: results[-1:] for pair, results in outcomes.items()}
        return outcomes

    @cached_property
    def distractor_weights(self) -> Ids:
        """Shape (E,), int64: weight of each entity as a distractor."""
        weights = np.ones(self.nothing, dtype=np.int64)
        if self.config.distractor_weighting == "use":
            a, b, _ = self.split.recipes("train").T
            users = np.concatenate([a, b[b != a]])
            weights += np.bincount(users, minlength=self.nothing)
        return weights

    @cached_property
    def guarded_recipes(self) -> NDArray[np.bool_]:
        """Shape (num_recipes,): recipes that no distractor may complete if they make the goal.

        In the train part these are the held-out ones, so that training never shows a test pair with its goal; with
        ``no_shortcut`` all of them.
        """
        if self.config.distractor_policy == "no_shortcut":
            return np.ones(self.graph.num_recipes, dtype=bool)
        if self.config.part == "train":
            return ~self.split.is_in("train")
        return np.zeros(self.graph.num_recipes, dtype=bool)

    @cached_property
    def makeable(self) -> Ids:
        """What can be made of each task's start in all attempts but the last, shape (N, W), padded.

        Only where recipes are guarded; a distractor must not complete one with any of it.
        """
        rows: list[list[int]] = []
        for start in self.tasks.starts.tolist() if self.guarded_recipes.any() else [[]] * len(self.tasks):
            there = {entity for entity in start if entity < self.nothing}
            made: set[int] = set()
            for _ in range(self.config.attempts - 1):
                pairs = combinations_with_replacement(sorted(there | made), 2)
                more = {result for pair in pairs for result in self.outcomes.get(pair, ())} - there - made
                if not more:
                    break
                made |= more
            rows.append(sorted(made))
        return frozen(padded(rows, self.nothing))

    def has_shortcut(self, task: int, distractors: list[int]) -> bool:
        """Return whether distractors open a way to the goal, within an episode's attempts, that would not be there."""
        start = [entity for entity in self.tasks.starts[task].tolist() if entity < self.nothing]
        goal, attempts = int(self.tasks.goals[task]), self.config.attempts
        return all_ways(self.graph, goal, [*start, *distractors], attempts) != all_ways(
            self.graph, goal, start, attempts
        )

    def check_tries(self, tries: int, task: int) -> None:
        """Give up on a table without shortcuts after many tries.

        Raises:
            ConfigError: naming the task.
        """
        if tries > SHORTCUT_TRIES:
            raise ConfigError(
                f"found no {self.config.num_distractors} distractors without a shortcut to "
                f"'{self.graph.entities[self.tasks.goals[task]]}' in {SHORTCUT_TRIES} tries; "
                "take fewer distractors, or distractor_policy 'any'."
            )
