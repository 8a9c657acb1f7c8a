"""V-trace: value targets and advantages from the experience of an older policy."""

from typing import NamedTuple

import torch
from torch import Tensor


class VTrace(NamedTuple):
    """Targets ``vs`` for state values and policy gradient advantages, shape (T, B) each, without gradients."""

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
    ``pg_advantage_t = min(ρ̄_pg, π/μ) (r_t + γ_t vs_{t+1} - V_t)``. With all ratios 1, vs are the returns.

    Args:
        log_rhos: shape (T, B): log π(a|x) - log μ(a|x).
        discounts: shape (T, B): γ, or 0 at the end of an episode.
        rewards: shape (T, B).
        values: shape (T, B): V before each step.
        bootstrap_value: shape (B,): V after the last step.
        clip_rho: ρ̄, which determines the fixed point.
        clip_c: c̄, which limits the range of corrections.
        clip_pg_rho: ρ̄_pg, for the policy gradient.

    Source: Espeholt et al. 2018, "IMPALA", equations 1 and 2 and section 4.2.
    """
    rhos = log_rhos.exp()
    next_values = torch.cat([values[1:], bootstrap_value[None]])
    deltas = rhos.clamp(max=clip_rho) * (rewards + discounts * next_values - values)
    reach = discounts * rhos.clamp(max=clip_c)
    corrections = torch.empty_like(values)
    beyond = torch.zeros_like(bootstrap_value)
    for t in range(len(values) - 1, -1, -1):
        beyond = torch.addcmul(deltas[t], reach[t], beyond)
        corrections[t] = beyond
    vs = values + corrections
    next_vs = torch.cat([vs[1:], bootstrap_value[None]])
    return VTrace(vs, rhos.clamp(max=clip_pg_rho) * (rewards + discounts * next_vs - values))
