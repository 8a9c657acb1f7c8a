"""Games as conversations: prompts to a player, and the player's answers."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

from wordcraft_kg.apps.text_agents.games import DiscoveryGames, Game, TaskGames
from wordcraft_kg.apps.text_agents.knowledge import Knowledge, open_knowledge
from wordcraft_kg.apps.text_agents.records import PlayedSettings
from wordcraft_kg.apps.text_agents.settings import (
    ATTEMPTS,
    LOOK_UPS,
    MAX_INVALID,
    EvaluationSettings,
    GameSettings,
)
from wordcraft_kg.base.answers import answer_line, read_answer
from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.base.labels import read_label
from wordcraft_kg.base.wording import counted
from wordcraft_kg.envs.words import prompt_text
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import open_graph

# Language models write "look up", "look-up" and "lookup", with and without a colon.
_LOOK_UP = re.compile(r"look[\s-]*up\b[\s:]*(.*)", re.IGNORECASE)


class Conversation:
    """A game played in text: an opening prompt, and a reply to each message by the player.

    Two labels in a message are an attempt to combine the entities, read by
    :func:`~wordcraft_kg.base.answers.read_answer`; a last line with ``look up`` and a label is a
    request for facts. An invalid message costs nothing, but after ``max_invalid`` in a row the next
    costs an attempt, so every conversation ends.

    Attributes:
        game: the game.
        invalid_actions: number of messages that were not understood.
        lost_attempts: number of attempts lost by them.
        look_ups: number of entities that were looked up.

    Example:
        >>> games = TaskGames(World("kitchen", WordCraftConfig(part="test", num_distractors=2)))
        >>> talk = Conversation(games.begin(task=0))
        >>> talk.opening.splitlines()[-1]
        'Attempts left: 1'
        >>> talk.hear("1 + unicorn").splitlines()[0][:15], talk.game.attempts_left
        ('Invalid answer:', 1)
    """

    def __init__(
        self,
        game: Game,
        knowledge: Knowledge | None = None,
        *,
        max_invalid: int = MAX_INVALID,
        look_ups: int = LOOK_UPS,
    ):
        """Begin a conversation.

        Args:
            game: a game that has just begun.
            knowledge: source of look-ups; None offers none.
            max_invalid: consecutive invalid messages without cost; the next one costs an attempt.
            look_ups: look-ups in the game.
        """
        self.game = game
        self.invalid_actions = 0
        self.lost_attempts = 0
        self.look_ups = 0
        self._knowledge = knowledge
        self._max_invalid = max_invalid
        self._most_look_ups = look_ups
        self._in_a_row = 0

    @property
    def rules(self) -> str:
        """Text with the game's rules, the answer format and any offer of look-ups."""
        parts = [self.game.rules, prompt_text("answer")]
        if self.offers_look_ups:
            parts.append(prompt_text("look_up", look_ups=counted(self.offers_look_ups, "look-up")))
        return "\n".join(parts)

    @property
    def offers_look_ups(self) -> int:
        """Number of look-ups in the game; 0 if none are offered."""
        return 0 if self._knowledge is None else self._most_look_ups

    @property
    def opening(self) -> str:
        """First prompt to the player: rules and current state."""
        return f"{self.rules}\n\n{self.game.state}"

    @property
    def is_over(self) -> bool:
        """Whether the game is over."""
        return self.game.is_over

    @property
    def after_the_end(self) -> str:
        """Reply to a message after the end of the game, which changes nothing; else empty."""
        return f"This game is over. {self.game.state}" if self.is_over else ""

    def hear(self, message: str) -> str:
        """Carry out the attempt or look-up in a player's message.

        Returns:
            The reply: the outcome and the new state of the game.

        Raises:
            EpisodeError: for an attempt after the end of the game, also one that an invalid message
                would cost.
        """
        return self._answer(lambda: self._act(message))

    def combine(self, first: str, second: str) -> str:
        """Make an attempt with two items by label or number, as a tool does.

        Returns:
            The reply: the outcome and the new state of the game.

        Raises:
            EpisodeError: for an attempt after the end of the game, also one that invalid items
                would cost.
        """

        def attempt() -> str:
            at_hand = self.game.labels
            return self.game.combine(read_label(first, at_hand), read_label(second, at_hand))

        return self._answer(attempt)

    def look_up_item(self, item: str) -> str:
        """Look up an item by label, as a tool does; returns the reply as :meth:`combine`."""
        return self._answer(lambda: self.look_up(self._entity(item))[1])

    def _answer(self, act: Callable[[], str]) -> str:
        """Carry out an attempt or look-up; return its outcome and the new state."""
        try:
            outcome = act()
            self._in_a_row = 0
        except ActionError as error:
            outcome = self._reject(str(error))
        return f"{outcome}\n\n{self.game.state}"

    def _act(self, message: str) -> str:
        """Carry out the attempt or look-up in a message; ActionError if there is none."""
        line = answer_line(message, self.game.labels)
        # Without knowledge "look up" is an ordinary word: an entity may have this label.
        look_up = _LOOK_UP.fullmatch(line) if self._knowledge is not None else None
        if look_up is not None:
            return self.look_up(self._entity(look_up[1]))[1]
        pair = read_answer(message, self.game.labels)
        return self.game.combine(*pair)

    def _entity(self, label: str) -> int:
        """Return the id of an entity, at hand or not.

        By label alone: numbers stand for the entities at hand.
        """
        return read_label(label, self.game.graph.entities, by_number=False)

    def look_up(self, entity: int) -> tuple[list[str], str]:
        """Count a look-up, and return an entity's facts as lines, and as a reply.

        Raises:
            ActionError: if no look-up is left.
        """
        if self._knowledge is None or self.look_ups >= self._most_look_ups:
            raise ActionError(prompt_text("no_look_ups"))
        facts = self._knowledge.facts(entity, self.game)
        # Only now: a look-up that failed is not counted.
        self.look_ups += 1
        return facts, self._knowledge.reply(self.game.graph.entities[entity], facts)

    def _reject(self, reason: str) -> str:
        self.invalid_actions += 1
        self._in_a_row += 1
        if self._in_a_row <= self._max_invalid:
            return prompt_text("invalid", reason=reason)
        # The count begins anew, so that each lost attempt stands for equally many messages.
        self.game.lose_attempt()
        self.lost_attempts += 1
        self._in_a_row = 0
        return prompt_text("attempt_lost", reason=reason)


