"""For Stable-Baselines3: policies for PPO, A2C and MaskablePPO, and a fast ``VecEnv``.

Needs the extra ``interop`` and the plain ``WordCraft-v0``; the policy reads entity ids::

    env = SB3VecEnv(256, opened, num_distractors=8)
    network, _ = make_policy(PolicyConfig(), opened.graph, env.action_space.n)
    model = MaskablePPO(MaskableSB3Policy, env, policy_kwargs={"network": network}, n_steps=16)
    model.learn(100_000)
    trained = model.policy.network
"""

import copy
import logging
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.base.errors import ActionError, ConfigError, LeakError
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.envs.wordcraft import Arrays, WordCraftVectorEnv
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.wrappers import TaskNumbers
from wordcraft_kg.graphs.graph_folder import GraphLike
from wordcraft_kg.models.policies.policy import Policy, PolicyOutput
from wordcraft_kg.models.policies.states import States

try:
    from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
    from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
    from stable_baselines3.common.vec_env import VecEnv
except ImportError:
    raise missing_extra("interop", ["stable-baselines3", "sb3-contrib"]) from None

Observations = Mapping[str, Tensor]
Schedule = Callable[[float], float]


class _NetworkPolicy(BasePolicy):
    """Base class: actions and values come from a policy of this package.

    Stable-Baselines3's own features, layers and initial weights are not used. Observations have ids
    in ``goal`` and ``selection``, shape (B,) or (B, 1), and ``table``, shape (B, A), in any number
    type. ``task`` is read if scores depend on the task; further keys are ignored.
    """

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        use_sde: bool = False,
        *,
        network: Policy,
        optimizer_class: type[torch.optim.Optimizer] = torch.optim.Adam,
        optimizer_kwargs: dict[str, Any] | None = None,
    ):
        """Copy a policy; algorithms pass positional arguments, ``policy_kwargs`` keyword arguments.

        Args:
            observation_space: the environment's.
            action_space: the environment's.
            lr_schedule: learning rate by the remaining share of training, 1 to 0.
            use_sde: always False: PPO and A2C pass it, but refuse this noise for discrete actions.
            network: the policy to train, which stays unchanged; the trained copy is the attribute
                ``network``.
            optimizer_class: Adam by default, with Stable-Baselines3's ``eps`` of 1e-5.
            optimizer_kwargs: its settings besides the learning rate.

        Raises:
            ConfigError: unless the spaces are those of ``WordCraft-v0``, with as many entities as
                the policy knows.
        """
        _check_spaces(observation_space, action_space, network)
        # So that the environments know that their ids are read as ids.
        observation_space.read_as_ids = True  # type: ignore[attr-defined]
        super().__init__(
            observation_space,
            action_space,
            lr_schedule,
            optimizer_class=optimizer_class,
            optimizer_kwargs=optimizer_kwargs,
        )
        # Copied, because several algorithms may train the same policy, one after the other.
        self.network = copy.deepcopy(network)
        self._tasks = self._bound_to()
        self.optimizer = self.optimizer_class(
            self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs
        )

    def forward(
        self,
        obs: Observations,
        deterministic: bool = False,
        action_masks: Any = None,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Choose an action in each of B states.

        Args:
            obs: ids of B states.
            deterministic: choose the most probable slots instead of sampling.
            action_masks: see :meth:`get_distribution`.

        Returns:
            Actions (B,), values (B, 1) and the actions' log-probabilities (B,).

        Raises:
            ActionError: if a mask leaves a state without a slot to choose.
            LeakError: if the policy was bound to other tasks after training began.
        """
        distribution, values = self._decide(obs, action_masks)
        actions = distribution.get_actions(deterministic=deterministic)
        return actions, values, distribution.log_prob(actions)

    def evaluate_actions(
        self,
        obs: Observations,
        actions: Tensor,
        action_masks: Any = None,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Evaluate given actions under the current policy.

        Args:
            obs: ids of B states.
            actions: shape (B,): slots.
            action_masks: see :meth:`get_distribution`.

        Returns:
            Values (B, 1), log-probabilities (B,) of the actions, and entropies (B,) in nats.

        Raises:
            ActionError: if a mask leaves a state without a slot to choose.
            LeakError: if the policy was bound to other tasks after training began.
        """
        distribution, values = self._decide(obs, action_masks)
        return values, distribution.log_prob(actions), distribution.entropy()

    def get_distribution(self, obs: Observations, action_masks: Any = None) -> Any:
        """Return the distribution over slots; empty and masked slots have probability exactly 0.

        Args:
            obs: ids of B states.
            action_masks: anything that reshapes to (B, A): False excludes a slot, True does not
                revive an empty slot. None excludes empty slots only.

        Raises:
            ActionError: if a row leaves no choice.
            LeakError: if the policy was bound to other tasks after training began.
        """
        return self._decide(obs, action_masks)[0]

    def predict_values(self, obs: Observations) -> Tensor:
        """Return state values, shape (B, 1).

        Raises:
            LeakError: if the policy was bound to other tasks after training began.
        """
        return self._ask(obs).value[:, None]

    def _build(self, lr_schedule: Schedule) -> None:
        """Skip the default network construction."""

    def _get_constructor_parameters(self) -> dict[str, Any]:
        """Return what `policy.save` keeps besides the weights: the arguments of the constructor."""
        names = (
            "observation_space",
            "action_space",
            "network",
            "optimizer_class",
            "optimizer_kwargs",
        )
        parameters = {name: getattr(self, name) for name in names}
        # A schedule is a function, which a saved policy does not need.
        parameters["lr_schedule"] = self._dummy_schedule
        return parameters

    def _decide(self, obs: Observations, action_masks: Any) -> tuple[Any, Tensor]:
        logits, value, *_ = self._ask(obs)
        if action_masks is not None:
            mask = torch.as_tensor(action_masks, dtype=torch.bool, device=logits.device)
            logits = logits.masked_fill(~mask.reshape(logits.shape), -torch.inf)
            if (logits == -torch.inf).all(1).any():
                raise ActionError(
                    "`action_masks` leaves a state without a slot to choose: "
                    "only empty slots are True."
                )
        return self.action_dist.proba_distribution(action_logits=logits), value[:, None]

    def _ask(self, obs: Observations) -> PolicyOutput:
        # An evaluation in between may have bound the copy to other tasks, silently.
        if self._bound_to() != self._tasks:
            raise LeakError(
                "the policy was bound to different tasks after training began, so its task indices "
                "do not match this environment. Bind the policy again: "
                "model.policy.network.bind(world.tasks)."
            )
        task = obs["task"] if self.network.reads_task else None
        return self.network(States.of_observation(obs, task))

    def _bound_to(self) -> list[str]:
        """Return the hashes of the tasks that the sources' task numbers index."""
        return [source.bound_to for source in self.network.folded_sources]


class SB3Policy(_NetworkPolicy, ActorCriticPolicy):
    """A policy for PPO and A2C: ``PPO(SB3Policy, env, policy_kwargs={"network": policy})``.

    ``network`` is a policy of this package, from
    :func:`~wordcraft_kg.models.policies.policy_folder.make_policy` or ``load_policy``. Training
    changes a copy, ``model.policy.network``, but neither scores nor constant vectors, which are
    buffers. Ids must belong to the policy's graph; only the number of entities is checked. Further
    settings are ``optimizer_class`` and ``optimizer_kwargs``. Empty slots are never chosen, with or
    without masks.

    A policy with a cross-fitted scorer must be made with ``tasks``, and the environment wrapped in
    :class:`~wordcraft_kg.envs.wrappers.TaskObservation`.

    ``model.save`` pickles ``policy_kwargs``, including the untrained ``network`` with scores and
    features. So ``PPO.load`` needs neither graph nor scorer, but the same versions of torch and
    this package. Load trusted files only: a pickle can run any code.
    """


class MaskableSB3Policy(_NetworkPolicy, MaskableActorCriticPolicy):
    """:class:`SB3Policy` for MaskablePPO of sb3-contrib, which also takes masks of a user.

    The environment's own masks only repeat which slots are empty, and change nothing here.
    """


def _check_spaces(
    observation_space: spaces.Space[Any],
    action_space: spaces.Space[Any],
    network: Policy,
) -> None:
    """Raise a ConfigError unless spaces are those of a WordCraft environment that fits.

    For scores that depend on the task, observations need the numbers of the policy's tasks.
    """
    keys = observation_space.spaces if isinstance(observation_space, spaces.Dict) else {}
    goal = keys.get("goal")
    selection = keys.get("selection")
    table = keys.get("table")
    if not (
        isinstance(goal, spaces.Discrete)
        and isinstance(selection, spaces.Discrete | spaces.MultiDiscrete)
        and isinstance(table, spaces.MultiDiscrete)
        and isinstance(action_space, spaces.Discrete)
        and table.shape == (action_space.n,)
    ):
        raise ConfigError(
            f"observations {observation_space} and actions {action_space}: expected goal, "
            "selection and table as ids, and slots, as in WordCraft-v0. "
            "Remove wrappers that replace ids."
        )
    if goal.n != network.num_entities:
        raise ConfigError(
            f"the policy knows {network.num_entities:,} entities but the environment has "
            f"{goal.n:,}. Make or load a policy for the environment's graph."
        )
    # The task numbers that the scores need.
    task = keys.get("task")
    if network.reads_task and not isinstance(task, spaces.Discrete):
        raise ConfigError(
            "the policy's scorer is cross-fitted, so its scores depend on the task, but the "
            "observations have no task index. Wrap the environment: TaskObservation(env)."
        )
    amounts = {len(source.model_of_task) for source in network.folded_sources if source.bound_to}
    if isinstance(task, spaces.Discrete) and amounts and amounts != {task.n}:
        raise ConfigError(
            f"the policy was made for {max(amounts) - 1:,} tasks but the environment has "
            f"{task.n - 1:,}. Make the policy with the `tasks` in this environment's world."
        )


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
            **settings: settings of :class:`~wordcraft_kg.envs.world_config.WordCraftConfig`.

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
        super().__init__(self.env.num_envs, space, self.env.single_action_space)

    def reset(self) -> Arrays:
        """Begin new episodes, after :meth:`seed` the first ones of its seed.

        Environments have separate streams of this one seed, as in the vector environment.
        """
        if not getattr(self.observation_space, "read_as_ids", False):
            logging.getLogger(__name__).warning(
                "observations are ids of entities, and no policy of this package reads them: "
                "MultiInputPolicy takes each id for a category of its own, and hardly learns. Use "
                "MaskableSB3Policy, or a features extractor that looks up vectors."
            )
        observations, infos = self.env.reset(seed=self._seeds[0])
        self._reset_seeds()
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
            ActionError: for a number that is not a slot.
        """
        observations, rewards, over, _, infos = self.env.step(self._actions)
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

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute, which all environments share, once for each chosen environment.

        Args:
            attr_name: name of the attribute.
            indices: numbers of the chosen environments; None for all.

        Raises:
            AttributeError: if there is no such attribute.
        """
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

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
        masks = self.env.action_masks()
        return [masks[place] for place in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Indices = None) -> list[bool]:
        """Return False for each chosen environment: none is wrapped."""
        return [False for _ in self._get_indices(indices)]
