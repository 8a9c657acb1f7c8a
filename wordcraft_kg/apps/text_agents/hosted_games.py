"""Concurrent games with ids on a server.

Players may reconnect by id. The memory is bounded, because anyone can begin games: the least recent
games are forgotten, and long games are recorded in part.
"""

import logging
import secrets
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from weakref import WeakSet

from wordcraft_kg.apps.text_agents.conversation import Conversation, Play
from wordcraft_kg.apps.text_agents.records import GamesHeader, TaskGameRecord, WorldGameRecord
from wordcraft_kg.apps.text_agents.results import append_game, open_games, record_of
from wordcraft_kg.base.artefacts import check_file, made_folder
from wordcraft_kg.base.errors import ActionError, EpisodeError
from wordcraft_kg.base.labels import read_label
from wordcraft_kg.base.settings import MAX_SIZE
from wordcraft_kg.runs.run_folder import locked

NEVER = MAX_SIZE
"""Value of ``max_invalid`` without a limit: invalid tool calls never cost an attempt."""
_MOST_GAMES = 1_000
"""Remembered games: ten per player for a hundred players."""
_MOST_CHARACTERS = 200_000
"""Recorded characters per game: all games stay below about 200 MiB."""


class HostedGame:
    """A game on a server.

    Methods raise an EpisodeError once the game is over, an ActionError for invalid input, and an
    OSError if the record cannot be written; :meth:`end` then tries to write the record again.

    Attributes:
        name: the game's id.
        talk: the conversation.
        messages: all messages by server and player in turn, as far as there is room. Of the
            server's, only the first has rules and state.
    """

    def __init__(self, name: str, talk: Conversation, keep: "Callable[[HostedGame], None]"):
        """Begin a game.

        Args:
            name: the game's id.
            talk: the conversation at its beginning.
            keep: function that records the finished game.
        """
        self.name = name
        self.talk = talk
        self._keep = keep
        self.messages = [f"{talk.game.rules}\n\n{talk.game.state}"]
        self._room = _MOST_CHARACTERS
        self._is_kept = False

    def combine(self, first: str, second: str) -> str:
        """Make an attempt with two entities, by label or number.

        Return a sentence on the result.

        Raises:
            ActionError: if an item is not at hand, or a name fits several.
            EpisodeError: if the game is over.
            OSError: if the game is over now, and its record cannot be written.
        """
        game = self.talk.game
        message = f"{first} + {second}"
        with self._hearing(message):
            places = (read_label(first, game.labels), read_label(second, game.labels))
            result = game.combine(*places)
        self._note(message, result)
        self._keep_if_over()
        return result

    def look_up(self, item: str) -> tuple[str, list[str], str]:
        """Look up an entity; return label, facts as lines, and facts as a text.

        Raises:
            ActionError: for an unknown item, or if no look-up is left.
            EpisodeError: if the game is over.
        """
        entities = self.talk.game.graph.entities
        message = f"look up {item}"
        with self._hearing(message):
            entity = read_label(item, entities, by_number=False)
            facts, reply = self.talk.look_up(entity)
        self._note(message, "\n".join(facts))
        return entities[entity], facts, reply

    def end(self) -> None:
        """Give up the game if it is not over, and record the game.

        Raises:
            OSError: if the record cannot be written; another call tries again.
        """
        if not self.talk.is_over:
            self.talk.game.end()
            # The answer is the state alone.
            self._note("end", "")
        self._keep_if_over()

    @contextmanager
    def _hearing(self, message: str) -> Iterator[None]:
        if self.talk.is_over:
            raise EpisodeError(f"{self.talk.after_the_end} Start a new game.")
        try:
            yield
        except ActionError as error:
            self.talk.invalid_actions += 1
            self._note(message, str(error))
            raise

    def _note(self, message: str, answer: str) -> None:
        # A client may send invalid calls without end; they cost no attempt, so this bounds memory.
        self._room -= len(message) + len(answer) + 100  # for two objects
        if self._room > 0:
            self.messages += [message, answer]

    def _keep_if_over(self) -> None:
        # Marked as kept after the record is written: after an OSError, `end` can try again.
        if self.talk.is_over and not self._is_kept:
            self._keep(self)
            self._is_kept = True
            self.messages.clear()


class HostedGames:
    """All games on a server, open to anyone with a game's id.

    Attributes:
        play: the games.
        keep: function that records each finished game; by default nothing is recorded.
    """

    def __init__(self, play: Play, *, most: int = _MOST_GAMES):
        """Prepare to host games; at most ``most`` games are remembered."""
        self.play = play
        self._most = most
        self.keep: Callable[[HostedGame], None] = lambda game: None
        self._begun: set[tuple[int, int]] = set()
        self._hosted: OrderedDict[str, HostedGame] = OrderedDict()

    def begin(self, task: int = 0, distractor_seed: int = 0) -> HostedGame:
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
        # The id is the only key to a game, so nobody may guess it: 72 random bits.
        name = secrets.token_urlsafe(9)
        hosted = HostedGame(name, self.play.begin(task, distractor_seed), self.keep)
        self._begun.add(key)
        if len(self._hosted) >= self._most:
            # `min` takes the first of equals, the least recent one: `game` moves ids to the end.
            oldest = min(self._hosted, key=lambda name: not self._hosted[name].talk.is_over)
            try:
                self._hosted[oldest].end()
            except OSError as error:
                raise EpisodeError(
                    f"The server has no room for a game ({error.strerror}). Try again later."
                ) from None
            del self._hosted[oldest]
        self._hosted[name] = hosted
        return hosted

    def game(self, name: str) -> HostedGame:
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


@contextmanager
def kept_games(path: Path, header: GamesHeader) -> Iterator[Callable[[HostedGame], None]]:
    """Lock a games file, and yield a function that appends a finished game.

    Arguments and errors are those of :func:`kept_conversations`.
    """
    with kept_conversations(path, header) as keep_talk:

        def keep(hosted: HostedGame) -> None:
            # The record of a conversation ends with the outcome, which is in no tool's message.
            last = f"{hosted.messages[-1]}\n\n{hosted.talk.game.state}".lstrip()
            keep_talk(hosted.talk, [*hosted.messages[:-1], last])

        yield keep


class KeptGames:
    """A file to which a server appends finished games, in the order in which they end."""

    def __init__(self, path: Path, count: int):
        """Bind the file, which is locked and has ``count`` games."""
        self._path = path
        self._count = count
        self._waiting: list[TaskGameRecord | WorldGameRecord] = []
        # Which conversations were recorded; those that are forgotten elsewhere are forgotten here.
        self._recorded = WeakSet[Conversation]()

    def __call__(self, talk: Conversation, messages: Sequence[str]) -> None:
        """Record a finished game, and save it; a further call only tries to save it again.

        Raises:
            OSError: as :meth:`save`.
        """
        if talk not in self._recorded:
            self._recorded.add(talk)
            self._waiting.append(record_of(talk, messages, self._count))
            self._count += 1
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
def kept_conversations(path: Path, header: GamesHeader) -> Iterator[KeptGames]:
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
            kept = KeptGames(path, len(open_games(path, header)))
            try:
                yield kept
            finally:
                try:
                    kept.save()
                except OSError as error:
                    logging.getLogger(__name__).error("games were not saved: %s", error)
