"""V-trace: value targets and advantages from the experience of an older policy."""

from typing import NamedTuple

import torch
from torch import Tensor


class VTrace(NamedTuple):
    """Targets for a batch of unrolls, without gradients.

    Attributes:
        vs: shape (T, B): targets for state values.
        pg_advantages: shape (T, B): advantages for the policy gradient.
    """

    vs: Tensor
    pg_advantages: Tensor


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
) -> VTrace:
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
        Value targets and advantages.

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
    return VTrace(vs, pg_advantages)
