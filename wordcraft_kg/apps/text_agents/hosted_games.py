"""Concurrent games with ids on a server, and the file to which a server appends finished games.

Players may reconnect by id. The memory is bounded, because anyone can begin games: the least recent
games are forgotten, and long games are recorded in part.
"""

import logging
import secrets
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from wordcraft_kg.apps.text_agents.conversation import Conversation, Play
from wordcraft_kg.apps.text_agents.records import GameRecord, GamesHeader
from wordcraft_kg.apps.text_agents.results import append_game, open_games, record_of
from wordcraft_kg.base.artefacts import check_file, made_folder
from wordcraft_kg.base.errors import EpisodeError
from wordcraft_kg.base.settings import MAX_SIZE
from wordcraft_kg.runs.run_folder import locked

NEVER = MAX_SIZE
"""Value of ``max_invalid`` without a limit: invalid tool calls never cost an attempt."""
_MOST_GAMES = 1_000
"""Remembered games: ten per player for a hundred players."""


class HostedGames:
    """All games on a server, open to anyone with a game's id.

    Attributes:
        play: the games.
        keep: called with each finished game; by default its messages are forgotten.
    """

    def __init__(self, play: Play, *, most: int = _MOST_GAMES):
        """Prepare to host games; at most ``most`` games are remembered."""
        self.play = play
        self._most = most
        self.keep: Callable[[Conversation], None] = lambda talk: talk.messages.clear()
        self._begun: set[tuple[int, int]] = set()
        self._hosted: OrderedDict[str, Conversation] = OrderedDict()

    def begin(self, task: int = 0, distractor_seed: int = 0) -> Conversation:
        """Begin a game, see :meth:`Play.begin`.

        On a track each game can be begun once, and open-ended games come in turn. If there are too
        many games, end and forget a game: finished games first, then the least recent.

        Raises:
            ConfigError: if there is no such task or seed.
            EpisodeError: if the game was begun before on a track, or if the forgotten game cannot
                be recorded.
        """
        settings = self.play.settings
        if settings.track and settings.is_open_ended:
            distractor_seed = len(self._begun)
        key = (task, distractor_seed)
        # Who begins a game again knows it, and could pick the better result.
        if settings.track and (key in self._begun or distractor_seed >= settings.distractor_seeds):
            raise EpisodeError(
                f"Each game of {settings.track} is played once, and this game was begun before."
            )
        talk = self.play.begin(task, distractor_seed)
        # The id is the only key to a game, so nobody may guess it: 72 random bits.
        talk.name = secrets.token_urlsafe(9)
        # Tools say by their schemas how to answer.
        talk.messages = [f"{talk.game.rules}\n\n{talk.game.state}"]
        talk.on_end = self.keep
        self._begun.add(key)
        if len(self._hosted) >= self._most:
            # `min` takes the first of equals, the least recent one: `game` moves ids to the end.
            oldest = min(self._hosted, key=lambda name: not self._hosted[name].is_over)
            try:
                self._hosted[oldest].end()
            except OSError as error:
                raise EpisodeError(
                    f"The server has no room for a game ({error.strerror}). Try again later."
                ) from None
            del self._hosted[oldest]
        self._hosted[talk.name] = talk
        return talk

    def game(self, name: str) -> Conversation:
        """Return the game with the id ``name``.

        Raises EpisodeError for an unknown or forgotten id.
        """
        if name not in self._hosted:
            raise EpisodeError(
                f"Unknown game id '{name[:40]}': expected an id returned by `begin`; the server "
                "keeps the last "
                f"{self._most:,} games. Start a new game."
            )
        self._hosted.move_to_end(name)
        return self._hosted[name]


class GamesWriter:
    """A file to which a server appends finished games, in the order in which they end."""

    def __init__(self, path: Path, count: int):
        """Bind the file, which is locked and has ``count`` games."""
        self._path = path
        self._count = count
        self._waiting: list[GameRecord] = []

    def __call__(self, talk: Conversation) -> None:
        """Record a finished game, and save it; a further call only tries to save it again.

        Raises:
            OSError: as :meth:`save`.
        """
        if not talk.is_recorded:
            self._waiting.append(record_of(talk, self._count))
            self._count += 1
            talk.is_recorded = True
            talk.messages.clear()
        self.save()

    def save(self) -> None:
        """Write the games that could not be written before, such as on a full disk.

        They come before all later games, so a game that went wrong is never the second of its task.

        Raises:
            OSError: if a game cannot be written; it still waits.
        """
        while self._waiting:
            append_game(self._path, self._waiting[0])
            del self._waiting[0]


@contextmanager
def games_writer(path: Path, header: GamesHeader) -> Iterator[GamesWriter]:
    """Lock a games file, and yield a function that appends a finished game with its messages.

    Args:
        path: the file; it is created if it does not exist, and continued if it does.
        header: player and settings of the games.

    Raises:
        ArtefactError: if the file is damaged, no plain file, or in use by another process.
        GraphMismatchError: if its games are of another graph or split.
        ConfigError: if its games are of another player or other settings.
    """
    with made_folder(path.parent):
        if not path.exists():
            path.touch()  # the lock needs a file
        # No device, folder or broken link: records are appended for as long as the server runs.
        check_file(path)
        with locked(path, "written"):
            writer = GamesWriter(path, len(open_games(path, header)))
            try:
                yield writer
            finally:
                try:
                    writer.save()
                except OSError as error:
                    logging.getLogger(__name__).error("games were not saved: %s", error)
