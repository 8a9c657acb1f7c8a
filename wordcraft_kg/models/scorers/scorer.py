"""The base class for scorers: labels, ids and rankings; a new scorer implements ``_score``.

Each scorer follows the interface :class:`~wordcraft_kg.models.scorers.protocol.TripleScorer`.

The page docs/link-prediction.md has an example under *Custom scorers and PyKEEN models*.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.base import UnknownEntityError, nearest
from wordcraft_kg.graphs.triples import RELATIONS

EntityIds = int | str | Sequence[int] | Sequence[str] | np.ndarray | Tensor
"""Entities by id or label: one, a sequence, or an array or tensor of ids of any shape."""
RelationIds = int | str | Tensor
"""Relations by id or label, or a tensor of ids."""


class Scorer(ABC):
    """Base class for scorers of triples; it converts labels to ids and checks their range.

    Attributes:
        entities: labels in id order.
        graph_hash: content hash of the recipe graph that the ids belong to.
        device: torch device on which scores are computed and returned.
        name: the scorer's name in reports and errors.
    """

    def __init__(
        self,
        entities: Sequence[str],
        graph_hash: str,
        device: str | torch.device = "cpu",
        name: str = "",
    ):
        """Store the vocabulary; a subclass stores the data that it scores with.

        Args:
            entities: labels in id order.
            graph_hash: content hash of the recipe graph that the ids belong to.
            device: torch device for computation and results.
            name: name in reports and errors; empty for the name of the class.
        """
        self.entities = tuple(entities)
        self.graph_hash = graph_hash
        self.device = torch.device(device)
        self.name = name or type(self).__name__
        self._index = {label: i for i, label in enumerate(self.entities)}

    @abstractmethod
    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        """Score broadcastable int64 ids within range; return float32 of the broadcast shape."""

    def score(self, heads: EntityIds, relations: RelationIds, tails: EntityIds) -> Tensor:
        """Score triples by ids or labels; a higher score means more plausible, on any scale.

        Args:
            heads: one entity, a sequence, or an array or tensor of ids of any shape.
            relations: one relation, or a tensor of ids.
            tails: as ``heads``; the three arguments broadcast against each other.

        Returns:
            float32 scores with the broadcast shape, on :attr:`device`.

        Raises:
            UnknownEntityError: for a label or id that the scorer does not know.
        """
        return self._score(
            self.entity_ids(heads),
            self.relation_ids(relations),
            self.entity_ids(tails),
        )

    def table(self, relation: int | str) -> Tensor:
        """Return scores of all pairs in a relation, (E, E), row = head; 1.5 GiB for E = 20,000.

        Raises:
            UnknownEntityError: for an unknown relation.
        """
        # A column of heads and a row of tails broadcast to all pairs.
        everything = torch.arange(len(self.entities), device=self.device)
        return self._score(everything[:, None], self.relation_ids(relation), everything[None, :])

    def entity_ids(self, entities: EntityIds) -> Tensor:
        """Convert labels or ids to int64 ids on the device, with the shape of the argument.

        Raises:
            UnknownEntityError: for an unknown label (the error names the nearest labels), an id out
                of range, or numbers that are not integers.
        """
        if not isinstance(entities, torch.Tensor):
            values = np.asarray(entities)
            if values.dtype.kind == "U":
                values = self._ids_of_labels(values)
            # NumPy makes an empty list an array of floats, which are refused below.
            entities = torch.tensor(values if values.size else values.astype(np.int64))
        if entities.is_floating_point() or entities.is_complex():
            raise UnknownEntityError(
                f"expected entities as labels or integer ids; found {entities.dtype}."
            )
        ids = entities.to(self.device, torch.int64)
        _check_range(ids, len(self.entities), "entity")
        return ids

    def _ids_of_labels(self, labels: np.ndarray) -> np.ndarray:
        """Return the ids of labels, with the shape of the array of labels."""
        for label in labels.flat:
            if label not in self._index:
                hint = nearest(str(label), self.entities)
                raise UnknownEntityError(f"no entity '{label}' in {self.name}.{hint}")
        return np.vectorize(self._index.__getitem__, otypes=[np.int64])(labels)

    def relation_ids(self, relations: RelationIds) -> Tensor:
        """Convert relation names or ids to int64 ids on the device.

        Raises:
            UnknownEntityError: for an unknown relation; the error names the known relations.
        """
        if isinstance(relations, str):
            if relations not in RELATIONS:
                hint = nearest(relations, RELATIONS)
                raise UnknownEntityError(
                    f"no relation '{relations}'; expected {' or '.join(RELATIONS)}.{hint}"
                )
            relations = RELATIONS.index(relations)
        # As tensors, so that subclasses need not distinguish one relation from many.
        ids = torch.as_tensor(relations, dtype=torch.int64, device=self.device)
        _check_range(ids, len(RELATIONS), "relation")
        return ids

    def top(
        self,
        head: EntityIds | None,
        relation: RelationIds,
        tail: EntityIds | None,
        limit: int | None = 10,
    ) -> list[tuple[str, float]]:
        """Rank all entities for the open slot of a triple, known answers included.

        Args:
            head: the head, as id or label; None to rank heads.
            relation: the relation, as id or label.
            tail: the tail, as id or label; None to rank tails.
            limit: maximum number of entities; None for all.

        Returns:
            labels and scores, best first; ties are in id order.

        Raises:
            ValueError: unless exactly one of ``head`` and ``tail`` is None.
            UnknownEntityError: for a label or id that the scorer does not know.
        """
        if (head is None) == (tail is None):
            raise ValueError("either head or tail must be None, not both.")
        # All entities in the open slot, against which the known one broadcasts.
        everything = torch.arange(len(self.entities), device=self.device)
        scores = self.score(
            everything if head is None else head,
            relation,
            everything if tail is None else tail,
        )
        # A stable sort keeps ties in id order, so equal scorers list equal answers.
        order = torch.sort(scores, descending=True, stable=True).indices[:limit]
        return [(self.entities[i], float(scores[i])) for i in order.tolist()]


class StoredScorer(Scorer):
    """A scorer that a model folder can store as named tensors.

    Attributes:
        kind: the key of the class in :data:`~wordcraft_kg.models.scorers.scorer_folder.SCORERS`,
            and the scorer kind in ``vocabulary.json``.
        shared: names of tensors that the models of all folds have in common, stored once.
    """

    kind: ClassVar[str]
    shared: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def tensors(self) -> dict[str, Tensor]:
        """Return the tensors, by name, from which :meth:`restored` makes the scorer."""

    @staticmethod
    @abstractmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:
        """Check tensors from a file before a scorer is made from them.

        Args:
            tensors: tensors by name.
            size: number of entities E in the vocabulary.

        Raises:
            KeyError: if a tensor is missing.
            ValueError: if a tensor has the wrong shape, type or value.
        """

    @classmethod
    def restored(
        cls,
        tensors: Mapping[str, Tensor],
        entities: Sequence[str],
        graph_hash: str,
        **settings: Any,
    ) -> Scorer:
        """Make the scorer from the tensors that :meth:`tensors` returned.

        Args:
            tensors: tensors by name, which have passed :meth:`check`.
            entities: labels in id order.
            graph_hash: content hash of the recipe graph that the ids belong to.
            settings: ``device`` and ``name``, as in :class:`Scorer`.
        """
        return cls(tensors, entities, graph_hash, **settings)  # type: ignore[arg-type]


def _check_range(ids: Tensor, size: int, id_kind: str) -> None:
    # Negative ids are refused too: they would index from the end without an error.
    if ids.numel() and not 0 <= int(ids.min()) <= int(ids.max()) < size:
        raise UnknownEntityError(
            f"{id_kind} ids must be 0 .. {size - 1}; found {int(ids.min())} .. {int(ids.max())}."
        )
