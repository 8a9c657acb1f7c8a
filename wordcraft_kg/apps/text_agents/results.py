"""Text agents' results, with the same metrics as for trained agents."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from wordcraft_kg.agents.discovery import MARKS
from wordcraft_kg.agents.outcomes import TERMINATION_REASONS, TerminationReason
from wordcraft_kg.apps.text_agents.conversation import Conversation
from wordcraft_kg.apps.text_agents.games import DiscoveryGame, TaskGame
from wordcraft_kg.apps.text_agents.records import (
    GAMES_FILE,
    RESULT_FILE,
    GamesHeader,
    PlayedSettings,
    PlayedTask,
    PlayedWorld,
    TextResult,
)
from wordcraft_kg.base.artefacts import read_large_file, sha256_of
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import parse_lines, parse_record, read_record
from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.arrays import Ids

if TYPE_CHECKING:
    from wordcraft_kg.agents.evaluation import Evaluation

COUNTS = ("invalid_actions", "lost_attempts", "look_ups")
"""Fields in the record of a game that are summed over games."""


def chosen_tasks(world: World, most: int | None) -> Ids:
    """Return the indices of all tasks in a world, or of ``most`` (1 or more) evenly spaced tasks."""
    if most is not None:
        whole("tasks", most, 1, MAX_SIZE)
    number = len(world.tasks)
    most = number if most is None else min(most, number)
    return np.arange(most) * number // most


def record_of(talk: Conversation, messages: Sequence[str], number: int = 0) -> PlayedTask | PlayedWorld:
    """Return the record of the finished game in a conversation; ``number`` is the index of an open-ended game."""
    game = talk.game
    counts = {**{name: getattr(talk, name) for name in COUNTS}, "messages": tuple(messages)}
    if isinstance(game, DiscoveryGame):
        return PlayedWorld(game=number, known_after=tuple(game.known_after), repeated=game.repeated, **counts)
    assert isinstance(game, TaskGame)
    return PlayedTask(
        task=game.task,
        distractor_seed=game.distractor_seed,
        goal=game.goal,
        table=game.start,
        success=game.is_made,
        by_plan=game.by_plan,
        actions=game.actions,
        termination=_termination_of(game),
        last=game.last,
        **counts,
    )


def _termination_of(game: TaskGame) -> TerminationReason:
    if game.is_made:
        return "goal"
    if game.last is None:
        return "no_recipe"
    one, other = map(game.graph.id_of, game.last)
    parts = {part for plan in game.tasks.plans[game.task] for part in game.graph.recipes[plan[-1], :2].tolist()}
    if one == other:
        return "same_twice"
    if {one, other} & parts:
        return "one_right_part"
    return "no_right_part" if (min(one, other), max(one, other)) in game.graph.outcomes else "no_recipe"


def evaluation_of(played: Sequence[PlayedTask]) -> "Evaluation":
    """Convert the records of N tasks with D distractor seeds each to an evaluation, without last pairs (-1)."""
    from wordcraft_kg.agents.evaluation import Evaluation  # loads torch

    tasks = np.array(sorted({one.task for one in played}), dtype=np.int64)
    shape = len(tasks), len({one.distractor_seed for one in played})
    if len(played) != shape[0] * shape[1]:
        raise ValueError(f"{len(played)} games: expected {shape[0]} tasks with {shape[1]} distractor seeds each")
    games = sorted(played, key=lambda one: (one.task, one.distractor_seed))
    return Evaluation(
        tasks,
        np.array([one.success for one in games], dtype=bool).reshape(shape),
        np.array([one.by_plan for one in games], dtype=bool).reshape(shape),
        np.array([one.actions for one in games], dtype=np.int64).reshape(shape),
        np.array([TERMINATION_REASONS.index(one.termination) for one in games], dtype=np.int8).reshape(shape),
        np.full((*shape, 2), -1),
    )


def mean_known(played: Sequence[PlayedWorld], attempts: int, base: int) -> dict[int, float]:
    """Return the mean number of known entities by number of attempts; all games start with ``base`` known entities.

    Games that ended early keep the last number.
    """
    marks = sorted({mark for mark in (*MARKS, attempts) if mark <= attempts})
    after = {mark: [(base, *one.known_after[:mark])[-1] for one in played] for mark in marks}
    return {mark: float(np.mean(known)) for mark, known in after.items()}


def result_of(player: str, settings: PlayedSettings, played: Sequence[PlayedTask | PlayedWorld]) -> TextResult:
    """Return a player's result: metrics and counts over all recorded games."""
    counts = {name: sum(getattr(one, name) for one in played) for name in COUNTS}
    worlds = [one for one in played if isinstance(one, PlayedWorld)]
    tasks = [one for one in played if isinstance(one, PlayedTask)]
    evaluation = None if settings.is_open_ended else evaluation_of(tasks)
    return TextResult(
        player=player,
        settings=settings,
        games=len(played),
        success=evaluation.figures() if evaluation else None,
        outcomes=evaluation.shares() if evaluation else {},
        known={} if evaluation else mean_known(worlds, settings.attempts, len(settings.base)),
        **counts,
    )


def read_games(path: Path) -> tuple[GamesHeader, Sequence[PlayedTask | PlayedWorld], bytes]:
    """Return the header, the games and the incomplete last line (empty if complete) in a games file."""
    lines, _, torn = read_large_file(path).rpartition(b"\n")
    first, _, rest = lines.partition(b"\n")
    header = parse_record(first, GamesHeader, f"{path}, line 1,")
    kind: type[PlayedTask | PlayedWorld] = PlayedWorld if header.settings.is_open_ended else PlayedTask
    return header, parse_lines(rest, kind, f"{path} (after line 1)"), torn


def read_result(folder: Path) -> TextResult:
    """Read a text agent's metrics from an output folder; ArtefactError unless its games give the same metrics."""
    result, path = read_record(folder / RESULT_FILE, TextResult), folder / GAMES_FILE
    if path.is_file():
        header, played, _ = read_games(path)
        try:
            expected = result_of(header.player, header.settings, played)
        except ValueError as error:
            raise ArtefactError(f"{path} was edited: {error}. Restore a copy.") from None
        if result != msgspec.structs.replace(expected, games_hash=sha256_of(path)):
            raise ArtefactError(f"'{folder}': {RESULT_FILE} is not the result of {GAMES_FILE}. Restore a copy.")
    return result
