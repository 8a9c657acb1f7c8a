"""Games as conversations: prompts to a player, the player's answers, and facts to look up.

A :class:`Conversation` is the session of one game, whichever interface carries it: programs, MCP,
OpenEnv, TRL, Gymnasium or Inspect.
"""

import re
from collections.abc import Callable

import numpy as np

from wordcraft_kg.apps.text_agents.games import Game, TaskGame
from wordcraft_kg.apps.text_agents.settings import MAX_INVALID
from wordcraft_kg.base import MAX_SIZE, ActionError, EpisodeError, counted
from wordcraft_kg.base.answers import answer_line, read_answer, read_set
from wordcraft_kg.base.labels import read_label
from wordcraft_kg.envs.words import combined, prompt_text
from wordcraft_kg.graphs import layers

Facts = Callable[[Game, int], list[str]]
"""From a game and an entity (id) to facts about it as text lines, the most relevant first."""
_MOST_FACTS = 40
"""Most recipes in a reply; some entities have hundreds."""


def hidden_pairs(game: Game) -> set[int]:
    """Return the pairs (``graph.pair_of_recipe``) that look-ups hide in a game.

    Hidden are all pairs in the task's plans, and every pair that makes the goal in this world with
    both ingredients on the starting table or makeable from this table before the last attempt (a
    crafting round per attempt): no look-up completes a way to the goal. A pair that makes two
    entities is hidden with both, because to combine it is what solves the task. None are hidden in
    the open-ended world.
    """
    if not isinstance(game, TaskGame):
        return set()
    graph = game.graph
    usable = game.world.usable
    goal_rows = graph.recipes_of(game.goal)
    goal_rows = goal_rows[usable[goal_rows]]
    # Rounds of crafting until an ingredient can be at hand; -1 if it never can. Shape (R, S).
    # The padding of smaller sets is always at hand.
    rounds = np.append(layers(graph, game.start, usable), 0)[graph.sets[goal_rows, :-1]]
    in_time = ((rounds >= 0) & (rounds < game.world.config.attempts)).all(axis=1)
    rows = goal_rows[in_time].tolist()
    for plan in game.tasks.plans[game.task]:
        rows += plan
    return {*graph.pair_of_recipe[rows].tolist()}


def known_recipes(game: Game, entity: int) -> list[str]:
    """Return the train recipes with an entity as text lines, at most 40, without hidden pairs.

    First come the recipes that make the entity, then those that use it with something at hand, then
    its other uses. Hidden are :func:`hidden_pairs`.

    Args:
        game: the game in which the entity is looked up.
        entity: id of the entity.
    """
    graph = game.graph
    is_known = game.split.is_in("train")
    hidden = hidden_pairs(game)
    at_hand = {graph.id_of(label) for label in game.labels}

    def rank(row: int) -> tuple[int, int]:
        *ingredients, result = graph.sets[row].tolist()
        partners = {*ingredients} - {entity, graph.num_entities} or {entity}
        if result == entity:
            relevance = 0
        elif partners <= at_hand:
            relevance = 1
        else:
            relevance = 2
        # The row breaks ties, so that replies never depend on a set.
        return relevance, row

    rows = {*graph.recipes_of(entity).tolist(), *graph.uses_of(entity).tolist()}
    visible = [row for row in rows if is_known[row] and graph.pair_of_recipe[row] not in hidden]
    ranked = sorted(visible, key=rank)
    recipes = graph.recipe_labels(graph.sets[ranked[:_MOST_FACTS]])
    facts = [combined(recipe.ingredients, (recipe.result,)) for recipe in recipes]
    if len(ranked) > _MOST_FACTS:
        rest_text = counted(len(ranked) - _MOST_FACTS, "more recipe")
        facts.append(prompt_text("more_recipes", more=rest_text))
    return facts


class Seat:
    """A player's place at one game after another, as interfaces with a reset have it.

    Attributes:
        talk: the conversation of the present game; None before the first ``reset``.
    """

    talk: "Conversation | None" = None

    @property
    def _begun(self) -> "Conversation":
        if self.talk is None:
            raise EpisodeError("there is no game; call reset first.")
        return self.talk


LONGEST_ITEM = 1_000
"""Characters of an item that are read: more than the longest label."""
MOST_ITEMS = 100
"""Items of a set that are read: more than the largest recipe has."""
NEVER = MAX_SIZE
"""Value of ``max_invalid`` without a limit: invalid messages never cost an attempt."""
MOST_CHARACTERS = 200_000
"""Noted characters of a game without that limit: a thousand games stay below about 200 MiB."""
# Language models write "look up", "look-up" and "lookup", with and without a colon.
_LOOK_UP = re.compile(r"look[\s-]*up\b[\s:]*(.*)", re.IGNORECASE)


