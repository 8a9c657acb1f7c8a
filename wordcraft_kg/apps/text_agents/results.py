"""Games of text agents on disk: records, resumable evaluation, the metrics of trained agents.

Each game is on disk before the next one begins: a language model's games are expensive, and a
machine may stop at any time.
"""

import logging
import os
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from wordcraft_kg.agents.discovery import LATER_MARKS, MARKS
from wordcraft_kg.apps.text_agents.conversation import Conversation
from wordcraft_kg.apps.text_agents.games import DiscoveryGame, TaskGame
from wordcraft_kg.apps.text_agents.plays import Play, TaskGames, chosen_tasks
from wordcraft_kg.apps.text_agents.settings import PlayedSettings
from wordcraft_kg.apps.text_agents.text_players import LinePlayer, TextPlayer
from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    Count,
    PlayerError,
    Record,
    as_lines,
    as_values,
    check_file,
    counted,
    made_folder,
    parse_lines,
    parse_record,
    read_large_file,
    steps,
)
from wordcraft_kg.base.wording import for_file
from wordcraft_kg.envs.draws import EvaluationTables, sampled_tasks
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import Ids
from wordcraft_kg.runs.run_folder import locked, locked_folder, sigterm_as_interrupt

if TYPE_CHECKING:
    from wordcraft_kg.agents.evaluation import Evaluation
    from wordcraft_kg.evaluation.agents import ExternalPlayer


GAMES_FILE = "games.jsonl"
COUNTS = ("invalid_actions", "lost_attempts", "look_ups")


class GamesHeader(Record, frozen=True, kw_only=True):
    """The first line in a ``games.jsonl`` file, before the games.

    Attributes:
        format: format of the file.
        player: the player's name, such as a program's or a language model's.
        settings: settings of all games in the file.
    """

    format: Literal["wordcraft-kg text games 3"] = "wordcraft-kg text games 3"
    player: str
    settings: PlayedSettings


class GameRecord(Record, frozen=True, kw_only=True):
    """A finished game: a line in ``games.jsonl``.

    Attributes:
        task: index of the task in its part; 0 in the open-ended world.
        distractor_seed: seed of the distractors on the table, or number of the open-ended game.
        goal: label of the entity to make; None in the open-ended world.
        table: labels at the start, in slot order; empty in the open-ended world.
        success: whether the goal was made.
        by_plan: whether a plan's last pair made the goal.
        actions: number of actions (choices of an entity) in a task until the end.
        known_after: number of known entities after each attempt in the open-ended world.
        invalid_actions: number of messages that were not understood.
        lost_attempts: number of attempts lost by them.
        look_ups: number of entities that were looked up.
        messages: all prompts and answers in turn; empty in Inspect's logs, which have their own.
        pairs: labels of all combined pairs or sets in turn, None for a lost attempt.
    """

    task: Count = 0
    distractor_seed: Count = 0
    goal: str | None = None
    table: tuple[str, ...] = ()
    success: bool = False
    by_plan: bool = False
    actions: Count = 0
    known_after: tuple[Count, ...] = ()
    invalid_actions: Count = 0
    lost_attempts: Count = 0
    look_ups: Count = 0
    messages: tuple[str, ...] = ()
    pairs: tuple[tuple[str, ...] | None, ...]


def read_games(path: Path) -> tuple[GamesHeader, Sequence[GameRecord], bytes]:
    """Read a games file without changing it.

    Returns:
        The header, the games, and the bytes of an incomplete last line (empty if complete), which
        is from a process that was killed.

    Raises:
        ArtefactError: if the file is missing, of another kind, or damaged.
    """
    lines, _, torn = read_large_file(path).rpartition(b"\n")
    header_line, _, records = lines.partition(b"\n")
    header = parse_record(header_line, GamesHeader, f"{path}, line 1,")
    return header, parse_lines(records, GameRecord, f"{path} (after line 1)"), torn


def open_games(path: Path, header: GamesHeader) -> list[GameRecord]:
    """Create a games file with this header, or return the games in an existing file.

    An incomplete last line is cut off. The file is unchanged on errors.

    Args:
        path: the file.
        header: player and settings of the games.

    Raises:
        ArtefactError: if the file is of another kind or damaged.
        ConfigError: if its games are of another player, graph, split or other settings.
    """
    if path.exists() and path.stat().st_size:
        stored_header, played, torn = read_games(path)
        # Without games, nothing is lost by new settings.
        if played or stored_header == header:
            _check_header(path, stored_header, header)
            if torn:
                logging.getLogger(__name__).warning(
                    "%s ended in a torn line, which was dropped; the game is played again", path
                )
                os.truncate(path, path.stat().st_size - len(torn))
            return [*played]
    path.write_bytes(b"")
    append_game(path, header)
    return []


def append_game(path: Path, played: Record) -> None:
    """Append the record of a game; it is on disk when this returns.

    Raises:
        OSError: if it cannot be written, such as on a full disk; the file is unchanged.
    """
    size = path.stat().st_size
    try:
        with path.open("ab") as file:
            file.write(as_lines([played])[0].encode())
            file.flush()
            # Survives a power failure, too.
            os.fsync(file.fileno())
    except OSError:
        # A part of the line may be there, and the next record would be glued to it.
        with suppress(OSError):
            os.truncate(path, size)
        raise