def converse(talk: Conversation, answer: Callable[[str], str]) -> list[str]:
    """Let a player play a game to its end.

    Args:
        talk: the conversation at its beginning.
        answer: the player: a function from a prompt to an answer.

    Returns:
        All messages, prompts and answers in turn; the last one is the outcome.
    """
    messages = [talk.opening]
    while not talk.is_over:
        messages.append(answer(messages[-1]))
        messages.append(talk.hear(messages[-1]))
    return messages


@dataclass(frozen=True)
class Play:
    """Games with settings and facts to look up.

    Attributes:
        games: tasks or open-ended games.
        settings: settings as recorded with each game.
        knowledge: source of look-ups; None offers none.

    Raises:
        LeakError: if look-ups would leak train recipes on train tasks.
    """

    games: TaskGames | DiscoveryGames
    settings: PlayedSettings
    knowledge: Knowledge | None = None

    def __post_init__(self) -> None:
        if self.knowledge is not None:
            # A leak shows with the first look-up: found here, it costs no game.
            self.knowledge.facts(0, self.games.begin())

    @classmethod
    def open(
        cls, graph: str, settings: GameSettings, *, reward: str = "sparse", **rules: Any
    ) -> Self:
        """Prepare the games on a graph.

        Args:
            graph: graph folder, recipe book file, or name of a built-in book.
            settings: the games.
            reward: reward preset of tasks, see :data:`~wordcraft_kg.envs.config.REWARDS`.
            rules: further fields of
                :class:`~wordcraft_kg.apps.text_agents.records.PlayedSettings` to record.

        Raises:
            ConfigError: for settings that do not fit the graph, or an unknown reward.
            GraphMismatchError: if the scorer is of another graph or split.
            LeakError: if a scorer would reveal its train recipes on train tasks.
            TaskError: if the graph has no task for these settings.
            RecipeFileError: if there is no such graph, or a book cannot be read.
            ArtefactError: if the scorer's folder or a graph folder is unfinished or damaged.
        """
        opened = open_graph(graph)
        knowledge = open_knowledge(settings, opened)
        rules |= {"knowledge": settings.knowledge, "look_ups": settings.look_ups}
        if isinstance(settings, EvaluationSettings):
            rules |= {
                "distractor_seeds": settings.distractor_seeds,
                "tasks": settings.tasks,
                "max_invalid": settings.max_invalid,
            }
        if knowledge is not None:
            rules |= {"scorer": knowledge.scorer, "kg": knowledge.kg}
        if settings.open_ended:
            worlds = DiscoveryGames(
                opened, attempts=settings.attempts or ATTEMPTS, base=settings.base
            )
            return cls(worlds, PlayedSettings.of(worlds.env, opened.split, **rules), knowledge)
        tasks = TaskGames(World(opened, replace(settings.environment, reward=reward)))
        return cls(tasks, PlayedSettings.of(tasks.world, opened.split, **rules), knowledge)

    def begin(self, task: int = 0, distractor_seed: int = 0) -> Conversation:
        """Begin a game on a task (index) with the distractors for this seed.

        In the open-ended world the task is ignored, and the seed is the number of the game.

        Raises:
            ConfigError: if there is no such task or seed.
        """
        rules = self.settings
        game = self.games.begin(task, distractor_seed)
        return Conversation(
            game, self.knowledge, max_invalid=rules.max_invalid, look_ups=rules.look_ups
        )
