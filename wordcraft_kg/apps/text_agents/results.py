"""Resumable evaluation of text agents, with the metrics of trained agents.

Each game is on disk before the next one begins: a language model's games are expensive, and a
machine may stop at any time.
"""

import logging
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wordcraft_kg.agents.agent_records import TERMINATION_REASONS
from wordcraft_kg.agents.discovery import LATER_MARKS, MARKS
from wordcraft_kg.apps.text_agents.conversation import converse
from wordcraft_kg.apps.text_agents.game_records import (
    GAMES_FILE,
    GameRecord,
    GamesHeader,
    append_game,
    open_games,
    read_games,
    record_of,
)
from wordcraft_kg.apps.text_agents.games import TaskGames
from wordcraft_kg.apps.text_agents.plays import Play, chosen_tasks
from wordcraft_kg.apps.text_agents.text_players import LinePlayer, TextPlayer
from wordcraft_kg.base import (
    ArtefactError,
    PlayerError,
    WordCraftKGError,
    counted,
    steps,
)
from wordcraft_kg.envs.draws import EvaluationTables, sampled_tasks
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import Ids
from wordcraft_kg.runs.run_folder import locked_folder, sigterm_as_interrupt

if TYPE_CHECKING:
    from wordcraft_kg.agents.evaluation import Evaluation
    from wordcraft_kg.evaluation.agents import ExternalPlayer


def evaluation_of(played: Sequence[GameRecord], groups: Ids | None = None) -> "Evaluation":
    """Convert the records of N tasks with D distractor seeds each to an evaluation, shape (N, D).

    The last pairs have no ids (-1), because records need no graph; no metric depends on them.

    Args:
        played: the records, in any order.
        groups: resampling group of each task of the world, see :attr:`World.groups`; None if each
            task is a group of its own.

    Raises:
        ValueError: if a task lacks a distractor seed that another one has.
    """
    from wordcraft_kg.agents.evaluation import Evaluation  # loads torch

    tasks = np.array(sorted({game.task for game in played}), dtype=np.int64)
    seeds = {game.distractor_seed for game in played}
    shape = (len(tasks), len(seeds))
    if len(played) != shape[0] * shape[1]:
        raise ValueError(
            f"{len(played)} games: expected {shape[0]} tasks with {shape[1]} distractor seeds each"
        )
    # Sorted by task, then by seed, so that a reshaping gives a row for each task.
    games = sorted(played, key=lambda game: (game.task, game.distractor_seed))
    terminations = [TERMINATION_REASONS.index(game.termination or "no_recipe") for game in games]
    return Evaluation(
        tasks,
        tasks if groups is None else groups[tasks],
        np.array([game.success for game in games], dtype=bool).reshape(shape),
        np.array([game.by_plan for game in games], dtype=bool).reshape(shape),
        np.array([game.actions for game in games], dtype=np.int64).reshape(shape),
        np.array(terminations, dtype=np.int8).reshape(shape),
        np.full((*shape, 2), -1),
        np.full(shape, -1),
    )


def mean_known(curves: Sequence[Sequence[int]], attempts: int) -> dict[int, float]:
    """Return the mean number of known entities after some numbers of attempts.

    Args:
        curves: for each game the number of known entities at the start and after each attempt. A
            curve may end early: the game keeps what it knew.
        attempts: attempts in a game, the last of the numbers.
    """
    before = [mark for mark in (*MARKS, *LATER_MARKS) if mark < attempts]
    means: dict[int, float] = {}
    for mark in sorted({attempts, *before}):
        counts = [curve[: mark + 1][-1] for curve in curves]
        means[mark] = float(np.mean(counts))
    return means


