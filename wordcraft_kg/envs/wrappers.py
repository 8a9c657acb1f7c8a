"""Wrappers for additional observations: knowledge-graph scores, numbers of tasks, and words.

The plain environments observe ids, which this package's policies read. Wrappers are for other
libraries and for language models; wrappers that need ids come first, next to the environment.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.base.labels import read_label, read_pair
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.words import NOTHING, characters, numbered, prompt_text
from wordcraft_kg.envs.world import World

Env = gym.Env[Any, Any]
Observation = dict[str, Any]
Info = dict[str, Any]


class _Masked(gym.Wrapper[Any, Any, Any, Any]):
    def action_masks(self) -> NDArray[np.bool_]:
        """Return which slots hold an entity, shape (num_slots,), bool.

        Libraries query the outermost wrapper, and Gymnasium's wrappers do not pass the call on.
        """
        return np.asarray(self.env.get_wrapper_attr("action_masks")(), dtype=bool)


class _Ids(_Masked, gym.ObservationWrapper[Observation, Any, Observation]):
    """Changes observations of a single crafting environment."""


class SlotSource(Protocol):
    """Interface of a source of scores; see ``wordcraft_kg.models.policies.sources``.

    Environments know no models, so that they work without torch; this is all they need of one.

    Attributes:
        name: key of the scores in observations.
        graph_hash: content hash of the source's recipe graph.
    """

    @property
    def name(self) -> str: ...  # noqa: D102

    graph_hash: str

    def score_observation(self, observation: Mapping[str, Any], task: Any = None) -> Any:
        """Score slots, as a tensor of shape (B, num_slots); B is 1 for a single environment."""
        ...


class _Scores:
    """The scores of sources for observations in a world."""

    def __init__(self, world: World, sources: Sequence[SlotSource]):
        self.sources = sources
        self.world = world
        # Without train recipes no task is in a model's training data, and needs no number.
        self.has_train_recipes = world.config.part in ("train", "all")
        for source in sources:
            if source.graph_hash != world.graph.hash:
                raise GraphMismatchError(
                    f"source '{source.name}' belongs to graph {source.graph_hash[:12]} but the "
                    f"environment plays on '{world.graph.name}', {world.graph.hash[:12]}. "
                    "Take a scorer for that graph."
                )
        self._bind()

    def _bind(self) -> None:
        """Bind sources to the world's tasks; repeated, since a source may serve several worlds."""
        if not self.has_train_recipes:
            return
        for source in self.sources:
            if getattr(source, "reads_task", False) and hasattr(source, "bind"):
                source.bind(self.world.tasks)

    def of(self, observation: Mapping[str, Any], task: Any) -> dict[str, NDArray[np.float32]]:
        """Score one state."""
        self._bind()
        # A single observation has no axis of environments; sources always add one.
        shape = np.shape(observation["table"])
        known = task if self.has_train_recipes else None
        scores = {}
        for source in self.sources:
            scores[source.name] = (
                source.score_observation(observation, known).reshape(shape).numpy()
            )
        return scores

    def spaces(self, shape: tuple[int, ...]) -> dict[str, spaces.Space[Any]]:
        return {
            source.name: spaces.Box(-np.inf, np.inf, shape, np.float32) for source in self.sources
        }


class KGScoreObservation(_Ids):
    """Adds knowledge-graph scores to observations, by source name, each of shape (num_slots,).

    A policy mixes these values. L is a scorer's score for a triple. ``u_i = L(e_i, combinesWith,
    e_held)`` scores the entity in slot i with the selected entity, or 0 without a selection;
    ``v_i = L(e_i, componentOf, e_goal)`` scores this entity with the goal. Both are 0 for empty
    slots.

    Source: Jiang et al. 2020, section "Knowledge-guided policy".
    """

    def __init__(self, env: Env, sources: Sequence[SlotSource]):
        """Wrap a single environment.

        Args:
            env: a crafting environment that observes ids.
            sources: sources for the environment's graph, such as
                ``make_sources(["combines", "component"], scorer)``. A
                cross-fitted scorer needs the tasks, too:
                ``make_sources(..., tasks=env.unwrapped.world.tasks)``.

        Raises:
            GraphMismatchError: if a source belongs to another graph or split.
            LeakError: if a source would score train tasks by a model trained on their recipes,
                although it has another.
            ConfigError: if ``env`` is no crafting environment, or ids were replaced already.
        """
        super().__init__(env)
        world = _world(env)
        self._scores = _Scores(world, sources)
        self.observation_space = spaces.Dict(
            {**_id_spaces(env), **self._scores.spaces((world.num_slots,))}
        )

    def observation(self, observation: Observation) -> Observation:
        """Add each source's slot scores, (num_slots,), under the source's name."""
        task = self.env.get_wrapper_attr("state").task
        return {**observation, **self._scores.of(observation, task)}


