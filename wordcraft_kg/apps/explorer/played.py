"""The runs of agents, and the worlds in which agents are asked."""

from dataclasses import replace
from typing import Literal

from wordcraft_kg.agents.config import TaskConfig
from wordcraft_kg.agents.following import FollowedRun
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.splits import TEST
from wordcraft_kg.graphs.tasks import TaskPart

AskedPart = Literal["", "all", "train", "valid", "test"]
"""A part of the tasks; by default test tasks, or train tasks where the split holds nothing out."""
AskedDepth = Literal[0, 1, 2, 3, 4, 5]
"""A depth of tasks; by default that on which the agent was trained."""


def followed(explored: Explored, name: str = "") -> tuple[str, FollowedRun]:
    """Return a run with its name; without a name the first; errors as of :meth:`Explored.run`."""
    found, folder = explored.run(name)
    return found, explored.once(("followed run", found), lambda: FollowedRun(folder, explored.opened))


def is_done(run: FollowedRun) -> bool:
    """Return whether nothing about a run changes any more."""
    try:
        return run.records().run.status == "done"
    except ArtefactError:
        return False


def tasks_of(run: FollowedRun | None) -> TaskConfig:
    """Return the settings of a run's tasks; the defaults without a run that can be read."""
    if run is None:
        return TaskConfig()
    try:
        return run.records().config.tasks
    except ArtefactError:
        return TaskConfig()


def settings_of(
    explored: Explored, tasks: TaskConfig, part: AskedPart = "", depth: AskedDepth = 0, distractors: int | None = None
) -> WordCraftConfig:
    """Return the settings of a world: those of an agent's tasks, with changes.

    Raises:
        ConfigError: for a number out of range.
    """
    if depth and depth != tasks.depth:
        enough = tasks.max_attempts is not None and tasks.max_attempts >= depth
        tasks = replace(tasks, depth=depth, max_attempts=tasks.max_attempts if enough else None)
    return tasks.environment(part or usual_part(explored), distractors)


def plain_world(explored: Explored, config: WordCraftConfig) -> World:
    """Return a world with the tasks of some settings and without distractors, made once.

    Raises:
        TaskError: if there is no such task.
    """
    plain = WordCraftConfig(
        part=config.part,
        depth=config.depth,
        num_distractors=0,
        task_weighting=config.task_weighting,
        num_tasks=config.num_tasks,
        task_seed=config.task_seed,
    )
    return explored.once(("world", plain), lambda: World(explored.opened, plain))


def world_of(explored: Explored, config: WordCraftConfig) -> World:
    """Return the world of some settings, made once; it shares its tasks with all that have the same.

    Raises:
        TaskError: if there is no such task.
        ConfigError: if there are too few entities for so many distractors.
    """
    return explored.once(("world", config), lambda: World(plain_world(explored, config), config))


def usual_part(explored: Explored) -> TaskPart:
    """Return the default part of tasks."""
    return "test" if (explored.opened.split.parts == TEST).any() else "train"
