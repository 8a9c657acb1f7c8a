"""The file that a server keeps games in that are over; one server's alone."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from wordcraft_kg.apps.text_agents.games_file import append_game, open_games
from wordcraft_kg.apps.text_agents.hosted_games import HostedGame
from wordcraft_kg.apps.text_agents.played import played_task, played_world
from wordcraft_kg.apps.text_agents.records import GamesHeader, PlayedTask, PlayedWorld
from wordcraft_kg.base.artefacts import check_file
from wordcraft_kg.runs.folder import locked


@contextmanager
def kept_games(path: Path, header: GamesHeader) -> Iterator[Callable[[HostedGame], None]]:
    """Yield what adds a game that is over to a file, new or begun; the line is on the disk when it returns.

    Raises:
        ArtefactError: if another server writes it, or what is there is damaged or something else.
        GraphMismatchError, ConfigError: if its games were played on another graph or with other settings; the file is
            unchanged in all cases.
    """
    is_world = header.settings.is_open_ended

    def read() -> int:
        return len(open_games(path, header, PlayedWorld) if is_world else open_games(path, header, PlayedTask))

    if path.exists():
        check_file(path)
        with locked(path, "written"):  # what is there may be another file once it is read
            read()
    else:
        read()
    with locked(path, "written"):
        games = read()

        def keep(hosted: HostedGame) -> None:
            nonlocal games
            game, talk = hosted.talk.game, hosted.talk
            messages = [*hosted.messages[:-1], f"{hosted.messages[-1]}\n\n{game.state}".lstrip()]
            record = played_world(talk, games, messages) if is_world else played_task(talk, messages)
            size = path.stat().st_size
            try:
                append_game(path, record)
            except OSError:
                with suppress(OSError):
                    os.truncate(path, size)  # a torn line may not stand before the next one
                raise
            games += 1

        yield keep
