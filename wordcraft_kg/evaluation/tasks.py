"""Crafting tasks in a split part: counts and examples."""

import numpy as np

from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.tasks import TaskPart


class ShownTask(Record):
    """An example task.

    Attributes:
        goal: label of the goal.
        start: starting ingredients.
        distractors: other entities on the table.
        table: the table, slot by slot.
        plans: all ways to make the goal, each as recipes in turn.
    """

    goal: str
    start: tuple[str, ...]
    distractors: tuple[str, ...]
    table: tuple[str, ...]
    plans: tuple[tuple[Recipe, ...], ...]


class TaskListing(Record):
    """The tasks in a split part, with examples.

    Attributes:
        graph: name of the graph.
        depth: fewest attempts that solve a task.
        part: the split part.
        tasks: number of tasks.
        uses_twice: share of the tasks all of whose plans use an entity twice.
        complete: whether these are all tasks of the part, and not a random sample.
        mixed: number of tasks that use recipes of several parts and belong to none.
        shown: the examples.
    """

    graph: str
    depth: int
    part: TaskPart
    tasks: Count
    uses_twice: Share
    complete: bool
    mixed: Count
    shown: tuple[ShownTask, ...]


def view_tasks(env: WordCraftEnv, limit: int, seed: int) -> TaskListing:
    """Count an environment's tasks and show examples.

    Args:
        env: the environment.
        limit: most examples to return.
        seed: seed of the choice and of the distractors.

    Returns:
        Counts, and the examples in random order.
    """
    # Seeding only the first episode, as in training, gives different distractors to each table.
    env.reset(seed=seed)
    order = np.random.default_rng(seed).permutation(len(env.tasks))[:limit].tolist()
    return TaskListing(
        graph=env.world.graph.name,
        depth=env.config.depth,
        part=env.config.part,
        tasks=len(env.tasks),
        uses_twice=float(env.tasks.uses_twice.mean()),
        complete=env.tasks.is_complete,
        mixed=env.tasks.mixed,
        shown=tuple(_shown(env, index) for index in order),
    )


def _shown(env: WordCraftEnv, index: int) -> ShownTask:
    observation, _ = env.reset(options={"task": index})
    task = env.task
    # Slots without an entity have no label.
    table = env.world.graph.labels(observation["table"][observation["action_mask"] == 1])
    return ShownTask(
        goal=task.goal,
        start=tuple(task.start),
        # Sorted, because the table's order is random and tells nothing.
        distractors=tuple(sorted(set(table) - set(task.start))),
        table=table,
        plans=tuple(map(tuple, task.plans)),
    )
