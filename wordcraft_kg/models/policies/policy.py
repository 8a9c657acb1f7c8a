"""Policies as plain torch modules: ids of goal, selection and table in, logits of the slots and a value out."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from wordcraft_kg.base.errors import UnknownEntityError
from wordcraft_kg.base.settings import nearest, refuse
from wordcraft_kg.graphs.recipe_graph import Entity
from wordcraft_kg.graphs.tasks import TaskSet
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


class Pick(NamedTuple):
    """A decision: the slot, the label of the entity there, and the probability of the slot among all."""

    slot: int
    entity: str
    probability: float


class EntityVectors(nn.Module):
    """The vectors x of entities: constant, learned or one-hot (never written out); that of nothing, the id E, is zero.

    Attributes:
        num_entities: E.
        dim: F, the length of a vector.
        is_one_hot: whether the vectors are the rows of the identity.
    """

    vectors: Tensor

    def __init__(self, num_entities: int, vectors: Tensor | None = None, *, learned_dim: int = 0):
        """Take constant vectors, shape (E, F); without them, learn vectors of ``learned_dim`` or use one-hot ones."""
        super().__init__()
        self.num_entities = num_entities
        self.is_one_hot = vectors is None and not learned_dim
        if vectors is not None:
            self.register_buffer("vectors", vectors.detach().to(torch.float32).clone())
        elif learned_dim:
            self.vectors = nn.Parameter(torch.randn(num_entities, learned_dim))
        else:
            self.register_buffer("vectors", torch.empty(0, 0))
        self.dim = num_entities if self.is_one_hot else self.vectors.shape[1]

    def weights(self) -> dict[str, Tensor]:
        """Return ``vectors`` of all entities and of nothing, shape (E + 1, F); without that key if they are one-hot."""
        return {} if self.is_one_hot else {"vectors": nn.functional.pad(self.vectors, (0, 0, 0, 1))}


def look_up(vectors: Tensor, ids: Tensor) -> Tensor:
    """Return the vectors of entities, ``ids`` of any shape: shape (*ids, F)."""
    return vectors.index_select(0, ids.reshape(-1)).view(*ids.shape, vectors.shape[1])


class Policy(nn.Module):
    """Base of all policies: ``policy(goal, selection, table)`` for a batch of ids, :meth:`act` for one state's labels.

    Ids are those of the environments: entities 0 to E - 1, and E for nothing.

    Attributes:
        config: its settings.
        num_entities: E.
        sources: sources of knowledge by name; see :mod:`wordcraft_kg.models.policies.sources`.
        labels: labels of the terms of the mixture, in order: ``alpha`` if it is mixed in, then the sources.
        entities: labels in id order, set like ``graph_hash`` when a policy is made or loaded.
        graph_hash: hash of the graph.
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

    def bind(self, tasks: TaskSet) -> None:
        """Take the tasks whose numbers are passed from now on; does nothing unless :attr:`reads_task`.

        Raises:
            LeakError: if a source would score one by a model that has been trained on its recipes.
            GraphMismatchError: if they are tasks of another graph or split.
        """
        for source in self.sources.values():
            source.bind(tasks)

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
        opinions: Tensor | None = None,
    ) -> PolicyOutput:
        """Return logits and value of states.

        Args:
            goal: shape (B,), int64: the entity to make.
            selection: shape (B,), int64: the entity held, E for nothing.
            table: shape (B, A), int64: the entities on the table, E for an empty slot. No row is empty.
            weights: result of :meth:`weights`; None computes it.
            task: shape (B,), int64: number of the task among those of :meth:`bind`, or their number for another task;
                None for tasks without train recipes, or if :attr:`reads_task` is False.
            opinions: result of :meth:`opinions`; None computes it.
        """
        raise NotImplementedError

    @torch.no_grad()
    def opinions(self, goal: Tensor, selection: Tensor, table: Tensor, task: Tensor | None = None) -> Tensor | None:
        """Return the scores of the sources, which no training changes, to compute them once for many calls.

        States are those of :meth:`forward`; the result has shape (B, S, A), or is None without sources.
        """
        if not self.sources:
            return None
        return torch.stack([source(goal, selection, table, task) for source in self.sources.values()], dim=1)

    @torch.no_grad()
    def act(
        self,
        goal: Entity,
        table: Sequence[Entity | None],
        selection: Entity | None = None,
        *,
        generator: torch.Generator | None = None,
    ) -> Pick:
        """Decide in one state, given by labels or ids.

        Args:
            goal: entity to make.
            table: entities on the table; None for an empty slot.
            selection: the entity held, None for nothing.
            generator: draws the slot by its probability, on the CPU; by default the first of the most probable slots.

        Raises:
            UnknownEntityError: with the nearest labels.
            ConfigError: if there is nothing on the table.
        """
        if all(entity is None for entity in table):
            raise refuse("table", list(table), "one entity or more")
        device = next(self.parameters()).device
        ids = [self.id_of(entity) for entity in (goal, selection, *table)]
        logits = self(*(torch.tensor(part, device=device) for part in (ids[:1], ids[1:2], [ids[2:]]))).logits
        probabilities = torch.softmax(logits[0], dim=0).cpu()
        slot = int(probabilities.argmax() if generator is None else probabilities.multinomial(1, generator=generator))
        return Pick(slot, self.entities[ids[2 + slot]], float(probabilities[slot]))

    def id_of(self, entity: Entity | None) -> int:
        """Return the id of an entity given by label or id; E for None, which is nothing.

        Raises:
            UnknownEntityError: with the nearest labels, or the range of ids.
        """
        if entity is None:
            return self.num_entities
        if isinstance(entity, str):
            if entity not in self.entities:
                raise UnknownEntityError(f"the policy knows no '{entity}'.{nearest(entity, self.entities)}")
            return self.entities.index(entity)
        if not 0 <= entity < self.num_entities:
            raise UnknownEntityError(f"the policy knows no id {entity}; ids are 0 .. {self.num_entities - 1}.")
        return int(entity)


def log_policy(logits: Tensor) -> Tensor:
    """Return the log-probabilities of masked logits (B, A), slots first: shape (A, B); -inf where a slot is empty."""
    return torch.log_softmax(logits.T.contiguous(), dim=0)
