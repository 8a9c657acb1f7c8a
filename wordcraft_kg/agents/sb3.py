"""Our policies in Stable-Baselines3: :class:`SB3Policy` for PPO and A2C, and a masked one for MaskablePPO.

Needs the extra ``interop``. The environment is the plain ``WordCraft-v0``; ids go to the policy unchanged::

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

from wordcraft_kg.base.errors import ActionError, ConfigError, LeakError, MissingExtraError
from wordcraft_kg.models.policies.policy import Policy, PolicyOutput
from wordcraft_kg.models.policies.sources.source import FoldedSource

try:
    from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
    from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
except ImportError:
    raise MissingExtraError(
        "training with Stable-Baselines3 needs stable-baselines3 and sb3-contrib, and one of them is not installed. "
        "Install them: pip install 'wordcraft-kg[interop]'"
    ) from None

Observations = Mapping[str, Tensor]
Schedule = Callable[[float], float]


class _NetworkPolicy(BasePolicy):
    """Base of both classes: actions and values come from a :class:`~wordcraft_kg.models.policies.policy.Policy`.

    Stable-Baselines3's own features, layers and initial weights are not used. The ids of B states are in the keys
    ``goal`` and ``selection``, of shape (B,) or (B, 1), and ``table``, of shape (B, A), of any number type; other keys
    are ignored, except for ``task`` where the scores depend on it.
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
        """Copy the policy; the algorithm gives the positional arguments, ``policy_kwargs`` those after the star.

        Args:
            observation_space: the environment's.
            action_space: the environment's.
            lr_schedule: learning rate by the remaining share of the training, 1 to 0.
            use_sde: always False: PPO and A2C pass it, but refuse that noise for discrete actions.
            network: the policy to train; it stays unchanged, and its trained copy is the attribute of this name.
            optimizer_class: Adam by default, with Stable-Baselines3's ``eps`` of 1e-5.
            optimizer_kwargs: its settings besides the learning rate.

        Raises:
            ConfigError: if the spaces are not those of ``WordCraft-v0`` with as many entities as the policy has.
        """
        _check_spaces(observation_space, action_space, network)
        super().__init__(
            observation_space,
            action_space,
            lr_schedule,
            optimizer_class=optimizer_class,
            optimizer_kwargs=optimizer_kwargs,
        )
        self.network = copy.deepcopy(network)
        self._tasks = self._bound_to()
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)

    def forward(
        self, obs: Observations, deterministic: bool = False, action_masks: Any = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return actions (B,), values (B, 1) and the log-probabilities (B,) of the actions."""
        distribution, values = self._decide(obs, action_masks)
        actions = distribution.get_actions(deterministic=deterministic)
        return actions, values, distribution.log_prob(actions)

    def evaluate_actions(
        self, obs: Observations, actions: Tensor, action_masks: Any = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return values (B, 1), log-probabilities (B,) of actions (B,), and entropies (B,), in nats."""
        distribution, values = self._decide(obs, action_masks)
        return values, distribution.log_prob(actions), distribution.entropy()

    def get_distribution(self, obs: Observations, action_masks: Any = None) -> Any:
        """Return the distribution over slots; the probability of an empty or a masked one is exactly 0.

        Args:
            obs: ids of B states.
            action_masks: anything that reshapes to (B, A): False excludes a slot, and True changes nothing, so that no
                mask can revive an empty slot. None excludes the empty slots only.

        Raises:
            ActionError: if a row of ``action_masks`` leaves nothing to choose.
        """
        return self._decide(obs, action_masks)[0]

    def predict_values(self, obs: Observations) -> Tensor:
        """Return the values of states, shape (B, 1)."""
        return self._ask(obs).value[:, None]

    def _build(self, lr_schedule: Schedule) -> None:
        """Skip the network that Stable-Baselines3 builds by default."""

    def _get_constructor_parameters(self) -> dict[str, Any]:
        """Return what saving the policy alone keeps besides the weights."""
        return {
            "observation_space": self.observation_space,
            "action_space": self.action_space,
            "lr_schedule": self._dummy_schedule,
            "network": self.network,
            "optimizer_class": self.optimizer_class,
            "optimizer_kwargs": self.optimizer_kwargs,
        }

    def _decide(self, obs: Observations, action_masks: Any) -> tuple[Any, Tensor]:
        logits, value, *_ = self._ask(obs)
        if action_masks is not None:
            mask = torch.as_tensor(action_masks, dtype=torch.bool, device=logits.device).reshape(logits.shape)
            logits = logits.masked_fill(~mask, -torch.inf)
            if (logits == -torch.inf).all(1).any():
                raise ActionError("`action_masks` leaves a state without a slot to choose: only empty slots are True.")
        return self.action_dist.proba_distribution(action_logits=logits), value[:, None]

    def _ask(self, obs: Observations) -> PolicyOutput:
        # Some versions keep ids as floats in their rollout buffers, and single numbers as rows of one.
        goal, selection = obs["goal"].long().reshape(-1), obs["selection"].long().reshape(-1)
        if self._bound_to() != self._tasks:
            raise LeakError(
                "the policy was bound to other tasks since its training began, so the numbers of this environment's "
                "tasks would mean others. Bind it again: model.policy.network.bind(world.tasks)."
            )
        task = obs["task"].long().reshape(-1) if self.network.reads_task else None
        return self.network(goal, selection, obs["table"].long(), task=task)

    def _bound_to(self) -> list[str]:
        """Return the hashes of the tasks whose numbers the sources take."""
        return [source.bound_to for source in _folded(self.network)]


def _folded(network: Policy) -> list[FoldedSource]:
    """Return the sources whose scores depend on the task."""
    return [source for source in network.sources.values() if isinstance(source, FoldedSource) and source.reads_task]


class SB3Policy(_NetworkPolicy, ActorCriticPolicy):
    """A policy of ours for Stable-Baselines3's PPO and A2C: ``PPO(SB3Policy, env, policy_kwargs={"network": policy})``.

    ``network`` is what :func:`~wordcraft_kg.models.policies.folder.make_policy` or ``load_policy`` return. A
    copy is trained, ``model.policy.network``, which is a policy like any other. Scores and constant vectors are
    buffers, so no optimiser changes them. The ids must be those of the policy's graph; only their number is checked.

    A policy with a cross-fitted scorer needs to know the tasks that it is trained on. Make it with ``tasks``, and wrap
    the environment: :class:`~wordcraft_kg.envs.wrappers.TaskObservation`.

    ``optimizer_class`` and ``optimizer_kwargs`` are the only other settings. Empty slots are never picked, with or
    without masks, so PPO needs no wrapper for that.

    ``model.save`` is Stable-Baselines3's: it pickles ``policy_kwargs``, and with it the untrained ``network`` including
    scores and features. So ``PPO.load`` needs neither graph nor scorer; but load only files that you trust, and expect
    them to work only with the versions of torch and of this package that wrote them.
    """


class MaskableSB3Policy(_NetworkPolicy, MaskableActorCriticPolicy):
    """:class:`SB3Policy` for sb3-contrib's MaskablePPO, which also takes masks of your own.

    The environment's own masks only repeat which slots are empty, so they change nothing here.
    """


def _check_spaces(observation_space: spaces.Space[Any], action_space: spaces.Space[Any], network: Policy) -> None:
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
            f"observations {observation_space} and actions {action_space}: expected the ids of goal, selection and "
            "table and the slots of WordCraft-v0. Use the environment without a wrapper that replaces its ids."
        )
    if goal.n != network.num_entities:
        raise ConfigError(
            f"the policy knows {network.num_entities:,} entities but the environment has {goal.n:,}. Make or load a "
            "policy of the environment's graph."
        )
    _check_tasks(known.get("task"), network)


def _check_tasks(task: spaces.Space[Any] | None, network: Policy) -> None:
    """Check the part of the observations that says which task is played."""
    if network.reads_task and not isinstance(task, spaces.Discrete):
        raise ConfigError(
            "the policy's scorer is cross-fitted: which of its models has not seen a task depends on the task, and the "
            "observations do not have it. Wrap the environment: TaskObservation(env)."
        )
    amounts = {len(source.model_of_task) for source in _folded(network) if source.bound_to}
    if isinstance(task, spaces.Discrete) and amounts and amounts != {task.n}:
        raise ConfigError(
            f"the policy was made for {max(amounts) - 1:,} tasks but the environment has {task.n - 1:,}. Make it with "
            "the `tasks` of this environment's world."
        )
