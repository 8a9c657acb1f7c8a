"""Policies as plain torch modules: ids of goal, selection and table in, logits of the slots and a value out."""

from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor, nn

from wordcraft_kg.errors import ConfigError
from wordcraft_kg.models.attention import EntityVectors, Slots, TableAttention, look_up, masked_softmax
from wordcraft_kg.models.mixing import KnowledgeScores, mix_logits
from wordcraft_kg.models.policy_config import PolicyConfig

Weights = tuple[Tensor, ...]


class PolicyOutput(NamedTuple):
    """What a policy says about a batch of states.

    Attributes:
        logits: β, shape (B, A): unnormalised log-probabilities, -inf where a slot is empty.
        value: V, shape (B,): expected discounted return.
        sources: what β is mixed from, shape (B, S, A): α where it takes part, then u and v; None without a mixture.
        lambdas: λ of each source, shape (B, S); None without a mixture.
    """

    logits: Tensor
    value: Tensor
    sources: Tensor | None = None
    lambdas: Tensor | None = None


class Policy(nn.Module):
    """What all policies have in common.

    A policy takes ids as the environments give them: entities 0 to E - 1, and E for nothing. It can be used without
    our trainer; ``policy(goal, selection, table)`` is all there is to it.

    Attributes:
        config: its settings.
        num_entities: E.
        source_names: names of the mixed sources in order: ``alpha``, ``u``, ``v``; empty without a mixture.
    """

    def __init__(self, config: PolicyConfig, vectors: EntityVectors):
        """Keep the settings and the entities' vectors."""
        super().__init__()
        self.config = config
        self.vectors = vectors
        self.num_entities = vectors.num_entities
        self.source_names: tuple[str, ...] = ()

    @classmethod
    def from_pretrained(cls, folder: str | Path) -> "Policy":
        """Load the policy of a run folder, which is all it needs.

        Raises:
            ArtefactError: if the run is unfinished, or a file in it is missing or damaged.
        """
        from wordcraft_kg.models.policy_folder import load_policy

        return load_policy(folder)[0]

    def weights(self) -> Weights:
        """Return what depends on the parameters alone, to be computed once for many calls."""
        raise NotImplementedError

    def forward(self, goal: Tensor, selection: Tensor, table: Tensor, weights: Weights | None = None) -> PolicyOutput:
        """Return logits and value of states.

        Args:
            goal: shape (B,), int64: the entity to make.
            selection: shape (B,), int64: the entity held, E for nothing.
            table: shape (B, A), int64: the entities on the table, E for an empty slot. At least one is there.
            weights: what :meth:`weights` returned; None computes it.
        """
        raise NotImplementedError


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


class MLPPolicy(Policy):
    """The paper's simple baseline: one hidden layer on the vectors of goal, selection and all slots in their order.

    It is made for tables of one size, and permuting the slots changes what it does.

    Source: Jiang et al. 2020, appendix "Extended Discussion".
    """

    def __init__(self, config: PolicyConfig, vectors: EntityVectors, num_slots: int):
        """Take entity vectors and the number of slots."""
        super().__init__(config, vectors)
        self.num_slots = num_slots
        self.hidden = nn.Linear((2 + num_slots) * vectors.dim, config.hidden_size)
        self.logits = nn.Linear(config.hidden_size, num_slots)
        self.value = nn.Linear(config.hidden_size, 1)

    def weights(self) -> Weights:  # noqa: D102 - inherited
        layers = (self.hidden, self.logits, self.value)
        return (self.vectors(), *(tensor for layer in layers for tensor in (layer.weight.T, layer.bias)))

    def forward(  # noqa: D102 - inherited
        self, goal: Tensor, selection: Tensor, table: Tensor, weights: Weights | None = None
    ) -> PolicyOutput:
        if table.shape[1] != self.num_slots:
            raise ConfigError(
                f"tables of {table.shape[1]} slots: this mlp was made for {self.num_slots}. Only the attention policy "
                "takes tables of any size; play with the number of distractors that it was trained with."
            )
        vectors, hidden, hidden_bias, head, head_bias, value, value_bias = weights or self.weights()
        ids = torch.cat([goal[:, None], selection[:, None], table], dim=1)
        if len(vectors):
            inner = torch.addmm(hidden_bias, look_up(vectors, ids).flatten(1), hidden)
        else:
            by_place = nn.functional.pad(hidden.view(ids.shape[1], self.num_entities, -1), (0, 0, 0, 1)).flatten(0, 1)
            places = torch.arange(ids.shape[1], device=ids.device) * (self.num_entities + 1)
            inner = hidden_bias + look_up(by_place, ids + places).sum(1)
        inner = torch.relu(inner)
        logits = torch.addmm(head_bias, inner, head).masked_fill(table == self.num_entities, -torch.inf)
        return PolicyOutput(logits, torch.addmm(value_bias, inner, value)[:, 0])


def _head(dim: int, size: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(dim, size), nn.ReLU(), nn.Linear(size, outputs))


def _mlp(state: Tensor, layers: list[Tensor]) -> Tensor:
    first, first_bias, second, second_bias = layers
    return torch.addmm(second_bias, torch.relu(torch.addmm(first_bias, state, first)), second)
