"""The tables of evaluations, the same for agents, scripted players and text agents."""

import numpy as np

from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.envs.arrays import arrays_of
from wordcraft_kg.envs.draws import Draws
from wordcraft_kg.envs.world import World

MOST_TASKS = 50_000
"""Most tasks of a part that are played by default; of more, an evenly spaced sample."""
EVALUATION_SEED = 0
"""Seed of the distractors, whatever an agent's own."""


def distance_of(amount: int, limit: int | None) -> int:
    """Return the distance of the tasks that are played, so that there are at most ``limit`` of them; 1 for all."""
    return 1 if limit is None else -(-amount // limit)


def environment_of(task: int, amount: int) -> int:
    """Return the number of the environment that plays a task, on which its tables depend.

    A task outside the sample of very many has tables of its own.
    """
    place, rest = divmod(task, distance_of(amount, MOST_TASKS))
    return place if not rest else task


class EvaluationTables:
    """The tables of an evaluation, one at a time, in any order.

    Example:
        >>> tables = EvaluationTables(World("kitchen", WordCraftConfig(part="test", num_distractors=2)))
        >>> len(tables.table(0)), tables.table(0) == tables.table(0, draw=1)
        (4, False)
    """

    def __init__(self, world: World):
        """Take a world."""
        self.world = world
        self._draws = Draws(world, arrays_of("cpu"))

    def table(self, task: int, draw: int = 0) -> list[int]:
        """Return the ids on the table of a task, slot by slot.

        Args:
            task: number of the task in the world's.
            draw: number of the draw of distractors.

        Raises:
            ConfigError: if there is no such task or draw.
        """
        amount, draws = len(self.world.tasks), self._draws
        whole("task", task, 0, amount - 1)
        whole("draw", draw, 0, MAX_SIZE)
        keys = draws.keys(draws.env_keys(EVALUATION_SEED, environment_of(task, amount), 1), np.array([draw]))
        return [entity for entity in draws.tables(keys, np.array([task]))[0].tolist() if entity != self.world.nothing]
