"""Many games at once for players that come back: each game has an id, and the oldest are forgotten."""

import secrets
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from wordcraft_kg.apps.text_agents.conversation import Conversation, Play
from wordcraft_kg.apps.text_agents.playing import append_game, open_games
from wordcraft_kg.apps.text_agents.records import GamesHeader
from wordcraft_kg.apps.text_agents.results import record_of
from wordcraft_kg.base.artefacts import check_file
from wordcraft_kg.base.errors import ActionError, EpisodeError
from wordcraft_kg.base.labels import read_label
from wordcraft_kg.base.settings import MAX_SIZE
from wordcraft_kg.runs.folder import locked

MOST_GAMES = 1_000
"""Most games that are remembered: ten for each of a hundred players at once, in less than 100 MiB."""
MOST_MESSAGES = 10_000
"""Most messages of a game that are kept, however often its player is refused."""
NEVER = MAX_SIZE
"""Refusals in a row until one costs an attempt: players that call tools read the error, and call again."""


@dataclass
class HostedGame:
    """A game with an id and the messages of its player.

    A game that is over raises an EpisodeError, a message that is not understood an ActionError, a record that cannot be
    kept an OSError; ``end`` tries again to keep it.

    Attributes:
        name: the game's id.
        talk: the game, and its counts.
        keep: called with the game once it is over, to keep its record.
        attempts: the attempts so far, in words.
        messages: prompts and answers in turn; the first has the rules and the first state, later ones no states.
    """

    name: str
    talk: Conversation
    keep: "Callable[[HostedGame], None]"
    attempts: list[str] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._is_kept = False
        self.messages.append(f"{self.talk.game.rules}\n\n{self.talk.game.state}")

    def combine(self, first: str, second: str) -> str:
        """Make an attempt and return its outcome in words."""
        game = self.talk.game
        with self._heard(said := f"{first} + {second}"):
            came = game.combine(*(read_label(thing, game.labels) for thing in (first, second)))
        self.attempts.append(came)
        self._note(said, came)
        self._keep_if_over()
        return came

    def look_up(self, thing: str) -> tuple[str, list[str]]:
        """Return the label of an entity, and the facts about it."""
        entities = self.talk.game.graph.entities
        with self._heard(said := f"look up {thing}"):
            entity = read_label(thing, entities, by_number=False)
            facts = self.talk.facts(entity)
        self._note(said, "\n".join(facts))
        return entities[entity], facts

    def end(self) -> None:
        """Give the game up, if it is not over."""
        if not self.talk.is_over:
            self.talk.game.end()
            self._note("end", "")  # the answer is the state alone
        self._keep_if_over()

    @contextmanager
    def _heard(self, said: str) -> Iterator[None]:
        if self.talk.is_over:
            raise EpisodeError(f"This game is over. {self.talk.game.state} Begin another one.")
        try:
            yield
        except ActionError as error:
            self.talk.refused += 1
            self._note(said, str(error))
            raise

    def _note(self, said: str, answer: str) -> None:
        if len(self.messages) < MOST_MESSAGES:
            self.messages += [said, answer]

    def _keep_if_over(self) -> None:
        if self.talk.is_over and not self._is_kept:
            self.keep(self)
            self._is_kept = True


class HostedGames:
    """Games of one world, played at the same time by everybody who knows a game's id.

    Attributes:
        play: the games and their rules.
        keep: see :class:`HostedGame`.

    Example:
        >>> world = World("kitchen", WordCraftConfig(part="test"))
        >>> hosted = HostedGames(Play(TaskGames(world), PlayedSettings.of_tasks(world, refusals=NEVER)))
        >>> game = hosted.begin(task=0)
        >>> hosted.game(game.name).combine("the flour", "2")
        'flour + water -> dough'
    """

    def __init__(self, play: Play, keep: Callable[[HostedGame], None] = lambda game: None, *, most: int = MOST_GAMES):
        """Host games; ``most`` of them are remembered."""
        self.play, self.keep, self._most = play, keep, most
        self._hosted: OrderedDict[str, HostedGame] = OrderedDict()

    def begin(self, task: int = 0, draw: int = 0) -> HostedGame:
        """Begin a game.

        Raises:
            ConfigError: if there is no such task or draw.
        """
        # A game's id cannot be guessed from another one.
        hosted = HostedGame(secrets.token_urlsafe(9), self.play.begin(task, draw), self.keep)
        self._hosted[hosted.name] = hosted
        while len(self._hosted) > self._most:
            self._hosted.popitem(last=False)
        return hosted

    def game(self, name: str) -> HostedGame:
        """Return a game.

        Raises:
            EpisodeError: if there is none, or it was forgotten.
        """
        if name not in self._hosted:
            raise EpisodeError(
                f"There is no game '{name[:40]}': expected the id that `begin` returned, of one of the last "
                f"{self._most:,} games. Begin another one."
            )
        self._hosted.move_to_end(name)
        return self._hosted[name]


@contextmanager
def kept_games(path: Path, header: GamesHeader) -> Iterator[Callable[[HostedGame], None]]:
    """Yield a function that adds a game that is over to a file, which no other server may write.

    Raises:
        ArtefactError: if another server writes the file, or it is damaged or of another kind.
        GraphMismatchError, ConfigError: if its games are of another graph or other settings; the file is unchanged.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    check_file(path)
    with locked(path, "written"):
        games = len(open_games(path, header))

        def keep(hosted: HostedGame) -> None:
            nonlocal games
            last = f"{hosted.messages[-1]}\n\n{hosted.talk.game.state}".lstrip()
            append_game(path, record_of(hosted.talk, [*hosted.messages[:-1], last], games))
            games += 1

        yield keep
