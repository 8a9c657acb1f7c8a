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
"""What depends on the parameters alone, by name."""


class PolicyOutput(NamedTuple):
    """What a policy says about a batch of states.

    Attributes:
        logits: β, shape (B, A): unnormalised log-probabilities, -inf where a slot is empty.
        value: V, shape (B,): expected discounted return.
        sources: what β is mixed from, shape (B, S, A): α where it takes part, then each source; None without a mixture.
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
        sources: what knows something about slots, by name; see :mod:`wordcraft_kg.models.policies.sources`.
        labels: of what is mixed, in order: ``alpha`` where the attention takes part, then the sources; empty without.
        entities: labels in id order, and ``graph_hash`` the graph's hash; set where policies are made and loaded.
    """

    def __init__(self, config: PolicyConfig, vectors: EntityVectors, sources: Iterable[Source] = ()):
        """Keep the settings, the entities' vectors and the sources."""
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
        """Whether a source's scores depend on the task, so that it should be passed on."""
        return any(source.reads_task for source in self.sources.values())

    def weights(self) -> Weights:
        """Return what depends on the parameters alone, to be computed once for many calls."""
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
            table: shape (B, A), int64: the entities on the table, E for an empty slot. At least one is there.
            weights: what :meth:`weights` returned; None computes it.
            task: shape (B,), int64: number of the task among the train tasks; None if they are not or it is not known.
        """
        raise NotImplementedError


def log_policy(logits: Tensor) -> Tensor:
    """Return the log-probabilities of masked logits (B, A), slots first: shape (A, B); -inf where a slot is empty."""
    return torch.log_softmax(logits.T.contiguous(), dim=0)
