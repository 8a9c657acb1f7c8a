"""Text agents' results as rows for the table that the command ``reference`` prints."""

from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any, get_args

import msgspec

from wordcraft_kg.apps.text_agents.benchmark import open_track
from wordcraft_kg.apps.text_agents.inspect_log import read_inspect_log, read_logged_games
from wordcraft_kg.apps.text_agents.records import (
    GAMES_FILE,
    GamesFormat,
    PlayedSettings,
    PlayedTask,
    TextResult,
)
from wordcraft_kg.apps.text_agents.results import chosen_tasks, groups_of, read_games, result_of
from wordcraft_kg.apps.text_agents.settings import GameSettings
from wordcraft_kg.apps.text_agents.submission import SUBMISSION_FILE, Submission, read_lines
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import read_record
from wordcraft_kg.base.wording import counted
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation.reference import (
    Estimate,
    MeasuredValue,
    OpenPlay,
    ReferenceRow,
    TaskPlay,
    figures_of,
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
        (path / SUBMISSION_FILE).is_file()
        or _is_log(path)
        or begins_with(_games_file(path), *get_args(GamesFormat))
    )


def _result(path: Path, opened: OpenedGraph) -> TextResult:
    if (path / SUBMISSION_FILE).is_file():
        raise ConfigError(f"'{path}' has the games of a track, not all tasks; see `bench run`.")
    result = (
        read_inspect_log(path, opened)
        if _is_log(path)
        else read_games_result(_games_file(path), opened)
    )
    if result.settings.track is not None:
        raise ConfigError(
            f"--external-results: '{path}' has the games of {result.settings.track}, not all tasks; see `bench run`."
        )
    check_hash(path, "graph", result.settings.graph_hash, opened.graph.hash)
    return result


def read_games_result(path: Path, opened: OpenedGraph) -> TextResult:
    """Read a games file, of each task the first game; ConfigError if a task was not played."""
    header, played, _ = read_games(path)
    settings = header.settings
    check_hash(path, "graph", settings.graph_hash, opened.graph.hash)
    check_hash(path, "split", settings.split_hash, opened.split.hash)
    if settings.part is None or settings.depth is None or settings.distractors is None:
        if not played:
            raise ConfigError(f"'{path}' holds no finished game.")
        return result_of(
            header.player, msgspec.structs.replace(settings, distractor_seeds=len(played)), played
        )
    games = GameSettings(settings.part, settings.depth, settings.distractors, settings.attempts)
    tasks = set(chosen_tasks(World(opened, games.environment), settings.tasks).tolist())
    first = {
        (one.task, one.distractor_seed): one
        for one in reversed(played)
        if isinstance(one, PlayedTask)
    }
    seeds = 1 + max((distractor_seed for _, distractor_seed in first), default=0)
    needed, held = (
        len(tasks) * seeds,
        sum(task in tasks for task, _ in first),
    )  # seeds may be too many for a set
    if not len(first) == held == needed:
        raise ConfigError(
            f"'{path}' holds {held:,} / {needed:,} games for the {settings.part} tasks: expected each task with each "
            "distractor seed, because selected tasks are not representative."
        )
    return result_of(
        header.player,
        msgspec.structs.replace(settings, distractor_seeds=seeds),
        [*first.values()],
        groups_of(opened, settings),
    )


def _open_rows(
    paths: Sequence[Path], opened: OpenedGraph, play: OpenPlay
) -> Sequence[ReferenceRow]:
    rows = []
    for path in paths:
        result = _result(path, opened)
        settings = result.settings
        if not settings.is_open_ended or settings.base != play.base:
            start = (
                f"starts from {', '.join(settings.base)}"
                if settings.is_open_ended
                else "was recorded on tasks"
            )
            raise ConfigError(
                f"--external-results: '{path}' {start}; expected open-ended mode from {', '.join(play.base)}."
            )
        known: dict[int, Estimate] = {
            attempts: (value, None, None) for attempts, value in result.known.items()
        }
        rows.append(
            _row(path, result, play, figures_of(known), measure="entities known", runs=result.games)
        )
    return rows


