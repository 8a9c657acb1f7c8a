"""How difficult the tasks of the built-in book are, as measured by three players.

The file has a line for each task of the benchmark's splits and depths: the number of tables, out of
five with eight distractors, on which it was solved by nearest words, by a learner after a short
training, and by a planner. ``data/make_difficulty.py`` measures and writes it.
"""

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from wordcraft_kg.base import ConfigError, number_in
from wordcraft_kg.envs.world import World

FILE = Path(__file__).parent / "difficulty.csv.gz"
KEY = ("split", "goal", "start")
PLAYERS = ("words", "learner", "planner")
COLUMNS = (*KEY, *PLAYERS)
TABLES = 5
"""Tables of a task on which each player was measured."""
Range = tuple[float, float]
"""The least and the largest difficulty of tasks, from 0 to 1."""


def task_keys(world: World) -> Iterator[tuple[str, int, str]]:
    """Yield the key of each task in the file: split, goal and starting ingredients, by id."""
    split = world.split.hash[:12]
    for goal, start in zip(world.tasks.goals.tolist(), world.tasks.starts.tolist(), strict=True):
        yield split, goal, " ".join(map(str, start))


def measured_success(world: World) -> NDArray[np.float64]:
    """Return the measured success of :data:`PLAYERS` on each task, shape (T, 3), from 0 to 1.

    Args:
        world: a world with eight distractors or any other number: they were measured with eight.

    Raises:
        ConfigError: if a task was not measured.
    """
    measured = _file()
    counts = [measured.get(key) for key in task_keys(world)]
    if None in counts:
        raise ConfigError(
            f"`difficulty`: {counts.count(None):,} of {len(counts):,} tasks of "
            f"{world.graph.name} were not measured; expected tasks of depth 1 or 2 of everyday, by "
            "its split or by-goal. Measure others with data/make_difficulty.py."
        )
    return np.array(counts) / TABLES


def tasks_within(world: World, limits: Range) -> NDArray[np.int64]:
    """Return the indices of the tasks whose difficulty is in a range, ascending.

    The difficulty of a task is the share of games that the three players lose, each counted alike.

    Raises:
        ConfigError: for another range, a task that was not measured, or if no task is left.
    """
    low, high = limits
    number_in("difficulty", low, 0, 1, "a share from 0 to 1")
    number_in("difficulty", high, low, 1, f"a share from {low:g} to 1")
    difficulty = 1 - measured_success(world).mean(axis=1)
    tasks = np.flatnonzero((difficulty >= low) & (difficulty <= high))
    if not len(tasks):
        raise ConfigError(
            f"`difficulty` {low:g}:{high:g}: no task is left; expected a wider range."
        )
    return tasks


def read_range(text: str | None) -> Range | None:
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
def _file() -> dict[tuple[str, int, str], tuple[int, ...]]:
    frame = pd.read_csv(FILE)
    keys = frame[list(KEY)].itertuples(index=False, name=None)
    return dict(zip(keys, frame[list(PLAYERS)].itertuples(index=False, name=None), strict=True))
