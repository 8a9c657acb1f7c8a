"""Observations for others: entity vectors, knowledge-graph scores and words, added to ids and masks."""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray

from wordcraft_kg.envs.world import World
from wordcraft_kg.errors import ActionError, ConfigError
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF
from wordcraft_kg.models.scorers.protocol import TripleScorer, check_scorer
from wordcraft_kg.settings import nearest

ID_KEYS = ("goal", "selection", "table")


class FeatureObservation(gym.ObservationWrapper[dict[str, Any], Any, dict[str, Any]]):
    """Replaces the ids by entity vectors, for libraries that want boxes of floats; nothing is a vector of zeros.

    ``goal`` and ``selection`` have shape (D,), ``table`` (num_slots, D), ``attempts_left`` is a float (1,); what else
    there is stays.
    """

    def __init__(self, env: gym.Env[Any, Any], vectors: NDArray[np.floating[Any]]):
        """Take vectors, shape (E, D), in the order of the graph's ids.

        Raises:
            ConfigError: if there are not as many vectors as entities.
        """
        super().__init__(env)
        world = _world(env)
        vectors = np.asarray(vectors, dtype=np.float32)
        if vectors.ndim != 2 or len(vectors) != world.nothing:
            raise ConfigError(f"vectors of shape {vectors.shape}: expected ({world.nothing}, D), one for each entity.")
        self.vectors = np.concatenate([vectors, np.zeros((1, vectors.shape[1]), dtype=np.float32)])
        width = vectors.shape[1]
        shapes = {"goal": (width,), "selection": (width,), "table": (world.num_slots, width), "attempts_left": (1,)}
        boxes: dict[str, spaces.Space[Any]] = {
            key: spaces.Box(-np.inf, np.inf, shape, np.float32) for key, shape in shapes.items()
        }
        known = _id_spaces(env)
        self.observation_space = spaces.Dict({**known, **boxes})

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Look the vectors up."""
        found = {key: self.vectors[observation[key]] for key in ID_KEYS}
        left = np.array([observation["attempts_left"]], dtype=np.float32)
        return {**observation, **found, "attempts_left": left}

    def action_masks(self) -> NDArray[np.bool_]:
        """Return which slots hold an entity, for libraries that ask the outermost wrapper."""
        return np.asarray(self.env.get_wrapper_attr("action_masks")(), dtype=bool)


class _Scores:
    """u and v of table slots from the score tables of a scorer."""

    def __init__(self, world: World, scorer: TripleScorer):
        check_scorer(scorer, world.graph)
        tables = []
        for relation in (COMBINES_WITH, COMPONENT_OF):
            table = np.zeros((world.nothing + 1, world.nothing + 1), dtype=np.float32)
            table[:-1, :-1] = scorer.table(relation).cpu().numpy()
            tables.append(table)
        self.combines, self.component = tables

    def add(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """Return the observation with u and v: ``L(e_i, combinesWith, held)`` and ``L(e_i, componentOf, goal)``."""
        table = observation["table"]
        held, goal = np.asarray(observation["selection"])[..., None], np.asarray(observation["goal"])[..., None]
        return {**observation, "u": self.combines[table, held], "v": self.component[table, goal]}

    @staticmethod
    def space(shape: tuple[int, ...]) -> dict[str, spaces.Space[Any]]:
        return {key: spaces.Box(-np.inf, np.inf, shape, np.float32) for key in ("u", "v")}


class KGScoreObservation(gym.ObservationWrapper[dict[str, Any], Any, dict[str, Any]]):
    """Adds a scorer's u and v of each slot, shape (num_slots,): how well it goes with what is held, and with the goal.

    ``u_i = L(e_i, combinesWith, e_held)`` and ``v_i = L(e_i, componentOf, e_goal)``; 0 for empty slots, and u is 0
    while nothing is held.

    Source: Jiang et al. 2020, section "Knowledge-guided policy".
    """

    def __init__(self, env: gym.Env[Any, Any], scorer: TripleScorer):
        """Take any scorer of the environment's graph.

        Raises:
            GraphMismatchError: if it belongs to another graph.
        """
        super().__init__(env)
        self._scores = _Scores(_world(env), scorer)
        self.observation_space = spaces.Dict({**_id_spaces(env), **_Scores.space((_world(env).num_slots,))})

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Add the scores."""
        return self._scores.add(observation)

    def action_masks(self) -> NDArray[np.bool_]:
        """Return which slots hold an entity, for libraries that ask the outermost wrapper."""
        return np.asarray(self.env.get_wrapper_attr("action_masks")(), dtype=bool)


