"""Evaluation tables: the fixed starting tables that all kinds of players share.

Agents, scripted players, text agents and people play on the same tables, so their results can be
compared task by task.
"""

import logging

import numpy as np

from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.envs.arrays import arrays_of
from wordcraft_kg.envs.draws import Draws
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.arrays import Ids

MOST_TASKS = 50_000
"""Most tasks to play by default; of more, evenly spaced tasks are played."""
EVALUATION_SEED = 0
"""Seed for distractors in evaluation, independent of an agent's seed."""
MANY_TASKS = 6_000
"""Most tasks that are played on several tables by default.

For more tasks, further tables hardly change an interval.
"""


def default_seeds(num_tasks: int) -> int:
    """Return the default number of distractor seeds (tables per task).

    5, or 1 above :data:`MANY_TASKS` tasks.
    """
    return 5 if num_tasks <= MANY_TASKS else 1


def distance_of(amount: int, limit: int | None) -> int:
    """Return the step between evaluated tasks, 1 for all tasks.

    With it, at most ``limit`` out of ``amount`` tasks are evaluated; None is no limit.
    """
    if limit is None:
        return 1
    return (amount + limit - 1) // limit  # rounded up


def sampled_tasks(world: World, limit: int | None = MOST_TASKS) -> Ids:
    """Return the numbers of the evaluated tasks: all, or at most ``limit`` evenly spaced ones."""
    num_tasks = len(world.tasks)
    return np.arange(0, num_tasks, distance_of(num_tasks, limit))


def warn_of_sample(world: World, tasks: Ids, limit: int | None) -> None:
    """Log a warning that only some tasks are evaluated, unless the user has set the limit.

    Args:
        world: graph, tasks and settings.
        tasks: numbers of the evaluated tasks, shape (N,), from :func:`sampled_tasks`.
        limit: the limit of which the sample comes; only the default one is worth a warning.
    """
    if len(tasks) < len(world.tasks) and limit == MOST_TASKS:
        logging.getLogger(__name__).warning(
            "%s %s tasks are too many: evaluating a sample of %s tasks.",
            f"{len(world.tasks):,}",
            world.config.part,
            f"{len(tasks):,}",
        )


class EvaluationTables:
    """The fixed starting table for each task and distractor seed in a world.

    Attributes:
        world: graph, tasks and settings.

    Example:
        >>> world = World.open("kitchen", WordCraftConfig(part="test", num_distractors=2))
        >>> tables = EvaluationTables(world)
        >>> len(tables.table(0)), tables.table(0) == tables.table(0, distractor_seed=1)
        (4, False)
    """

    def __init__(self, world: World):
        """Prepare the draws of a world's tables."""
        self.world = world
        self._draws = Draws(world, arrays_of("cpu"))

    def table(self, task: int, distractor_seed: int = 0) -> list[int]:
        """Return the ids on a task's starting table in slot order.

        Args:
            task: task index.
            distractor_seed: number of the table, 0 or more.

        Raises:
            ConfigError: if there is no such task or seed, or no distractors without a shortcut are
                found for the task.
        """
        amount = len(self.world.tasks)
        whole("task", task, 0, amount - 1)
        whole("distractor_seed", distractor_seed, 0, MAX_SIZE)
        # An evaluator plays every n-th task, each in an environment of its own, and the environment
        # seeds the distractors. A task outside the sample has separate tables.
        place, remainder = divmod(task, distance_of(amount, MOST_TASKS))
        environment = task if remainder else place
        env_keys = self._draws.env_keys(EVALUATION_SEED, environment, 1)
        keys = self._draws.keys(env_keys, np.array([distractor_seed]))
        (table,) = self._draws.tables(keys, np.array([task]))
        return [entity for entity in table.tolist() if entity != self.world.nothing]
