"""A scorer with a table of scores from elsewhere: of sets of ingredients for results."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.base.tensors import check_tensors
from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, RELATIONS, Ids
from wordcraft_kg.models.scorers.scorer import StoredScorer


class SetTableScorer(StoredScorer):
    """Scores of N sets, such as a language model's opinions; 0, the mean, where there is none.

    A triple has the highest score of the sets that it is part of.

    Attributes:
        kind: ``set-table``, the scorer kind in ``vocabulary.json``.
        sets: shape (N, 8), int64: the ingredients in ascending order, padded with E.
        results: shape (N,), int64.
        values: shape (N,), float32: standardised scores.
    """

    kind: ClassVar[str] = "set-table"

    def __init__(
        self,
        tensors: Mapping[str, Tensor],
        entities: Sequence[str],
        graph_hash: str,
        **settings: Any,
    ):
        """Take the three tensors by name; ``settings`` are ``device`` and ``name``."""
        super().__init__(entities, graph_hash, **settings)
        self.sets = tensors["sets"]
        self.results = tensors["results"]
        self.values = tensors["values"]

    def tensors(self) -> dict[str, Tensor]:  # noqa: D102 - inherited
        return {"sets": self.sets, "results": self.results, "values": self.values}

    @staticmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:  # noqa: D102 - inherited
        layouts = {"sets": "N P int64", "results": "N int64", "values": "N float32"}
        check_tensors(tensors, layouts, P=8)
        sets, results = tensors["sets"], tensors["results"]
        is_in_range = ((sets >= 0) & (sets <= size)).all() and ((results >= 0) & (results < size))
        if not len(sets) or not bool(torch.as_tensor(is_in_range).all()):
            raise ValueError("the sets are none, or hold numbers of no entity")

    def score_sets(self, sets: Ids, goals: Ids) -> NDArray[np.float32]:
        """Score sets, shape (N, 8), ids padded with -1, for goals (N,); returns shape (N,)."""
        padded = np.sort(np.where(sets < 0, len(self.entities), sets), axis=1)
        rows = np.column_stack([padded, goals]).tolist()
        return np.array([self._values.get(tuple(row), 0.0) for row in rows], dtype=np.float32)

    @cached_property
    def _values(self) -> dict[tuple[int, ...], float]:
        rows = torch.cat([self.sets, self.results[:, None]], dim=1)
        return dict(zip(map(tuple, rows.tolist()), self.values.tolist(), strict=True))

    @cached_property
    def _tables(self) -> Tensor:
        """The scores of all triples, shape (R, E, E), -inf where no set has one."""
        size = len(self.entities)
        tables = torch.full((len(RELATIONS), size + 1, size + 1), -torch.inf)
        flat = tables.view(-1)
        for i, first in enumerate(self.sets.T):
            links = [(COMPONENT_OF, self.results)]
            links += [(COMBINES_WITH, ids) for j, ids in enumerate(self.sets.T) if i != j]
            for relation, second in links:
                cells = (relation * (size + 1) + first) * (size + 1) + second
                flat.scatter_reduce_(0, cells, self.values, "amax")
        return tables[:, :size, :size].masked_fill(tables[:, :size, :size] == -torch.inf, 0)

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        return self._tables.to(self.device)[relations, heads, tails]
