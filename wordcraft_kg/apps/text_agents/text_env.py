"""The crafting game for Gymnasium by text: observations and actions are strings.

An action is a message, as in all conversations, and makes an attempt.
"""

import string
from typing import Any

import gymnasium as gym
from gymnasium import spaces

from wordcraft_kg.apps.text_agents.conversation import Seat
from wordcraft_kg.apps.text_agents.games import TaskGame
from wordcraft_kg.apps.text_agents.plays import TaskGames, chosen_tasks
from wordcraft_kg.apps.text_agents.settings import LOOK_UPS, LookUps
from wordcraft_kg.base import MAX_SIZE, ActionError, ConfigError
from wordcraft_kg.envs.words import characters
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.graph_folder import GraphLike

LONGEST_ACTION = 10_000
"""Characters of an action in the space; of a longer one the last are read."""
LONGEST_OBSERVATION = 100_000
"""Characters of an observation in the space; no table is that long."""
_UNKNOWN = "\N{REPLACEMENT CHARACTER}"
"""Stands in observations for a character of an action that is in no prompt and no label."""
Info = dict[str, Any]


class TextEnv(Seat, gym.Env[str, str]):
    """``WordCraft-Text-v0``: make a goal, attempt by attempt, in words.

    ## Description
    The game of ``WordCraft-v0`` as a conversation: the same tasks, on the tables of agent
    evaluation.

    ## Actions
    Text: a message whose last line names two items, such as ``water + earth``, or with look-ups
    ``look up water``. An invalid message costs nothing, but after three in a row the next one costs
    an attempt.

    ## Observations
    Text: first the rules and the state, then the reply to the action and the new state.

    ## Rewards
    1 for the goal; shaped rewards as in ``WordCraft-v0``.

    ## Starting state
    A task of the chosen part and a table of it. ``reset(seed=...)`` draws both;
    ``reset(options={"task": 3, "distractor_seed": 0})`` chooses them.

    ## Episode end
    *Terminated* when the goal is made or no attempt is left. Never truncated. Infos have ``task``,
    ``distractor_seed``, ``goal``, ``is_success``, ``by_plan`` and ``invalid_actions``.

    ## Arguments
    ``graph`` and settings as for ``WordCraft-v0``; ``knowledge`` (none or partial) and ``look_ups``
    offer train recipes to look up; ``difficulty`` chooses tasks, such as ``(.2, .8)``.

    Attributes:
        talk: the conversation; None before the first ``reset``.
    """

    def __init__(
        self,
        graph: GraphLike | World = "everyday",
        *,
        knowledge: LookUps = "none",
        look_ups: int = LOOK_UPS,
        difficulty: tuple[float, float] | None = None,
        **settings: Any,
    ):
        """Open the graph and prepare the tasks.

        Args:
            graph: as for ``WordCraft-v0``.
            render_mode: None, or ``ansi`` (the state).
            knowledge: look-ups: none, or partial (train recipes).
            look_ups: look-ups in a game.
            difficulty: least and largest measured difficulty of the tasks to draw; None for all.
            settings: settings of :class:`~wordcraft_kg.envs.world_config.WordCraftConfig`.

        Raises:
            ConfigError: for an unknown setting, or a value out of range.
            TaskError: if the graph has no such task.
            RecipeFileError: if there is no such graph, or a book cannot be read.
        """
        self.world = World.of(graph, settings)
        self._play = TaskGames(self.world, knowledge=knowledge, look_ups=look_ups)
        self._tasks = chosen_tasks(self.world, None, difficulty)
        charset = characters(self.world.graph).union(string.printable, _UNKNOWN)
        self.observation_space = spaces.Text(LONGEST_OBSERVATION, min_length=1, charset=charset)
        self.action_space = spaces.Text(LONGEST_ACTION, min_length=0, charset=charset)
        self._charset = charset

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[str, Info]:
        """Begin a game.

        Args:
            seed: seeds the generator of tasks and tables; None continues it.
            options: ``task`` and ``distractor_seed``; what is missing is drawn.

        Returns:
            The opening, with rules and state, and the info.

        Raises:
            ConfigError: for an unknown option, task or seed.
        """
        super().reset(seed=seed)
        choices = options or {}
        if unknown := sorted(choices.keys() - {"task", "distractor_seed"}):
            raise ConfigError(
                f"unknown reset option '{unknown[0]}'; expected task or distractor_seed."
            )
        # Both are always drawn, so that an option does not change the games that follow.
        task = int(self._tasks[self.np_random.integers(len(self._tasks))])
        distractor_seed = int(self.np_random.integers(MAX_SIZE))
        self.talk = self._play.begin(
            choices.get("task", task), choices.get("distractor_seed", distractor_seed)
        )
        return self._in_space(self.talk.opening), self._info()

    def step(self, action: str) -> tuple[str, float, bool, bool, Info]:
        """Say a message to the game.

        Returns:
            The reply, the reward, whether the game is over, False (never truncated), and the info.

        Raises:
            ActionError: for an action that is no text.
            EpisodeError: before :meth:`reset`, or for an attempt after the end of the game.
        """
        if not isinstance(action, str):
            raise ActionError(f"action {action!r}: expected a text, such as 'water + earth'.")
        talk = self._begun
        reply = talk.hear(action[-LONGEST_ACTION:])
        return self._in_space(reply), talk.reward, talk.is_over, False, self._info()

    def _info(self) -> Info:
        talk = self._begun
        game = talk.game
        assert isinstance(game, TaskGame)
        return {
            "task": game.task,
            "distractor_seed": game.distractor_seed,
            "goal": game.goal,
            "is_success": game.is_made,
            "by_plan": game.by_plan,
            "invalid_actions": talk.invalid_actions,
        }

    def _in_space(self, text: str) -> str:
        """Return a text of the space: an error repeats a part of the action, in any characters."""
        return "".join(letter if letter in self._charset else _UNKNOWN for letter in text)
