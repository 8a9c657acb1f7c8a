"""All tasks of a depth and part, page by page, and how often an agent solved each."""

from collections.abc import Iterator

from wordcraft_kg.agents.following import FollowedRun
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, State
from wordcraft_kg.apps.explorer.played import (
    AskedDepth,
    AskedPart,
    followed,
    is_done,
    plain_world,
    settings_of,
    tasks_of,
    usual_part,
)
from wordcraft_kg.apps.explorer.views.task_table import TaskResults, TaskTable, Won, view_task_table
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Record
from wordcraft_kg.graphs.tasks import TaskPart, TaskSet


class Tasks(State):
    """Some tasks.

    Attributes:
        part: part of the tasks.
        depth: fewest attempts that solve them; 0 for those on which the agent was trained.
        goal: only tasks with this goal.
        run: the agent; by default the first one.
        success: with how many of the draws of distractors the agent solved them.
        page: number of the page.
    """

    part: AskedPart = ""
    depth: AskedDepth = 0
    goal: str = ""
    run: str = ""
    success: Won = "any"
    page: int = 1


class ShownTasks(Record):
    """Tasks, with an agent's results beside them.

    Attributes:
        run: name of the agent; empty without one.
        runs: names of all agents.
        missing: why there are no results of it; empty if there are, or without an agent.
        usual: the part that is shown unless another one is asked for.
        table: the tasks.
    """

    run: str
    runs: tuple[str, ...]
    missing: str
    usual: TaskPart
    table: TaskTable


def list_tasks(explored: Explored, state: Tasks) -> ShownTasks:
    """Return the view of some tasks."""
    name, run = followed(explored, state.run) if explored.runs or state.run else ("", None)
    tasks = plain_world(explored, settings_of(explored, tasks_of(run), state.part, state.depth)).tasks
    missing = "" if run is None else _missing(name, run, tasks)
    results = None if run is None or missing else _results(explored, name, run, tasks)
    table = view_task_table(tasks, results, goal=state.goal, won=state.success, page=state.page)
    return ShownTasks(name, tuple(explored.runs), missing, usual_part(explored), table)


def _missing(name: str, run: FollowedRun, tasks: TaskSet) -> str:
    """Say why there are no results of an agent on some tasks; an empty text if there are."""
    try:
        found = run.records()
        if found.evaluation is None:
            return f"{name} is {found.run.status}: how often it solves each task comes with its evaluation."
        if found.config.tasks.depth != tasks.depth:
            return f"{name} was evaluated on tasks of depth {found.config.tasks.depth}."
        if tasks.part not in found.evaluation.success:
            return f"{name} was evaluated on {' and '.join(found.evaluation.success)} tasks."
        run.episodes()
    except ArtefactError as error:
        return str(error)
    return ""


def _results(explored: Explored, name: str, run: FollowedRun, tasks: TaskSet) -> TaskResults:
    key = "results", name, run.records().run.ended, tasks.hash
    return explored.once(key, lambda: TaskResults.of(tasks, run.episodes().values()))


def _is_live(explored: Explored, state: Tasks) -> bool:
    return bool(explored.runs) and not is_done(followed(explored, state.run)[1])


def _exported(explored: Explored) -> Iterator[Tasks]:
    """Yield the first page of each agent: a site of files would hold too many others."""
    yield Tasks()
    yield from (Tasks(run=name) for name in explored.runs)


PAGE = Page("tasks", Tasks, list_tasks, title="Tasks", exported=_exported, is_live=_is_live)
