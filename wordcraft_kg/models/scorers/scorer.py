"""The base class for scorers; a new scorer implements ``_score``."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.base.errors import UnknownEntityError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.graphs.triples import RELATIONS

if TYPE_CHECKING:
    from wordcraft_kg.models.scorers.cross_fitting import CrossFitted

EntityIds = int | str | Sequence[int] | Sequence[str] | np.ndarray | Tensor
"""Entities by id or label: one, a sequence, or an array or tensor of ids of any shape."""
RelationIds = int | str | Tensor
"""Relations by id or label, or a tensor of ids."""


class Scorer(ABC):
    """Base class for scorers of triples on a torch ``device``; ``entities`` are the labels in id order."""

    def __init__(
        self,
        entities: Sequence[str],
        graph_hash: str,
        device: str | torch.device = "cpu",
        name: str = "",
    ):
        self.entities = tuple(entities)
        self.graph_hash = graph_hash
        self.device = torch.device(device)
        self.name = name or type(self).__name__
        self._index = {label: i for i, label in enumerate(self.entities)}

    @property
    def whole(self) -> "Scorer":
        """The scorer trained on all train recipes: ``self`` unless cross-fitted (a model per left-out fold)."""
        return self

    @property
    def folds(self) -> "CrossFitted | None":
        """``self`` if cross-fitted (a model per left-out fold), else None."""
        return None

    @abstractmethod
    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        """Score broadcastable int64 ids within range; float32."""

    def score(self, heads: EntityIds, relations: RelationIds, tails: EntityIds) -> Tensor:
        """Score triples, float32; ids or labels broadcast. Raises UnknownEntityError for an unknown label or id."""
        return self._score(
            self.entity_ids(heads), self.relation_ids(relations), self.entity_ids(tails)
        )

    def table(self, relation: int | str) -> Tensor:
        """Return scores for all pairs in a relation, (E, E), row = head; 1.5 GiB for 20,000 entities."""
        everything = torch.arange(len(self.entities), device=self.device)
        return self._score(everything[:, None], self.relation_ids(relation), everything[None, :])

    def entity_ids(self, entities: EntityIds) -> Tensor:
        """Convert labels or ids to int64 ids on the device; UnknownEntityError names the nearest labels."""
        if not isinstance(entities, torch.Tensor):
            values = np.asarray(entities)
            if values.dtype.kind == "U":
                unknown = [str(label) for label in values.flat if str(label) not in self._index]
                if unknown:
                    hint = nearest(unknown[0], self.entities)
                    raise UnknownEntityError(f"no entity '{unknown[0]}' in {self.name}.{hint}")
                values = np.array([self._index[str(label)] for label in values.flat]).reshape(
                    values.shape
                )
            entities = torch.tensor(values if values.size else values.astype(np.int64))
        if entities.is_floating_point() or entities.is_complex():
            raise UnknownEntityError(
                f"expected entities as labels or integer ids; found {entities.dtype}."
            )
        ids = entities.to(self.device, torch.int64)
        _check_range(ids, len(self.entities), "entity")
        return ids

    def relation_ids(self, relations: RelationIds) -> Tensor:
        """Convert relation names or ids to int64 ids; UnknownEntityError names the relations."""
        if isinstance(relations, str):
            if relations not in RELATIONS:
                hint = nearest(relations, RELATIONS)
                raise UnknownEntityError(
                    f"no relation '{relations}'; expected {' or '.join(RELATIONS)}.{hint}"
                )
            relations = RELATIONS.index(relations)
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
        """Rank entities for the head or tail that is None: labels and scores, best first; all without ``limit``."""
        if (head is None) == (tail is None):
            raise ValueError("either head or tail must be None, not both.")
        everything = torch.arange(len(self.entities), device=self.device)
        scores = self.score(
            everything if head is None else head, relation, everything if tail is None else tail
        )
        order = torch.sort(scores, descending=True, stable=True).indices[:limit]
        return [(self.entities[i], float(scores[i])) for i in order.tolist()]


class StoredScorer(Scorer):
    """A scorer that a model folder can store as named tensors; ``kind`` is a key in ``SCORERS``."""

    kind: ClassVar[str]

    @abstractmethod
    def tensors(self) -> dict[str, Tensor]:
        """Return the tensors, by name, from which :meth:`restored` makes the scorer."""

    @staticmethod
    @abstractmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:
        """Check tensors for E = ``size`` entities: KeyError if missing, ValueError if shape, type or value is wrong."""

    @classmethod
    def restored(
        cls,
        tensors: Mapping[str, Tensor],
        entities: Sequence[str],
        graph_hash: str,
        **settings: Any,
    ) -> Scorer:
        """Make the scorer from its tensors, labels and graph hash; ``settings`` are ``device`` and ``name``."""
        return cls(tensors, entities, graph_hash, **settings)  # type: ignore[arg-type]


def check_shapes(
    tensors: Mapping[str, Tensor],
    expected: Mapping[str, tuple[int, ...]],
    dtypes: Mapping[str, torch.dtype] = {},
) -> None:
    """Raise KeyError for a missing tensor, ValueError for a wrong shape or type (float32 unless in ``dtypes``)."""
    for name, shape in expected.items():
        if tensors[name].dtype != (kind := dtypes.get(name, torch.float32)):
            raise ValueError(f"{name} has type {tensors[name].dtype}, not {kind}")
        if tensors[name].shape != shape:
            raise ValueError(
                f"{name} has shape {tuple(tensors[name].shape)}, the vocabulary needs {shape}"
            )


def check_ids(name: str, ids: Tensor, high: int) -> None:
    """Raise ValueError if an id is outside 0 .. ``high``; ``name`` is for the error."""
    if ids.numel() and not 0 <= int(ids.min()) <= int(ids.max()) <= high:
        raise ValueError(f"{name} contains numbers outside 0 .. {high}")


def _check_range(ids: Tensor, size: int, what: str) -> None:
    if ids.numel() and not 0 <= int(ids.min()) <= int(ids.max()) < size:
        raise UnknownEntityError(
            f"{what} ids must be 0 .. {size - 1}; found {int(ids.min())} .. {int(ids.max())}."
        )
