"""A session of an OpenEnv client: one game after another, as OpenEnv's ``reset`` and ``step``.

Nothing here knows of connections: :mod:`~wordcraft_kg.apps.text_agents.openenv_server` carries the
messages.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from wordcraft_kg.apps.text_agents.conversation import Conversation
from wordcraft_kg.apps.text_agents.hosted_games import KeptGames
from wordcraft_kg.apps.text_agents.named_games import GameList, NamedGame
from wordcraft_kg.base.errors import ActionError, ConfigError, EpisodeError
from wordcraft_kg.base.settings import MAX_SIZE, whole

LONGEST_ANSWER = 100_000
"""Characters at the end of an answer that are read: only its last line counts."""
_LONGEST_ITEM = 1_000
_RESET = ("seed", "episode_id", "split", "index", "task_id")
_STEP = ({"answer"}, {"first", "second"}, {"look_up"})
# A client for language models shows this schema to the model, so it is a prompt.
ACTION_SCHEMA: dict[str, Any] = {
    "title": "CraftingAction",
    "type": "object",
    "required": ["answer"],
    "properties": {
        "answer": {
            "type": "string",
            "description": "text whose last line names two items, such as 'water + earth'",
        }
    },
    "additionalProperties": False,
}
_TEXT = {"type": "string"}
_WHOLE = {"type": "integer"}
OBSERVATION_SCHEMA: dict[str, Any] = {
    "title": "CraftingObservation",
    "type": "object",
    "properties": {
        "text": {**_TEXT, "description": "first the rules, then the reply; always the state"},
        "goal": _TEXT,
        "table": {"type": "array", "items": _TEXT},
        "attempts_left": _WHOLE,
        "task_id": {**_TEXT, "description": "name of the game"},
    },
}
STATE_SCHEMA: dict[str, Any] = {
    "title": "CraftingState",
    "type": "object",
    "properties": {"episode_id": {"type": ["string", "null"]}, "step_count": _WHOLE},
}


class CraftingSession:
    """The games of a client, one at a time.

    Attributes:
        games: the games on offer.
    """

    def __init__(self, games: GameList, keep: KeptGames | None = None):
        """Wait for :meth:`reset`.

        Args:
            games: the games on offer.
            keep: file for finished games; None records nothing.
        """
        self.games = games
        self._keep = keep
        self._game: NamedGame | None = None
        self._talk: Conversation | None = None
        self._messages: list[str] = []
        self._episode: str | None = None
        self._steps = 0

    def reset(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """Begin a game, and end the one before.

        Args:
            asked: ``task_id``, the name of a game; or ``split`` and ``index``, with ``seed`` as the
                distractor seed (0 by default); or neither: then ``seed`` draws the game, and
                without a seed the system does. ``episode_id`` is only repeated in the state.

        Returns:
            the first observation; its text has the rules.

        Raises:
            ConfigError: for another argument, a value out of range, or a game that is not offered.
            OSError: if a game cannot be recorded, of whatever session: no other may begin before.
        """
        unknown = sorted(asked.keys() - {*_RESET})
        if unknown:
            raise ConfigError(f"reset has no argument '{unknown[0][:60]}': {', '.join(_RESET)}.")
        game = self._chosen({key: value for key, value in asked.items() if value is not None})
        # Begun before the last game ends: a refused reset changes nothing.
        talk = game.begin()
        self.close()
        if self._keep is not None:
            self._keep.save()
        self._game = game
        self._talk = talk
        self._messages = [talk.opening]
        self._episode = None if asked.get("episode_id") is None else str(asked["episode_id"])[:255]
        self._steps = 0
        return self._observation(talk, talk.opening, reward=None)

    def step(self, action: Any) -> dict[str, Any]:
        """Act in the game; an invalid answer is part of the game, and no error.

        Args:
            action: ``answer``, a text as in all conversations; or ``first`` and ``second``, two
                items; or ``look_up``, an item. A number is taken for its text.

        Returns:
            the observation. After the end of the game an action changes nothing.

        Raises:
            ActionError: for an object with other keys.
            EpisodeError: before :meth:`reset`.
        """
        if not isinstance(action, dict) or action.keys() - {"metadata"} not in _STEP:
            raise ActionError('the action must be {"answer": "first + second"}.')
        if self._talk is None:
            raise EpisodeError("there is no game; send reset first.")
        talk = self._talk
        if talk.is_over:
            return self._observation(talk, talk.after_the_end, reward=0.0)
        before = talk.game.reward
        said, reply = self._acted(talk, action)
        self._steps += 1
        self._messages += [said, reply]
        if talk.is_over:
            self._record(talk)
        return self._observation(talk, reply, reward=talk.game.reward - before)

    @property
    def state(self) -> dict[str, Any]:
        """OpenEnv's state: the episode's id and the number of actions."""
        return {"episode_id": self._episode, "step_count": self._steps}

    def close(self) -> None:
        """End the game, as its client leaves: on a track, a game that was begun counts as it is."""
        talk = self._talk
        if talk is None or talk.is_over:
            return
        talk.game.end()
        assert self._game is not None
        # Otherwise a client could leave each game that goes wrong, and begin it again.
        if self._game.play.settings.track and self._steps:
            self._messages[-1] += f"\n\n{talk.game.state}"
            self._record(talk)

    def _chosen(self, asked: dict[str, Any]) -> NamedGame:
        if "task_id" in asked:
            return self.games.named(asked["task_id"])
        part = asked.get("split", next(iter(self.games.plays)))
        if "seed" in asked:
            whole("seed", asked["seed"], 0, MAX_SIZE)
        if "index" in asked:
            return self.games.at(part, asked["index"], asked.get("seed", 0))
        # A generator of its own for each call: a seed always draws the same game.
        rng = np.random.default_rng(asked.get("seed"))
        index = int(rng.integers(self.games.count(part)))
        return self.games.at(part, index, int(rng.integers(MAX_SIZE)))

    def _acted(self, talk: Conversation, action: dict[str, Any]) -> tuple[str, str]:
        """Carry out an action; return it as a message, and the reply."""
        if "answer" in action:
            answer = _text(action["answer"])[-LONGEST_ANSWER:]
            return answer, talk.hear(answer)
        if "look_up" in action:
            item = _text(action["look_up"])[:_LONGEST_ITEM]
            return f"look up {item}", talk.look_up_item(item)
        first, second = (_text(action[key])[:_LONGEST_ITEM] for key in ("first", "second"))
        return f"{first} + {second}", talk.combine(first, second)

    def _record(self, talk: Conversation) -> None:
        if self._keep is not None:
            self._keep(talk, self._messages)
        self._messages = []

    def _observation(
        self, talk: Conversation, text: str, *, reward: float | None
    ) -> dict[str, Any]:
        assert self._game is not None
        game = talk.game
        seen = {
            "text": text,
            "goal": game.goal,
            "table": list(game.labels),
            "attempts_left": game.attempts_left,
            "task_id": self._game.name,
        }
        counts = {"invalid_actions": talk.invalid_actions, "look_ups": talk.look_ups}
        metadata = {"success": game.is_made, "by_plan": game.by_plan, **counts}
        return {"observation": seen, "reward": reward, "done": talk.is_over, "metadata": metadata}


def _text(value: Any) -> str:
    """Return an answer as text: models also write numbers and lists, which the grammar reads."""
    return value if isinstance(value, str) else json.dumps(value)
