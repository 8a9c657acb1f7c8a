"""The task page: all tasks of a depth and part, and how often an agent solved each of them."""

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from wordcraft_kg.agents.agent_records import PlayedTask, TerminationReason
from wordcraft_kg.agents.following import FollowedRun
from wordcraft_kg.apps.explorer.explored import AskedDepth, AskedPart, Explored
from wordcraft_kg.apps.explorer.page import Page, PageState, Paging, paging
from wordcraft_kg.base import ArtefactError, Count, Record
from wordcraft_kg.graphs import Recipe, TaskPart, TaskSet

TASKS_A_PAGE = 50
Won = Literal["any", "always", "sometimes", "never"]
"""Share of distractor seeds with a solved task."""


class TasksState(PageState):
    """Page settings: filters for tasks, and an agent.

    Attributes:
        part: part of the tasks; empty for the usual part.
        depth: depth of the tasks, in crafts; 0 for the agent's training depth.
        goal: label of the goal; empty for all goals.
        run: name of the agent's run; empty for the first.
        success: how often the agent solved the tasks.
        page: page number in the list.
    """

    part: AskedPart = ""
    depth: AskedDepth = 0
    goal: str = ""
    run: str = ""
    success: Won = "any"
    page: int = 1


class ListedTask(Record):
    """A task with an agent's results.

    Attributes:
        number: number of the task among those of its depth and part.
        goal: label of the goal.
        start: labels of the starting ingredients.
        plans: plans that make the goal, as recipes in turn.
        won: number of episodes that made the goal; None if the agent has not played the task.
        distractor_seeds: number of episodes, one for each distractor seed; None if the agent has
            not played the task.
    """

    number: Count
    goal: str
    start: tuple[str, ...]
    plans: tuple[tuple[Recipe, ...], ...]
    won: Count | None
    distractor_seeds: Count | None


class TaskTable(Record):
    """Tasks for a depth and part.

    Attributes:
        part: part of the tasks.
        depth: depth of the tasks, in crafts.
        tasks: number of all tasks.
        is_complete: whether these are all existing tasks; otherwise a random sample.
        mixed: number of tasks outside all parts, because their recipes are of several parts.
        counts: number of tasks with the chosen goal, by an agent's results; empty if the agent has
            played none.
        paging: which tasks are on this page.
        rows: the tasks on this page.
    """

    part: TaskPart
    depth: int
    tasks: Count
    is_complete: bool
    mixed: Count
    counts: dict[Won, Count]
    paging: Paging
    rows: tuple[ListedTask, ...]


class ShownTasks(Record):
    """The table of tasks, with an agent's results.

    Attributes:
        run: name of the agent's run; empty without an agent.
        missing: reason for missing results; empty if there are results, and without an agent.
        table: the tasks.
    """

    run: str
    missing: str
    table: TaskTable


Outcomes = Sequence[tuple[TerminationReason, ...]]
"""How an agent's episodes of each task ended, one for each distractor seed; empty if not played."""


def outcomes_of(tasks: TaskSet, episodes: Iterable[PlayedTask]) -> Outcomes:
    """Return the outcomes of an agent's evaluated episodes for each task in a task set."""
    played = {
        (episode.goal, episode.start): episode.terminations
        for episode in episodes
        if episode.part == tasks.part
    }
    # Starting ingredients are padded with num_entities, here the index of the empty label.
    labels = np.array([*tasks.graph.entities, ""], dtype=object)
    pairs = zip(labels[tasks.goals], labels[tasks.starts].tolist(), strict=True)
    return [played.get((goal, tuple(filter(None, start))), ()) for goal, start in pairs]


def _solved(outcomes: tuple[TerminationReason, ...]) -> Won:
    """Return how often a task was solved; any for a task that was not played."""
    if not outcomes:
        return "any"
    if "goal" not in outcomes:
        return "never"
    return "always" if set(outcomes) == {"goal"} else "sometimes"