def _in_turn(
    play: Callable[[tuple[int, int]], GameRecord], games: list[tuple[int, int]], parallel: int
) -> Iterator[GameRecord]:
    """Play games, some at a time, and yield their records in the order of the games."""
    if parallel == 1:
        # A program plays in this thread: a signal that ends the command ends its game.
        yield from map(play, steps("playing", games))
        return
    with ThreadPoolExecutor(parallel) as pool:
        records = pool.map(play, games)
        try:
            for _ in steps("playing", games):
                yield next(records)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def play_all(
    player: TextPlayer,
    play: Play,
    folder: Path,
    tasks: Sequence[int] | None = None,
    *,
    parallel: int = 1,
    is_replacing: bool = False,
) -> list[GameRecord]:
    """Let a player play all games, or continue an interrupted evaluation.

    Args:
        player: the player.
        play: the games.
        folder: folder for the games.
        tasks: indices of the tasks; None for those of the settings.
        parallel: games at a time, each in a thread; they are recorded in the order of the tasks.
        is_replacing: whether games of another player or other settings, and complete games, are
            played anew.

    Returns:
        The records of all games, in the order in which they were played.

    Raises:
        ArtefactError: if the folder's games are damaged or changed, or the folder is in use by
            another process.
        GraphMismatchError: if the folder's games are of another graph or split.
        ConfigError: if they are of another player or other settings.
    """
    path = folder / GAMES_FILE
    settings = play.settings
    if tasks is None:
        tasks = [0]
        if isinstance(play.games, TaskGames):
            tasks = chosen_tasks(play.world, settings.tasks).tolist()
    # A dict as an ordered set: games are played seed by seed.
    missing = dict.fromkeys(
        (task, seed) for seed, task in product(range(settings.distractor_seeds), tasks)
    )
    # Two processes that play at once would play the same games.
    with locked_folder(folder, "written"):
        # Not to write through a link: the file that it names may be anyone's.
        if path.is_symlink():
            raise ArtefactError(f"{path} is a link; expected a file. Choose another `out`.")
        header = GamesHeader(player=player.name, settings=settings)
        if is_replacing and not _is_begun(path, header, len(missing)):
            path.unlink(missing_ok=True)
        played = open_games(path, header)
        for line, game in enumerate(played, 2):
            key = (game.task, game.distractor_seed)
            # A game twice would count twice; a game of other tasks is not part of the result.
            if key not in missing:
                raise ArtefactError(
                    f"{path}, line {line}, is damaged: the game is a duplicate, or not part of the "
                    "evaluation. "
                    "Remove the line."
                )
            del missing[key]

        def play_game(task_and_seed: tuple[int, int]) -> GameRecord:
            conversation = play.begin(*task_and_seed)
            converse(conversation, player.speaker(conversation))
            return record_of(conversation, task_and_seed[1])

        for record in _in_turn(play_game, list(missing), parallel):
            played.append(record)
            append_game(path, record)
    return played


def _is_begun(path: Path, header: GamesHeader, most: int) -> bool:
    """Return whether a file has the beginning of these games, and not all of them."""
    try:
        stored_header, played, _ = read_games(path)
    except ArtefactError:  # missing or damaged
        return False
    return stored_header == header and len(played) < most


@contextmanager
def continuable(folder: Path) -> Iterator[None]:
    """Say, when games are interrupted or their player fails, how they are continued.

    Args:
        folder: folder for the games, at any depth.

    Raises:
        KeyboardInterrupt, PlayerError: as in the block, with the way to continue.
        ArtefactError: for an OSError in the block, such as of a full disk, if there are games.
    """
    with sigterm_as_interrupt():
        try:
            yield
        except (KeyboardInterrupt, PlayerError, OSError) as error:
            has_games = any(folder.rglob(GAMES_FILE))
            goes_on = f" Finished games are in {folder}; repeat the command to continue."
            hint = goes_on if has_games else ""
            if isinstance(error, KeyboardInterrupt):
                raise KeyboardInterrupt(f"interrupted.{hint}") from None
            if isinstance(error, PlayerError):
                raise PlayerError(f"{error}{hint}") from None
            if isinstance(error, WordCraftKGError) or not has_games:
                raise
            raise ArtefactError(f"{folder}: {error.strerror or error}.{hint}") from None


def evaluate_program(
    player: "ExternalPlayer", worlds: Sequence[World], tables: int, limit: int
) -> tuple[str, list["Evaluation"]]:
    """Let a program play the tasks of agent evaluation, on the same tables.

    The games of each world are in a folder of their own; the same call continues them.

    Args:
        player: the program, as ``program:COMMAND``.
        worlds: worlds that differ in the number of distractors.
        tables: tables for each task.
        limit: most tasks; of more, evenly spaced ones are played.

    Returns:
        The program's name, and its results in each world.

    Raises:
        PlayerError: if the program does not start, ends early or does not answer in time.
        ConfigError: if a folder has games of another player or other settings.
        ArtefactError: if a folder's games are damaged, or another process plays there.
    """
    results = []
    with LinePlayer(player.name.partition(":")[2], timeout=player.timeout) as program:
        # A name may hold separators or `..`; the folder is always one below text-agents.
        file_name = re.sub(r"[^\w.+ -]", "-", program.name).strip(". ") or "player"
        folder = player.out or Path("text-agents") / file_name
        with continuable(folder):
            for world in worlds:
                tasks = sampled_tasks(world, limit)
                play = Play.of(
                    TaskGames(world, EvaluationTables(world, limit).table),
                    distractor_seeds=tables,
                    tasks=None if len(tasks) == len(world.tasks) else len(tasks),
                )
                games = folder / f"distractors-{world.config.num_distractors}"
                played = play_all(program, play, games, tasks.tolist())
                results.append(evaluation_of(played, world.groups))
                _log_answers(program.name, played)
    return program.name, results


def _log_answers(name: str, played: Sequence[GameRecord]) -> None:
    invalid = sum(game.invalid_actions for game in played)
    lost = sum(game.lost_attempts for game in played)
    if invalid:
        logging.getLogger(__name__).warning(
            "%s: %s, %s lost", name, counted(invalid, "invalid answer"), counted(lost, "attempt")
        )
