"""What IMPALA learns from: V-trace targets, loss terms, and a memory of own successes.

Losses are sums over time and batch, not means: the paper's learning rate and costs belong to sums.
"""

import torch
from torch import Tensor


def policy_gradient_loss(log_probs: Tensor, advantages: Tensor) -> Tensor:
    """Return ``-Σ log π(a|x) · advantage``.

    Args:
        log_probs: shape (T, B), nats: log-probabilities of the chosen actions.
        advantages: shape (T, B), without gradients.

    Returns:
        shape ().
    """
    return -(log_probs * advantages).sum()


def baseline_loss(values: Tensor, targets: Tensor) -> Tensor:
    """Return ``½ Σ (vs - V)²``.

    Args:
        values: shape (T, B): state values V.
        targets: shape (T, B): value targets vs, without gradients.

    Returns:
        shape ().
    """
    return 0.5 * (targets - values).square().sum()


def divergence(log_policies: Tensor, references: Tensor | float) -> Tensor:
    """Return the summed divergence ``Σ π (log π - log ρ)`` in nats.

    Slots with probability 0 under π add 0. Where π is above 0, ρ must be, too.

    Args:
        log_policies: shape (N, A), nats: log π.
        references: shape (N, A), nats: log ρ; 0 for the negative entropy of π.

    Returns:
        shape ().
    """
    # An empty slot has log π = -inf and π = 0: the product would be NaN, and its limit is 0.
    differences = log_policies - references
    finite = differences.masked_fill(log_policies == -torch.inf, 0)
    return (log_policies.exp() * finite).sum()


def memory_loss(log_policies: Tensor, remembered: Tensor) -> Tensor:
    """Return ``-Σ log Σ π`` in nats: the inner sum over remembered choices of a state.

    States without a remembered choice add 0.

    Args:
        log_policies: shape (C, N), nats: log π.
        remembered: shape (C, N), bool; no choice with probability 0.

    Returns:
        shape ().

    Source: Oh et al. 2018, "Self-Imitation Learning", with all successes worth the same.
    """
    has_any = remembered.any(0)
    # Elsewhere the sum over no choice would be log 0; all choices give a constant instead.
    target_log_probs = log_policies.masked_fill(~remembered & has_any, -torch.inf)
    return -torch.logsumexp(target_log_probs, dim=0).masked_fill(~has_any, 0).sum()


@torch.no_grad()
def v_trace(
    log_rhos: Tensor,
    discounts: Tensor,
    rewards: Tensor,
    values: Tensor,
    bootstrap_value: Tensor,
    *,
    clip_rho: float = 1.0,
    clip_c: float = 1.0,
    clip_pg_rho: float = 1.0,
) -> tuple[Tensor, Tensor]:
    """Correct returns for the difference between the acting policy (μ) and the learning policy (π).

    With ``ρ_t = min(ρ̄, π/μ)`` and ``c_t = min(c̄, π/μ)``:
    ``vs_t = V_t + ρ_t (r_t + γ_t V_{t+1} - V_t) + γ_t c_t (vs_{t+1} - V_{t+1})``, and
    ``pg_advantage_t = min(ρ̄_pg, π/μ) (r_t + γ_t vs_{t+1} - V_t)``. With all ratios 1, vs are the
    returns.

    Args:
        log_rhos: shape (T, B): log π(a|x) - log μ(a|x).
        discounts: shape (T, B): γ, or 0 where the episode ended with this step.
        rewards: shape (T, B).
        values: shape (T, B): V of the states in which actions were chosen.
        bootstrap_value: shape (B,): V of the state after the last step.
        clip_rho: ρ̄, which determines the fixed point.
        clip_c: c̄, which limits how far corrections reach back.
        clip_pg_rho: ρ̄_pg, for the policy gradient.

    Returns:
        Without gradients, shape (T, B) each: targets for state values (vs), and advantages for the
        policy gradient.

    Source: Espeholt et al. 2018, "IMPALA", equations 1 and 2 and section 4.2.
    """
    rhos = log_rhos.exp()
    next_values = torch.cat([values[1:], bootstrap_value[None]])
    deltas = rhos.clamp(max=clip_rho) * (rewards + discounts * next_values - values)
    reach = discounts * rhos.clamp(max=clip_c)
    # Equation 1 as the recursion of remark 1, backwards in time: with d_t = vs_t - V_t,
    # d_t = delta_t + γ_t c_t d_{t+1}, and d_T = 0.
    corrections = torch.empty_like(values)
    correction = torch.zeros_like(bootstrap_value)
    for t in range(len(values) - 1, -1, -1):
        correction = torch.addcmul(deltas[t], reach[t], correction)
        corrections[t] = correction
    vs = values + corrections
    # The policy gradient uses vs, not V, of the next state: a better estimate of its return.
    next_vs = torch.cat([vs[1:], bootstrap_value[None]])
    pg_advantages = rhos.clamp(max=clip_pg_rho) * (rewards + discounts * next_vs - values)
    return vs, pg_advantages


