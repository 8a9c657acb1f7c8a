"""Many games at once for players that come back: each game has an id, and the oldest are forgotten."""

import secrets
from collections import OrderedDict
from collections.abc import Callable

from wordcraft_kg.apps.text_agents.conversation import Conversation
from wordcraft_kg.apps.text_agents.games import DiscoveryGames, TaskGames
from wordcraft_kg.apps.text_agents.knowledge import Knowledge
from wordcraft_kg.apps.text_agents.records import WordsSettings
from wordcraft_kg.base.errors import ActionError, EpisodeError
from wordcraft_kg.base.labels import read_label
from wordcraft_kg.base.settings import MAX_SIZE

MOST_GAMES = 1_000
"""Most games that are remembered: ten for each of a hundred players at once, in less than 100 MiB."""
MOST_MESSAGES = 10_000
"""Most messages of a game that are kept: who is refused for ever shall not fill the memory."""
NEVER = MAX_SIZE
"""Refusals in a row until one costs an attempt: who calls tools is told what was wrong, and can call again."""


class HostedGame:
    """A game with what its player has been told.

    Attributes:
        name: the game's id.
        talk: the game, and what is counted.
        attempts: the attempts so far, in words.
        messages: what was told and said in turn; the first has the rules and the first state, later ones no states.
        is_kept: whether the game is over and its record was kept.
    """

    def __init__(self, name: str, talk: Conversation):
        """Begin."""
        self.name, self.talk = name, talk
        self.attempts: list[str] = []
        self.messages = [f"{talk.game.rules}\n\n{talk.game.state}"]
        self.is_kept = False

    def note(self, said: str, answer: str) -> None:
        """Add what was said and what was told then."""
        if len(self.messages) < MOST_MESSAGES:
            self.messages += [said, answer]


class HostedGames:
    """Games of one world, played at the same time by whoever knows a game's id.

    Attributes:
        games: the world.
        settings: what is played, and under which rules.
        keep: called with each game that is over; its record is kept when this returns.

    Example:
        >>> world = World("kitchen", WordCraftConfig(part="test"))
        >>> hosted = HostedGames(TaskGames(world), WordsSettings.of_tasks(world, refusals=NEVER))
        >>> name = hosted.begin(task=0).name
        >>> hosted.combine(name, "the flour", "2")
        'flour + water -> dough'
    """

    def __init__(
        self,
        games: TaskGames | DiscoveryGames,
        settings: WordsSettings,
        knowledge: Knowledge | None = None,
        keep: Callable[[HostedGame], None] | None = None,
        *,
        most: int = MOST_GAMES,
    ):
        """Take a world.

        Args:
            games: the world.
            settings: what is played, and under which rules.
            knowledge: what may be looked up; None for nothing.
            keep: see the attribute; None keeps nothing.
            most: most games that are remembered.

        Raises:
            LeakError: if a scorer would tell what it remembers of train tasks.
        """
        self.games, self.settings = games, settings
        self.keep, self._knowledge, self._most = keep, knowledge, most
        self._hosted: OrderedDict[str, HostedGame] = OrderedDict()
        if knowledge is not None:
            knowledge.facts(0, self._talk(0, 0).game)  # so that what is refused is refused before somebody plays

    @property
    def has_look_ups(self) -> bool:
        """Whether anything can be looked up."""
        return self._knowledge is not None and self.settings.look_ups > 0

    def begin(self, task: int = 0, draw: int = 0) -> HostedGame:
        """Begin a game; in the open-ended world all begin alike.

        Raises:
            ConfigError: if there is no such task or draw.
        """
        # Who does not know a game's id cannot play it, nor guess it from another one.
        hosted = HostedGame(secrets.token_urlsafe(9), self._talk(task, draw))
        self._hosted[hosted.name] = hosted
        while len(self._hosted) > self._most:
            self._hosted.popitem(last=False)
        return hosted

    def game(self, name: str) -> HostedGame:
        """Return a game.

        Raises:
            EpisodeError: if there is none, or none any more.
        """
        if name not in self._hosted:
            raise EpisodeError(
                f"There is no game '{name[:40]}': expected the id that `begin` returned, of one of the last "
                f"{self._most:,} games. Begin another one."
            )
        self._hosted.move_to_end(name)
        return self._hosted[name]

    def combine(self, name: str, first: str, second: str) -> str:
        """Make an attempt; return in words what came of it.

        Raises:
            ActionError: if one of the things is not there to be combined; it costs nothing.
            EpisodeError: if there is no such game, or it is over.
            OSError: if this attempt ended the game and its record could not be kept.
        """
        hosted = self._going_on(name)
        game, said = hosted.talk.game, f"{first} + {second}"
        try:
            one, other = (read_label(thing, game.labels) for thing in (first, second))
        except ActionError as error:
            hosted.talk.refused += 1
            hosted.note(said, str(error))
            raise
        came = game.combine(one, other)
        hosted.attempts.append(came)
        hosted.note(said, came)
        self._keep_if_over(hosted)
        return came

    def look_up(self, name: str, thing: str) -> tuple[str, list[str]]:
        """Return a thing, and what is known of it.

        Raises:
            ActionError: if there is no such thing, or no look-up is left.
            EpisodeError: if there is no such game, or it is over.
        """
        hosted = self._going_on(name)
        talk, said = hosted.talk, f"look up {thing}"
        try:
            entity = read_label(thing, talk.game.graph.entities, by_number=False)
            facts = talk.facts(entity)
        except ActionError as error:
            talk.refused += 1
            hosted.note(said, str(error))
            raise
        hosted.note(said, "\n".join(facts))
        return talk.game.graph.entities[entity], facts

    def end(self, name: str) -> HostedGame:
        """Give a game up; one that is over stays as it is.

        Raises:
            EpisodeError: if there is no such game.
            OSError: if its record could not be kept.
        """
        hosted = self.game(name)
        if not hosted.talk.is_over:
            hosted.talk.game.end()
            hosted.note("end", "")  # what is told is the state alone
        self._keep_if_over(hosted)
        return hosted

    def _talk(self, task: int, draw: int) -> Conversation:
        games, rules = self.games, self.settings
        game = games.begin(task, draw) if isinstance(games, TaskGames) else games.begin()
        return Conversation(game, self._knowledge, refusals=rules.refusals, look_ups=rules.look_ups)

    def _going_on(self, name: str) -> HostedGame:
        hosted = self.game(name)
        if hosted.talk.is_over:
            raise EpisodeError(f"This game is over. {hosted.talk.game.state} Begin another one.")
        return hosted

    def _keep_if_over(self, hosted: HostedGame) -> None:
        if self.keep is not None and hosted.talk.is_over and not hosted.is_kept:
            self.keep(hosted)
            hosted.is_kept = True
