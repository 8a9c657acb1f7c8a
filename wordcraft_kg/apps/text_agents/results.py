"""Resumable evaluation of text agents: each game is on disk before the next; metrics are as for trained agents."""

import logging
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from wordcraft_kg.agents.discovery import LATER_MARKS, MARKS
from wordcraft_kg.agents.outcomes import TERMINATION_REASONS, TerminationReason
from wordcraft_kg.apps.text_agents.conversation import Conversation, Play, converse
from wordcraft_kg.apps.text_agents.games import DiscoveryGame, TaskGame, TaskGames
from wordcraft_kg.apps.text_agents.records import (
    GAMES_FILE,
    GamesHeader,
    PlayedSettings,
    PlayedTask,
    PlayedWorld,
    TextResult,
)
from wordcraft_kg.apps.text_agents.settings import GameSettings
from wordcraft_kg.base.artefacts import read_large_file
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.base.progress import steps
from wordcraft_kg.base.records import as_lines, parse_lines, parse_record
from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.runs.folder import locked

if TYPE_CHECKING:
    from wordcraft_kg.agents.evaluation import Evaluation

REPLACEMENT = "replacement"
"""Folder beside games for those that replace them once complete."""
COUNTS = ("invalid_actions", "lost_attempts", "look_ups")


def chosen_tasks(world: World, most: int | None) -> Ids:
    """Return the indices of all tasks in a world, or of ``most`` (1 or more) evenly spaced tasks."""
    if most is not None:
        whole("tasks", most, 1, MAX_SIZE)
    number = len(world.tasks)
    most = number if most is None else min(most, number)
    return np.arange(most) * number // most


def record_of(
    talk: Conversation, messages: Sequence[str], number: int = 0
) -> PlayedTask | PlayedWorld:
    """Return the record of the finished game in a conversation; ``number`` is the index of an open-ended game."""
    game = talk.game
    counts = {
        **{name: getattr(talk, name) for name in COUNTS},
        "messages": tuple(messages),
        "pairs": tuple(game.pairs),
    }
    if isinstance(game, DiscoveryGame):
        number = number if game.number is None else game.number
        return PlayedWorld(
            game=number, known_after=tuple(game.known_after), repeated=game.repeated, **counts
        )
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
    parts = {
        part
        for plan in game.tasks.plans[game.task]
        for part in game.graph.recipes[plan[-1], :2].tolist()
    }
    if one == other:
        return "same_twice"
    if {one, other} & parts:
        return "one_right_part"
    return (
        "no_right_part"
        if (min(one, other), max(one, other)) in game.graph.outcomes
        else "no_recipe"
    )


def groups_of(opened: OpenedGraph, settings: PlayedSettings) -> Ids | None:
    """Return the resampling group of each task of recorded games; None without tasks, or for a track or other graph."""
    hashes = settings.graph_hash, settings.split_hash
    if settings.track is not None or hashes != (opened.graph.hash, opened.split.hash):
        return None
    if settings.part is None or settings.depth is None or settings.distractors is None:
        return None
    games = GameSettings(settings.part, settings.depth, settings.distractors, settings.attempts)
    return World(opened, games.environment).groups


def evaluation_of(played: Sequence[PlayedTask], groups: Ids | None = None) -> "Evaluation":
    """Convert the records of N tasks with D distractor seeds each to an evaluation, without pairs (-1).

    ``groups`` has the resampling group of each task of the world, see :attr:`World.groups`; None if each task is a
    group of its own.
    """
    from wordcraft_kg.agents.evaluation import Evaluation  # loads torch

    tasks = np.array(sorted({one.task for one in played}), dtype=np.int64)
    shape = len(tasks), len({one.distractor_seed for one in played})
    if len(played) != shape[0] * shape[1]:
        raise ValueError(
            f"{len(played)} games: expected {shape[0]} tasks with {shape[1]} distractor seeds each"
        )
    games = sorted(played, key=lambda one: (one.task, one.distractor_seed))
    return Evaluation(
        tasks,
        tasks if groups is None else groups[tasks],
        np.array([one.success for one in games], dtype=bool).reshape(shape),
        np.array([one.by_plan for one in games], dtype=bool).reshape(shape),
        np.array([one.actions for one in games], dtype=np.int64).reshape(shape),
        np.array(
            [TERMINATION_REASONS.index(one.termination) for one in games], dtype=np.int8
        ).reshape(shape),
        np.full((*shape, 2), -1),
        np.full(shape, -1),
    )


def mean_known(curves: Sequence[Sequence[int]], attempts: int) -> dict[int, float]:
    """Return the mean number of known entities by attempts; curves begin at the start, and may end early."""
    marks = sorted({attempts, *(mark for mark in (*MARKS, *LATER_MARKS) if mark < attempts)})
    return {mark: float(np.mean([curve[: mark + 1][-1] for curve in curves])) for mark in marks}


def result_of(
    player: str,
    settings: PlayedSettings,
    played: Sequence[PlayedTask | PlayedWorld],
    groups: Ids | None = None,
) -> TextResult:
    """Return a player's result: metrics and counts over all recorded games.

    Args:
        player: name of the player.
        settings: settings of the games.
        played: all games.
        groups: resampling groups of the tasks, see :func:`evaluation_of`.
    """
    counts = {name: sum(getattr(one, name) for one in played) for name in COUNTS}
    curves = [
        (len(settings.base), *one.known_after) for one in played if isinstance(one, PlayedWorld)
    ]
    tasks = [one for one in played if isinstance(one, PlayedTask)]
    evaluation = None if settings.is_open_ended else evaluation_of(tasks, groups)
    return TextResult(
        player=player,
        settings=settings,
        games=len(played),
        success=evaluation.figures() if evaluation else None,
        outcomes=evaluation.shares() if evaluation else {},
        known={} if evaluation else mean_known(curves, settings.attempts),
        **counts,
    )


