"""How difficult the tasks of the built-in book are, as measured by three players.

The file has a line for each task of the benchmark's splits and depths: the number of tables, out of
five with eight distractors, on which it was solved by nearest words, by a learner after a short
training, and by a planner. ``data/make_difficulty.py`` measures and writes it.
"""

import csv
import gzip
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base import ConfigError, number_in
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import Ids

FILE = Path(__file__).parent / "difficulty.csv.gz"
COLUMNS = ("split", "goal", "start", "words", "learner", "planner")
TABLES = 5
"""Tables of a task on which each player was measured."""


def task_keys(world: World) -> Iterator[tuple[str, ...]]:
    """Yield the key of each task in the file: split, goal and starting ingredients, by id."""
    split = world.split.hash[:12]
    for goal, start in zip(world.tasks.goals.tolist(), world.tasks.starts.tolist(), strict=True):
        yield split, str(goal), " ".join(map(str, start))


def measured_success(world: World) -> NDArray[np.float64]:
    """Return the success of words, learner and planner on each task, shape (T, 3), from 0 to 1.

    It is that with eight distractors, whatever the world's number.

    Raises:
        ConfigError: if a task was not measured.
    """
    counts = [_measured().get(key) for key in task_keys(world)]
    if None in counts:
        raise ConfigError(
            f"`difficulty`: {counts.count(None):,} of {len(counts):,} tasks of "
            f"{world.graph.name} were not measured; expected tasks of depth 1 or 2 of everyday, or "
            "of depth 1 of its split by-goal. data/make_difficulty.py measures tasks."
        )
    return np.array(counts) / TABLES


def tasks_within(world: World, limits: tuple[float, float]) -> Ids:
    """Return the indices of the tasks whose difficulty is in a range, ascending.

    The difficulty of a task is the share of games that the three players lose, each counted alike.

    Args:
        world: the world of the tasks.
        limits: least and largest difficulty, from 0 to 1.

    Raises:
        ConfigError: for another range, a task that was not measured, or if no task is left.
    """
    if not isinstance(limits, tuple | list) or len(limits) != 2:
        raise ConfigError(f"`difficulty` {limits!r}: expected two shares such as (.2, .8).")
    low, high = limits
    number_in("difficulty", low, 0, 1, "a share from 0 to 1")
    number_in("difficulty", high, low, 1, f"a share from {low:g} to 1")
    difficulty = 1 - measured_success(world).mean(axis=1)
    tasks = np.flatnonzero((difficulty >= low) & (difficulty <= high))
    if not len(tasks):
        raise ConfigError(f"`difficulty` {low:g}:{high:g} leaves no task; expected a wider range.")
    return tasks


def read_range(text: str | None) -> tuple[float, float] | None:
    """Parse a range of difficulty such as ``.2:.8``; None for none.

    Raises:
        ConfigError: for other text.
    """
    if text is None:
        return None
    low, _, high = text.partition(":")
    try:
        return float(low), float(high)
    except ValueError:
        raise ConfigError(f"`difficulty` '{text}': expected a range such as .2:.8.") from None


@cache
def _measured() -> dict[tuple[str, ...], list[int]]:
    """Return the counts of solved tables by task."""
    with gzip.open(FILE, "rt", encoding="utf-8") as file:
        _, *rows = csv.reader(file)
    return {tuple(row[:3]): list(map(int, row[3:])) for row in rows}
