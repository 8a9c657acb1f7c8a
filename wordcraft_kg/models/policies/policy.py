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
from wordcraft_kg.models.policies.sources.source import Attempts, Source, ask

Weights = dict[str, Tensor]
"""Tensors derived from parameters only, by name."""


class PolicyOutput(NamedTuple):
    """A policy's output for a batch with B states, A slots and S mixed scores per slot.

    Attributes:
        logits: β, shape (B, A): unnormalised log-probabilities, -inf for empty slots.
        value: V, shape (B,): expected discounted return.
        sources: mixed scores, shape (B, S, A): attention logits α if in use, then the knowledge sources' scores; None
            without sources.
        lambdas: mixing weights λ, shape (B, S); None without sources.
    """

    logits: Tensor
    value: Tensor
    sources: Tensor | None = None
    lambdas: Tensor | None = None


class Action(NamedTuple):
    """The choice of a table slot: the entity's label and the slot's probability."""

    slot: int
    entity: str
    probability: float


class EntityVectors(nn.Module):
    """Entity vectors x, of length ``dim``: constant, learned or one-hot; the id E (empty slot) has zeros."""

    vectors: Tensor

    def __init__(self, num_entities: int, vectors: Tensor | None = None, *, learned_dim: int = 0):
        """Use ``vectors``, constant, (E, F); else learned vectors with ``learned_dim`` > 0; else one-hot."""
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
        """Return all vectors as ``vectors``, shape (E + 1, F); an empty mapping for one-hot vectors."""
        return {} if self.is_one_hot else {"vectors": nn.functional.pad(self.vectors, (0, 0, 0, 1))}


def look_up(vectors: Tensor, ids: Tensor) -> Tensor:
    """Return the vectors for ids with any shape: shape (*ids, F) from vectors (E + 1, F)."""
    return vectors.index_select(0, ids.reshape(-1)).view(*ids.shape, vectors.shape[1])


class Policy(nn.Module):
    """Base class of policies: ``policy(goal, selection, table)`` for batches of ids, :meth:`act` for one state.

    Ids equal environment ids: entities 0 to E - 1, and E for an empty slot or no selection.

    Attributes:
        config: settings.
        num_entities: E, the number of entities.
        sources: knowledge sources by name; see :mod:`wordcraft_kg.models.policies.sources`.
        labels: names of the mixed scores, in order: ``alpha`` (attention) if in use, then the sources.
        entities: entity labels in id order; like ``graph_hash``, set by ``make_policy`` and ``load_policy``.
        graph_hash: content hash of the recipe graph.
    """

    def __init__(
        self, config: PolicyConfig, vectors: EntityVectors, sources: Iterable[Source] = ()
    ):
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
        """Whether a source's scores depend on the task, so that :meth:`forward` needs task numbers."""
        return any(source.reads_task for source in self.sources.values())

    def bind(self, tasks: TaskSet) -> None:
        """Set the task set that task numbers in later calls index; no effect unless :attr:`reads_task`."""
        for source in self.sources.values():
            source.bind(tasks)

    def weights(self) -> Weights:
        """Return tensors computed from parameters only, which several :meth:`forward` calls can share."""
        raise NotImplementedError

    def forward(
        self,
        goal: Tensor,
        selection: Tensor,
        table: Tensor,
        weights: Weights | None = None,
        task: Tensor | None = None,
        external_scores: Tensor | None = None,
        attempts: Attempts | None = None,
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
            attempts: attempts left, for sources that look ahead; unused with ``external_scores``.
        """
        if external_scores is None:
            external_scores = self.external_scores(goal, selection, table, task, attempts)
        return self.output(goal, selection, table, weights or self.weights(), external_scores)

    def output(
        self,
        goal: Tensor,
        selection: Tensor,
        table: Tensor,
        weights: Weights,
        external_scores: Tensor | None,
    ) -> PolicyOutput:
        """Return what :meth:`forward` does, given weights and, with sources, their scores."""
        raise NotImplementedError

    @torch.no_grad()
    def external_scores(
        self,
        goal: Tensor,
        selection: Tensor,
        table: Tensor,
        task: Tensor | None = None,
        attempts: Attempts | None = None,
    ) -> Tensor | None:
        """Return the knowledge sources' scores, (B, S, A), for reuse in :meth:`forward`; None without sources."""
        if not self.sources:
            return None
        state = goal, selection, table, task
        return torch.stack(
            [ask(source, *state, attempts) for source in self.sources.values()], dim=1
        )

    @torch.no_grad()
    def act(
        self,
        goal: Entity,
        table: Sequence[Entity | None],
        selection: Entity | None = None,
        *,
        attempts_left: int = 1,
        generator: torch.Generator | None = None,
    ) -> Action:
        """Choose a slot in a single state; entities are labels or ids.

        Empty slots in ``table``, and ``selection`` without a selected entity, are None. ``generator``, on the CPU,
        samples the slot; by default the first most probable slot is chosen. Sources that look ahead use
        ``attempts_left``. UnknownEntityError with the nearest labels, ConfigError if the table is empty.
        """
        if all(entity is None for entity in table):
            raise refuse("table", list(table), "at least an entity")
        device = next(self.parameters()).device
        ids = [self.id_of(entity) for entity in (goal, selection, *table)]
        state = [torch.tensor(part, device=device) for part in (ids[:1], ids[1:2], [ids[2:]])]
        logits = self(
            *state, attempts=Attempts(torch.tensor([attempts_left], device=device))
        ).logits
        probabilities = torch.softmax(logits[0], dim=0).cpu()
        slot = int(
            probabilities.argmax()
            if generator is None
            else probabilities.multinomial(1, generator=generator)
        )
        return Action(slot, self.entities[ids[2 + slot]], float(probabilities[slot]))

    def id_of(self, entity: Entity | None) -> int:
        """Return the id for a label or id (None: the id of nothing). UnknownEntityError names the nearest labels."""
        if entity is None:
            return self.num_entities
        if isinstance(entity, str):
            if entity not in self.entities:
                raise UnknownEntityError(
                    f"the policy has no entity '{entity}'.{nearest(entity, self.entities)}"
                )
            return self.entities.index(entity)
        if not 0 <= entity < self.num_entities:
            raise UnknownEntityError(
                f"the policy has no entity {entity}; expected 0 .. {self.num_entities - 1}."
            )
        return int(entity)


def log_policy(logits: Tensor) -> Tensor:
    """Convert logits (B, A) to log-probabilities, slots first: shape (A, B); -inf for empty slots."""
    return torch.log_softmax(logits.T.contiguous(), dim=0)
