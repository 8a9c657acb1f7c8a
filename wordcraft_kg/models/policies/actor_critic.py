"""The self-attention actor-critic, alone or guided by knowledge."""

import torch
from torch import Tensor, nn

from wordcraft_kg.errors import ConfigError
from wordcraft_kg.models.policies.attention import EntityVectors, Slots, TableAttention, masked_softmax
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.models.policies.mixing import KnowledgeScores, mix_logits
from wordcraft_kg.models.policies.policy import Policy, PolicyOutput, Weights


class AttentionPolicy(Policy):
    """Self-attention actor-critic, alone or guided by a scorer.

    ``α_i = Q([x_g; x_s]) · K(x_i) / √d``, ``V = MLP(wᵀ x)`` with ``w = softmax(α)`` over the slots (or the raw α),
    and with a scorer ``β = λα·α + λu·u + λv·v``, ``λ = MLP(wᵀ x)`` with weights of its own. An MLP here is the
    linear map W of the paper, a rectifier and a linear map; W, with a bias, is applied to the sum.

    Permuting the slots permutes the logits and leaves the value as it is.

    Source: Jiang et al. 2020, sections "Self-attention Actor-Critic Network" and "Learning Mixing Coefficients".
    """

    def __init__(self, config: PolicyConfig, vectors: EntityVectors, knowledge: KnowledgeScores | None = None):
        """Take entity vectors, and what the scorer says if there is one."""
        super().__init__(config, vectors)
        if config.kg_only and knowledge is None:
            raise ConfigError("--kg-only mixes a scorer's scores and nothing else; give a --scorer too.")
        self.attention = TableAttention(vectors.dim, config.key_size)
        self.value = nn.Sequential(
            nn.Linear(vectors.dim, config.value_size), nn.ReLU(), nn.Linear(config.value_size, 1)
        )
        self.knowledge = knowledge
        if knowledge is not None:
            self.source_names = (*(() if config.kg_only else ("alpha",)), *knowledge.sources)
            self.mixture = _head(vectors.dim, config.value_size, len(self.source_names))
            last = self.mixture[2]
            assert isinstance(last, nn.Linear)
            if config.mixing == "free":  # all sources begin with about the same say
                nn.init.ones_(last.bias)

    def weights(self) -> Weights:  # noqa: D102 - inherited
        heads = [self.value, self.mixture] if self.knowledge is not None else [self.value]
        linear = [layer for head in heads for layer in (head[0], head[2])]
        return (
            self.vectors(),
            *(tensor for layer in linear for tensor in (layer.weight.T, layer.bias)),
            *self.attention.weights(),
        )

    def forward(  # noqa: D102 - inherited
        self, goal: Tensor, selection: Tensor, table: Tensor, weights: Weights | None = None
    ) -> PolicyOutput:
        vectors, *layers = weights or self.weights()
        of_value, layers = layers[:4], layers[4:]
        mask = table != self.num_entities
        slots = Slots(vectors, table)
        if self.knowledge is not None:
            of_mixture, layers = layers[:4], layers[4:]
        alpha = slots.dot(self.attention.rows(tuple(layers), vectors, goal, selection))
        is_softmax = self.config.value_readout == "softmax"
        state = slots.sum(masked_softmax(alpha, mask) if is_softmax else alpha.masked_fill(~mask, 0), self.num_entities)
        value = _mlp(state, of_value)[:, 0]
        if self.knowledge is None:
            return PolicyOutput(alpha.masked_fill(~mask, -torch.inf), value)
        sources = self.knowledge(goal, selection, table)
        if not self.config.kg_only:
            sources = torch.cat([alpha[:, None, :], sources], dim=1)
        lambdas = _mlp(state, of_mixture)
        if self.config.mixing == "softmax":
            lambdas = torch.softmax(lambdas, dim=1)
        return PolicyOutput(mix_logits(sources, lambdas, mask), value, sources, lambdas)


def _head(dim: int, size: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(dim, size), nn.ReLU(), nn.Linear(size, outputs))


def _mlp(state: Tensor, layers: list[Tensor]) -> Tensor:
    first, first_bias, second, second_bias = layers
    return torch.addmm(second_bias, torch.relu(torch.addmm(first_bias, state, first)), second)