def _task_rows(
    paths: Sequence[Path], opened: OpenedGraph, play: TaskPlay, columns: Sequence[int]
) -> Sequence[ReferenceRow]:
    rows: dict[tuple[str, PlayedSettings, int], ReferenceRow] = {}
    for path in paths:
        result = _result(path, opened)
        settings = result.settings
        check_hash(path, "split", settings.split_hash, opened.split.hash)
        success, amount = result.success, settings.distractors
        if settings.part is None or settings.depth is None or amount is None or success is None:
            raise ConfigError(
                f"--external-results: '{path}' was recorded in open-ended mode; add --open-ended, or omit the path."
            )
        check_tasks(path, TaskPlay(settings.part, settings.depth, settings.attempts), play)
        if amount not in columns:
            raise ConfigError(
                f"--external-results: '{path}' has {counted(amount, 'distractor')}, but the columns are "
                f"{','.join(map(str, columns))}; add {amount} to --distractors."
            )
        figures = figures_of({amount: (success.mean, success.ci_low, success.ci_high)})
        amounts = {"tasks": success.tasks, "distractor_seeds": success.distractor_seeds}
        row = _row(path, result, play, figures, interval=over(opened.split.unit), **amounts)
        # A player with several results for the same tasks has a row per result.
        same = result.player, msgspec.structs.replace(settings, distractors=None)
        times = ((*same, time) for time in count())
        key = next(key for key in times if key not in rows or str(amount) not in rows[key].figures)
        if key in rows:
            figures = rows[key].figures | figures
            notes = ", ".join(dict.fromkeys(note for note in (rows[key].notes, row.notes) if note))
            row = msgspec.structs.replace(
                row, figures=figures, source=f"{rows[key].source}, {row.source}", notes=notes
            )
        rows[key] = row
    return list(rows.values())


def _row(
    path: Path,
    result: TextResult,
    play: TaskPlay | OpenPlay,
    figures: dict[str, MeasuredValue],
    **more: Any,
) -> ReferenceRow:
    settings, success = result.settings, result.success
    is_remembered = (
        settings.knowledge != "none" and settings.part in ("train", "all") and not _is_log(path)
    )
    notes = (
        f"an even sample of {counted(success.tasks, 'task')}"
        if success and settings.tasks is not None
        else "",
        f"{counted(result.lost_attempts, 'attempt')} lost by invalid actions"
        if result.lost_attempts
        else "",
        f"its scorer {SEEN}" if settings.kg == "full" else "",
        "look-ups in other games name the recipes of the task" if is_remembered else "",
    )
    look_ups = {"knowledge": settings.knowledge, "look-ups a game": str(settings.look_ups)}
    return ReferenceRow(
        player=result.player,
        kind="language model" if _is_log(path) else "other",
        figures=figures,
        origin="external",
        source=str(path),
        play=play,
        settings={} if settings.knowledge == "none" else look_ups,
        notes=", ".join(note for note in notes if note),
        **{"measure": "success", **more},
    )


def _games(path: Path, opened: OpenedGraph) -> Iterator[TableGame]:
    if (path / SUBMISSION_FILE).is_file():
        submission = read_record(path / SUBMISSION_FILE, Submission)
        track = open_track(submission.track)
        lines = read_lines(path / GAMES_FILE, track, track.play(submission.knowledge))
        graph, frozen = track.opened.graph, track.frozen
        name, kind, hashes = (
            submission.player,
            submission.kind,
            (graph.hash, track.opened.split.hash),
        )
        games = [
            TableGame(
                name,
                kind,
                "test",
                frozen.depth,
                line.goal,
                graph.labels(task.table),
                line.pairs,
                line.success,
            )
            for line, task in zip(lines, frozen.tasks, strict=False)
            if line.goal is not None and line.success is not None
        ]
    else:
        if _is_log(path):
            logged = read_logged_games(path)
            name, kind, settings, played = (
                logged.model,
                "language model",
                logged.settings,
                logged.games,
            )
        else:
            header, played, _ = read_games(_games_file(path))
            name, kind, settings = header.player, "other", header.settings
        hashes, part, depth = (
            (settings.graph_hash, settings.split_hash),
            settings.part,
            settings.depth,
        )
        games = [
            TableGame(
                name, kind, part, depth, one.goal, one.table, one.pairs or (one.last,), one.success
            )
            for one in played
            if isinstance(one, PlayedTask) and part is not None and depth is not None
        ]
    check_hash(path, "graph", hashes[0], opened.graph.hash)
    check_hash(path, "split", hashes[1], opened.split.hash)
    yield from games


READER = ResultReader(
    "a folder of 'evaluate-text' or 'bench run', an 'mcp --out' file, or an Inspect AI log (.eval, .json)",
    _knows,
    _task_rows,
    _open_rows,
    _games,
)
