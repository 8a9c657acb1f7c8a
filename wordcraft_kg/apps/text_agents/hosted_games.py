"""Many games at once for players that come back: each game has an id, and the oldest are forgotten."""

import secrets
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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


class HostedGame:
    """A game with the messages of its player.

    Attributes:
        name: the game's id.
        talk: the game, and its counts.
        attempts: the attempts so far, in words.
        messages: prompts and answers in turn; the first has the rules and the first state, later ones no states.
        is_kept: whether the game is over and its record was kept.
    """

    def __init__(self, name: str, talk: Conversation):
        """Begin."""
        self.name, self.talk = name, talk
        self.attempts: list[str] = []
        self.messages = [f"{talk.game.rules}\n\n{talk.game.state}"]
        self.is_kept = False

    def note(self, said: str, answer: str) -> None:
        """Add a message and its answer."""
        if len(self.messages) < MOST_MESSAGES:
            self.messages += [said, answer]


class HostedGames:
    """Games of one world, played at the same time by everybody who knows a game's id.

    Attributes:
        play: the games and their rules.
        keep: called with each game that is over, to keep its record.

    Example:
        >>> world = World("kitchen", WordCraftConfig(part="test"))
        >>> hosted = HostedGames(Play(TaskGames(world), PlayedSettings.of_tasks(world, refusals=NEVER)))
        >>> name = hosted.begin(task=0).name
        >>> hosted.combine(name, "the flour", "2")
        'flour + water -> dough'
    """

    def __init__(self, play: Play, *, most: int = MOST_GAMES):
        """Host games; ``most`` of them are remembered."""
        self.play, self._most = play, most
        self.keep: Callable[[HostedGame], None] | None = None
        self._hosted: OrderedDict[str, HostedGame] = OrderedDict()

    def begin(self, task: int = 0, draw: int = 0) -> HostedGame:
        """Begin a game.

        Raises:
            ConfigError: if there is no such task or draw.
        """
        # A game's id cannot be guessed from another one.
        hosted = HostedGame(secrets.token_urlsafe(9), self.play.begin(task, draw))
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

    def combine(self, name: str, first: str, second: str) -> str:
        """Make an attempt and return its outcome in words.

        Raises:
            ActionError: if one of the two cannot be combined; it costs nothing.
            EpisodeError: if there is no such game, or it is over.
            OSError: if this attempt ended the game and its record could not be kept.
        """
        said = f"{first} + {second}"
        with self._heard(name, said) as hosted:
            game = hosted.talk.game
            came = game.combine(*(read_label(thing, game.labels) for thing in (first, second)))
        hosted.attempts.append(came)
        hosted.note(said, came)
        self._keep_if_over(hosted)
        return came

    def look_up(self, name: str, thing: str) -> tuple[str, list[str]]:
        """Return the label of an entity, and the facts about it.

        Raises:
            ActionError: if there is no such entity, or no look-up is left.
            EpisodeError: if there is no such game, or it is over.
        """
        said = f"look up {thing}"
        with self._heard(name, said) as hosted:
            entities = hosted.talk.game.graph.entities
            entity = read_label(thing, entities, by_number=False)
            facts = hosted.talk.facts(entity)
        hosted.note(said, "\n".join(facts))
        return entities[entity], facts

    def end(self, name: str) -> HostedGame:
        """Give a game up; one that is over stays as it is.

        Raises:
            EpisodeError: if there is no such game.
            OSError: if its record could not be kept.
        """
        hosted = self.game(name)
        if not hosted.talk.is_over:
            hosted.talk.game.end()
            hosted.note("end", "")  # the answer is the state alone
        self._keep_if_over(hosted)
        return hosted

    @contextmanager
    def _heard(self, name: str, said: str) -> Iterator[HostedGame]:
        """Yield a game that is not over; a message that is not understood is counted."""
        hosted = self.game(name)
        if hosted.talk.is_over:
            raise EpisodeError(f"This game is over. {hosted.talk.game.state} Begin another one.")
        try:
            yield hosted
        except ActionError as error:
            hosted.talk.refused += 1
            hosted.note(said, str(error))
            raise

    def _keep_if_over(self, hosted: HostedGame) -> None:
        if self.keep is not None and hosted.talk.is_over and not hosted.is_kept:
            self.keep(hosted)
            hosted.is_kept = True


@contextmanager
def kept_games(path: Path, header: GamesHeader) -> Iterator[Callable[[HostedGame], None]]:
    """Yield a function that adds a game that is over to a file, which no other server may write.

    Raises:
        ArtefactError: if another server writes the file, or it is damaged or of another kind.
        GraphMismatchError, ConfigError: if its games are of another graph or other settings; the file is unchanged.
    """
    if path.exists():
        check_file(path)
    else:
        open_games(path, header)
    with locked(path, "written"):
        open_games(path, header)  # may put another file in the place of one without games
    with locked(path, "written"):
        games = len(open_games(path, header))

        def keep(hosted: HostedGame) -> None:
            nonlocal games
            last = f"{hosted.messages[-1]}\n\n{hosted.talk.game.state}".lstrip()
            append_game(path, record_of(hosted.talk, [*hosted.messages[:-1], last], games))
            games += 1

        yield keep
