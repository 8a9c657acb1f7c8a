"""The self-attention actor-critic, alone or with scores from knowledge sources.

Tables have few slots, so product shapes matter more than sizes: ``index_select`` fetches vectors, a row's slots are
columns in a single small product, and softmax runs along the first axis.
"""

import math
from collections.abc import Iterable, Mapping
from typing import cast

import torch
from torch import Tensor, nn

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.models.policies.policy import (
    EntityVectors,
    Policy,
    PolicyOutput,
    Weights,
    look_up,
)
from wordcraft_kg.models.policies.sources.source import Source

FOLD_LIMIT = 300
"""Dimensions up to which query and key weights are multiplied once per update."""
AHEAD = 10.0
"""First λ of sources that look ahead. With 1 or 5, agents explore so much at first that they forget their planner."""


class AttentionPolicy(Policy):
    """Self-attention actor-critic, alone or guided by knowledge sources; permuting slots permutes logits.

    With vectors x for goal g, selection s and slot i, ``α_i = Q([x_g; x_s]) · K(x_i) / √d``, ``V = MLP(wᵀ x)`` with ``w
    = softmax(α)`` over the slots (or the raw α), and with sources ``β = λα·α + Σ_s λ_s·source_s``, ``λ = MLP(wᵀ x)``
    with separate weights. Logits are β, or α without sources. An MLP is a linear map W with bias, a rectifier and a
    linear map; W is applied after the sum over slots.

    Source: Jiang et al. 2020, sections "Self-attention Actor-Critic Network" and "Learning Mixing Coefficients".
    """

    def __init__(
        self, config: PolicyConfig, vectors: EntityVectors, sources: Iterable[Source] = ()
    ):
        super().__init__(config, vectors, sources)
        if config.kg_only and not self.sources:
            raise ConfigError("`kg_only` mixes only scorer scores; give a `scorer` too.")
        self.attention = TableAttention(vectors.dim, config.key_size)
        self.value = _head(vectors.dim, config.value_size, 1)
        if self.sources:
            self.mixture = _head(vectors.dim, config.value_size, len(self.labels))
            last = self.mixture[2]
            assert isinstance(last, nn.Linear)
            ahead = [source.label for source in self.sources.values() if source.reads_attempts]
            if (
                config.mixing == "free" and ahead
            ):  # start as the planner: other sources value one pair only
                nn.init.zeros_(last.weight)
                with torch.no_grad():
                    last.bias.copy_(
                        torch.tensor([AHEAD * (label in ahead) for label in self.labels])
                    )
            elif config.mixing == "free":  # all sources start with about the same weight
                nn.init.ones_(last.bias)

    def weights(self) -> Weights:  # noqa: D102 - inherited
        mixture = _head_weights("mixture", self.mixture) if self.sources else {}
        return {
            **self.vectors.weights(),
            **_head_weights("value", self.value),
            **mixture,
            **self.attention.weights(),
        }

    def output(  # noqa: D102 - inherited
        self,
        goal: Tensor,
        selection: Tensor,
        table: Tensor,
        weights: Weights,
        external_scores: Tensor | None,
    ) -> PolicyOutput:
        mask = table != self.num_entities
        slots = Slots(weights.get("vectors"), table)
        alpha = slots.dot(self.attention.rows(weights, goal, selection))
        is_softmax = self.config.value_readout == "softmax"
        state = slots.sum(
            masked_softmax(alpha, mask) if is_softmax else alpha.masked_fill(~mask, 0),
            self.num_entities,
        )
        value = _mlp(state, weights, "value")[:, 0]
        if external_scores is None:
            return PolicyOutput(alpha.masked_fill(~mask, -torch.inf), value)
        sources = (
            external_scores
            if self.config.kg_only
            else torch.cat([alpha[:, None], external_scores], dim=1)
        )
        lambdas = _mlp(state, weights, "mixture")
        if self.config.mixing == "softmax":
            lambdas = torch.softmax(lambdas, dim=1)
        return PolicyOutput(mix_logits(sources, lambdas, mask), value, sources, lambdas)


def mix_logits(logits: Tensor, lambdas: Tensor, slot_mask: Tensor) -> Tensor:
    """Mix the sources' scores into a logit for each slot: ``β_i = Σ_s λ_s · source_s,i``.

    ``logits`` are scores, shape (B, S, A), with a channel for each source in use; attention logits α first if in use.
    ``lambdas`` are mixing weights, shape (B, S), and ``slot_mask``, shape (B, A), is True for occupied slots. Empty
    slots become -inf *after* mixing, so no λ can revive empty slots.

    Source: Jiang et al. 2020, appendix "Learning Mixing Coefficients"; differs by masking after mixing.
    """
    return torch.bmm(lambdas[:, None, :], logits)[:, 0].masked_fill(~slot_mask, -torch.inf)


