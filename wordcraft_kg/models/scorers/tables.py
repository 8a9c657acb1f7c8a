"""Scorers with precomputed scores."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.scorers.scorer import Scorer, StoredScorer, check_shapes


class TableScorer(StoredScorer):
    """Looks up scores in a table, shape (R, E, E), by relation, head and tail."""

    kind: ClassVar[str] = "table"

    def __init__(self, scores: Tensor, entities: Sequence[str], graph_hash: str, **kwargs: Any):
        super().__init__(entities, graph_hash, **kwargs)
        self.scores = scores.to(self.device, torch.float32).contiguous()

    def tensors(self) -> dict[str, Tensor]:  # noqa: D102 - inherited
        return {"scores": self.scores}

    @staticmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:  # noqa: D102 - inherited
        check_shapes(tensors, {"scores": (len(RELATIONS), size, size)})

    @classmethod
    def restored(  # noqa: D102 - inherited
        cls, tensors: Mapping[str, Tensor], entities: Sequence[str], graph_hash: str, **settings: Any
    ) -> "TableScorer":
        return cls(tensors["scores"], entities, graph_hash, **settings)

    @classmethod
    def of(cls, scorer: Scorer) -> "TableScorer":
        """Tabulate all scores of a scorer."""
        scores = torch.stack([scorer.table(relation) for relation in range(len(RELATIONS))])
        return TableScorer(scores, scorer.entities, scorer.graph_hash, device=scorer.device, name=scorer.name)

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        size = len(self.entities)
        return self.scores.view(-1)[(relations * size + heads) * size + tails]

    def table(self, relation: int | str) -> Tensor:  # noqa: D102 - inherited
        return self.scores[self.relation_ids(relation)]
