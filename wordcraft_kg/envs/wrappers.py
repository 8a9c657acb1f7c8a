"""Wrappers for additional observations: knowledge-graph scores, and numbers of tasks.

The plain environments observe ids, which this package's policies read. Wrappers are for other
libraries; they need ids, so they come first, next to the environment.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import Observation


class _Ids(gym.ObservationWrapper[Observation, Any, Observation]):
    """Adds to the observations of a single crafting environment."""

    def __init__(self, env: gym.Env[Any, Any]):
        super().__init__(env)
        world = getattr(env.unwrapped, "world", None)
        if not isinstance(world, World):
            raise ConfigError(f"{env.unwrapped} is not a WordCraft environment.")
        space = env.observation_space
        keys = space.spaces if isinstance(space, spaces.Dict) else {}
        if not isinstance(keys.get("table"), spaces.MultiDiscrete):
            raise ConfigError(
                "this wrapper needs ids; apply this wrapper before a wrapper that replaces ids."
            )
        self._world = world
        self._keys = dict(keys)

    def action_masks(self) -> NDArray[np.bool_]:
        """Return which slots hold an entity, shape (num_slots,), bool.

        Libraries query the outermost wrapper, and Gymnasium's wrappers do not pass the call on.
        """
        return np.asarray(self.env.get_wrapper_attr("action_masks")(), dtype=bool)


class KGScoreObservation(_Ids):
    """Adds knowledge-graph scores to observations, by source name, each of shape (num_slots,).

    A policy mixes these values. L is a scorer's score for a triple. ``u_i = L(e_i, combinesWith,
    e_held)`` scores the entity in slot i with the selected entity, or 0 without a selection;
    ``v_i = L(e_i, componentOf, e_goal)`` scores this entity with the goal. Both are 0 for empty
    slots.

    Source: Jiang et al. 2020, section "Knowledge-guided policy".
    """

    def __init__(self, env: gym.Env[Any, Any], sources: Sequence[Any]):
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
        # Any: environments know no models, so that they work without torch.
        self._sources = sources
        # Without train recipes no task is in a model's training data, and needs no number.
        self._has_train_recipes = self._world.config.part in ("train", "all")
        graph = self._world.graph
        for source in sources:
            if source.graph_hash != graph.hash:
                raise GraphMismatchError(
                    f"source '{source.name}' belongs to graph {source.graph_hash[:12]} but the "
                    f"environment plays on '{graph.name}', {graph.hash[:12]}. "
                    "Take a scorer for that graph."
                )
        self._bind()
        box = spaces.Box(-np.inf, np.inf, (self._world.num_slots,), np.float32)
        scores = {source.name: box for source in sources}
        self.observation_space = spaces.Dict({**self._keys, **scores})

    def _bind(self) -> None:
        """Bind sources to the world's tasks; repeated, since a source may serve several worlds."""
        if self._has_train_recipes:
            for source in self._sources:
                source.bind(self._world.tasks)

    def observation(self, observation: Observation) -> Observation:
        """Add each source's slot scores, (num_slots,), under the source's name."""
        self._bind()
        task = self.env.get_wrapper_attr("state").task if self._has_train_recipes else None
        scores = {}
        for source in self._sources:
            # A single observation has no axis of environments; sources always add one.
            (scores[source.name],) = source.score_observation(observation, task).numpy()
        return {**observation, **scores}


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

    def __init__(self, env: gym.Env[Any, Any]):
        """Wrap a single crafting environment.

        Raises:
            ConfigError: if ``env`` is no crafting environment, ids were replaced already, or a
                train task leaves too few entities for the distractors.
            TaskError: if the graph has no train task of this depth.
        """
        super().__init__(env)
        self._numbers = TaskNumbers(self._world)
        self.observation_space = spaces.Dict({**self._keys, "task": self._numbers.space})

    def observation(self, observation: Observation) -> Observation:
        """Add the task's number to an observation."""
        task = self.env.get_wrapper_attr("state").task
        return {**observation, "task": self._numbers.of(task)}