class Conversation:
    """A game played in text: an opening prompt, and a reply to each message by the player.

    Two labels in a message are an attempt to combine the entities, read by
    :func:`~wordcraft_kg.base.answers.read_answer` (larger sets by ``read_set``); a last line with
    ``look up`` and a label is a request for facts. An invalid message costs nothing, but after
    ``max_invalid`` in a row the next costs an attempt, so every conversation ends.

    Tools act by :meth:`combine` and :meth:`look_up_item`, with replies as for messages.

    Attributes:
        game: the game.
        name: the game's name, or its id on a server of tools; empty for a game without either.
        invalid_actions: number of messages that were not understood.
        lost_attempts: number of attempts lost by them.
        look_ups: number of entities that were looked up.
        offers_look_ups: number of look-ups in the game; 0 if none are offered.
        reward: reward of the last action.
        outcome: result of the last action, without the state.
        is_invalid: whether the last message was not understood.
        facts: label and facts of the last look-up.
        opening: first prompt to the player: rules and state at the start.
        messages: all prompts and answers in turn; with :data:`NEVER` as far as there is room, and
            without states in between.
        on_end: called when the game is over, and again by :meth:`end`; an OSError says that the
            game could not be recorded. None calls nothing.

    Example:
        >>> world = World.open("kitchen", WordCraftConfig(part="test", num_distractors=2))
        >>> talk = TaskGames(world).begin(task=0)
        >>> talk.opening.splitlines()[-1]
        'Attempts left: 1'
        >>> talk.hear("1 + unicorn").splitlines()[0][:15], talk.game.attempts_left
        ('Invalid answer:', 1)
    """

    def __init__(
        self,
        game: Game,
        *,
        max_invalid: int = MAX_INVALID,
        look_ups: int = 0,
        knowledge: Facts = known_recipes,
    ):
        """Begin a conversation.

        Args:
            game: a game that has just begun.
            max_invalid: consecutive invalid messages without cost; the next one costs an attempt.
            look_ups: look-ups in the game; 0 offers none.
            knowledge: source of the look-ups.
        """
        self.game = game
        self.name = ""
        self.invalid_actions = 0
        self.lost_attempts = 0
        self.look_ups = 0
        self.offers_look_ups = look_ups
        self.reward = 0.0
        self.outcome = ""
        self.is_invalid = False
        self.facts: tuple[str, list[str]] = ("", [])
        self.on_end: Callable[[Conversation], None] | None = None
        self._knowledge = knowledge
        self._max_invalid = max_invalid
        self._in_a_row = 0
        self._room = MOST_CHARACTERS
        self.opening = f"{self.rules}\n\n{game.state}"
        self.messages = [self.opening]

    @property
    def rules(self) -> str:
        """Text with the game's rules, the answer format and any offer of look-ups."""
        parts = [self.game.rules, self.game.text("answer")]
        if self.offers_look_ups:
            parts.append(prompt_text("look_up", look_ups=counted(self.offers_look_ups, "look-up")))
        return "\n".join(parts)

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
            OSError: if the game is over now, and cannot be recorded.
        """
        return self._answer(message, lambda: self._act(message))

    def combine(self, *items: str) -> str:
        """Make an attempt with two items, or a set, by label or number, as a tool does.

        Returns:
            The reply: the outcome and the new state of the game.

        Raises:
            EpisodeError: for an attempt after the end of the game, also one that invalid items
                would cost.
            OSError: if the game is over now, and cannot be recorded.
        """
        shown_items = [item[:LONGEST_ITEM] for item in items[:MOST_ITEMS]]
        at_hand = self.game.labels
        return self._answer(
            " + ".join(shown_items),
            lambda: self.game.combine(*(read_label(item, at_hand) for item in shown_items)),
        )

    def look_up_item(self, item: str) -> str:
        """Look up an item by label, as a tool does; returns the reply as :meth:`combine`."""
        label = item[:LONGEST_ITEM]
        return self._answer(f"look up {label}", lambda: self._look_up(label))

    def end(self) -> None:
        """Give up the game if it is not over.

        Raises:
            OSError: if the game cannot be recorded; another call tries again.
        """
        if not self.is_over:
            self.game.end()
            self._note("end", self.game.state)
        self._report_end()

    def _note(self, message: str, answer: str) -> None:
        # Invalid messages that cost no attempt may come without end, so this bounds memory.
        if self._max_invalid == NEVER:
            self._room -= len(message) + len(answer) + 100  # for two objects
        if self._room > 0 or self.is_over:
            self.messages += [message, answer]

    def _report_end(self) -> None:
        if self.is_over and self.on_end is not None:
            self.on_end(self)

    def _answer(self, message: str, act: Callable[[], str]) -> str:
        """Carry out an attempt or look-up; return its outcome and the new state."""
        reward_before = self.game.reward
        self.is_invalid = False
        try:
            self.outcome = act()
            self._in_a_row = 0
        except ActionError as error:
            self.is_invalid = True
            self.outcome = self._reject(str(error))
        reply = f"{self.outcome}\n\n{self.game.state}"
        self.reward = self.game.reward - reward_before
        has_state = self.is_over or self._max_invalid < NEVER
        self._note(message, reply if has_state else self.outcome)
        self._report_end()
        return reply

    def _act(self, message: str) -> str:
        """Carry out the attempt or look-up in a message; ActionError if there is none."""
        line = answer_line(message, self.game.labels)
        # Without look-ups "look up" is an ordinary word: an entity may have this label.
        look_up = _LOOK_UP.fullmatch(line) if self.offers_look_ups else None
        if look_up is not None:
            return self._look_up(look_up[1])
        if self.game.most_picks:
            return self.game.combine(*read_set(message, self.game.labels, self.game.most_picks))
        return self.game.combine(*read_answer(message, self.game.labels))

    def _look_up(self, item: str) -> str:
        """Count a look-up, and return an entity's facts as a reply.

        The entity need not be at hand.

        Raises:
            ActionError: for an unknown item, or if no look-up is left.
        """
        # By label alone: numbers stand for the entities at hand.
        entities = self.game.graph.entities
        entity = read_label(item, entities, by_number=False)
        if self.look_ups >= self.offers_look_ups:
            raise ActionError(self.game.text("no_look_ups"))
        facts = self._knowledge(self.game, entity)
        # Only now: a look-up that failed is not counted.
        self.look_ups += 1
        self.facts = (entities[entity], facts)
        prompt = "known_recipes" if self._knowledge is known_recipes else "likely_links"
        prompt = prompt if facts else "no_facts"
        return prompt_text(prompt, entity=entities[entity], facts="\n".join(facts))

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
