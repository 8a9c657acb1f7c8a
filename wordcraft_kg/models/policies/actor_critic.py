"""The self-attention actor-critic, alone or guided by knowledge."""

from collections.abc import Iterable

import torch
from torch import Tensor, nn

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.models.policies.attention import EntityVectors, Slots, TableAttention, masked_softmax
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.models.policies.mixing import mix_logits
from wordcraft_kg.models.policies.policy import Policy, PolicyOutput, Weights
from wordcraft_kg.models.policies.sources.source import Source


class AttentionPolicy(Policy):
    """Self-attention actor-critic, alone or guided by sources.

    ``α_i = Q([x_g; x_s]) · K(x_i) / √d``, ``V = MLP(wᵀ x)`` with ``w = softmax(α)`` over the slots (or the raw α),
    and with sources ``β = λα·α + Σ_s λ_s·source_s``, ``λ = MLP(wᵀ x)`` with its own weights. An MLP here is the
    linear map W of the paper, a rectifier and a linear map; W, with a bias, is applied to the sum.

    Permuting the slots permutes the logits and leaves the value as it is.

    Source: Jiang et al. 2020, sections "Self-attention Actor-Critic Network" and "Learning Mixing Coefficients".
    """

    def __init__(self, config: PolicyConfig, vectors: EntityVectors, sources: Iterable[Source] = ()):
        """Take entity vectors and any sources of knowledge."""
        super().__init__(config, vectors, sources)
        if config.kg_only and not self.sources:
            raise ConfigError("`kg_only` mixes a scorer's scores and nothing else; give a `scorer` too.")
        self.attention = TableAttention(vectors.dim, config.key_size)
        self.value = _head(vectors.dim, config.value_size, 1)
        if self.sources:
            self.mixture = _head(vectors.dim, config.value_size, len(self.labels))
            last = self.mixture[2]
            assert isinstance(last, nn.Linear)
            if config.mixing == "free":  # all sources start with about the same weight
                nn.init.ones_(last.bias)

    def weights(self) -> Weights:  # noqa: D102 - inherited
        mixture = _head_weights("mixture", self.mixture) if self.sources else {}
        return {**self.vectors.weights(), **_head_weights("value", self.value), **mixture, **self.attention.weights()}

    def forward(  # noqa: D102 - inherited
        self,
        goal: Tensor,
        selection: Tensor,
        table: Tensor,
        weights: Weights | None = None,
        task: Tensor | None = None,
        opinions: Tensor | None = None,
    ) -> PolicyOutput:
        weights = weights or self.weights()
        mask = table != self.num_entities
        slots = Slots(weights.get("vectors"), table)
        alpha = slots.dot(self.attention.rows(weights, goal, selection))
        is_softmax = self.config.value_readout == "softmax"
        state = slots.sum(masked_softmax(alpha, mask) if is_softmax else alpha.masked_fill(~mask, 0), self.num_entities)
        value = _mlp(state, weights, "value")[:, 0]
        opinions = self.opinions(goal, selection, table, task) if opinions is None else opinions
        if opinions is None:
            return PolicyOutput(alpha.masked_fill(~mask, -torch.inf), value)
        sources = opinions if self.config.kg_only else torch.cat([alpha[:, None], opinions], dim=1)
        lambdas = _mlp(state, weights, "mixture")
        if self.config.mixing == "softmax":
            lambdas = torch.softmax(lambdas, dim=1)
        return PolicyOutput(mix_logits(sources, lambdas, mask), value, sources, lambdas)


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