class VectorKGScoreObservation(VectorWrapper):
    """:class:`KGScoreObservation` for the vector environment: u and v have shape (N, num_slots)."""

    def __init__(self, env: VectorEnv[Any, Any, Any], scorer: TripleScorer):
        """Take any scorer of the environment's graph.

        Raises:
            GraphMismatchError: if it belongs to another graph.
        """
        super().__init__(env)
        world: World = env.unwrapped.engine.world  # type: ignore[attr-defined]
        self._scores = _Scores(world, scorer)
        single, batched = env.single_observation_space, env.observation_space
        assert isinstance(single, spaces.Dict)
        assert isinstance(batched, spaces.Dict)
        self.single_observation_space = spaces.Dict({**single.spaces, **_Scores.space((world.num_slots,))})
        shape = (env.num_envs, world.num_slots)
        self.observation_space = spaces.Dict({**batched.spaces, **_Scores.space(shape)})

    def reset(self, **options: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin all environments anew."""
        observations, infos = self.env.reset(**options)
        return self._scores.add(observations), infos

    def step(self, actions: Any) -> tuple[dict[str, Any], Any, Any, Any, dict[str, Any]]:
        """Pick a slot in each environment."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        return self._scores.add(observations), rewards, terminated, truncated, infos


class TextObservation(gym.Wrapper[Any, Any, Any, Any]):
    """Renders the state in words, and takes a word for an action: for language models and people."""

    MAX_LENGTH = 100_000

    def __init__(self, env: gym.Env[Any, Any]):
        """Wrap a single environment."""
        super().__init__(env)
        self._names = _world(env).graph.entities
        self.observation_space = spaces.Text(self.MAX_LENGTH, min_length=0, charset=_characters(self._names))
        self._table: list[int] = []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[str, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._text(observation), info

    def step(self, action: Any) -> tuple[str, Any, bool, bool, dict[str, Any]]:
        """Pick an entity, by its word or by the number of its slot."""
        slot = self.parse(action) if isinstance(action, str) else action
        observation, reward, terminated, truncated, info = self.env.step(slot)
        return self._text(observation), reward, terminated, truncated, info

    def parse(self, word: str) -> int:
        """Return the slot of a word on the table, or of a slot's number; case and outer blanks do not matter.

        Raises:
            ActionError: if it is not there, with the nearest words that are.
        """
        wanted = word.strip().casefold()
        words = [self._names[entity].casefold() for entity in self._table]
        if wanted in words:
            return words.index(wanted)
        if wanted.isdecimal():
            return int(wanted)
        raise ActionError(f"'{word}' is not on the table; there are {', '.join(words)}.{nearest(wanted, words)}")

    def action_masks(self) -> NDArray[np.bool_]:
        """Return which slots hold an entity."""
        return np.asarray(self.env.get_wrapper_attr("action_masks")(), dtype=bool)

    def _text(self, observation: Mapping[str, Any]) -> str:
        nothing = len(self._names)
        self._table = [entity for entity in observation["table"].tolist() if entity < nothing]
        held = int(observation["selection"])
        return (
            f"Make: {self._names[observation['goal']]}\n"
            f"On the table: {', '.join(self._names[entity] for entity in self._table)}\n"
            f"In hand: {self._names[held] if held < nothing else 'nothing'}\n"
            f"Attempts left: {observation['attempts_left']}"
        )


def _id_spaces(env: gym.Env[Any, Any]) -> dict[str, spaces.Space[Any]]:
    known = env.observation_space
    if not isinstance(known, spaces.Dict) or not isinstance(known.spaces.get("table"), spaces.MultiDiscrete):
        raise ConfigError("this wrapper needs ids; put it around the environment before one that replaces them.")
    return dict(known.spaces)


def _world(env: gym.Env[Any, Any]) -> World:
    world = getattr(env.unwrapped, "world", None)
    if not isinstance(world, World):
        raise ConfigError(f"{env.unwrapped} is not a WordCraft environment.")
    return world


def _characters(names: tuple[str, ...]) -> frozenset[str]:
    template = "Make: \nOn the table: , In hand: nothing\nAttempts left: 0123456789"
    return frozenset(template).union(*names)
