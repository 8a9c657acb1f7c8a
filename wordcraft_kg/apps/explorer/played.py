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
    """Return the name of an agent's run and a reader of its growing files; see :meth:`Explored.run`."""
    name, folder = explored.run(name)
    return name, explored.once(("followed run", name), lambda: FollowedRun(folder, explored.opened))


def is_done(run: FollowedRun) -> bool:
    """Return whether a training is complete and evaluated."""
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
    """Return the environment settings of an agent's training tasks, with another part, depth or distractors."""
    if depth and depth != tasks.depth:
        enough = tasks.max_attempts is not None and tasks.max_attempts >= depth
        tasks = replace(tasks, depth=depth, max_attempts=tasks.max_attempts if enough else None)
    return tasks.environment(part or usual_part(explored), distractors)


def plain_world(explored: Explored, config: WordCraftConfig) -> World:
    """Return the tasks for environment settings, without distractors; no task is a TaskError."""
    kept = ("part", "depth", "task_weighting", "num_tasks", "task_seed")
    plain = WordCraftConfig(num_distractors=0, **{name: getattr(config, name) for name in kept})
    return explored.once(("world", plain), lambda: World(explored.opened, plain))


def world_of(explored: Explored, config: WordCraftConfig) -> World:
    """Return the tasks and rules for environment settings, made once."""
    return explored.once(("world", config), lambda: World(plain_world(explored, config), config))


def usual_part(explored: Explored) -> TaskPart:
    """Return the task part shown by default: test, or train if the graph has no test recipes."""
    return "test" if (explored.opened.split.parts == TEST).any() else "train"