class TaskNumbers:
    """The numbers of tasks in observations, for policies with a cross-fitted scorer.

    Such a scorer has a model for each fold of the train recipes; the task selects the model. For
    tasks with train recipes the number is an index into ``world.tasks``; for all further tasks, and
    always on the test part, it is the number of train tasks. So a policy is trained and evaluated
    with equal observation spaces.

    Attributes:
        space: the space of a number.
    """

    def __init__(self, world: World):
        """Count the train tasks of a world.

        Raises:
            TaskError: if the graph has no train task of this depth.
            ConfigError: if a train task leaves too few entities for the distractors.
        """
        self._is_known = world.config.part in ("train", "all")
        # The number of train tasks stands for all other tasks, in every part alike.
        train = world if self._is_known else world.variant(part="train")
        self._other = len(train.tasks)
        self.space = spaces.Discrete(self._other + 1)

    def of(self, tasks: Any) -> Any:
        """Return the numbers of tasks, int64: of one task (index), or of N, shape (N,)."""
        indices = np.asarray(tasks, dtype=np.int64)
        numbers = indices if self._is_known else np.full_like(indices, self._other)
        return numbers[()]  # a task alone is a number, not an array without axes


class TaskObservation(_Ids):
    """Adds ``task``, the number of the episode's task, see :class:`TaskNumbers`."""

    def __init__(self, env: Env):
        """Wrap a single crafting environment.

        Raises:
            ConfigError: if ``env`` is no crafting environment, ids were replaced already, or a
                train task leaves too few entities for the distractors.
            TaskError: if the graph has no train task of this depth.
        """
        super().__init__(env)
        self._numbers = TaskNumbers(_world(env))
        self.observation_space = spaces.Dict({**_id_spaces(env), "task": self._numbers.space})

    def observation(self, observation: Observation) -> Observation:
        """Add the task's number to an observation."""
        task = self.env.get_wrapper_attr("state").task
        return {**observation, "task": self._numbers.of(task)}


class TextObservation(_Masked):
    """Describes the state in words and accepts actions in words, for language models and people.

    A crafting action is a label, a label's beginning, or a number from 1 in table order. An
    open-ended action is a pair, such as ``"water + earth"``, see :mod:`wordcraft_kg.base.labels`.
    Actions that are not text pass unchanged.
    """

    MAX_LENGTH = 100_000
    """Most characters of a text, for the observation space; no table is that long."""

    def __init__(self, env: Env):
        """Wrap a single environment, crafting or open-ended.

        Raises:
            ConfigError: if ``env`` is neither a crafting nor an open-ended environment.
        """
        super().__init__(env)
        inner = env.unwrapped
        self._is_open = isinstance(inner, OpenEndedEnv)
        self._graph = inner.graph if isinstance(inner, OpenEndedEnv) else _world(env).graph
        self.observation_space = spaces.Text(
            self.MAX_LENGTH, min_length=0, charset=characters(self._graph)
        )
        self._ids: list[int] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[str, Info]:
        """Begin an episode; seed and options are those of the wrapped environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._text(observation), info

    def step(self, action: Any) -> tuple[str, Any, bool, bool, Info]:
        """Choose an entity, or combine two entities in an open-ended environment.

        Raises:
            ActionError: as :meth:`parse`, or for a refused action of the wrapped environment; no
                attempt is used up.
            EpisodeError: before :meth:`reset`, or after the end of the episode.
        """
        chosen = self.parse(action) if isinstance(action, str) else action
        observation, reward, terminated, truncated, info = self.env.step(chosen)
        return self._text(observation), reward, terminated, truncated, info

    def parse(self, written: str) -> Any:
        """Parse words as a slot, or in an open-ended environment as two ids.

        Raises:
            ActionError: if no entity or several entities are meant, naming what would be clear.
        """
        labels = self._graph.labels(self._ids)
        if self._is_open:
            return [self._ids[place] for place in read_pair(written, labels)]
        return read_label(written, labels)

    def _text(self, observation: Mapping[str, Any]) -> str:
        # `parse` numbers entities in the order in which they were last shown.
        left = int(observation["attempts_left"])
        nothing = self._graph.num_entities
        if self._is_open:
            self._ids = [*self.env.get_wrapper_attr("discovery").known]
            known = len(self._ids)
            return prompt_text(
                "world",
                known=known,
                table=self._table(),
                attempts_left=left,
            )
        self._ids = [entity for entity in observation["table"].tolist() if entity < nothing]
        selection = int(observation["selection"])
        return prompt_text(
            "selection",
            goal=self._graph.entities[observation["goal"]],
            table=self._table(),
            selection=self._graph.entities[selection] if selection < nothing else NOTHING,
            attempts_left=left,
        )

    def _table(self) -> str:
        return numbered(self._graph.labels(self._ids))


def _id_spaces(env: Env) -> dict[str, spaces.Space[Any]]:
    """Return an environment's spaces by key; ConfigError unless it still observes ids."""
    known = env.observation_space
    keys = known.spaces if isinstance(known, spaces.Dict) else {}
    if not isinstance(keys.get("table"), spaces.MultiDiscrete):
        raise ConfigError(
            "this wrapper needs ids; apply this wrapper before a wrapper that replaces ids."
        )
    return dict(keys)


def _world(env: Env) -> World:
    """Return a crafting environment's world; ConfigError for another environment."""
    world = getattr(env.unwrapped, "world", None)
    if not isinstance(world, World):
        raise ConfigError(f"{env.unwrapped} is not a WordCraft environment.")
    return world
