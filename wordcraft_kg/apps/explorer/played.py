"""Agent runs, and the worlds in which agents act."""

from contextlib import suppress
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
"""A part of the tasks; by default test tasks, or train tasks without held-out recipes."""
AskedDepth = Literal[0, 1, 2, 3, 4, 5]
"""A depth of tasks; 0 is the agent's training depth."""


def followed(explored: Explored, name: str = "") -> tuple[str, FollowedRun]:
    """Return a run with its name, by default the first; errors as in :meth:`Explored.run`."""
    name, folder = explored.run(name)
    return name, explored.once(("followed run", name), lambda: FollowedRun(folder, explored.opened))


def is_done(run: FollowedRun) -> bool:
    """Return whether a run is final."""
    try:
        return run.records().run.status == "done"
    except ArtefactError:
        return False


def tasks_of(run: FollowedRun | None) -> TaskConfig:
    """Return a run's task settings; defaults without a readable run."""
    with suppress(ArtefactError):
        if run is not None:
            return run.records().config.tasks
    return TaskConfig()


def settings_of(
    explored: Explored, tasks: TaskConfig, part: AskedPart = "", depth: AskedDepth = 0, distractors: int | None = None
) -> WordCraftConfig:
    """Return world settings from an agent's tasks, with changes."""
    if depth and depth != tasks.depth:
        enough = tasks.max_attempts is not None and tasks.max_attempts >= depth
        tasks = replace(tasks, depth=depth, max_attempts=tasks.max_attempts if enough else None)
    return tasks.environment(part or usual_part(explored), distractors)


def plain_world(explored: Explored, config: WordCraftConfig) -> World:
    """Return a world with the tasks of some settings and without distractors, made once; no task is a TaskError."""
    kept = ("part", "depth", "task_weighting", "num_tasks", "task_seed")
    plain = WordCraftConfig(num_distractors=0, **{name: getattr(config, name) for name in kept})
    return explored.once(("world", plain), lambda: World(explored.opened, plain))


def world_of(explored: Explored, config: WordCraftConfig) -> World:
    """Return the cached world for some settings; worlds share equal tasks."""
    return explored.once(("world", config), lambda: World(plain_world(explored, config), config))


def usual_part(explored: Explored) -> TaskPart:
    """Return the default task part."""
    return "test" if (explored.opened.split.parts == TEST).any() else "train"
