"""An episode: the table, what agents thought at each pick, and what they would do at another table."""

from collections.abc import Iterator

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, State, has_runs
from wordcraft_kg.apps.explorer.pages.tasks import PAGE as TASKS
from wordcraft_kg.apps.explorer.pages.tasks import list_tasks
from wordcraft_kg.apps.explorer.played import AskedDepth, AskedPart, followed, is_done, settings_of, tasks_of, world_of
from wordcraft_kg.apps.explorer.views.episodes import EpisodeView, TableQuestion, view_episode
from wordcraft_kg.base.errors import WordCraftKGError
from wordcraft_kg.base.records import Count, Record

DRAWS = 5
"""Draws of distractors that are offered; those of the evaluation."""
MOST_ROWS = 160
"""Rows of slots on a page; of large tables and many agents only the best of each pick are shown."""


class Episode(State):
    """A table, and who is asked there.

    Attributes:
        run: the agent; by default the first one.
        other: agents to be compared with it.
        part: part of the task.
        depth: fewest attempts that solve it; 0 for that on which the agent was trained.
        task: number of the task among those of its depth and part.
        draw: draw of distractors.
        distractors: number of distractors; below 0 for as many as in training.
        goal: another goal than the task's.
        table: another table than the drawn one; empty texts count for nothing.
        held: what is held.
    """

    run: str = ""
    other: tuple[str, ...] = ()
    part: AskedPart = ""
    depth: AskedDepth = 0
    task: int = 0
    draw: int = 0
    distractors: int = -1
    goal: str = ""
    table: tuple[str, ...] = ()
    held: str = ""


class ShownEpisode(Record):
    """An episode, and what else could be asked.

    Attributes:
        runs: names of all agents.
        draws: draws that are offered.
        trained_with: distractors that the agent was trained with.
        most_slots: the most slots that are shown of each pick.
        episode: the episode.
    """

    runs: tuple[str, ...]
    draws: Count
    trained_with: Count
    most_slots: Count
    episode: EpisodeView


def _view(explored: Explored, state: Episode) -> ShownEpisode:
    name, run = followed(explored, state.run)
    tasks = tasks_of(run)
    distractors = None if state.distractors < 0 else state.distractors
    world = world_of(explored, settings_of(explored, tasks, state.part, state.depth, distractors))
    others = dict(followed(explored, other) for other in state.other if other)
    table = tuple(label for label in state.table if label)
    question = TableQuestion(state.task, state.draw, state.goal, table, state.held)
    found = view_episode(world, {name: run} | others, question)
    steps = sum(len(agent.found.episode.steps) for agent in found.agents if agent.found)
    return ShownEpisode(
        tuple(explored.runs),
        max(DRAWS, len(found.endings)),
        tasks.distractors,
        max(MOST_ROWS // steps, 4),
        found,
    )


def _is_live(explored: Explored, state: Episode) -> bool:
    return not all(is_done(followed(explored, name)[1]) for name in (state.run, *filter(None, state.other)))


def _exported(explored: Explored) -> Iterator[Episode]:
    """Yield the episodes of the tasks that a site of files lists."""
    for tasks in TASKS.states(explored):
        try:
            followed(explored, tasks.run)[1].agent()  # one that has no weights yet cannot be asked
            rows = list_tasks(explored, tasks).table.rows
        except WordCraftKGError:
            continue
        yield from (Episode(run=tasks.run, task=row.number) for row in rows)


PAGE = Page("episode", Episode, _view, "Episodes", exported=_exported, is_there=has_runs, is_live=_is_live)
