"""The task page."""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.agents.following import FollowedRun
from wordcraft_kg.agents.records import PlayedTask
from wordcraft_kg.apps.explorer.explored import AskedDepth, AskedPart, Explored
from wordcraft_kg.apps.explorer.page import Page, PageState, Paging, paging
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.tasks import TaskPart, TaskSet

TASKS_A_PAGE = 50
Won = Literal["any", "always", "sometimes", "never"]
"""Share of distractor seeds with a solved task."""


class TasksState(PageState):
    """Page settings: filters for tasks. Depth 0 is the training depth for the agent ``run``, by default the first."""

    part: AskedPart = ""
    depth: AskedDepth = 0
    goal: str = ""
    run: str = ""
    success: Won = "any"
    page: int = 1


class ListedTask(Record):
    """A task with its number, and how many episodes an agent ``won`` of ``distractor_seeds``; None without results."""

    number: Count
    goal: str
    start: tuple[str, ...]
    plans: tuple[tuple[Recipe, ...], ...]
    won: Count | None
    distractor_seeds: Count | None


class TaskTable(Record):
    """Tasks for a depth and part, with ``counts`` by an agent's results; ``mixed`` tasks are outside all parts."""

    part: TaskPart
    depth: int
    tasks: Count
    is_complete: bool
    mixed: Count
    goal: str
    won: Won
    counts: dict[Won, Count]
    paging: Paging
    rows: tuple[ListedTask, ...]


class ShownTasks(Record):
    """The table of tasks, the agent's name, the reason for missing results, and the part shown by default."""

    run: str
    runs: tuple[str, ...]
    missing: str
    usual: TaskPart
    table: TaskTable


@dataclass(frozen=True)
class TaskResults:
    """Won and played episode counts, one for each distractor seed, for N tasks; shape (N,), int64."""

    won: Ids
    distractor_seeds: Ids

    @classmethod
    def of(cls, tasks: TaskSet, episodes: Iterable[PlayedTask]) -> "TaskResults":
        """Count an agent's evaluated episodes for each task in a task set."""
        played = {
            (one.goal, one.start): one.terminations for one in episodes if one.part == tasks.part
        }
        labels = np.array([*tasks.graph.entities, ""], dtype=object)
        starts = (tuple(filter(None, row)) for row in labels[tasks.starts].tolist())
        ends = [
            played.get(key, ()) for key in zip(labels[tasks.goals].tolist(), starts, strict=True)
        ]
        counts = [(terminations.count("goal"), len(terminations)) for terminations in ends]
        return cls(*np.array(counts, dtype=np.int64).reshape(-1, 2).T)

    def where(self, won: Won) -> NDArray[np.bool_]:
        """Return which tasks the agent always, sometimes or never solves, shape (N,), bool."""
        is_played, is_always, is_never = (
            self.distractor_seeds > 0,
            self.won == self.distractor_seeds,
            self.won == 0,
        )
        return {
            "any": np.ones_like(is_played),
            "always": is_played & is_always,
            "sometimes": is_played & ~is_always & ~is_never,
            "never": is_played & is_never,
        }[won]


def view_task_table(
    tasks: TaskSet,
    results: TaskResults | None = None,
    *,
    goal: str = "",
    won: Won = "any",
    page: int = 1,
) -> TaskTable:
    """List tasks page by page, optionally filtered by goal or by an agent's result."""
    results = results or TaskResults(*np.zeros((2, len(tasks)), dtype=np.int64))
    is_chosen = (
        np.ones(len(tasks), dtype=bool) if not goal else tasks.goals == tasks.graph.id_of(goal)
    )
    kinds: tuple[Won, ...] = (
        ("always", "sometimes", "never") if results.distractor_seeds[is_chosen].any() else ()
    )
    chosen = np.flatnonzero(is_chosen & results.where(won))
    shown = paging(len(chosen), page, TASKS_A_PAGE)
    return TaskTable(
        part=tasks.part,
        depth=tasks.depth,
        tasks=len(tasks),
        is_complete=tasks.is_complete,
        mixed=tasks.mixed,
        goal=goal,
        won=won,
        counts={kind: int((is_chosen & results.where(kind)).sum()) for kind in kinds},
        paging=shown,
        rows=tuple(_listed(tasks, results, number) for number in chosen[shown.rows].tolist()),
    )


def _listed(tasks: TaskSet, results: TaskResults, number: int) -> ListedTask:
    task, distractor_seeds = tasks[number], int(results.distractor_seeds[number])
    won = (int(results.won[number]), distractor_seeds) if distractor_seeds else (None, None)
    return ListedTask(number, task.goal, task.start, task.plans, *won)


def list_tasks(explored: Explored, state: TasksState) -> ShownTasks:
    """Return the page's values: tasks that fit its settings, with an agent's results."""
    name, run = explored.followed(state.run) if explored.runs or state.run else ("", None)
    tasks = explored.plain_world(
        explored.settings_of(explored.tasks_of(run), state.part, state.depth)
    ).tasks
    missing, results = "", None
    if run is not None and not (missing := _missing(name, run, tasks)):
        key = "results", name, run.records().run.ended, tasks.hash
        results = explored.once(key, lambda: TaskResults.of(tasks, run.episodes().values()))
    table = view_task_table(tasks, results, goal=state.goal, won=state.success, page=state.page)
    return ShownTasks(name, tuple(explored.runs), missing, explored.usual_part(), table)


def _missing(name: str, run: FollowedRun, tasks: TaskSet) -> str:
    try:
        records = run.records()
        if records.evaluation is None:
            return f"{name} is {records.run.status}: results per task follow the evaluation."
        if records.config.tasks.depth != tasks.depth:
            return f"{name} was evaluated on tasks of depth {records.config.tasks.depth}."
        if tasks.part not in records.evaluation.success:
            return f"{name} was evaluated on {' and '.join(records.evaluation.success)} tasks."
        run.episodes()
    except ArtefactError as error:
        return str(error)
    return ""


def _is_live(explored: Explored, state: TasksState) -> bool:
    return bool(explored.runs) and explored.is_any_live(state.run)


def _exported(explored: Explored) -> Iterator[TasksState]:
    # Only the first page for each agent: all pages would be too many files.
    yield from (TasksState(run=name) for name in ("", *explored.runs))


def _questions(explored: Explored) -> Iterator[tuple[str, TasksState]]:
    for name in explored.runs:
        with suppress(ArtefactError):
            played = explored.followed(name)[1].episodes().values()
            if any(
                task.part == explored.usual_part() and "goal" not in task.terminations
                for task in played
            ):
                yield f"Where does {name} fail?", TasksState(run=name, success="never")
                return


PAGE = Page(
    "tasks",
    TasksState,
    list_tasks,
    title="Tasks",
    exported=_exported,
    questions=_questions,
    is_live=_is_live,
)