def masked_softmax(logits: Tensor, mask: Tensor) -> Tensor:
    """Return the softmax over slots where ``mask`` is True, shape (B, A); exactly 0 elsewhere."""
    return torch.softmax(logits.masked_fill(~mask, -torch.inf).T.contiguous(), dim=0).T


class TableAttention(nn.Module):
    """Scaled dot-product attention from goal g and selection s to each slot: ``α_i = Q([x_g; x_s]) · K(x_i) / √d``.

    As ``q · K x = (Kᵀ q) · x``, and vectors do not depend on the sample, keys are folded into the query. K has no bias,
    which would shift all slots equally.

    Source: Jiang et al. 2020, section "Self-attention Actor-Critic Network". The paper's query also has the second
    selection, which is always empty when an action is chosen.
    """

    def __init__(self, dim: int, key_size: int):
        super().__init__()
        self.query = nn.Linear(2 * dim, key_size)
        self.key = nn.Linear(dim, key_size, bias=False)

    def weights(self) -> dict[str, Tensor]:
        """Return the tensors for :meth:`rows`: ``query``, ``query.bias`` and, unless folded into the query, ``key``."""
        key = self.key.weight / math.sqrt(self.key.out_features)
        query, bias = self.query.weight.T, cast("Tensor", self.query.bias)
        if self.key.in_features <= FOLD_LIMIT:
            return {"query": query @ key, "query.bias": bias @ key}
        return {"query": query, "query.bias": bias, "key": key}

    @staticmethod
    def rows(weights: Mapping[str, Tensor], goal: Tensor, selection: Tensor) -> Tensor:
        """Return ``Kᵀ q / √d``, shape (B, F); the dot product with a slot's entity vector is the slot's α."""
        query, bias, vectors = weights["query"], weights["query.bias"], weights.get("vectors")
        if vectors is not None:
            both = look_up(vectors, torch.stack([goal, selection], dim=1)).flatten(1)
            projected = torch.addmm(bias, both, query)
        else:
            by_goal, by_selection = nn.functional.pad(
                query.view(2, -1, query.shape[1]), (0, 0, 0, 1)
            )
            projected = (
                bias + by_goal.index_select(0, goal) + by_selection.index_select(0, selection)
            )
        return projected @ weights["key"] if "key" in weights else projected


class Slots:
    """Entity vectors at B tables of A ids, from ``vectors`` for all ids (E + 1, F), or one-hot vectors if None."""

    def __init__(self, vectors: Tensor | None, table: Tensor):
        self.table = table
        self.vectors = None if vectors is None else look_up(vectors, table)

    def dot(self, rows: Tensor) -> Tensor:
        """Return each slot's dot product ``r · x_i`` with the row r for its table: rows (B, F) -> (B, A)."""
        if self.vectors is not None:
            return torch.bmm(rows[:, None, :], self.vectors.transpose(1, 2))[:, 0]
        return nn.functional.pad(rows, (0, 1)).gather(1, self.table)

    def sum(self, weights: Tensor, num_entities: int) -> Tensor:
        """Return each table's weighted sum of entity vectors, ``Σ_i w_i x_i``: weights (B, A) -> (B, F)."""
        if self.vectors is not None:
            return torch.bmm(weights[:, None, :].contiguous(), self.vectors)[:, 0]
        sums = weights.new_zeros(len(weights), num_entities + 1)
        return sums.scatter_add(1, self.table, weights)[:, :-1]


def _head(dim: int, size: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(dim, size), nn.ReLU(), nn.Linear(size, outputs))


def _head_weights(name: str, head: nn.Sequential) -> Weights:
    first, _, second = head
    assert isinstance(first, nn.Linear)
    assert isinstance(second, nn.Linear)
    return {
        f"{name}.first": first.weight.T,
        f"{name}.first.bias": first.bias,
        f"{name}.second": second.weight.T,
        f"{name}.second.bias": second.bias,
    }


def _mlp(state: Tensor, weights: Weights, name: str) -> Tensor:
    hidden = torch.relu(torch.addmm(weights[f"{name}.first.bias"], state, weights[f"{name}.first"]))
    return torch.addmm(weights[f"{name}.second.bias"], hidden, weights[f"{name}.second"])
