"""Policies as torch modules: from goal, selection and table ids to slot logits and a state value."""

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
"""Tensors derived from parameters only, by name."""


class PolicyOutput(NamedTuple):
    """Policy output for a batch of states.

    Attributes:
        logits: β, shape (B, A): unnormalised log-probabilities, -inf for empty slots.
        value: V, shape (B,): expected discounted return.
        sources: mixture terms, shape (B, S, A): α if mixed in, then external scores; None without mixture.
        lambdas: λ by term, shape (B, S); None without mixture.
    """

    logits: Tensor
    value: Tensor
    sources: Tensor | None = None
    lambdas: Tensor | None = None


class Action(NamedTuple):
    """The choice of a slot, with the label of the entity there and the slot's probability."""

    slot: int
    entity: str
    probability: float


class EntityVectors(nn.Module):
    """Entity vectors x: constant, learned or one-hot (implicit); id E (empty) has the zero vector.

    Attributes:
        num_entities: E.
        dim: F, the vector length.
        is_one_hot: vectors are unit vectors.
    """

    vectors: Tensor

    def __init__(self, num_entities: int, vectors: Tensor | None = None, *, learned_dim: int = 0):
        """Use constant vectors, shape (E, F), else learned vectors of ``learned_dim``, else one-hot vectors."""
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
        """Return ``vectors`` by id, shape (E + 1, F); an empty mapping for one-hot vectors."""
        return {} if self.is_one_hot else {"vectors": nn.functional.pad(self.vectors, (0, 0, 0, 1))}


def look_up(vectors: Tensor, ids: Tensor) -> Tensor:
    """Return vectors for ids with any shape: shape (*ids, F)."""
    return vectors.index_select(0, ids.reshape(-1)).view(*ids.shape, vectors.shape[1])


class Policy(nn.Module):
    """Base class: ``policy(goal, selection, table)`` for id batches, :meth:`act` for a single state in labels.

    Ids equal environment ids: entities 0 to E - 1, and E for an empty slot or no selection.

    Attributes:
        config: settings.
        num_entities: E.
        sources: knowledge sources by name; see :mod:`wordcraft_kg.models.policies.sources`.
        labels: names of the mixture terms, in order: ``alpha`` if mixed in, then the sources.
        entities: labels in id order; set, like ``graph_hash``, on making or loading.
        graph_hash: the graph's content hash.
    """

    def __init__(self, config: PolicyConfig, vectors: EntityVectors, sources: Iterable[Source] = ()):
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
        """Some source's scores depend on the task number."""
        return any(source.reads_task for source in self.sources.values())

    def bind(self, tasks: TaskSet) -> None:
        """Set the tasks to which later task numbers refer; no effect unless :attr:`reads_task`."""
        for source in self.sources.values():
            source.bind(tasks)

    def weights(self) -> Weights:
        """Return tensors derived from parameters only, for reuse in many calls."""
        raise NotImplementedError

    def forward(
        self,
        goal: Tensor,
        selection: Tensor,
        table: Tensor,
        weights: Weights | None = None,
        task: Tensor | None = None,
        external_scores: Tensor | None = None,
    ) -> PolicyOutput:
        """Return logits and values for a batch of states.

        Args:
            goal: shape (B,), int64: entity to make.
            selection: shape (B,), int64: selected entity, E without selection.
            table: shape (B, A), int64: entities on the table, E for empty slots. Each row has an entity.
            weights: result of :meth:`weights`; computed by default.
            task: shape (B,), int64: index into the tasks given to :meth:`bind`, or the number of tasks for unlisted
                tasks; None for tasks without train recipes, or if :attr:`reads_task` is False.
            external_scores: result of :meth:`external_scores`; computed by default.
        """
        raise NotImplementedError

    @torch.no_grad()
    def external_scores(
        self, goal: Tensor, selection: Tensor, table: Tensor, task: Tensor | None = None
    ) -> Tensor | None:
        """Return the sources' constant scores, shape (B, S, A), for reuse; None without sources."""
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
    ) -> Action:
        """Choose a slot in a single state, given as labels or ids.

        Args:
            goal: entity to make.
            table: entities on the table; None for empty slots.
            selection: selected entity, None without selection.
            generator: CPU generator that samples a slot; by default the first most probable slot.

        Raises:
            UnknownEntityError: with the nearest labels.
            ConfigError: if the table is empty.
        """
        if all(entity is None for entity in table):
            raise refuse("table", list(table), "at least an entity")
        device = next(self.parameters()).device
        ids = [self.id_of(entity) for entity in (goal, selection, *table)]
        logits = self(*(torch.tensor(part, device=device) for part in (ids[:1], ids[1:2], [ids[2:]]))).logits
        probabilities = torch.softmax(logits[0], dim=0).cpu()
        slot = int(probabilities.argmax() if generator is None else probabilities.multinomial(1, generator=generator))
        return Action(slot, self.entities[ids[2 + slot]], float(probabilities[slot]))

    def id_of(self, entity: Entity | None) -> int:
        """Return an entity's id, or E for None. UnknownEntityError names the nearest labels."""
        if entity is None:
            return self.num_entities
        if isinstance(entity, str):
            if entity not in self.entities:
                raise UnknownEntityError(f"the policy has no entity '{entity}'.{nearest(entity, self.entities)}")
            return self.entities.index(entity)
        if not 0 <= entity < self.num_entities:
            raise UnknownEntityError(f"the policy has no entity {entity}; expected 0 .. {self.num_entities - 1}.")
        return int(entity)


def log_policy(logits: Tensor) -> Tensor:
    """Return log-probabilities for masked logits (B, A), slots first: shape (A, B); -inf for empty slots."""
    return torch.log_softmax(logits.T.contiguous(), dim=0)