def read_games(path: Path) -> tuple[GamesHeader, Sequence[PlayedTask | PlayedWorld], bytes]:
    """Return the header, the games and the incomplete last line (empty if complete) in a games file."""
    lines, _, torn = read_large_file(path).rpartition(b"\n")
    first, _, rest = lines.partition(b"\n")
    header = parse_record(first, GamesHeader, f"{path}, line 1,")
    kind: type[PlayedTask | PlayedWorld] = (
        PlayedWorld if header.settings.is_open_ended else PlayedTask
    )
    return header, parse_lines(rest, kind, f"{path} (after line 1)"), torn


_HASHES = {"graph_hash": "the graph's hash", "split_hash": "the split's hash"}
_NO_OPTION = {"answer_grammar": "the answer grammar"}
_Speaker = Callable[[Conversation], Callable[[str], str]]


def play_all(player: str, speak: _Speaker, play: Play, folder: Path) -> TextResult:
    """Evaluate a player in all games, and write the games to a folder; continue an interrupted evaluation.

    ``speak`` maps a conversation to the function that answers the prompts. Damaged or changed games, or a folder in use
    by another process, are an ArtefactError; for other players or settings see :func:`open_games`.
    """
    path, settings = folder / GAMES_FILE, play.settings
    tasks = (
        chosen_tasks(play.games.world, settings.tasks).tolist()
        if isinstance(play.games, TaskGames)
        else [0]
    )
    missing = dict.fromkeys(
        (task, distractor_seed)
        for distractor_seed in range(settings.distractor_seeds)
        for task in tasks
    )
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder, "written"):
        if path.is_symlink():
            raise ArtefactError(f"{path} is a link; expected a file. Choose another `out`.")
        played = open_games(path, GamesHeader(player=player, settings=settings))
        for line, one in enumerate(played, 2):
            key = (one.task, one.distractor_seed) if isinstance(one, PlayedTask) else (0, one.game)
            if key not in missing:
                raise ArtefactError(
                    f"{path}, line {line}, is damaged: the game is a duplicate, or not part of the evaluation. "
                    "Remove the line."
                )
            del missing[key]
        for task, distractor_seed in steps("playing", missing):
            talk = play.begin(task, distractor_seed)
            played.append(record_of(talk, converse(talk, speak(talk)), distractor_seed))
            append_game(path, played[-1])
    groups = play.games.world.groups if isinstance(play.games, TaskGames) else None
    return result_of(player, settings, played, groups)


@contextmanager
def replaced_games(folder: Path, header: GamesHeader) -> Iterator[Path]:
    """Yield a folder for new games, which take the place of the earlier games at the end of the block.

    After an interruption the earlier games are as before; the new games are kept, and continued by a later call with
    the same header. ArtefactError if another process plays in the folder.

    Args:
        folder: folder with earlier games, perhaps without any.
        header: player and settings of the new games.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder, "written"):
        new = folder / REPLACEMENT
        if not _has_header(new / GAMES_FILE, header):
            shutil.rmtree(new, ignore_errors=True)
        yield new
        os.replace(new / GAMES_FILE, folder / GAMES_FILE)
        shutil.rmtree(new)


def _has_header(path: Path, header: GamesHeader) -> bool:
    try:
        return read_games(path)[0] == header
    except ArtefactError:  # missing or damaged
        return False


def open_games(path: Path, header: GamesHeader) -> list[PlayedTask | PlayedWorld]:
    """Create a games file with this header, or return the games in an existing file without an incomplete last line.

    A damaged file is an ArtefactError, another graph or split a GraphMismatchError, and another player or setting a
    ConfigError. The file is unchanged on errors.
    """
    line = as_lines([header])[0].encode()
    if not path.exists():
        path.touch()
    with path.open("rb") as file:
        start = file.read(len(line))
    if start == line or not line.startswith(
        start
    ):  # else empty, or killed while the header was written
        kept, played, torn = read_games(path)
        if played or kept == header:
            _check_header(path, kept, header)
            if torn:
                text = "%s ended in a torn line, which was dropped; the game is played again"
                logging.getLogger(__name__).warning(text, path)
                os.truncate(path, path.stat().st_size - len(torn))
            return [*played]
    _write(path, "wb", line)
    return []


def append_game(path: Path, played: PlayedTask | PlayedWorld) -> None:
    """Append the record of a game to a games file and flush to disk; the file is unchanged on an OSError."""
    size = path.stat().st_size
    try:
        _write(path, "ab", as_lines([played])[0].encode())
    except OSError:
        with suppress(OSError):
            os.truncate(path, size)
        raise


def _write(path: Path, mode: str, line: bytes) -> None:
    with path.open(mode) as file:
        file.write(line)
        file.flush()
        os.fsync(file.fileno())


def _check_header(path: Path, kept: GamesHeader, own: GamesHeader) -> None:
    if kept.player != own.player:
        raise ConfigError(
            f"'{path}' holds games by '{kept.player}', and the player is '{own.player}'. Choose another `out`."
        )
    names = [field.name for field in msgspec.structs.fields(kept.settings)]
    for name in sorted(names, key=_HASHES.__contains__, reverse=True):
        before, now = (_given(getattr(header.settings, name)) for header in (kept, own))
        if before != now:
            kind = GraphMismatchError if name in _HASHES else ConfigError
            called = (_HASHES | _NO_OPTION).get(name, f"`{name}`")
            raise kind(
                f"'{path}' holds games with {called} {before}, and this command has {now}. "
                "Choose another `out`, or use the same settings."
            )


def _given(value: object) -> str:
    if value is None:
        return "none"
    return ",".join(value) if isinstance(value, tuple) else str(value)
