"""IMPALA on the batched environment: actor and learner take turns in one process and on one device.

The actor collects experience, the learner updates the parameters. With ``policy_lag`` k, the actor uses the weights
from k updates ago, like actors in a distributed IMPALA, and V-trace corrects for the difference.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from wordcraft_kg.agents.config import ImpalaConfig
from wordcraft_kg.agents.losses import baseline_loss, divergence, entropy, policy_gradient_loss
from wordcraft_kg.agents.states import bind_tasks, states_of
from wordcraft_kg.agents.vtrace import v_trace
from wordcraft_kg.base.errors import ConfigError, TrainingError
from wordcraft_kg.base.settings import check_memory
from wordcraft_kg.base.tensors import as_tensor, copied
from wordcraft_kg.envs.batch import GOAL, State
from wordcraft_kg.models.policies.policy import Policy, Weights, log_policy
from wordcraft_kg.models.policies.sources import W

LOSSES = ("loss", "pg_loss", "baseline_loss", "entropy", "grad_norm")
"""Names of the losses (summed over the batch) and of the gradient norm before clipping."""
FIGURES = (*LOSSES, "rewards", "episodes", "successes", "updates")
"""Names of the sums since metrics were last taken: losses, rewards, and counts of episodes, goals and updates."""


class _Unroll(NamedTuple):
    """T steps in B environments, and the next states.

    Attributes:
        goal, selection: shape (T + 1, B), int64.
        table: shape (T + 1, B, A), int64.
        external_scores: shape (T + 1, B, S, A): source scores, cached for the learner; None without sources.
        actions: shape (T, B), int64.
        log_probs: shape (T, B): log-probabilities under the acting policy.
        rewards, discounts: shape (T, B).
        over, won: shape (T, B), bool: the episode ended; the episode reached the goal.
    """

    goal: Tensor
    selection: Tensor
    table: Tensor
    external_scores: Tensor | None
    actions: Tensor
    log_probs: Tensor
    rewards: Tensor
    discounts: Tensor
    over: Tensor
    won: Tensor


class Impala:
    """Trainer for a policy, from experience in a batch of environments.

    ``envs`` is the current state of the environments, ``update_number`` the number of finished updates.
    """

    def __init__(self, policy: Policy, envs: State, config: ImpalaConfig):
        """Prepare training in place, from the first state in ``config.batch_size`` environments.

        Every update changes ``policy``. ConfigError if ``config.compile`` is set and torch cannot compile.
        """
        self.policy, self.envs, self.config = policy, envs, config
        self.device = torch.device(config.device)
        policy.to(self.device)
        self.update_number = 0
        cost = config.scorer_cost
        if cost is None:  # attention sees each of a few tasks more often, and remembers it
            cost = 3.0 if len(envs.world.tasks) < 1_000 else 0.3
        self._scorer_cost = (
            cost if config.has_scorer_cost(policy.sources, envs.world.config.depth) else 0.0
        )
        self._parameters = [
            parameter for parameter in policy.parameters() if parameter.requires_grad
        ]
        # The parameters are views of a flat tensor, so that an optimiser step takes a few calls, not hundreds.
        self._flat = nn.Parameter(
            torch.cat([parameter.detach().reshape(-1) for parameter in self._parameters])
        )
        self._flat.grad = gradients = torch.zeros_like(self._flat)
        sizes = [parameter.numel() for parameter in self._parameters]
        views = zip(
            self._parameters, self._flat.data.split(sizes), gradients.split(sizes), strict=True
        )
        for parameter, value, gradient in views:
            parameter.data, parameter.grad = value.view_as(parameter), gradient.view_as(parameter)
        rate, decay, epsilon = config.learning_rate, config.rms_decay, config.rms_epsilon
        self.optimizer = torch.optim.RMSprop(
            [self._flat], rate, decay, epsilon, momentum=config.momentum
        )
        lag = min(config.policy_lag, config.updates)
        check_memory(
            "policy_lag", config.policy_lag, "that many policies", 4 * len(self._flat) * lag
        )
        self._generator = torch.Generator(self.device).manual_seed(config.seed)
        self._snapshots: deque[Weights] = deque(maxlen=config.policy_lag + 1)
        time, batch, slots = config.unroll, config.batch_size, envs.engine.num_slots
        self._unroll = _Unroll(
            goal=self._empty(time + 1, batch, dtype=torch.int64),
            selection=self._empty(time + 1, batch, dtype=torch.int64),
            table=self._empty(time + 1, batch, slots, dtype=torch.int64),
            # Scores stay 0 in the last states, where only the value matters, which does not depend on scores.
            external_scores=self._empty(time + 1, batch, len(policy.sources), slots).zero_()
            if policy.sources
            else None,
            actions=self._empty(time, batch, dtype=torch.int64),
            log_probs=self._empty(time, batch),
            rewards=self._empty(time, batch),
            discounts=self._empty(time, batch),
            over=self._empty(time, batch, dtype=torch.bool),
            won=self._empty(time, batch, dtype=torch.bool),
        )
        self._sums = self._empty(len(FIGURES), dtype=torch.float64).zero_()
        self._last: tuple[Tensor, ...] = ()
        self._act, self._learn = self._choose, self._losses
        if config.compile:
            check_compiler(self.device)
            mode = "reduce-overhead" if self.device.type == "cuda" else "default"
            self._act = torch.compile(self._choose, mode=mode, dynamic=False)
            self._learn = torch.compile(self._losses, mode=mode, dynamic=False)

    def update(self) -> None:
        """Collect an unroll (a few steps in each environment) and update the parameters.

        TrainingError if the loss is not finite; then parameters are unchanged.
        """
        bind_tasks([self.policy], self.envs.world)  # an evaluation may have bound different tasks
        weights = self.policy.weights()
        acting = {name: tensor.detach() for name, tensor in weights.items()}
        if self.config.policy_lag:
            # Contiguous, as in a checkpoint: products with a transposed tensor round differently.
            contiguous = torch.contiguous_format
            self._snapshots.append(
                {name: tensor.clone(memory_format=contiguous) for name, tensor in acting.items()}
            )
            acting = self._snapshots[0]
        is_cut = self._collect(acting)
        assert self._flat.grad is not None
        self._flat.grad.zero_()
        losses, last = self._learn(weights, self._unroll, is_cut)
        losses[0].backward()
        norm = self._flat.grad.norm()
        # Checked only on the CPU: on a device a check would synchronise, so take_figures and state check.
        if self.device.type == "cpu" and not math.isfinite(norm.item()):
            raise TrainingError(self._not_finite())
        self._flat.grad.mul_((self.config.clip / (norm + 1e-6)).clamp(max=1))
        for group in self.optimizer.param_groups:
            group["lr"] = self.config.learning_rate * max(
                0, 1 - self.update_number / self.config.updates
            )
        self.optimizer.step()
        self.update_number += 1
        unroll = self._unroll
        counts = (
            unroll.rewards.sum(),
            unroll.over.sum(),
            unroll.won.sum(),
            torch.ones((), device=self.device),
        )
        self._sums += torch.stack([*(loss.detach() for loss in losses), norm, *counts])
        self._last = tuple(
            tensor.clone() for tensor in last
        )  # a compiled learner reuses its output tensors

    def take_figures(self) -> dict[str, float | None]:
        """Return training metrics since the last call, by name, and reset the sums.

        Losses are batch sums, averaged over updates; ``entropy`` is a mean over steps; ``return`` and ``success`` are
        means over finished episodes, None without finished episodes.

        Two kinds describe the last update only. ``lambda_<source>_first`` and ``lambda_<source>_second`` are mean
        mixing weights for the first and second selection in an attempt; a source is ``alpha`` (attention) or a
        knowledge graph score. ``ratio_mean``, ``ratio_max`` and ``ratio_clipped`` (share above 1) describe importance
        ratios π/μ. TrainingError if the loss was not finite.
        """
        sums = dict(zip(FIGURES, self._sums.tolist(), strict=True))
        self._sums.zero_()
        if not math.isfinite(sums["grad_norm"]):
            raise TrainingError(self._not_finite())
        updates, episodes = max(sums["updates"], 1), sums["episodes"]
        figures: dict[str, float | None] = {name: sums[name] / updates for name in LOSSES}
        figures["entropy"] = sums["entropy"] / updates / self.config.steps_per_update
        figures["return"] = sums["rewards"] / episodes if episodes else None
        figures["success"] = sums["successes"] / episodes if episodes else None
        if self._last:
            log_rhos, lambdas = self._last
            ratios = log_rhos.exp()
            figures["ratio_mean"], figures["ratio_max"] = ratios.mean().item(), ratios.max().item()
            figures["ratio_clipped"] = (ratios > 1 + 1e-5).float().mean().item()
            is_first = self._unroll.selection[:-1].reshape(-1) == self.policy.num_entities
            for action, rows in (("first", is_first), ("second", ~is_first)):
                means = lambdas[rows].mean(0).tolist() if rows.any() else [None] * lambdas.shape[1]
                names = (f"lambda_{label.name}_{action}" for label in self.policy.labels)
                figures |= dict(zip(names, means, strict=True))
        return figures

    def state(self) -> dict[str, Tensor]:
        """Return the complete training state by name; :meth:`restore` continues bit for bit.

        TrainingError if a parameter is not finite; updates on a device do not check.
        """
        if not self._flat.isfinite().all():
            raise TrainingError(self._not_finite())
        tensors: dict[str, Tensor] = {
            f"policy.{name}": parameter for name, parameter in self.policy.named_parameters()
        }
        for name, value in self.optimizer.state[self._flat].items():
            tensors[f"optimizer.{name}"] = torch.as_tensor(value)
        tensors |= {
            f"engine.{name}": torch.from_numpy(array) for name, array in self.envs.saved().items()
        }
        for i, snapshot in enumerate(self._snapshots):
            tensors |= {f"snapshot.{i}.{name}": tensor for name, tensor in snapshot.items()}
        tensors |= {"sums": self._sums, "generator": self._generator.get_state()}
        tensors["update"] = torch.tensor(self.update_number)
        return copied(tensors)

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Continue training from a :meth:`state` with the same policy, tasks and settings.

        KeyError if a tensor is missing, RuntimeError if a shape differs.
        """
        with torch.no_grad():
            for name, parameter in self.policy.named_parameters():
                parameter.copy_(state[f"policy.{name}"])
        self.optimizer.state[self._flat] = self._restored_optimizer(state)
        self.envs = self.envs.restored(
            {name: state[f"engine.{name}"].numpy() for name in self.envs.saved()}
        )
        self._snapshots.clear()
        snapshots: dict[int, Weights] = {}
        for key, tensor in state.items():
            if key.startswith("snapshot."):
                _, number, name = key.split(".", 2)
                snapshots.setdefault(int(number), {})[name] = tensor.to(self.device, copy=True)
        self._snapshots.extend(snapshots[number] for number in sorted(snapshots))
        self._sums.copy_(state["sums"])
        self._generator.set_state(state["generator"])
        self.update_number = int(state["update"])

    @torch.inference_mode()
    def _collect(self, weights: Weights) -> bool:
        """Collect an unroll; return whether an episode continues, so that bootstrap values are needed."""
        unroll, engine = self._unroll, self.envs.engine
        noise = torch.rand(
            self.config.unroll, engine.num_envs, generator=self._generator, device=self.device
        )
        for t in range(self.config.unroll):
            self._observe(t)
            external_scores = None if unroll.external_scores is None else unroll.external_scores[t]
            state = unroll.goal[t], unroll.selection[t], unroll.table[t], external_scores
            actions, log_probs = self._act(weights, *state, noise[t])
            unroll.actions[t], unroll.log_probs[t] = actions, log_probs
            slots: Any = actions if engine.arrays.on_device else actions.numpy()
            self.envs, step = engine.step(self.envs, slots)
            unroll.rewards[t], unroll.over[t] = as_tensor(step.reward), as_tensor(step.over)
            unroll.won[t] = as_tensor(step.outcome == GOAL)
        self._observe(self.config.unroll)
        torch.mul(~unroll.over, self.config.discount, out=unroll.discounts)
        return engine.arrays.on_device or not step.over.all()

    def _observe(self, t: int) -> None:
        unroll, states = self._unroll, states_of(self.envs)
        unroll.goal[t], unroll.selection[t], unroll.table[t] = (
            states.goal,
            states.selection,
            states.table,
        )
        external_scores = self.policy.external_scores(*states) if t < self.config.unroll else None
        if external_scores is not None:
            assert unroll.external_scores is not None
            unroll.external_scores[t] = external_scores

    def _choose(
        self,
        weights: Weights,
        goal: Tensor,
        selection: Tensor,
        table: Tensor,
        external_scores: Tensor | None,
        noise: Tensor,
    ) -> tuple[Tensor, Tensor]:
        log_probs = log_policy(
            self.policy(goal, selection, table, weights, external_scores=external_scores).logits
        )
        shares = log_probs.exp().cumsum(0)
        # The first slot where the cumulative probability exceeds the noise, never a slot with probability 0.
        actions = (shares <= noise * shares[-1]).sum(0)
        return actions, log_probs.gather(0, actions[None])[0]

    def _losses(
        self, weights: Weights, unroll: _Unroll, is_cut: bool
    ) -> tuple[tuple[Tensor, ...], tuple[Tensor, Tensor]]:
        """Return losses in the order of :data:`LOSSES`, then log-ratios and λ.

        ``is_cut``: an episode continues after the unroll, so values for the last states are needed.
        """
        config, time = self.config, self.config.unroll
        num_states = time + 1 if is_cut else time
        goal, selection, table, external_scores = (
            None if part is None else part[:num_states].flatten(0, 1)
            for part in (unroll.goal, unroll.selection, unroll.table, unroll.external_scores)
        )
        output = self.policy(goal, selection, table, weights, external_scores=external_scores)
        acted = unroll.actions.numel()
        log_policies = log_policy(output.logits[:acted])
        log_probs = log_policies.gather(0, unroll.actions.view(1, -1)).view_as(unroll.log_probs)
        values = output.value.view(num_states, -1)
        bootstrap = values[time].detach() if is_cut else torch.zeros_like(values[0])
        log_rhos = log_probs.detach() - unroll.log_probs
        targets = v_trace(
            log_rhos, unroll.discounts, unroll.rewards, values[:time].detach(), bootstrap
        )
        of_policy = policy_gradient_loss(log_probs, targets.pg_advantages)
        of_baseline = baseline_loss(values[:time], targets.vs)
        spread = entropy(log_policies)
        loss = of_policy + config.baseline_cost * of_baseline - config.entropy_cost * spread
        if self._scorer_cost:
            assert external_scores is not None
            scores = external_scores[:acted, list(self.policy.sources).index(W.name)]
            alone = log_policy(scores.masked_fill(output.logits[:acted] == -torch.inf, -torch.inf))
            loss = loss + self._scorer_cost * divergence(log_policies, alone)
        lambdas = (
            loss.new_zeros(acted, 0) if output.lambdas is None else output.lambdas[:acted].detach()
        )
        return (loss, of_policy, of_baseline, spread), (log_rhos, lambdas)

    def _restored_optimizer(self, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the optimiser state; without this check, torch would fail in the next update."""
        expected = {"step": (), "square_avg": self._flat.shape} if state["update"] else {}
        if expected and self.config.momentum:
            expected["momentum_buffer"] = self._flat.shape
        names = {
            name.removeprefix("optimizer."): name for name in state if name.startswith("optimizer.")
        }
        if names.keys() != expected.keys():
            raise KeyError(
                f"optimiser tensors: expected {', '.join(expected) or 'none'}, found {', '.join(names)}"
            )
        for key, name in names.items():
            if state[name].shape != expected[key] or not state[name].is_floating_point():
                raise RuntimeError(
                    f"{name} has shape {tuple(state[name].shape)} and type {state[name].dtype}"
                )
        return {
            key: state[name].to("cpu" if key == "step" else self.device, copy=True)
            for key, name in names.items()
        }

    def _not_finite(self) -> str:
        return (
            f"the loss is no longer a finite number in update {self.update_number + 1} (environment steps "
            f"{self.update_number * self.config.steps_per_update:,} to "
            f"{(self.update_number + 1) * self.config.steps_per_update:,}). Train with a lower `learning_rate`."
        )

    def _empty(self, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.empty(*shape, dtype=dtype, device=self.device)


def check_compiler(device: torch.device) -> None:
    """Check that torch can compile for a device; ConfigError with the reason given by torch."""
    try:
        torch.compile(lambda x: (x + 1).exp())(torch.zeros(8, device=device))
    except Exception as error:  # torch raises a dozen different classes here
        reason = (str(error).strip() or "no reason given").splitlines()[0]
        raise ConfigError(
            f"`compile`: torch cannot compile here ({type(error).__name__}: {reason}). Install a C++ compiler such as "
            "g++, or train without `compile`."
        ) from None
