"""A game as a conversation: what a player is told, what it says, and what its words do."""

import re
from collections.abc import Callable

from wordcraft_kg.apps.text_agents.config import LOOK_UPS, REFUSALS
from wordcraft_kg.apps.text_agents.games import Game
from wordcraft_kg.apps.text_agents.knowledge import Knowledge
from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.base.labels import last_line, read_label, read_pair
from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.envs.words import told

_LOOK_UP = re.compile(r"look[\s-]*up\b[\s:]*(.*)", re.IGNORECASE)


class Conversation:
    """A game in texts: the opening, and an answer to each message.

    The last line of a message counts: two things are an attempt, ``look up`` and a thing asks what is known of it. A
    message that is not understood is refused with what would be, and costs nothing; after some refusals in
    a row the next one costs the attempt, so that every conversation ends.

    Attributes:
        game: the game.
        refused: messages that were not understood.
        lost: attempts that were lost by them.
        look_ups: things that were looked up.

    Example:
        >>> games = TaskGames(World("kitchen", WordCraftConfig(part="test", num_distractors=2)))
        >>> talk = Conversation(games.begin(task=0))
        >>> talk.opening.splitlines()[-1], talk.hear("1 + unicorn").splitlines()[0][:15], talk.game.attempts_left
        ('Attempts left: 1', 'Not understood:', 1)
    """

    def __init__(
        self, game: Game, knowledge: Knowledge | None = None, *, refusals: int = REFUSALS, look_ups: int = LOOK_UPS
    ):
        """Begin a conversation.

        Args:
            game: the game.
            knowledge: what the player may look up; None for nothing.
            refusals: how often in a row an answer that is not understood costs nothing.
            look_ups: how often the player may look something up.

        Raises:
            ConfigError: for a negative number.
        """
        self.game, self._knowledge = game, knowledge
        self._refusals = whole("refusals", refusals, 0, MAX_SIZE)
        self._most_look_ups = whole("look_ups", look_ups, 0, MAX_SIZE)
        self.refused = self.lost = self.look_ups = 0
        self._in_a_row = 0

    @property
    def rules(self) -> str:
        """What the player is told once: the game, and how to answer."""
        parts = [self.game.rules, told("answer")]
        if self._knowledge is not None and self._most_look_ups:
            parts.append(told("look_up", look_ups=self._most_look_ups))
        return "\n".join(parts)

    @property
    def opening(self) -> str:
        """The rules and the state: what is told first."""
        return f"{self.rules}\n\n{self.game.state}"

    @property
    def is_over(self) -> bool:
        """Whether the game is over, so that nothing more is heard."""
        return self.game.is_over

    def hear(self, message: str) -> str:
        """Take a message in, and return what the player is told: what came of it, and the state.

        Raises:
            EpisodeError: if the game is over.
        """
        line = last_line(message)
        asked = _LOOK_UP.fullmatch(line) if self._knowledge is not None else None
        try:
            if asked is not None:
                entity = read_label(asked[1], self.game.graph.entities, by_number=False)
                said = self._looked_up(entity)
            else:
                said = self.game.combine(*read_pair(line, self.game.labels))
        except ActionError as error:
            return self._after(self._refuse(str(error)))
        self._in_a_row = 0
        return self._after(said)

    def facts(self, entity: int) -> list[str]:
        """Return what is known of a thing to who may look it up; it is counted.

        Raises:
            ActionError: if nothing more may be looked up.
        """
        if self._knowledge is None or self.look_ups >= self._most_look_ups:
            raise ActionError(told("no_look_ups"))
        found = self._knowledge.facts(entity, self.game)
        self.look_ups += 1
        return found

    def _looked_up(self, entity: int) -> str:
        facts, label = self.facts(entity), self.game.graph.entities[entity]
        return told("found", entity=label, facts="\n".join(facts)) if facts else told("nothing_found", entity=label)

    def _refuse(self, why: str) -> str:
        self.refused += 1
        self._in_a_row += 1
        if self._in_a_row <= self._refusals:
            return told("refused", why=why)
        self.game.lose_attempt()
        self.lost += 1
        self._in_a_row = 0
        return told("lost", why=why)

    def _after(self, said: str) -> str:
        return f"{said}\n\n{self.game.state}"


def converse(talk: Conversation, answer: Callable[[str], str]) -> list[str]:
    """Let a player play a game to its end.

    Args:
        talk: the conversation, at its beginning.
        answer: the player: what it says to what it is told.

    Returns:
        all messages, those told and those said in turn, the verdict last.
    """
    messages = [talk.opening]
    while not talk.is_over:
        messages.append(answer(messages[-1]))
        messages.append(talk.hear(messages[-1]))
    return messages
