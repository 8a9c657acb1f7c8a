"""Policies for Stable-Baselines3: :class:`SB3Policy` for PPO and A2C, and a masked variant for MaskablePPO.

Needs the extra ``interop`` and the plain ``WordCraft-v0``; the policy reads entity ids::

    policy, _ = make_policy(PolicyConfig(features="random"), opened.graph, env.unwrapped.num_slots)
    model = PPO(SB3Policy, env, policy_kwargs={"network": policy})
    model.learn(10_000)
    trained = model.policy.network
"""

import copy
from collections.abc import Callable, Mapping
from typing import Any

import torch
from gymnasium import spaces
from torch import Tensor

from wordcraft_kg.base.errors import ActionError, ConfigError, LeakError
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.models.policies.policy import Policy, PolicyOutput
from wordcraft_kg.models.policies.sources.source import Attempts, FoldedSource

try:
    from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
    from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
except ImportError:
    raise missing_extra("interop", ["stable-baselines3", "sb3-contrib"]) from None

Observations = Mapping[str, Tensor]
Schedule = Callable[[float], float]


class _NetworkPolicy(BasePolicy):
    """Base class: actions and values come from a :class:`~wordcraft_kg.models.policies.policy.Policy`.

    Observations have ids in ``goal`` and ``selection``, shape (B,) or (B, 1), and ``table``, shape (B, A), in
    any number type. ``task`` is read if scores depend on the task; further keys are ignored.
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
        """Copy the policy ``network``, which stays unchanged; the attribute ``network`` is the trained copy.

        Algorithms pass positional arguments, ``policy_kwargs`` keyword arguments. ``lr_schedule`` is the learning rate
        by the remaining share of training, 1 to 0; ``use_sde`` is always False. The optimiser is Adam by default, with
        the ``eps`` 1e-5 from Stable-Baselines3.

        ConfigError unless the spaces are from ``WordCraft-v0``, with the policy's number of entities.
        """
        _check_spaces(observation_space, action_space, network)
        settings = {"optimizer_class": optimizer_class, "optimizer_kwargs": optimizer_kwargs}
        super().__init__(observation_space, action_space, lr_schedule, **settings)
        self.network = copy.deepcopy(network)
        self._tasks = self._bound_to()
        self.optimizer = self.optimizer_class(
            self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs
        )

    def forward(
        self, obs: Observations, deterministic: bool = False, action_masks: Any = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return actions (B,), values (B, 1) and log-probabilities (B,)."""
        distribution, values = self._decide(obs, action_masks)
        actions = distribution.get_actions(deterministic=deterministic)
        return actions, values, distribution.log_prob(actions)

    def evaluate_actions(
        self, obs: Observations, actions: Tensor, action_masks: Any = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return values (B, 1), log-probabilities (B,) of actions (B,), and entropies (B,) in nats."""
        distribution, values = self._decide(obs, action_masks)
        return values, distribution.log_prob(actions), distribution.entropy()

    def get_distribution(self, obs: Observations, action_masks: Any = None) -> Any:
        """Return the distribution over slots; empty and masked slots have probability exactly 0.

        ``action_masks``, reshapeable to (B, A), excludes slots by False; True does not revive an empty slot, and None
        excludes empty slots only. ActionError if a row leaves no choice.
        """
        return self._decide(obs, action_masks)[0]

    def predict_values(self, obs: Observations) -> Tensor:
        """Return state values, shape (B, 1)."""
        return self._ask(obs).value[:, None]

    def _build(self, lr_schedule: Schedule) -> None:
        """Skip the default network construction."""

    def _get_constructor_parameters(self) -> dict[str, Any]:
        names = (
            "observation_space",
            "action_space",
            "network",
            "optimizer_class",
            "optimizer_kwargs",
        )
        return {name: getattr(self, name) for name in names} | {"lr_schedule": self._dummy_schedule}

    def _decide(self, obs: Observations, action_masks: Any) -> tuple[Any, Tensor]:
        logits, value, *_ = self._ask(obs)
        if action_masks is not None:
            mask = torch.as_tensor(action_masks, dtype=torch.bool, device=logits.device).reshape(
                logits.shape
            )
            logits = logits.masked_fill(~mask, -torch.inf)
            if (logits == -torch.inf).all(1).any():
                raise ActionError(
                    "`action_masks` leaves a state without a slot to choose: only empty slots are True."
                )
        return self.action_dist.proba_distribution(action_logits=logits), value[:, None]

    def _ask(self, obs: Observations) -> PolicyOutput:
        # Rollout buffers may store ids as floats, and single numbers with shape (1,).
        goal, selection = obs["goal"].long().reshape(-1), obs["selection"].long().reshape(-1)
        if self._bound_to() != self._tasks:
            raise LeakError(
                "the policy was bound to different tasks after training began, so its task indices do not match this "
                "environment. Bind the policy again: model.policy.network.bind(world.tasks)."
            )
        task = obs["task"].long().reshape(-1) if self.network.reads_task else None
        attempts = (
            Attempts(obs["attempts_left"].long().reshape(-1)) if "attempts_left" in obs else None
        )
        return self.network(goal, selection, obs["table"].long(), task=task, attempts=attempts)

    def _bound_to(self) -> list[str]:
        return [source.bound_to for source in _folded(self.network)]


def _folded(network: Policy) -> list[FoldedSource]:
    return [
        source
        for source in network.sources.values()
        if isinstance(source, FoldedSource) and source.reads_task
    ]


class SB3Policy(_NetworkPolicy, ActorCriticPolicy):
    """A policy for PPO and A2C with our network: ``PPO(SB3Policy, env, policy_kwargs={"network": policy})``.

    ``network`` is a policy of this package, from :func:`~wordcraft_kg.models.policies.folder.make_policy` or
    ``load_policy``. Training changes a copy, ``model.policy.network``, but neither scores nor constant vectors, which
    are buffers. Ids must belong to the policy's graph; only the number of entities is checked. Further settings are
    ``optimizer_class`` and ``optimizer_kwargs``. Empty slots are never chosen, with or without masks.

    A policy with a cross-fitted scorer must be made with ``tasks``, and the environment wrapped in
    :class:`~wordcraft_kg.envs.wrappers.TaskObservation`.

    ``model.save`` pickles ``policy_kwargs``, including the untrained ``network`` with scores and features. So
    ``PPO.load`` needs neither graph nor scorer, but the same versions of torch and this package. Load trusted files
    only.
    """


class MaskableSB3Policy(_NetworkPolicy, MaskableActorCriticPolicy):
    """:class:`SB3Policy` for MaskablePPO of sb3-contrib; empty slots are excluded with any masks."""


def _check_spaces(
    observation_space: spaces.Space[Any], action_space: spaces.Space[Any], network: Policy
) -> None:
    known = observation_space.spaces if isinstance(observation_space, spaces.Dict) else {}
    goal, selection, table = (known.get(key) for key in ("goal", "selection", "table"))
    if not (
        isinstance(goal, spaces.Discrete)
        and isinstance(selection, spaces.Discrete)
        and isinstance(table, spaces.MultiDiscrete)
        and isinstance(action_space, spaces.Discrete)
        and table.shape == (action_space.n,)
    ):
        raise ConfigError(
            f"observations {observation_space} and actions {action_space}: expected goal, selection and table as ids, "
            "and slots, as in WordCraft-v0. Remove wrappers that replace ids."
        )
    if goal.n != network.num_entities:
        raise ConfigError(
            f"the policy knows {network.num_entities:,} entities but the environment has {goal.n:,}. Make or load a "
            "policy for the environment's graph."
        )
    _check_tasks(known.get("task"), network)


def _check_tasks(task: spaces.Space[Any] | None, network: Policy) -> None:
    if network.reads_task and not isinstance(task, spaces.Discrete):
        raise ConfigError(
            "the policy's scorer is cross-fitted, so its scores depend on the task, but the observations have no task "
            "index. Wrap the environment: TaskObservation(env)."
        )
    amounts = {len(source.model_of_task) for source in _folded(network) if source.bound_to}
    if isinstance(task, spaces.Discrete) and amounts and amounts != {task.n}:
        raise ConfigError(
            f"the policy was made for {max(amounts) - 1:,} tasks but the environment has {task.n - 1:,}. Make the "
            "policy with the `tasks` in this environment's world."
        )
