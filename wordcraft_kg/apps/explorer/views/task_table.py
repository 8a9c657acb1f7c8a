"""The tasks of a graph page by page, with how an agent did."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.agents.records import PlayedTask
from wordcraft_kg.apps.explorer.views.paging import Paging, paging
from wordcraft_kg.base.errors import ArtefactError, UnknownEntityError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.tasks import TaskPart, TaskSet

TASKS_A_PAGE = 50
Won = Literal["any", "always", "sometimes", "never"]
"""With how many of the draws of distractors a task was solved."""


class ListedTask(Record):
    """A task, its plans, and how an agent did.

    Attributes:
        number: its number among the tasks of its depth and part.
        won: draws of distractors with which the agent made the goal; None if it has not played the task.
        draws: draws that it played; None if it has not.
    """

    number: Count
    goal: str
    start: tuple[str, ...]
    plans: tuple[tuple[Recipe, ...], ...]
    won: Count | None
    draws: Count | None


class TaskTable(Record):
    """Some tasks of a depth and part.

    Attributes:
        tasks: number of all tasks.
        is_complete: whether these are all that there are; otherwise they were drawn at random.
        mixed: number of tasks that belong to no part.
        goal: the goal of those that are listed; empty for any.
        won: with how many of the draws those that are listed were solved.
        counts: number of the goal's tasks by how often the agent solved them; empty if it has played none.
        paging: which are shown.
    """

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


@dataclass(frozen=True)
class TaskResults:
    """How an agent did on each of N tasks.

    Attributes:
        won: shape (N,), int64: draws with which it made the goal.
        draws: shape (N,), int64: draws that it played; 0 for a task that it has not played.
    """

    won: Ids
    draws: Ids

    @classmethod
    def of(cls, tasks: TaskSet, episodes: Iterable[PlayedTask]) -> "TaskResults":
        """Find the tasks of an evaluation among those of a set.

        Raises:
            ArtefactError: if one names what is not in the graph.
        """
        nothing, width = tasks.graph.num_entities, tasks.starts.shape[1]
        keys = np.column_stack([tasks.goals, tasks.starts])
        number = {key.tobytes(): place for place, key in enumerate(keys)}
        results = cls(np.zeros(len(tasks), dtype=np.int64), np.zeros(len(tasks), dtype=np.int64))
        for played in episodes:
            if played.part != tasks.part or len(played.start) > width:
                continue
            try:
                goal, *start = (tasks.graph.id_of(label) for label in (played.goal, *played.start))
            except UnknownEntityError as error:
                raise ArtefactError(f"the run's episodes are of another graph: {error}") from None
            padding = [nothing] * (width - len(start))
            place = number.get(np.array([goal, *sorted(start), *padding], dtype=np.int64).tobytes())
            if place is not None:
                results.won[place], results.draws[place] = played.endings.count("goal"), len(played.endings)
        return results

    def where(self, won: Won) -> NDArray[np.bool_]:
        """Return which tasks were solved so often, shape (N,); all for ``any``."""
        is_played, is_always, is_never = self.draws > 0, self.won == self.draws, self.won == 0
        return {
            "any": np.ones_like(is_played),
            "always": is_played & is_always,
            "sometimes": is_played & ~is_always & ~is_never,
            "never": is_played & is_never,
        }[won]


def view_task_table(
    tasks: TaskSet, results: TaskResults | None = None, *, goal: str = "", won: Won = "any", page: int = 1
) -> TaskTable:
    """List tasks page by page.

    Args:
        tasks: all tasks of a depth and part.
        results: how an agent did on them.
        goal: only tasks with this goal; empty for any.
        won: only tasks that the agent solved so often.
        page: number of the page.

    Raises:
        UnknownEntityError: if there is no such goal.
        ConfigError: if there is no such page.
    """
    results = results or TaskResults(*np.zeros((2, len(tasks)), dtype=np.int64))
    is_asked = np.ones(len(tasks), dtype=bool) if not goal else tasks.goals == tasks.graph.id_of(goal)
    kinds: tuple[Won, ...] = ("always", "sometimes", "never") if results.draws[is_asked].any() else ()
    chosen = np.flatnonzero(is_asked & results.where(won))
    found = paging(len(chosen), page, TASKS_A_PAGE)
    return TaskTable(
        part=tasks.part,
        depth=tasks.depth,
        tasks=len(tasks),
        is_complete=tasks.is_complete,
        mixed=tasks.mixed,
        goal=goal,
        won=won,
        counts={kind: int((is_asked & results.where(kind)).sum()) for kind in kinds},
        paging=found,
        rows=tuple(_listed(tasks, results, number) for number in chosen[found.rows].tolist()),
    )


def _listed(tasks: TaskSet, results: TaskResults, number: int) -> ListedTask:
    task, draws = tasks[number], int(results.draws[number])
    won = (int(results.won[number]), draws) if draws else (None, None)
    return ListedTask(number, task.goal, task.start, task.plans, *won)