def view_task_table(
    tasks: TaskSet,
    results: Outcomes = (),
    *,
    goal: str = "",
    won: Won = "any",
    page: int = 1,
) -> TaskTable:
    """List tasks page by page.

    Args:
        tasks: all tasks of a depth and part.
        results: an agent's results for each of these tasks; empty without an agent.
        goal: label of the goal; empty for all goals.
        won: which tasks are listed, by the results.
        page: page number, from 1.

    Returns:
        the tasks on the page, in the order of the task set.

    Raises:
        UnknownEntityError: if the graph does not have the goal.
        ConfigError: if the list has no such page.
    """
    results = results or [()] * len(tasks)
    goal_id = tasks.graph.id_of(goal) if goal else None
    numbers = [
        number
        for number, task_goal in enumerate(tasks.goals.tolist())
        if goal_id in (None, task_goal)
    ]
    solved = {number: _solved(results[number]) for number in numbers}
    listed = [number for number in numbers if won in ("any", solved[number])]
    shown = paging(len(listed), page, TASKS_A_PAGE)
    # Without results, no counts: zeros would say that the agent fails.
    has_results = any(results[number] for number in numbers)
    kinds: tuple[Won, ...] = ("always", "sometimes", "never") if has_results else ()
    return TaskTable(
        part=tasks.part,
        depth=tasks.depth,
        tasks=len(tasks),
        is_complete=tasks.is_complete,
        mixed=tasks.mixed,
        counts={kind: list(solved.values()).count(kind) for kind in kinds},
        paging=shown,
        rows=tuple(_listed(tasks, results[number], number) for number in listed[shown.rows]),
    )


def _listed(tasks: TaskSet, outcomes: tuple[TerminationReason, ...], number: int) -> ListedTask:
    task = tasks[number]
    return ListedTask(
        number=number,
        goal=task.goal,
        start=task.start,
        plans=task.plans,
        won=outcomes.count("goal") if outcomes else None,
        distractor_seeds=len(outcomes) or None,
    )


def list_tasks(explored: Explored, state: TasksState) -> ShownTasks:
    """Return the page's values: tasks that fit its settings, with an agent's results.

    Raises:
        TaskError: if there are no such tasks.
        UnknownEntityError: if the graph does not have the goal, or no run has the name.
        ConfigError: if a setting is out of range.
    """
    name = ""
    run: FollowedRun | None = None
    # Tasks need no agent; but a name without runs is an error that tells how to start with one.
    if explored.runs or state.run:
        name, run = explored.followed(state.run)
    config = explored.settings_of(run, state.part, state.depth)
    tasks = explored.plain_world(config).tasks
    missing = ""
    results: Outcomes = ()
    if run is not None:
        missing = _missing(name, run, tasks)
        if not missing:
            # A run may be trained and evaluated again while the server runs: the time of its end
            # tells the two apart.
            key = ("results", name, run.records().run.ended, tasks.hash)
            episodes = run.episodes()
            results = explored.once(key, lambda: outcomes_of(tasks, episodes.values()))
    return ShownTasks(
        run=name,
        missing=missing,
        table=view_task_table(tasks, results, goal=state.goal, won=state.success, page=state.page),
    )


def _missing(name: str, run: FollowedRun, tasks: TaskSet) -> str:
    """Return the reason why an agent has no results for these tasks; empty if it has."""
    try:
        records = run.records()
        if records.evaluation is None:
            return f"{name} is {records.run.status}: results per task follow the evaluation."
        if records.config.tasks.depth != tasks.depth:
            return f"{name} was evaluated on tasks of depth {records.config.tasks.depth}."
        if tasks.part not in records.evaluation.success:
            return f"{name} was evaluated on {' and '.join(records.evaluation.success)} tasks."
        # The page shows damaged episodes as a reason, instead of an error page without tasks.
        run.episodes()
    except ArtefactError as error:
        return str(error)
    return ""


PAGE = Page(
    "tasks",
    TasksState,
    list_tasks,
    title="Tasks",
    # Only the first page for each agent: all pages would be too many files.
    exported=lambda explored: [TasksState(run=name) for name in ("", *explored.runs)],
)
