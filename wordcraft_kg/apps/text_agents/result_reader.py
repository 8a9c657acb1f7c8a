"""Text agents' results as recorded games, which the explorer shows beside those of agents.

``READER`` at the end is what other rooms use, by the entry point group of game readers.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import get_args

from wordcraft_kg.apps.text_agents.benchmark import open_track
from wordcraft_kg.apps.text_agents.inspect_log import read_inspect_log
from wordcraft_kg.apps.text_agents.records import (
    GAMES_FILE,
    GameRecord,
    GamesFormat,
    PlayedSettings,
)
from wordcraft_kg.apps.text_agents.results import read_games
from wordcraft_kg.apps.text_agents.submission import (
    SUBMISSION_FILE,
    Submission,
    check_kind,
    is_submission,
    read_lines,
    read_submission_file,
)
from wordcraft_kg.base.records import parse_record
from wordcraft_kg.evaluation.reference import (
    GameReader,
    TableGame,
    begins_with,
    check_hash,
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


def _games(path: Path, opened: OpenedGraph) -> Iterator[TableGame]:
    if is_submission(path):
        games = _submitted_games(path, opened)
    elif _is_log(path):
        logged = read_inspect_log(path)
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
    played: Sequence[GameRecord],
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
    for game in played:
        if game.goal is not None and part is not None and depth is not None:
            games.append(
                TableGame(name, kind, part, depth, game.goal, game.table, game.pairs, game.success)
            )
    check_hash(path, "graph", settings.graph_hash, opened.graph.hash)
    check_hash(path, "split", settings.split_hash, opened.split.hash)
    return games


READER = GameReader(
    "a folder of games by 'evaluate-agent --player' or 'bench run', an 'mcp --out' file, or an "
    "Inspect AI log (.eval, .json)",
    _knows,
    _games,
)
