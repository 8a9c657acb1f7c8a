"""Judging players that use words like all others: on the same tasks, at the same tables, by the same counts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wordcraft_kg.agents.discovery import MARKS
from wordcraft_kg.agents.evaluation import Evaluation
from wordcraft_kg.agents.outcomes import ENDINGS
from wordcraft_kg.apps.text_agents.records import PlayedTask, PlayedWorld, WordsResult, WordsSettings
from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.envs.evaluation_tables import distance_of
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.arrays import Ids


def chosen_tasks(world: World, most: int | None) -> Ids:
    """Return the numbers of the tasks that are played: all, or at most ``most`` of them, evenly spaced.

    Raises:
        ConfigError: for a number below 1, as `tasks`.
    """
    if most is not None:
        whole("tasks", most, 1, MAX_SIZE)
    return np.arange(0, len(world.tasks), distance_of(len(world.tasks), most))


def evaluation_of(world: World | None, played: Sequence[PlayedTask]) -> Evaluation:
    """Return games as the evaluation of agents has them: N tasks with D draws each, all of them played.

    Without a world, the last pairs have no ids: they are -1. Figures and shares do not depend on them.

    Raises:
        ValueError: if a task lacks a draw that another one has.
    """
    tasks = np.array(sorted({one.task for one in played}), dtype=np.int64)
    draws = sorted({one.draw for one in played})
    if len(played) != len(tasks) * len(draws):
        raise ValueError(f"{len(played)} games of {len(tasks)} tasks with {len(draws)} draws: expected all of them")
    row = {int(task): place for place, task in enumerate(tasks)}
    column = {draw: place for place, draw in enumerate(draws)}
    shape, nothing = (len(tasks), len(draws)), -1 if world is None else world.nothing
    found = Evaluation(
        tasks,
        np.zeros(shape, dtype=bool),
        np.zeros(shape, dtype=bool),
        np.zeros(shape, dtype=np.int64),
        np.zeros(shape, dtype=np.int8),
        np.full((*shape, 2), nothing),
    )
    for one in played:
        place = row[one.task], column[one.draw]
        found.success[place], found.by_plan[place] = one.success, one.by_plan
        found.picks[place], found.endings[place] = one.picks, ENDINGS.index(one.ending)
        if one.last is not None and world is not None:
            found.last[place] = [world.graph.id_of(label) for label in one.last]
    return found


@dataclass(frozen=True)
class Tally:
    """What is counted over games of either kind."""

    refused: int
    lost: int
    look_ups: int

    @classmethod
    def of(cls, played: Sequence[PlayedTask] | Sequence[PlayedWorld]) -> "Tally":
        """Count."""
        return cls(*(sum(getattr(one, name) for one in played) for name in ("refused", "lost", "look_ups")))


def result_of_tasks(
    player: str, settings: WordsSettings, world: World | None, played: Sequence[PlayedTask]
) -> WordsResult:
    """Return the result of a player on tasks; the world is not needed for it."""
    found, tally = evaluation_of(world, played), Tally.of(played)
    return WordsResult(
        player=player,
        settings=settings,
        games=len(played),
        success=found.figures(),
        outcomes=found.shares(),
        known={},
        refused=tally.refused,
        lost=tally.lost,
        look_ups=tally.look_ups,
    )


def result_of_worlds(player: str, settings: WordsSettings, played: Sequence[PlayedWorld]) -> WordsResult:
    """Return the result of a player in the open-ended world.

    A game that ended before its attempts were used up keeps what it knew.
    """
    tally = Tally.of(played)
    return WordsResult(
        player=player,
        settings=settings,
        games=len(played),
        success=None,
        outcomes={},
        known=mean_known(played, settings.attempts, len(settings.base)),
        refused=tally.refused,
        lost=tally.lost,
        look_ups=tally.look_ups,
    )


def mean_known(played: Sequence[PlayedWorld], attempts: int, base: int) -> dict[int, float]:
    """Return how many entities are known on average after some numbers of attempts, the last of them ``attempts``."""
    marks = sorted({mark for mark in (*MARKS, attempts) if mark <= attempts})
    return {mark: float(np.mean([known_at(one, mark, base) for one in played])) for mark in marks}


def known_at(played: PlayedWorld, attempts: int, base: int) -> int:
    """Return how many entities were known after so many attempts, of ``base`` at the start."""
    after = played.known_after[:attempts]
    return after[-1] if after else base
