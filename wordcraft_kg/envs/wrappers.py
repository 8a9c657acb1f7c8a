"""Wrappers for additional observations: entity vectors, knowledge-graph scores, and words.

The plain environments observe ids, which this package's policies read. Wrappers are for other
libraries and for language models; wrappers that need ids come first, next to the environment.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.base.labels import read_label, read_pair
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.words import NOTHING, characters, numbered, prompt_text
from wordcraft_kg.envs.world import World

Env = gym.Env[Any, Any]
Observation = dict[str, Any]
Info = dict[str, Any]

_ID_KEYS = ("goal", "selection", "table")


class _Masked(gym.Wrapper[Any, Any, Any, Any]):
    def action_masks(self) -> NDArray[np.bool_]:
        """Return which slots hold an entity, shape (num_slots,), bool.

        Libraries query the outermost wrapper, and Gymnasium's wrappers do not pass the call on.
        """
        return np.asarray(self.env.get_wrapper_attr("action_masks")(), dtype=bool)


class _Ids(_Masked, gym.ObservationWrapper[Observation, Any, Observation]):
    """Changes observations of a single crafting environment."""


class FeatureObservation(_Ids):
    """Replaces ids in observations by entity vectors, for libraries that need float boxes.

    An empty slot becomes a zero vector. ``goal`` and ``selection`` have shape (D,), ``table``
    (num_slots, D), ``attempts_left`` is a float of shape (1,); further keys are unchanged.
    """

    def __init__(self, env: Env, vectors: NDArray[np.floating[Any]]):
        """Wrap an environment.

        Args:
            env: a single crafting environment.
            vectors: shape (E, D), a row for each entity in id order.

        Raises:
            ConfigError: if the vectors do not fit the entities, ids were replaced already, or
                ``env`` is no crafting environment.
        """
        super().__init__(env)
        world = _world(env)
        vectors = np.asarray(vectors, dtype=np.float32)
        if vectors.ndim != 2 or len(vectors) != world.nothing:
            raise ConfigError(
                f"`vectors` of shape {vectors.shape}: expected ({world.nothing}, D), "
                "a row for each entity."
            )
        width = vectors.shape[1]
        # A row of zeros at the end, for the id of nothing.
        self.vectors = np.concatenate([vectors, np.zeros((1, width), dtype=np.float32)])
        shapes = {
            "goal": (width,),
            "selection": (width,),
            "table": (world.num_slots, width),
            "attempts_left": (1,),
        }
        boxes = {
            key: spaces.Box(-np.inf, np.inf, shape, np.float32) for key, shape in shapes.items()
        }
        self.observation_space = spaces.Dict({**_id_spaces(env), **boxes})

    def observation(self, observation: Observation) -> Observation:
        """Replace the ids in an observation by vectors."""
        vectors = {key: self.vectors[observation[key]] for key in _ID_KEYS}
        left = np.array([observation["attempts_left"]], dtype=np.float32)
        return {
            **observation,
            **vectors,
            "attempts_left": left,
        }


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
        """Score one state, with keys of shape (), or N states, with keys of shape (N,)."""
        self._bind()
        # One environment's observation has no axis of environments; sources always add one.
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


class VectorKGScoreObservation(VectorWrapper):
    """:class:`KGScoreObservation` for the vector environment: scores have shape (N, num_slots)."""

    def __init__(self, env: VectorEnv[Any, Any, Any], sources: Sequence[SlotSource]):
        """Wrap a vector environment; arguments as :class:`KGScoreObservation`.

        Raises:
            GraphMismatchError: if a source belongs to another graph or split.
            LeakError: if a source would score train tasks by a model trained on their recipes,
                although it has another.
            ConfigError: if ``env`` is no crafting environment.
        """
        super().__init__(env)
        world = _world(env)
        self._scores = _Scores(world, sources)
        single = env.single_observation_space
        batched = env.observation_space
        assert isinstance(single, spaces.Dict)
        assert isinstance(batched, spaces.Dict)
        self.single_observation_space = spaces.Dict(
            {**single.spaces, **self._scores.spaces((world.num_slots,))}
        )
        shape = (env.num_envs, world.num_slots)
        self.observation_space = spaces.Dict({**batched.spaces, **self._scores.spaces(shape)})

    def reset(self, **options: Any) -> tuple[Observation, Info]:
        """Restart all environments."""
        observations, infos = self.env.reset(**options)
        return self._with_scores(observations), infos

    def step(self, actions: Any) -> tuple[Observation, Any, Any, Any, Info]:
        """Choose a slot in each environment."""
        observations, reward, terminated, truncated, infos = self.env.step(actions)
        if "final_obs" in infos:
            infos = {**infos, "final_obs": self._final(infos)}
        return self._with_scores(observations), reward, terminated, truncated, infos

    def _final(self, infos: Info) -> NDArray[np.object_]:
        """Add scores to the last observations of ended episodes, whose tasks are in their infos."""
        rows = np.flatnonzero(infos["_final_obs"])
        last = [infos["final_obs"][row] for row in rows]
        # From a dictionary for each episode to a dictionary of arrays, a row for each episode.
        batch = {}
        for name in last[0]:
            batch[name] = np.stack([one[name] for one in last])
        scores = self._scores.of(batch, infos["final_info"]["task"][rows])
        final = np.full_like(infos["final_obs"], None)
        for place, row in enumerate(rows):
            own = {name: values[place] for name, values in scores.items()}
            final[row] = {**last[place], **own}
        return final

    def _with_scores(self, observations: Observation) -> Observation:
        task = self.env.unwrapped.state.task  # type: ignore[attr-defined]
        return {**observations, **self._scores.of(observations, task)}


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


def _world(env: Env | VectorEnv[Any, Any, Any]) -> World:
    """Return a crafting environment's world; ConfigError for another environment."""
    world = getattr(env.unwrapped, "world", None)
    if not isinstance(world, World):
        raise ConfigError(f"{env.unwrapped} is not a WordCraft environment.")
    return world