class Successes:
    """Pairs that led to a goal, each with the attempts that were left before it.

    Attributes:
        keys: shape (n,), int64: a number for each pair, goal and attempts left, in ascending order.
    """

    def __init__(self, num_entities: int, device: torch.device):
        """Remember nothing yet, of ``num_entities`` (E) entities."""
        self._size = num_entities + 1
        self.keys = torch.empty(0, dtype=torch.int64, device=device)

    def add(self, goal: Tensor, attempts_left: Tensor, first: Tensor, second: Tensor) -> None:
        """Remember pairs of entities that led to a goal.

        Args:
            goal: ids, shape (n,), int64.
            attempts_left: attempts left before the pair, shape (n,), int64.
            first: ids of an entity of each pair, shape (n,), int64.
            second: ids of its partner, shape (n,), int64; the order of a pair has no meaning.
        """
        new = self._keys(goal, attempts_left, first, second)
        self.keys = torch.cat([self.keys, new]).unique()

    def hold(self, goal: Tensor, attempts_left: Tensor, table: Tensor) -> Tensor:
        """Return which slot pairs of B tables are remembered.

        Args:
            goal: ids, shape (B,).
            attempts_left: attempts left, shape (B,).
            table: ids in the slots, shape (B, A).

        Returns:
            shape (B, A, A), bool, symmetric; False for empty slots, which no pair has.
        """
        if not len(self.keys):
            return torch.zeros(
                (*table.shape, table.shape[1]), dtype=torch.bool, device=table.device
            )
        goals = goal[:, None, None]
        attempts = attempts_left[:, None, None]
        table_keys = self._keys(goals, attempts, table[:, :, None], table[:, None])
        places = torch.searchsorted(self.keys, table_keys).clamp(max=len(self.keys) - 1)
        return self.keys[places] == table_keys

    def _keys(self, goal: Tensor, attempts_left: Tensor, first: Tensor, second: Tensor) -> Tensor:
        """Return a number for each pair, goal and attempts left, whatever the pair's order."""
        # With five attempts left, 63 bits are enough for a million entities.
        lower = torch.minimum(first, second)
        higher = torch.maximum(first, second)
        return ((attempts_left * self._size + goal) * self._size + lower) * self._size + higher


def led_to_goals(won: Tensor, over: Tensor, is_new: Tensor) -> Tensor:
    """Return which choices of an unroll led to the goal, shape (T, B), bool.

    These are the choices that made the goal, and earlier ones in their episodes that made something
    else.

    Args:
        won: shape (T, B), bool: the choice made the goal.
        over: shape (T, B), bool: the choice ended the episode.
        is_new: shape (T, B), bool: the choice changed the table.
    """
    led = torch.zeros_like(won)
    is_reached = torch.zeros_like(won[0])
    for t in reversed(range(len(won))):
        is_reached = won[t] | (is_reached & ~over[t])
        led[t] = is_reached & (won[t] | is_new[t])
    return led
