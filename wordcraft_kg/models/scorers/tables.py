"""Scorers that look up scores that were computed once."""

from collections.abc import Sequence
from typing import Any

import torch

from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.scorers.scorer import Scorer


class TableScorer(Scorer):
    """Looks scores up in a table of all triples, shape (R, E, E): any link predictor, once it has scored everything."""

    def __init__(self, scores: torch.Tensor, entities: Sequence[str], graph_hash: str, **kwargs: Any):
        """Keep ``scores``, shape (R, E, E), float, indexed by relation, head, tail."""
        super().__init__(entities, graph_hash, **kwargs)
        self.scores = scores.to(self.device, torch.float32).contiguous()

    @classmethod
    def of(cls, scorer: Scorer) -> "TableScorer":
        """Return what looks up all that a scorer scores."""
        scores = torch.stack([scorer.table(relation) for relation in range(len(RELATIONS))])
        return TableScorer(scores, scorer.entities, scorer.graph_hash, device=scorer.device, name=scorer.name)

    def _score(self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor) -> torch.Tensor:
        size = len(self.entities)
        return self.scores.view(-1)[(relations * size + heads) * size + tails]

    def table(self, relation: int | str) -> torch.Tensor:  # noqa: D102 - inherited
        return self.scores[self.relation_ids(relation)]