def _check_header(path: Path, stored: GamesHeader, header: GamesHeader) -> None:
    before = {"player": stored.player, **as_values(stored.settings)}
    # Graph and split come first: another graph may also differ in settings.
    for name, value in {"player": header.player, **as_values(header.settings)}.items():
        if before[name] != value:
            raise ConfigError(
                f"'{path}' holds games with `{name}` {before[name]}, and this command has {value}. "
                "Choose another `out`, or use the same settings."
            )


def record_of(talk: Conversation) -> GameRecord:
    """Return the record of the finished game in a conversation."""
    game = talk.game
    counts = {name: getattr(talk, name) for name in COUNTS}
    # A record is written whatever the player says: a game without one could be played again.
    messages = tuple(map(for_file, talk.messages))
    pairs = tuple(game.pairs)
    if isinstance(game, DiscoveryGame):
        return GameRecord(
            distractor_seed=game.number,
            known_after=tuple(game.known_after),
            messages=messages,
            pairs=pairs,
            **counts,
        )
    assert isinstance(game, TaskGame)
    return GameRecord(
        task=game.task,
        distractor_seed=game.distractor_seed,
        goal=game.goal,
        table=game.start,
        success=game.is_made,
        by_plan=game.by_plan,
        actions=game.actions,
        messages=messages,
        pairs=pairs,
        **counts,
    )


Keep = Callable[[Conversation], None]
"""Records a finished game; a further call only tries again what an OSError has left."""


@contextmanager
def games_writer(path: Path, header: GamesHeader) -> Iterator[Keep]:
    """Lock a games file, and yield a function that appends a finished game with its messages.

    The function raises OSError if a game cannot be written, such as on a full disk. The game waits
    for the next call, whoever makes it: its client may have left.

    Args:
        path: the file; it is created if it does not exist, and continued if it does.
        header: player and settings of the games.

    Raises:
        ArtefactError: if the file is damaged, no plain file, or in use by another process.
        ConfigError: if its games are of another player, graph, split or other settings.
    """
    waiting: list[GameRecord] = []

    def keep(talk: Conversation) -> None:
        # Without messages it was recorded before.
        if talk.messages:
            waiting.append(record_of(talk))
            talk.messages.clear()
        # In turn, so that a game that went wrong is never the second of its task: the first counts.
        while waiting:
            append_game(path, waiting[0])
            del waiting[0]

    with made_folder(path.parent):
        if not path.exists():
            path.touch()  # the lock needs a file
        # No device, folder or broken link: records are appended for as long as the server runs.
        check_file(path)
        with locked(path, "written"):
            open_games(path, header)
            yield keep


def evaluation_of(played: Sequence[GameRecord], groups: Ids | None = None) -> "Evaluation":
    """Convert the records of N tasks with D distractor seeds each to an evaluation, shape (N, D).

    Decisions have no hash (-1) and games no reason of their end (0), because records need no graph;
    no metric depends on them.

    Args:
        played: the records, in any order.
        groups: resampling group of each task of the world, see :attr:`World.groups`; None if each
            task is a group of its own.

    Raises:
        ValueError: if a task lacks a distractor seed that another one has.
    """
    from wordcraft_kg.agents.evaluation import Evaluation  # loads torch

    tasks = np.array(sorted({game.task for game in played}), dtype=np.int64)
    shape = (len(tasks), len({game.distractor_seed for game in played}))
    # Sorted by task, then by seed, so that a reshaping gives a row for each task.
    games = sorted(played, key=lambda game: (game.task, game.distractor_seed))
    return Evaluation(
        tasks,
        tasks if groups is None else groups[tasks],
        np.array([game.success for game in games], dtype=bool).reshape(shape),
        np.array([game.by_plan for game in games], dtype=bool).reshape(shape),
        np.array([game.actions for game in games], dtype=np.int64).reshape(shape),
        np.zeros(shape, dtype=np.int8),
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
        means[mark] = float(np.mean([curve[: mark + 1][-1] for curve in curves]))
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
        ConfigError: if they are of another player, graph, split or other settings.
    """
    path = folder / GAMES_FILE
    settings = play.settings
    if tasks is None:
        tasks = [0]
        if not settings.is_open_ended:
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
            talk = play.begin(*task_and_seed)
            while not talk.is_over:
                talk.hear(player.answer(talk))
            return record_of(talk)

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
            if not any(folder.rglob(GAMES_FILE)):
                raise
            hint = f"Finished games are in {folder}; repeat the command to continue."
            if isinstance(error, KeyboardInterrupt):
                raise KeyboardInterrupt(f"interrupted. {hint}") from None
            if isinstance(error, PlayerError):
                raise PlayerError(f"{error} {hint}") from None
            raise ArtefactError(f"{folder}: {error.strerror or error}. {hint}") from None


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
                play = TaskGames(
                    world,
                    table=EvaluationTables(world, limit).table,
                    distractor_seeds=tables,
                    tasks=None if len(tasks) == len(world.tasks) else len(tasks),
                )
                games = folder / f"distractors-{world.config.num_distractors}"
                played = play_all(program, play, games, tasks.tolist())
                results.append(evaluation_of(played, world.groups))
                if invalid := sum(game.invalid_actions for game in played):
                    logging.getLogger(__name__).warning(
                        "%s: %s", program.name, counted(invalid, "invalid answer")
                    )
    return program.name, results
