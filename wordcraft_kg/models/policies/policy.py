"""Policies as plain torch modules: ids of goal, selection and table in, logits of the slots and a value out."""

from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor, nn

from wordcraft_kg.models.policies.attention import EntityVectors
from wordcraft_kg.models.policies.config import PolicyConfig

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
        from wordcraft_kg.models.policies.folder import load_policy

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


def log_policy(logits: Tensor) -> Tensor:
    """Return the log-probabilities of masked logits (B, A), slots first: shape (A, B); -inf where a slot is empty."""
    return torch.log_softmax(logits.T.contiguous(), dim=0)
