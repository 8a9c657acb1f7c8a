"""The formula that turns the logits of several sources into those of a policy."""

import torch
from torch import Tensor


def mix_logits(logits: Tensor, lambdas: Tensor, slot_mask: Tensor) -> Tensor:
    """Blend the logits of several sources, slot by slot.

    ``β_i = Σ_s λ_s · source_s,i``; empty slots become -inf *after* mixing, so no choice of λ can revive them.

    Args:
        logits: shape (B, S, A). One channel for each active source; the attention's α first if it is active.
        lambdas: shape (B, S). A source that is switched off has no entry.
        slot_mask: shape (B, A), bool. True where the slot holds an entity.

    Returns:
        shape (B, A). Exactly -inf where ``slot_mask`` is False.

    Source: Jiang et al. 2020, appendix "Learning Mixing Coefficients"; differs by masking after mixing.
    """
    return torch.bmm(lambdas[:, None, :], logits)[:, 0].masked_fill(~slot_mask, -torch.inf)
