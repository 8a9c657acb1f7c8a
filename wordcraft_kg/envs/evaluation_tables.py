"""Evaluation tables: the fixed starting tables that agents, scripted players and text agents share."""

import numpy as np

from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.envs.arrays import arrays_of
from wordcraft_kg.envs.draws import Draws
from wordcraft_kg.envs.world import World

MOST_TASKS = 50_000
"""Most tasks to play by default; if a part of the split has more, evenly spaced tasks are played."""
EVALUATION_SEED = 0
"""Seed for distractors in evaluation, independent of an agent's seed."""
MANY_TASKS = 6_000
"""Most tasks that are played on several tables by default; for more tasks, further tables hardly change an interval."""


def default_seeds(num_tasks: int) -> int:
    """Return the default number of distractor seeds (tables per task): 5, or 1 above :data:`MANY_TASKS` tasks."""
    return 5 if num_tasks <= MANY_TASKS else 1


def distance_of(amount: int, limit: int | None) -> int:
    """Return the step between evaluated tasks: at most ``limit`` out of ``amount`` are evaluated; 1 evaluates all."""
    return 1 if limit is None else -(-amount // limit)


class EvaluationTables:
    """The fixed starting table for each task and distractor seed in a world.

    Example:
        >>> tables = EvaluationTables(World("kitchen", WordCraftConfig(part="test", num_distractors=2)))
        >>> len(tables.table(0)), tables.table(0) == tables.table(0, distractor_seed=1)
        (4, False)
    """

    def __init__(self, world: World):
        self.world = world
        self._draws = Draws(world, arrays_of("cpu"))

    def table(self, task: int, distractor_seed: int = 0) -> list[int]:
        """Return the ids on a task's starting table in slot order, by task index and distractor seed."""
        amount, draws = len(self.world.tasks), self._draws
        whole("task", task, 0, amount - 1)
        whole("distractor_seed", distractor_seed, 0, MAX_SIZE)
        place, rest = divmod(task, distance_of(amount, MOST_TASKS))
        environment = task if rest else place  # a task outside the sample has separate tables
        keys = draws.keys(
            draws.env_keys(EVALUATION_SEED, environment, 1), np.array([distractor_seed])
        )
        return [
            entity
            for entity in draws.tables(keys, np.array([task]))[0].tolist()
            if entity != self.world.nothing
        ]
