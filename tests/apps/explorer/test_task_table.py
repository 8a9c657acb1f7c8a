"""The table of tasks: all tasks, with how often an agent solved each; only shown
tasks get labels."""

import numpy as np
import pytest

from wordcraft_kg.agents.evaluation import Evaluator
from wordcraft_kg.agents.players import random_entity
from wordcraft_kg.agents.records import PlayedTask
from wordcraft_kg.apps.explorer.pages.tasks import (
    TASKS_A_PAGE,
    ListedTask,
    TaskResults,
    view_task_table,
)
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.task_search import make_tasks


def played_at_random(opened, depth):
    """Episodes of chance, as a run records them; of every third task none."""
    world = World(opened, WordCraftConfig(part="train", depth=depth, num_distractors=0))
    success, lines = Evaluator(world, distractor_seeds=4)(random_entity).success, []
    for number in (number for number in range(len(world.tasks)) if number % 3):
        task, won = world.tasks[number], success[number].tolist()
        terminations = tuple("goal" if one else "no_recipe" for one in won)
        lines.append(
            PlayedTask("train", task.goal, task.start, float(np.mean(won)), terminations, (2,) * 4)
        )
    return world.tasks, lines


@pytest.mark.parametrize("depth", [1, 2])
def test_all_tasks_are_listed_once_with_how_often_they_were_solved(opened, depth):
    tasks, lines = played_at_random(opened, depth)
    results = TaskResults.of(tasks, reversed(lines))
    by_task = {(line.goal, line.start): line.terminations for line in lines}
    pages = view_task_table(tasks, results).paging.pages
    rows = [
        row
        for page in range(1, pages + 1)
        for row in view_task_table(tasks, results, page=page).rows
    ]
    assert [row.number for row in rows] == list(range(len(tasks)))
    for row, task in zip(rows, tasks, strict=True):
        terminations = by_task.get((task.goal, task.start))
        won = (None, None) if terminations is None else (terminations.count("goal"), 4)
        assert row == ListedTask(row.number, task.goal, task.start, task.plans, *won)
    found = view_task_table(tasks, results)
    assert sum(found.counts.values()) == len(lines)
    for kind, holds in (
        ("always", lambda row: row.won == 4),
        ("never", lambda row: row.won == 0),
        ("sometimes", lambda row: row.won is not None and 0 < row.won < 4),
    ):
        expected = [row for row in rows if holds(row)]
        chosen = view_task_table(tasks, results, won=kind)
        assert (chosen.counts, chosen.paging.total) == (found.counts, len(expected))
        assert chosen.counts[kind] == len(expected)
        assert list(chosen.rows) == expected[:TASKS_A_PAGE]
        assert expected or (tasks.depth, kind) == (2, "always")  # which chance hardly does


def test_drawn_tasks_are_said_to_be_drawn(opened):
    tasks = make_tasks(opened.graph, 3, opened.split, "train", limit=70)
    found = view_task_table(tasks)
    assert (found.tasks, found.is_complete, found.paging.pages) == (70, False, 2)
    assert view_task_table(make_tasks(opened.graph, 1)).is_complete
