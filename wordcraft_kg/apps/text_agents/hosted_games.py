"""Concurrent games with ids on a server: players may reconnect by id; the least recent games are forgotten."""

import secrets
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from wordcraft_kg.apps.text_agents.conversation import Conversation, Play
from wordcraft_kg.apps.text_agents.records import GamesHeader
from wordcraft_kg.apps.text_agents.results import append_game, open_games, record_of
from wordcraft_kg.base.artefacts import check_file
from wordcraft_kg.base.errors import ActionError, EpisodeError
from wordcraft_kg.base.labels import read_label
from wordcraft_kg.base.settings import MAX_SIZE
from wordcraft_kg.runs.folder import locked

NEVER = MAX_SIZE
"""Value of ``max_invalid`` without a limit: invalid tool calls never cost an attempt."""
_MOST_GAMES = 1_000
"""Remembered games: ten per player for a hundred players."""
_MOST_CHARACTERS = 200_000
"""Recorded characters per game: all games stay below about 200 MiB."""


class HostedGame:
    """A game on a server: id, conversation, and all messages between player and server.

    Methods raise an EpisodeError once the game is over, an ActionError for invalid input, and an OSError if the record
    cannot be written; :meth:`end` then tries to write the record again. Of the prompts, only the first has rules and
    state.
    """

    def __init__(self, name: str, talk: Conversation, keep: "Callable[[HostedGame], None]"):
        """Begin a game; ``keep`` is called with the finished game."""
        self.name, self.talk, self._keep = name, talk, keep
        self.messages = [f"{talk.game.rules}\n\n{talk.game.state}"]
        self._room = _MOST_CHARACTERS
        self._is_kept = False

    def combine(self, first: str, second: str) -> str:
        """Make an attempt with two entities, by label or number; describe the result in a sentence."""
        game = self.talk.game
        with self._hearing(message := f"{first} + {second}"):
            grammar = self.talk.grammar
            result = game.combine(
                *(read_label(item, game.labels, grammar=grammar) for item in (first, second))
            )
        self._note(message, result)
        self._keep_if_over()
        return result

    def look_up(self, item: str) -> tuple[str, list[str], str]:
        """Look up an entity; return label, facts as lines, and facts as a text."""
        entities = self.talk.game.graph.entities
        with self._hearing(message := f"look up {item}"):
            entity = read_label(item, entities, by_number=False, grammar=self.talk.grammar)
            facts, reply = self.talk.look_up(entity)
        self._note(message, "\n".join(facts))
        return entities[entity], facts, reply

    def end(self) -> None:
        """Give up the game if it is not over, and record the game."""
        if not self.talk.is_over:
            self.talk.game.end()
            self._note("end", "")  # the answer is the state alone
        self._keep_if_over()

    @contextmanager
    def _hearing(self, message: str) -> Iterator[None]:
        if self.talk.is_over:
            raise EpisodeError(f"This game is over. {self.talk.game.state} Start a new game.")
        try:
            yield
        except ActionError as error:
            self.talk.invalid_actions += 1
            self._note(message, str(error))
            raise

    def _note(self, message: str, answer: str) -> None:
        self._room -= len(message) + len(answer) + 100  # for two objects
        if self._room > 0:
            self.messages += [message, answer]

    def _keep_if_over(self) -> None:
        if self.talk.is_over and not self._is_kept:
            self._keep(self)
            self._is_kept = True
            self.messages.clear()


class HostedGames:
    """All games on a server, open to anyone with a game's id; ``keep`` records each finished game."""

    def __init__(self, play: Play, *, most: int = _MOST_GAMES):
        """Prepare to host games; at most ``most`` games are remembered."""
        self.play, self._most = play, most
        self.keep: Callable[[HostedGame], None] = lambda game: None
        self._begun: set[tuple[int, int]] = set()
        self._hosted: OrderedDict[str, HostedGame] = OrderedDict()

    def begin(self, task: int = 0, distractor_seed: int = 0) -> HostedGame:
        """Begin a game, see :meth:`Play.begin`; of a track each game once, and open-ended games in turn.

        If there are too many games, end and forget a game: finished games first, then the least recent. An EpisodeError
        if this game cannot be recorded, or was begun before on a track.
        """
        settings = self.play.settings
        if settings.track and settings.is_open_ended:
            distractor_seed = len(self._begun)
        key = task, distractor_seed
        if settings.track and (key in self._begun or distractor_seed >= settings.distractor_seeds):
            raise EpisodeError(
                f"Each game of {settings.track} is played once, and this game was begun before."
            )
        name = secrets.token_urlsafe(9)  # unguessable
        hosted = HostedGame(name, self.play.begin(task, distractor_seed), self.keep)
        self._begun.add(key)
        if len(self._hosted) >= self._most:
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
        """Return the game with the id ``name``; an unknown or forgotten id is an EpisodeError."""
        if name not in self._hosted:
            raise EpisodeError(
                f"Unknown game id '{name[:40]}': expected an id returned by `begin`; the server keeps the last "
                f"{self._most:,} games. Start a new game."
            )
        self._hosted.move_to_end(name)
        return self._hosted[name]


@contextmanager
def kept_games(path: Path, header: GamesHeader) -> Iterator[Callable[[HostedGame], None]]:
    """Lock a games file, and yield a function that appends a game; errors as :func:`open_games`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        path.touch()
    check_file(path)
    with locked(path, "written"):
        count = len(open_games(path, header))

        def keep(hosted: HostedGame) -> None:
            nonlocal count
            last = f"{hosted.messages[-1]}\n\n{hosted.talk.game.state}".lstrip()
            append_game(path, record_of(hosted.talk, [*hosted.messages[:-1], last], count))
            count += 1

        yield keep
