"""Scorers that learn nothing: the facts of a knowledge graph, and how often an entity occurs in it."""

from typing import Any

import numpy as np
import torch

from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.scorers.scorer import Scorer


class SymbolicScorer(Scorer):
    """Scores 1 for the triples of a set and 0 for all others: a knowledge graph without any generalisation."""

    def __init__(self, graph: RecipeGraph, triples: np.ndarray, **kwargs: Any):
        """Keep the triples, shape (T, 3), ids of ``graph``."""
        super().__init__(graph.entities, graph.hash, **kwargs)
        keys = torch.unique(self._key(*torch.tensor(triples, dtype=torch.int64, device=self.device).T))
        # The last key is larger than that of any triple, so that a search always ends at one.
        self._keys = torch.cat([keys, keys.new_full((1,), torch.iinfo(torch.int64).max)])

    def _key(self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor) -> torch.Tensor:
        return (relations * len(self.entities) + heads) * len(self.entities) + tails

    def _score(self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor) -> torch.Tensor:
        keys = self._key(heads, relations, tails)
        return (self._keys[torch.searchsorted(self._keys, keys)] == keys).float()

    def table(self, relation: int | str) -> torch.Tensor:  # noqa: D102 - inherited
        size = len(self.entities)
        cells = self._keys - self.relation_ids(relation) * size**2
        table = torch.zeros(size, size, device=self.device)
        table.view(-1)[cells[(cells >= 0) & (cells < size**2)]] = 1
        return table


class FrequencyScorer(Scorer):
    """Scores a triple by how often its head is a head and its tail a tail in known triples of the relation.

    With one slot open, this ranks the candidates by their training frequency in that slot: the baseline that a link
    predictor has to beat.
    """

    def __init__(self, graph: RecipeGraph, triples: np.ndarray, **kwargs: Any):
        """Count heads and tails of the triples, shape (T, 3), ids of ``graph``."""
        super().__init__(graph.entities, graph.hash, **kwargs)
        heads, relations, tails = torch.tensor(triples, dtype=torch.int64, device=self.device).T
        size = len(RELATIONS) * len(self.entities)
        shape = (len(RELATIONS), len(self.entities))
        self._as_head = torch.bincount(relations * shape[1] + heads, minlength=size).view(shape).float()
        self._as_tail = torch.bincount(relations * shape[1] + tails, minlength=size).view(shape).float()

    def _score(self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor) -> torch.Tensor:
        return self._as_head[relations, heads] + self._as_tail[relations, tails]
