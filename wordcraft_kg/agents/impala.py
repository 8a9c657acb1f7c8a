"""IMPALA on the batched environment: actor and learner take turns in one process and on one device.

The actor collects experience, the learner updates the parameters. With ``policy_lag`` k, the actor
uses the weights from k updates ago, like actors in a distributed IMPALA, and V-trace corrects for
the difference. Without a lag, the importance ratios of V-trace are 1 but for rounding.

Read :meth:`Impala.update` first: an update is an unroll, a loss and an optimiser step. Below, T is
the number of choices in an unroll, B of environments, A of slots, C of choices in a state, S of
knowledge sources. A choice is that of a slot, or of a pair of slots, which takes two environment
steps. The order of operations is part of the results: tests compare whole trainings bit for bit.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from wordcraft_kg.agents.agent_config import ImpalaConfig
from wordcraft_kg.agents.losses import (
    Successes,
    baseline_loss,
    divergence,
    led_to_goals,
    memory_loss,
    policy_gradient_loss,
    v_trace,
)
from wordcraft_kg.agents.states import bind_tasks, states_of
from wordcraft_kg.base import ConfigError, TrainingError, check_memory
from wordcraft_kg.base.tensors import as_tensor, copied, with_prefix
from wordcraft_kg.envs.batch import GOAL, State
from wordcraft_kg.models.policies.policy import Policy, Weights, log_policy
from wordcraft_kg.models.policies.sources import W
from wordcraft_kg.models.policies.states import Attempts, States
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge

LOSSES = ("loss", "pg_loss", "baseline_loss", "entropy", "grad_norm")
"""Names of the losses (summed over the batch) and of the gradient norm before clipping."""
METRICS = (*LOSSES, "rewards", "episodes", "successes", "updates")
"""Names of the sums since metrics were last taken.

