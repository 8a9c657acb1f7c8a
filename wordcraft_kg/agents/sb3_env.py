"""Many environments at once for Stable-Baselines3: its ``VecEnv`` over the batched engine.

``DummyVecEnv`` steps environments one by one in Python; here a step of all of them is a few array
operations. Needs the extra ``interop``::

    env = SB3VecEnv(256, "everyday", num_distractors=8)
    model = MaskablePPO(MaskableSB3Policy, env, policy_kwargs={"network": policy})
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from wordcraft_kg.base.errors import EpisodeError
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.envs.vector import Arrays, WordCraftVectorEnv
from wordcraft_kg.envs.world import GraphLike, World
from wordcraft_kg.envs.wrappers import TaskNumbers

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError:
    raise missing_extra("interop", ["stable-baselines3"]) from None

Indices = None | int | Iterable[int]


class SB3VecEnv(VecEnv):
    """N crafting environments for PPO, A2C, MaskablePPO and others of Stable-Baselines3.

    Observations, actions and rewards are those of ``WordCraft-v0`` with a first axis of length N.
    When an episode ends, the observation is the first of the next one, and the infos of this
    environment have ``terminal_observation``, ``TimeLimit.truncated`` (False: attempts are part of
    the observation), ``is_success``, ``outcome``, ``by_plan`` and ``task``; infos are empty
    otherwise. ``env_method("action_masks")`` returns the masks that MaskablePPO asks for.

    Attributes:
        env: the Gymnasium vector environment that does the work.
        world: graph, tasks and settings.
    """

    def __init__(
        self,
        num_envs: int,
        graph: GraphLike | World,
        *,
        with_task: bool = False,
        **settings: Any,
    ):
        """Prepare N environments.

        Args:
            num_envs: N, 1 or more.
            graph: as for the single environment.
            with_task: add the task's number to the observations, as
                :class:`~wordcraft_kg.envs.wrappers.TaskObservation` does, for policies with a
                cross-fitted scorer.
            **settings: settings of :class:`~wordcraft_kg.envs.config.WordCraftConfig`.

        Raises:
            ConfigError: for an unknown setting, or a value out of range.
            TaskError: if the graph has no such task.
            RecipeFileError: if there is no such graph, or a book cannot be read.
            ArtefactError: if a graph folder is damaged.
        """
        self.env = WordCraftVectorEnv(num_envs, graph, **settings)
        self.world = self.env.world
        self._numbers = TaskNumbers(self.world) if with_task else None
        space = self.env.single_observation_space
        if self._numbers is not None:
            assert isinstance(space, spaces.Dict)
            space = spaces.Dict({**space.spaces, "task": self._numbers.space})
        self._actions: NDArray[np.int64] | None = None
        self._seed: int | None = None
        super().__init__(self.env.num_envs, space, self.env.single_action_space)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seed of the next :meth:`reset`; None lets the system draw one.

        Environments have separate streams of this one seed, as in the vector environment.

        Returns:
            The seed, once for each environment.
        """
        self._seed = seed
        return [seed] * self.num_envs

    def reset(self) -> Arrays:
        """Begin new episodes, with the seed from :meth:`seed` the first ones of it."""
        observations, infos = self.env.reset(seed=self._seed)
        self._seed = None
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        return self._seen(observations, infos["task"])

    def step_async(self, actions: NDArray[np.int64]) -> None:
        """Note the slots to choose, shape (N,)."""
        self._actions = actions

    def step_wait(
        self,
    ) -> tuple[Arrays, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Choose the noted slots.

        Returns:
            Observations, rewards (float32), whether each episode ended, and infos.

        Raises:
            EpisodeError: without noted slots.
            ActionError: for a number that is not a slot.
        """
        if self._actions is None:
            raise EpisodeError("call step_async() with actions before step_wait().")
        observations, rewards, over, _, infos = self.env.step(self._actions)
        self._actions = None
        # A dictionary for each: wrappers of Stable-Baselines3 write into them.
        by_env: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if "final_obs" in infos:
            final = infos["final_info"]
            for row in np.flatnonzero(over).tolist():
                outcome = final["outcome"][row]
                task = int(final["task"][row])
                last = infos["final_obs"][row]
                if self._numbers is not None:
                    last = {**last, "task": self._numbers.of(task)}
                by_env[row] = {
                    "terminal_observation": last,
                    "TimeLimit.truncated": False,
                    "is_success": outcome == "goal",
                    "outcome": outcome,
                    "by_plan": bool(final["by_plan"][row]),
                    "task": task,
                }
        observed = self._seen(observations, infos["task"])
        return observed, rewards.astype(np.float32), over.copy(), by_env

    def _seen(self, observations: Arrays, tasks: NDArray[np.int64]) -> Arrays:
        if self._numbers is not None:
            observations["task"] = np.asarray(self._numbers.of(tasks))
        return observations

    def close(self) -> None:
        """Close the environments, which hold nothing open."""
        self.env.close()

    def action_masks(self) -> NDArray[np.bool_]:
        """Return which slots hold an entity, shape (N, num_slots).

        Raises:
            EpisodeError: before the first :meth:`reset`.
        """
        return self.env.action_masks()

    def has_attr(self, attr_name: str) -> bool:
        """Return whether environments have an attribute; MaskablePPO asks for action_masks."""
        return attr_name == "action_masks" or hasattr(self.env, attr_name)

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute, which all environments share, once for each chosen environment.

        Args:
            attr_name: name of the attribute.
            indices: numbers of the chosen environments; None for all.

        Raises:
            AttributeError: if there is no such attribute.
            IndexError: for a number without an environment.
        """
        return [getattr(self.env, attr_name)] * len(self._chosen(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Refuse to change settings, which all environments share.

        Args:
            attr_name: name of the attribute.
            value: its new value.
            indices: numbers of the chosen environments; None for all.

        Raises:
            AttributeError: always; make another environment with other settings.
        """
        raise AttributeError(
            f"'{attr_name}' cannot be set: the environments share their settings. Make another "
            "SB3VecEnv."
        )

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of single environments; there is ``action_masks``.

        Args:
            method_name: name of the method.
            method_args: none.
            indices: environments; None for all.
            method_kwargs: none.

        Returns:
            For each chosen environment its mask, shape (num_slots,).

        Raises:
            AttributeError: for another method.
            IndexError: for a number without an environment.
        """
        if method_name != "action_masks" or method_args or method_kwargs:
            raise AttributeError(
                f"environments have no method '{method_name}' with these arguments; expected "
                "action_masks without any."
            )
        masks = self.action_masks()
        return [masks[place] for place in self._chosen(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Indices = None) -> list[bool]:
        """Return False for each chosen environment: none is wrapped.

        Raises:
            IndexError: for a number without an environment.
        """
        return [False] * len(self._chosen(indices))

    def _chosen(self, indices: Indices) -> list[int]:
        places = range(self.num_envs)
        if indices is None:
            return list(places)
        # Through the range, so that a negative place counts from the end, and a wrong one fails.
        env_numbers = [indices] if isinstance(indices, int) else indices
        return [places[place] for place in env_numbers]
