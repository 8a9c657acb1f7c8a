"""Text agents' results as rows for the table that the command ``reference`` prints.

``READER`` at the end is what other rooms use, by the entry point group of result readers.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, get_args

import msgspec

from wordcraft_kg.apps.text_agents.benchmark import open_track
from wordcraft_kg.apps.text_agents.inspect_log import read_inspect_log, read_logged_games
from wordcraft_kg.apps.text_agents.records import (
    GAMES_FILE,
    GamesFormat,
    PlayedSettings,
    TaskGameRecord,
    TextResult,
    WorldGameRecord,
)
from wordcraft_kg.apps.text_agents.results import chosen_tasks, groups_of, read_games, result_of
from wordcraft_kg.apps.text_agents.settings import GameSettings
from wordcraft_kg.apps.text_agents.submission import Submission, check_kind, read_lines
from wordcraft_kg.apps.text_agents.submission_files import (
    SUBMISSION_FILE,
    is_submission,
    read_submission_file,
)
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import parse_record
from wordcraft_kg.base.wording import counted
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation.reference import (
    Estimate,
    MeasuredValue,
    OpenPlay,
    ReferenceRow,
    TaskPlay,
    metrics_of,
)
from wordcraft_kg.evaluation.result_readers import (
    SEEN,
    ResultReader,
    TableGame,
    begins_with,
    check_hash,
    check_tasks,
    over,
)
from wordcraft_kg.graphs.folder import OpenedGraph

_LOGS = (".eval", ".json")


def _is_log(path: Path) -> bool:
    return path.is_file() and path.suffix in _LOGS


def _games_file(path: Path) -> Path:
    return path / GAMES_FILE if path.is_dir() else path


def _knows(path: Path) -> bool:
    return (
        is_submission(path)
        or _is_log(path)
        or begins_with(_games_file(path), *get_args(GamesFormat))
    )


def _result(path: Path, opened: OpenedGraph) -> TextResult:
    """Read a result for the table.

    Raises ConfigError for a track's games, which are other tasks.
    """
    if is_submission(path):
        raise ConfigError(f"'{path}' has the games of a track, not all tasks; see `bench run`.")
    if _is_log(path):
        result = read_inspect_log(path, opened)
    else:
        result = read_games_result(_games_file(path), opened)
    if result.settings.track is not None:
        raise ConfigError(
            f"--external-results: '{path}' has the games of {result.settings.track}, not all "
            "tasks; see `bench run`."
        )
    check_hash(path, "graph", result.settings.graph_hash, opened.graph.hash)
    return result


def read_games_result(path: Path, opened: OpenedGraph) -> TextResult:
    """Read a games file, in which players may have chosen themselves what they play.

    Of a task that was played several times, the first game counts. Each task must have been played,
    because the other tasks may be easier: a result over tasks that a player has chosen says
    nothing.

    Args:
        path: the games file.
        opened: graph and split of its games.

    Raises:
        ArtefactError: if the file is missing or damaged.
        GraphMismatchError: if its games are of another graph or split.
        ConfigError: if a task was not played.
    """
    header, played, _ = read_games(path)
    settings = header.settings
    check_hash(path, "graph", settings.graph_hash, opened.graph.hash)
    check_hash(path, "split", settings.split_hash, opened.split.hash)
    if settings.part is None or settings.depth is None or settings.distractors is None:
        if not played:
            raise ConfigError(f"'{path}' holds no finished game.")
        of_worlds = msgspec.structs.replace(settings, distractor_seeds=len(played))
        return result_of(header.player, of_worlds, played)
    games = GameSettings(settings.part, settings.depth, settings.distractors, settings.attempts)
    world = World(opened, games.environment)
    tasks = set(chosen_tasks(world, settings.tasks).tolist())
    # Backwards: a later game of the same task is replaced by an earlier one.
    first: dict[tuple[int, int], TaskGameRecord] = {}
    for one in reversed(played):
        if isinstance(one, TaskGameRecord):
            first[one.task, one.distractor_seed] = one
    seeds = 1 + max((distractor_seed for _, distractor_seed in first), default=0)
    # Counted, not compared with the set of all games: a file may name a seed of many digits.
    needed = len(tasks) * seeds
    held = sum(task in tasks for task, _ in first)
    if not len(first) == held == needed:
        raise ConfigError(
            f"'{path}' holds {held:,} / {needed:,} games for the {settings.part} tasks: expected "
            "each task with each "
            "distractor seed, because selected tasks are not representative."
        )
    of_tasks = msgspec.structs.replace(settings, distractor_seeds=seeds)
    return result_of(header.player, of_tasks, [*first.values()], groups_of(opened, settings))


def _open_rows(
    paths: Sequence[Path], opened: OpenedGraph, play: OpenPlay
) -> Sequence[ReferenceRow]:
    rows = []
    for path in paths:
        result = _result(path, opened)
        settings = result.settings
        if not settings.is_open_ended or settings.base != play.base:
            start = "was recorded on tasks"
            if settings.is_open_ended:
                start = f"starts from {', '.join(settings.base)}"
            raise ConfigError(
                f"--external-results: '{path}' {start}; expected open-ended mode from "
                f"{', '.join(play.base)}."
            )
        known: dict[int, Estimate] = {
            attempts: (value, None, None) for attempts, value in result.known.items()
        }
        rows.append(
            _row(path, result, play, metrics_of(known), measure="entities known", runs=result.games)
        )
    return rows


def _task_rows(
    paths: Sequence[Path], opened: OpenedGraph, play: TaskPlay, columns: Sequence[int]
) -> Sequence[ReferenceRow]:
    # A row for each player and settings: results with other numbers of distractors become columns
    # of one row.
    rows: dict[tuple[str, PlayedSettings, int], ReferenceRow] = {}
    for path in paths:
        result = _result(path, opened)
        settings = result.settings
        check_hash(path, "split", settings.split_hash, opened.split.hash)
        success = result.success
        amount = settings.distractors
        if settings.part is None or settings.depth is None or amount is None or success is None:
            raise ConfigError(
                f"--external-results: '{path}' was recorded in open-ended mode; add --open-ended, "
                "or omit the path."
            )
        check_tasks(path, TaskPlay(settings.part, settings.depth, settings.attempts), play)
        if amount not in columns:
            raise ConfigError(
                f"--external-results: '{path}' has {counted(amount, 'distractor')}, but the "
                "columns are "
                f"{','.join(map(str, columns))}; add {amount} to --distractors."
            )
        figures = metrics_of({amount: (success.mean, success.ci_low, success.ci_high)})
        amounts = {"tasks": success.tasks, "distractor_seeds": success.distractor_seeds}
        row = _row(path, result, play, figures, interval=over(opened.split.unit), **amounts)
        # A player with several results for the same tasks has a row per result.
        without_amount = msgspec.structs.replace(settings, distractors=None)
        time = 0
        while (key := (result.player, without_amount, time)) in rows:
            if str(amount) not in rows[key].figures:
                break
            time += 1
        rows[key] = _merged(rows[key], row) if key in rows else row
    return list(rows.values())


def _merged(row: ReferenceRow, further: ReferenceRow) -> ReferenceRow:
    """Return a row with the columns of both."""
    notes = [note for note in (row.notes, further.notes) if note]
    return msgspec.structs.replace(
        further,
        figures=row.figures | further.figures,
        source=f"{row.source}, {further.source}",
        notes=", ".join(dict.fromkeys(notes)),  # the same note once
    )


def _row(
    path: Path,
    result: TextResult,
    play: TaskPlay | OpenPlay,
    figures: dict[str, MeasuredValue],
    **more: Any,
) -> ReferenceRow:
    """Return a row of the table.

    Args:
        path: where the result is from.
        result: the result.
        play: the games of the table.
        figures: estimates by column.
        more: further fields of the row.
    """
    settings = result.settings
    success = result.success
    notes = []
    if success and settings.tasks is not None:
        notes.append(f"an even sample of {counted(success.tasks, 'task')}")
    if result.lost_attempts:
        notes.append(f"{counted(result.lost_attempts, 'attempt')} lost by invalid actions")
    if settings.kg == "full":
        notes.append(f"its scorer {SEEN}")
    # Each task hides its own recipes from look-ups, but a program may remember what it has looked
    # up in the games of other train tasks. A language model in Inspect begins each game anew.
    has_train_tasks = settings.part in ("train", "all")
    if settings.knowledge != "none" and has_train_tasks and not _is_log(path):
        notes.append("look-ups in other games name the recipes of the task")
    look_ups = {"knowledge": settings.knowledge, "look-ups a game": str(settings.look_ups)}
    return ReferenceRow(
        player=result.player,
        kind="language model" if _is_log(path) else "other",
        figures=figures,
        origin="external",
        source=str(path),
        play=play,
        settings={} if settings.knowledge == "none" else look_ups,
        notes=", ".join(notes),
        **{"measure": "success", **more},
    )


def _games(path: Path, opened: OpenedGraph) -> Iterator[TableGame]:
    if is_submission(path):
        games = _submitted_games(path, opened)
    elif _is_log(path):
        logged = read_logged_games(path)
        games = _recorded_games(
            path, opened, logged.model, "language model", logged.settings, logged.games
        )
    else:
        header, played, _ = read_games(_games_file(path))
        games = _recorded_games(path, opened, header.player, "other", header.settings, played)
    yield from games


def _submitted_games(path: Path, opened: OpenedGraph) -> list[TableGame]:
    """Return the games on tasks in a submission, after replaying them."""
    data = read_submission_file(path, SUBMISSION_FILE)
    submission = parse_record(data, Submission, path / SUBMISSION_FILE)
    check_kind(path / SUBMISSION_FILE, submission)
    track = open_track(submission.track)
    lines = read_lines(path, track, track.play(submission.knowledge))
    graph = track.opened.graph
    games = []
    # An open-ended track has no tasks, so this leaves its lines out.
    for line, task in zip(lines, track.frozen.tasks, strict=False):
        if line.goal is not None and line.success is not None:
            game = TableGame(
                submission.player,
                submission.kind,
                "test",
                track.frozen.depth,
                line.goal,
                graph.labels(task.table),
                line.pairs,
                line.success,
            )
            games.append(game)
    check_hash(path, "graph", graph.hash, opened.graph.hash)
    check_hash(path, "split", track.opened.split.hash, opened.split.hash)
    return games


def _recorded_games(
    path: Path,
    opened: OpenedGraph,
    name: str,
    kind: str,
    settings: PlayedSettings,
    played: Sequence[TaskGameRecord | WorldGameRecord],
) -> list[TableGame]:
    """Return the games on tasks among recorded games.

    Args:
        path: where the games are from, for errors.
        opened: graph and split of the table.
        name: the player's name.
        kind: the player's kind.
        settings: recorded settings.
        played: recorded games.
    """
    part = settings.part
    depth = settings.depth
    games = []
    for one in played:
        if isinstance(one, TaskGameRecord) and part is not None and depth is not None:
            games.append(
                TableGame(name, kind, part, depth, one.goal, one.table, one.pairs, one.success)
            )
    check_hash(path, "graph", settings.graph_hash, opened.graph.hash)
    check_hash(path, "split", settings.split_hash, opened.split.hash)
    return games


READER = ResultReader(
    "a folder of 'evaluate-text' or 'bench run', an 'mcp --out' file, or an Inspect AI log (.eval, "
    ".json)",
    _knows,
    _task_rows,
    _open_rows,
    _games,
)