Losses, rewards, and counts of episodes, goals and updates.
"""
FEW_TASKS = 1_000
"""Number of train tasks below which the penalty of ``scorer_cost`` is strong by default."""


class _Unroll(NamedTuple):
    """T choices in B environments, and the states after the last one.

    Attributes:
        states: goal, selection and attempts left, shape (T + 1, B), and table, shape (T + 1, B, A).
        external_scores: shape (T + 1, B, S, C): source scores, cached for the learner; None without
            sources. 0 in the last states: only their value matters, and does not depend on scores.
        noise: shape (T + 1, B, H): which hidden units are dropped, the same for actor and learner;
            H is 0 for a policy without noise.
        remembered: shape (T, B, C), bool: choices that lead to remembered pairs; None without a
            memory.
        actions: shape (T, B), int64: choices.
        log_probs: shape (T, B): log-probabilities of the choices under the acting policy.
        rewards: shape (T, B).
        discounts: shape (T, B): γ for each environment step, or 0 where the episode ended.
        over: shape (T, B), bool: the episode ended.
        won: shape (T, B), bool: the episode reached the goal.
    """

    states: States
    external_scores: Tensor | None
    noise: Tensor
    remembered: Tensor | None
    actions: Tensor
    log_probs: Tensor
    rewards: Tensor
    discounts: Tensor
    over: Tensor
    won: Tensor


class Impala:
    """Trainer for a policy, from experience in a batch of environments.

    Attributes:
        policy: the policy in training, changed by every update.
        envs: current state of the environments.
        update_number: number of finished updates.
        optimizer: RMSProp on all parameters as one tensor.
        successes: memory of own successes; stays empty without ``config.memory_cost``.
        threads: threads of torch's own loops.
    """

    def __init__(
        self,
        policy: Policy,
        envs: State,
        config: ImpalaConfig,
    ):
        """Prepare training in place.

        Args:
            policy: the policy to train, moved to ``config.device``.
            envs: first state in ``config.num_envs`` environments.
            config: settings of the trainer.

        Raises:
            ConfigError: if ``config.policy_lag`` policies do not fit into memory, or if
                ``config.unroll`` ends within an attempt and the policy chooses pairs.
        """
        config = config.for_episodes(2 * envs.world.config.attempts)
        self._time, remainder = divmod(config.unroll_steps, policy.steps_per_choice)
        if remainder:
            raise ConfigError(
                f"`unroll` {config.unroll}: expected an even number, since `policy` "
                f"{policy.config.policy} chooses both slots of an attempt together."
            )
        self.policy = policy
        self.envs = envs
        self.config = config
        self.device = torch.device(config.device)
        policy.to(self.device)
        self.update_number = 0
        self._scorer_cost = self._weight_of_scorer_cost()
        self._flat, self._gradient = self._flattened()
        self.optimizer = torch.optim.RMSprop(
            [self._flat],
            lr=config.first_rate,
            alpha=config.rms_decay,
            eps=config.rms_epsilon,
        )
        # As RMSProp makes it in its first step; made here, every checkpoint has it.
        optimizer_state = self.optimizer.state[self._flat]
        optimizer_state["step"] = torch.tensor(0.0)  # counted on the CPU
        optimizer_state["square_avg"] = torch.zeros_like(self._flat)
        # Bytes of float32; a short training never keeps more policies than it has updates.
        num_bytes = 4 * len(self._flat) * min(config.policy_lag, config.updates)
        check_memory("policy_lag", config.policy_lag, "that many policies", num_bytes)
        # A choice never needs the slots that are free for the results of the last attempt.
        self._slots = envs.engine.num_slots
        # The action to combine is the last slot, and stays.
        if policy.num_slots is None and not policy.most_picks:
            self._slots -= envs.world.max_results
        self.successes = Successes(policy.num_entities, self.device)
        self._generator = torch.Generator(self.device).manual_seed(config.seed)
        # The newest snapshot is the learner's; with lag k the oldest is from k updates ago.
        self._snapshots: deque[Weights] = deque(maxlen=config.policy_lag + 1)
        by_lists = [part for part in policy.modules() if isinstance(part, RecipeKnowledge)]
        for knowledge in by_lists:
            knowledge.workers = config.threads
        # Where a recipe scorer's loops use the threads, torch's own would only wait, and waiting
        # takes the processor's time from the loops.
        self.threads = 1 if by_lists else config.threads
        # Sums stay on the device, in float64 so that many small terms do not vanish.
        self._sums = torch.zeros(len(METRICS), dtype=torch.float64, device=self.device)
        # Of the last update: log-ratios of the learning and the acting policy, shape (T, B).
        self._log_rhos: Tensor | None = None
        # Mixing weights in the last update, shape (T · B, S or S + 1); no columns without sources.
        self._lambdas: Tensor | None = None

    def _weight_of_scorer_cost(self) -> float:
        """Return the weight of the divergence from the scorer's policy; 0 for no such penalty."""
        config = self.config
        envs = self.envs
        if not config.has_scorer_cost(self.policy.sources, envs.world.config.depth):
            return 0.0
        if config.scorer_cost is not None:
            return config.scorer_cost
        # A network sees each of a few tasks more often, and remembers it.
        if len(envs.world.tasks) < FEW_TASKS:
            return 3.0
        return 1.0 if self.policy.config.policy == "pairs" else 0.3

    def _flattened(self) -> tuple[nn.Parameter, Tensor]:
        """Make all parameters and gradients views of one flat tensor each, and return the two.

        So an optimiser step, a gradient norm and a check for NaN take a few calls, not hundreds.
        """
        parameters = [part for part in self.policy.parameters() if part.requires_grad]
        pieces = [parameter.detach().reshape(-1) for parameter in parameters]
        flat = nn.Parameter(torch.cat(pieces))
        flat_gradient = torch.zeros_like(flat)
        flat.grad = flat_gradient
        sizes = [len(piece) for piece in pieces]
        values = flat.data.split(sizes)
        gradients = flat_gradient.split(sizes)
        for parameter, value, gradient in zip(parameters, values, gradients, strict=True):
            parameter.data = value.view_as(parameter)
            # `backward` adds to an existing gradient in place, and so writes into the flat tensor.
            parameter.grad = gradient.view_as(parameter)
        return flat, flat_gradient

    # --- an update --------------------------------------------------------------------------------

    def update(self) -> None:
        """Collect an unroll (a few steps in each environment) and update the parameters.

        Raises:
            TrainingError: if the loss is not finite, on the CPU; then parameters are unchanged.
        """
        # An evaluation in between may have bound the policy to other tasks.
        bind_tasks([self.policy], self.envs.world)
        # What depends on parameters only is computed once, for the actor and the learner.
        weights = self.policy.weights(self._generator)
        self._unroll = self._collect(self._acting(weights))
        # Gradients flow through `weights` into the views of the flat gradient.
        self._gradient.zero_()
        losses, self._log_rhos, self._lambdas = self._losses(weights)
        losses[0].backward()

        # Clip the norm of all gradients together, as `clip_grad_norm_` does.
        norm = self._gradient.norm()
        # Checked only on the CPU: on a device a check would wait for all pending work, so
        # take_metrics and state check there.
        if self.device.type == "cpu" and not math.isfinite(norm.item()):
            raise TrainingError(self._not_finite())
        scale = self.config.clip / (norm + 1e-6)
        self._gradient.mul_(scale.clamp(max=1))

        # The learning rate decays linearly to 0 at the end of training.
        remaining = max(0, 1 - self.update_number / self.config.updates)
        self.optimizer.param_groups[0]["lr"] = self.config.first_rate * remaining
        self.optimizer.step()
        self.update_number += 1

        # Added up in the order of METRICS, without waiting for them.
        unroll = self._unroll
        terms = [loss.detach() for loss in losses]
        terms += [norm, unroll.rewards.sum(), unroll.over.sum(), unroll.won.sum()]
        terms.append(torch.ones((), device=self.device))  # one update
        self._sums += torch.stack(terms)

    def _acting(self, weights: Weights) -> Weights:
        """Return the actor's weights: the learner's, or with a lag those of an earlier update."""
        if not self.config.policy_lag:
            return weights
        # Contiguous, as in a checkpoint: products with a transposed tensor round differently, and a
        # resumed training would end with other bits.
        layout = torch.contiguous_format
        snapshot = {
            name: tensor.detach().clone(memory_format=layout) for name, tensor in weights.items()
        }
        self._snapshots.append(snapshot)
        return self._snapshots[0]

    def take_metrics(self) -> dict[str, float | None]:
        """Return training metrics since the last call, by name, and reset the sums.

        Losses are batch sums, averaged over updates; ``entropy`` is a mean over steps; ``return``
        and ``success`` are means over finished episodes, None without finished episodes.

        Two kinds describe the last update only. ``lambda_<source>_first`` and
        ``lambda_<source>_second`` are mean mixing weights for the first and second selection in an
        attempt; a source is ``alpha`` (attention) or a knowledge graph score. ``ratio_mean``,
        ``ratio_max`` and ``ratio_clipped`` (share above 1) describe importance ratios π/μ.

        Raises:
            TrainingError: if the loss was not finite.
        """
        sums = dict(zip(METRICS, self._sums.tolist(), strict=True))
        self._sums.zero_()
        if not math.isfinite(sums["grad_norm"]):
            raise TrainingError(self._not_finite())
        updates = max(sums["updates"], 1)
        metrics: dict[str, float | None] = {name: sums[name] / updates for name in LOSSES}
        metrics["entropy"] = sums["entropy"] / updates / self.config.steps_per_update
        episodes = sums["episodes"]
        metrics["return"] = sums["rewards"] / episodes if episodes else None
        metrics["success"] = sums["successes"] / episodes if episodes else None
        if self._log_rhos is None or self._lambdas is None:
            return metrics
        ratios = self._log_rhos.exp()
        metrics["ratio_mean"] = ratios.mean().item()
        metrics["ratio_max"] = ratios.max().item()
        # A margin for ratios that are 1 but for rounding.
        metrics["ratio_clipped"] = (ratios > 1 + 1e-5).float().mean().item()
        # Without the states after the last step, in the order of the rows of the weights.
        states = self._unroll.states.of(slice(-1)).flattened()
        is_first = states.num_selected(self.policy.num_entities) == 0
        for action, rows in (("first", is_first), ("second", ~is_first)):
            no_means: list[float | None] = [None] * self._lambdas.shape[1]
            means = self._lambdas[rows].mean(0).tolist() if rows.any() else no_means
            for label, mean in zip(self.policy.labels, means, strict=True):
                metrics[f"lambda_{label.name}_{action}"] = mean
        return metrics

    # --- checkpoints ------------------------------------------------------------------------------

    def state(self) -> dict[str, Tensor]:
        """Return the complete training state by name; :meth:`restore` continues bit for bit.

        Returns:
            Contiguous copies on the CPU: parameters, optimiser, environments, the actor's earlier
            weights, sums of the metrics, memory of successes, generator and number of updates.

        Raises:
            TrainingError: if a parameter is not finite, which updates on a device do not check.
        """
        if not self._flat.isfinite().all():
            raise TrainingError(self._not_finite())
        tensors = self._changed_in_place()
        engine = self.envs.saved().items()
        tensors |= {f"engine.{name}": torch.from_numpy(array) for name, array in engine}
        for number, snapshot in enumerate(self._snapshots):
            tensors |= {f"snapshot.{number}.{name}": part for name, part in snapshot.items()}
        tensors["successes"] = self.successes.keys
        tensors["generator"] = self._generator.get_state()
        tensors["update"] = torch.tensor(self.update_number)
        return copied(tensors)

    def _changed_in_place(self) -> dict[str, Tensor]:
        """Return the tensors that an update writes into, by their names in a state."""
        parameters = self.policy.named_parameters()
        averages = self.optimizer.state[self._flat].items()
        return {
            "sums": self._sums,
            **{f"policy.{name}": parameter for name, parameter in parameters},
            **{f"optimizer.{name}": average for name, average in averages},
        }

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Continue training from a :meth:`state` with the same policy, tasks and settings.

        Raises:
            KeyError: if a tensor is missing.
            RuntimeError: if a shape differs.
            ConfigError: if an array of the environments has another shape.
        """
        with torch.no_grad():
            for name, tensor in self._changed_in_place().items():
                # A tensor of another shape might be repeated to fit.
                if state[name].shape != tensor.shape:
                    sizes = f"{tuple(state[name].shape)}; expected {tuple(tensor.shape)}"
                    raise RuntimeError(f"{name} has the size {sizes}")
                tensor.copy_(state[name])
        saved = {name: state[f"engine.{name}"].numpy() for name in self.envs.saved()}
        self.envs = self.envs.restored(saved)
        self.successes.keys = state["successes"].to(self.device, copy=True)
        self._generator.set_state(state["generator"])
        self.update_number = int(state["update"])
        self._snapshots.clear()
        num_snapshots = min(self.update_number, self.config.policy_lag + 1)
        for number in range(num_snapshots if self.config.policy_lag else 0):
            snapshot = with_prefix(state, f"snapshot.{number}.")
            self._snapshots.append(
                {name: part.to(self.device, copy=True) for name, part in snapshot.items()}
            )

    # --- acting -----------------------------------------------------------------------------------

    @torch.no_grad()
    def _collect(self, weights: Weights) -> _Unroll:
        """Collect an unroll; the states after it are the environments' next states."""
        engine = self.envs.engine
        batch = engine.num_envs
        # All random numbers of the unroll in two calls.
        noise = self._uniform(self._time, batch)
        dropped = self._uniform(self._time + 1, batch, self.policy.noise_size)
        # Without copies: an engine never writes into a state that it has returned.
        observed = [self._states()]
        scores_in_turn = []
        choices = []
        outcomes = []
        for t in range(self._time):
            states = observed[t]
            scores = self.policy.external_scores(states)
            actions, log_probs = self._choose(weights, states, scores, noise[t], dropped[t])
            for slot_actions in self.policy.slots_of(actions, self._slots):
                slots: Any = slot_actions if engine.arrays.on_device else slot_actions.numpy()
                self.envs, step = engine.step(self.envs, slots)
            # The first step of a choice of two only selects, and has no reward.
            outcomes.append(tuple(map(as_tensor, (step.reward, step.over, step.outcome == GOAL))))
            choices.append((actions, log_probs))
            if scores is not None:
                scores_in_turn.append(scores)
            # Also after the last step: the values of these states bootstrap the returns.
            observed.append(self._states())
        external_scores = None
        if scores_in_turn:
            # Kept, so that the learner does not compute them again.
            external_scores = torch.stack([*scores_in_turn, torch.zeros_like(scores_in_turn[0])])
        states = _stacked(observed)
        actions, log_probs = map(torch.stack, zip(*choices, strict=True))
        rewards, over, won = map(torch.stack, zip(*outcomes, strict=True))
        # The memory holds pairs.
        remembered = None
        if self.config.memory_cost and not self.policy.most_picks:
            remembered = self._remembered(states, actions, over, won)
        discounts = ~over * self.config.discount**self.policy.steps_per_choice
        return _Unroll(
            states,
            external_scores,
            dropped,
            remembered,
            actions,
            log_probs,
            rewards,
            discounts,
            over,
            won,
        )

    def _remembered(self, states: States, actions: Tensor, over: Tensor, won: Tensor) -> Tensor:
        """Add an unroll's successes to the memory; return which of its choices are remembered.

        Arguments and result as in :class:`_Unroll`.
        """
        before, after = states.of(slice(-1)), states.of(slice(1, None))
        is_new = (after.table != before.table).any(2)
        led = led_to_goals(won, over, is_new).flatten()
        # Time and environments become one batch axis.
        before = before.flattened()
        assert before.attempts is not None
        first, second = self.policy.pairs_of(before, actions.flatten())
        # A choice that only selects combines nothing yet.
        led &= first != self.policy.num_entities
        attempts_left = before.attempts.left
        self.successes.add(before.goal[led], attempts_left[led], first[led], second[led])
        is_held = self.successes.hold(before.goal, attempts_left, before.table)
        return self.policy.choices_with(before, is_held).view(*actions.shape, -1)

    def _states(self) -> States:
        """Return the environments' states, without slots that no choice needs."""
        states = states_of(self.envs)
        return states._replace(table=states.table[:, : self._slots])

    def _choose(
        self,
        weights: Weights,
        states: States,
        external_scores: Tensor | None,
        noise: Tensor,
        dropped: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Sample a choice in each state; return it and its log-probability, shape (B,) each.

        ``noise`` holds a uniform number in [0, 1) for each state, ``dropped`` those of the policy.
        """
        output = self.policy.choose(states, weights, external_scores, dropped)
        log_probs = log_policy(output.logits)
        # Cumulative probabilities, shape (C, B). The first choice that exceeds the noise is the
        # number of choices that do not; it never has probability 0. Scaled by the total, which is 1
        # but for rounding.
        shares = log_probs.exp().cumsum(0)
        actions = (shares <= noise * shares[-1]).sum(0)
        return actions, log_probs.gather(0, actions[None])[0]

    # --- learning ---------------------------------------------------------------------------------

    def _losses(self, weights: Weights) -> tuple[list[Tensor], Tensor, Tensor]:
        """Return the losses of the last unroll, and values for the metrics.

        Args:
            weights: weights of the learning policy, with gradients.

        Returns:
            The loss and its parts, shape () each, the first of :data:`LOSSES`; and without
            gradients, the log-ratios of the learning and the acting policy, shape (T, B), and the
            mixing weights, shape (T · B, S or S + 1).
        """
        config = self.config
        unroll = self._unroll
        time = self._time
        # Where every episode ends with the unroll, bootstrap values are 0, and the learner saves a
        # share of 1 / (T + 1) of its work. On a device, asking would wait for pending work.
        is_cut = self.envs.engine.arrays.on_device or not unroll.over[-1].all()
        num_states = time + 1 if is_cut else time
        # T · B; rows from here on are the states after the last step.
        acted = unroll.actions.numel()

        # One call of the policy for all states: time and environments become one batch axis.
        states = unroll.states.of(slice(num_states)).flattened()
        external_scores = None
        if unroll.external_scores is not None:
            external_scores = unroll.external_scores[:num_states].flatten(0, 1)
        noise = unroll.noise[:num_states].flatten(0, 1)
        output = self.policy.choose(states, weights, external_scores, noise)

        # Log-probabilities of all choices, (C, T · B), and of the chosen ones, (T, B).
        log_policies = log_policy(output.logits[:acted])
        action_log_probs = log_policies.gather(0, unroll.actions.view(1, -1))
        log_probs = action_log_probs.view_as(unroll.log_probs)
        values = output.value.view(num_states, -1)
        bootstrap = values[time].detach() if is_cut else torch.zeros_like(values[0])

        # Targets are constants for the gradient.
        log_rhos = log_probs.detach() - unroll.log_probs
        vs, pg_advantages = v_trace(
            log_rhos,
            unroll.discounts,
            unroll.rewards,
            values[:time].detach(),
            bootstrap,
        )
        policy_loss = policy_gradient_loss(log_probs, pg_advantages)
        value_loss = baseline_loss(values[:time], vs)
        # Subtracted: a policy with more entropy explores more.
        entropy = -divergence(log_policies, 0.0)
        loss = policy_loss + config.baseline_cost * value_loss - config.entropy_cost * entropy

        if unroll.remembered is not None:
            remembered = unroll.remembered.flatten(0, 1).T
            assert config.memory_cost is not None  # set by the preset
            loss = loss + config.memory_cost * memory_loss(log_policies, remembered)

        if self._scorer_cost:
            # Stay near the policy of the scorer alone, the softmax of w, so that attention learns
            # corrections rather than train tasks by heart.
            assert external_scores is not None
            place = list(self.policy.sources).index(W.name)
            scores = external_scores[:acted, place]
            is_empty = output.logits[:acted] == -torch.inf
            scorer_policy = log_policy(scores.masked_fill(is_empty, -torch.inf))
            loss = loss + self._scorer_cost * divergence(log_policies, scorer_policy)

        lambdas = loss.new_zeros(acted, 0) if output.lambdas is None else output.lambdas[:acted]
        return [loss, policy_loss, value_loss, entropy], log_rhos, lambdas.detach()

    def _not_finite(self) -> str:
        first = self.update_number * self.config.steps_per_update
        last = first + self.config.steps_per_update
        return (
            f"the loss is no longer a finite number in update {self.update_number + 1} "
            f"(environment steps {first:,} to {last:,}). Train with a lower `learning_rate`."
        )

    def _uniform(self, *shape: int) -> Tensor:
        return torch.rand(*shape, generator=self._generator, device=self.device)


def _stacked(observed: Sequence[States]) -> States:
    """Return states (B, ...) of several times as one, (T, B, ...), with what a policy reads."""
    attempts_left = [states.attempts.left for states in observed if states.attempts]
    return States(
        goal=torch.stack([states.goal for states in observed]),
        selection=torch.stack([states.selection for states in observed]),
        table=torch.stack([states.table for states in observed]),
        attempts=Attempts(torch.stack(attempts_left)),
    )
