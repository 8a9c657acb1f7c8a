"""Mixing a scorer's opinion into a policy: u and v of the slots, the coefficients λ, and the mixed logits."""

import torch
from torch import Tensor, nn

from wordcraft_kg.errors import ConfigError
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.tables import TABLE_LIMIT


class KnowledgeScores(nn.Module):
    """A scorer's u and v of every slot, from tables that never receive a gradient.

    ``u_i = L(e_i, combinesWith, e_s)``, 0 while nothing is selected, and ``v_i = L(e_i, componentOf, e_g)``; both are 0
    for an empty slot. The same values as ``KGScoreObservation`` gives for the same scorer.

    Attributes:
        sources: which of u and v, in this order.
        scores: buffer, shape (S, E + 1, E + 1): by source, by selection or goal, by the slot's entity.

    Source: Jiang et al. 2020, section "Link Prediction Model".
    """

    scores: Tensor
    _first: Tensor

    def __init__(self, num_entities: int, sources: tuple[str, ...], scorer: TripleScorer | None = None):
        """Ask a scorer once for all pairs; without one, the tables are zeros to be loaded.

        Raises:
            ConfigError: if the tables would not fit.
        """
        super().__init__()
        self.sources = sources
        size = num_entities + 1
        if len(sources) * size**2 * 4 > TABLE_LIMIT:
            raise ConfigError(
                f"the scores of all pairs of {num_entities:,} entities take {len(sources) * size**2 * 4 / 2**20:,.0f} "
                f"MiB; a policy looks scores up in tables of at most {TABLE_LIMIT / 2**20:.0f} MiB."
            )
        scores = torch.zeros(len(sources), size, size)
        if scorer is not None:
            for i, source in enumerate(sources):
                relation = COMBINES_WITH if source == "u" else COMPONENT_OF
                scores[i, :-1, :-1] = scorer.table(relation).detach().cpu().T
        self.register_buffer("scores", scores)
        self.register_buffer("_first", torch.arange(len(sources)) * size**2, persistent=False)
        self._size = size

    def forward(self, goal: Tensor, selection: Tensor, table: Tensor) -> Tensor:
        """Return the scores of each slot: goal and selection (B,), table (B, A) -> (B, S, A)."""
        keys = torch.stack([selection if source == "u" else goal for source in self.sources], dim=1)
        cells = (keys * self._size + self._first)[:, :, None] + table[:, None, :]
        return self.scores.view(-1).index_select(0, cells.reshape(-1)).view(cells.shape)


def mix_logits(logits: Tensor, lambdas: Tensor, slot_mask: Tensor) -> Tensor:
    """Blend the logits of several sources, slot by slot.

    ``β_i = Σ_s λ_s · source_s,i``; empty slots become -inf *after* mixing, so no choice of λ can revive them.

    Args:
        logits: shape (B, S, A). A channel for each active source, the attention's α first where it is active.
        lambdas: shape (B, S). A source that is switched off has no place in it, and takes no weight.
        slot_mask: shape (B, A), bool. True where the slot holds an entity.

    Returns:
        shape (B, A). Exactly -inf where ``slot_mask`` is False.

    Source: Jiang et al. 2020, appendix "Learning Mixing Coefficients"; differs by masking after mixing.
    """
    return torch.bmm(lambdas[:, None, :], logits)[:, 0].masked_fill(~slot_mask, -torch.inf)
