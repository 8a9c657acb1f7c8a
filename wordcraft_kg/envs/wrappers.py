"""A wrapper for other libraries: the number of the task as an additional observation.

The plain environments observe ids, which this package's policies read. The wrapper needs ids, so it
comes first, next to the environment.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import Observation


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


class TaskObservation(gym.ObservationWrapper[Observation, Any, Observation]):
    """Adds ``task``, the number of the episode's task, see :class:`TaskNumbers`."""

    def __init__(self, env: gym.Env[Any, Any]):
        """Wrap a single crafting environment.

        Raises:
            ConfigError: if ``env`` is no crafting environment, ids were replaced already, or a
                train task leaves too few entities for the distractors.
            TaskError: if the graph has no train task of this depth.
        """
        super().__init__(env)
        world = getattr(env.unwrapped, "world", None)
        if not isinstance(world, World):
            raise ConfigError(f"{env.unwrapped} is not a WordCraft environment.")
        self._numbers = TaskNumbers(world)
        space = env.observation_space
        keys = space.spaces if isinstance(space, spaces.Dict) else {}
        if not isinstance(keys.get("table"), spaces.MultiDiscrete):
            raise ConfigError(
                "this wrapper needs ids; apply this wrapper before a wrapper that replaces ids."
            )
        self.observation_space = spaces.Dict({**keys, "task": self._numbers.space})

    def observation(self, observation: Observation) -> Observation:
        """Add the task's number to an observation."""
        task = self.env.get_wrapper_attr("state").task
        return {**observation, "task": self._numbers.of(task)}

    def action_masks(self) -> NDArray[np.bool_]:
        """Return which slots hold an entity, shape (num_slots,), bool.

        Libraries query the outermost wrapper, and Gymnasium's wrappers do not pass the call on.
        """
        return np.asarray(self.env.get_wrapper_attr("action_masks")(), dtype=bool)
