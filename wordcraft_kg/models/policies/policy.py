"""Policies as plain torch modules: ids of goal, selection and table in, logits of the slots and a value out."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from wordcraft_kg.models.policies.attention import EntityVectors
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.models.policies.sources import ALPHA, Label
from wordcraft_kg.models.policies.sources.source import Source

Weights = dict[str, Tensor]
"""Tensors that depend on the parameters alone, by name."""


class PolicyOutput(NamedTuple):
    """The output of a policy for a batch of states.

    Attributes:
        logits: β, shape (B, A): unnormalised log-probabilities, -inf where a slot is empty.
        value: V, shape (B,): expected discounted return.
        sources: the terms of the mixture β, shape (B, S, A): α if it is mixed in, then each source; None without one.
        lambdas: λ of each term, shape (B, S); None without a mixture.
    """

    logits: Tensor
    value: Tensor
    sources: Tensor | None = None
    lambdas: Tensor | None = None


class Policy(nn.Module):
    """Base of all policies.

    A policy takes ids as the environments give them: entities 0 to E - 1, and E for nothing. It can be used without
    our trainer: just call ``policy(goal, selection, table)``.

    Attributes:
        config: its settings.
        num_entities: E.
        sources: sources of knowledge by name; see :mod:`wordcraft_kg.models.policies.sources`.
        labels: labels of the terms of the mixture, in order: ``alpha`` if it is mixed in, then the sources; empty
            without a mixture.
        entities: labels in id order; like ``graph_hash``, the hash of the graph, set when a policy is made or loaded.
        graph_hash: see ``entities``.
    """

    def __init__(self, config: PolicyConfig, vectors: EntityVectors, sources: Iterable[Source] = ()):
        """Store the settings, the entities' vectors and the sources."""
        super().__init__()
        self.entities: tuple[str, ...] = ()
        self.graph_hash = ""
        self.config = config
        self.vectors = vectors
        self.num_entities = vectors.num_entities
        modules = nn.ModuleDict({source.name: source for source in sources})
        self.sources = cast("Mapping[str, Source]", modules)
        own = (ALPHA,) if self.sources and not config.kg_only else ()
        self.labels: tuple[Label, ...] = (*own, *(source.label for source in self.sources.values()))

    @property
    def reads_task(self) -> bool:
        """Whether the scores of a source depend on the task, which should then be passed."""
        return any(source.reads_task for source in self.sources.values())

    def weights(self) -> Weights:
        """Return the tensors that depend on the parameters alone, to compute them once for many calls."""
        raise NotImplementedError

    def forward(
        self,
        goal: Tensor,
        selection: Tensor,
        table: Tensor,
        weights: Weights | None = None,
        task: Tensor | None = None,
    ) -> PolicyOutput:
        """Return logits and value of states.

        Args:
            goal: shape (B,), int64: the entity to make.
            selection: shape (B,), int64: the entity held, E for nothing.
            table: shape (B, A), int64: the entities on the table, E for an empty slot. No row is empty.
            weights: result of :meth:`weights`; None computes it.
            task: shape (B,), int64: number of the task among the train tasks; None for other tasks or if unknown.
        """
        raise NotImplementedError


def log_policy(logits: Tensor) -> Tensor:
    """Return the log-probabilities of masked logits (B, A), slots first: shape (A, B); -inf where a slot is empty."""
    return torch.log_softmax(logits.T.contiguous(), dim=0)
