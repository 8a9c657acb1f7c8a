"""Baseline scorers without learning: facts, counts, neighbours and votes."""

from functools import cached_property
from typing import Any

import numpy as np
import torch

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, RELATIONS
from wordcraft_kg.models.scorers.config import check_table
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.scorer import EntityIds, Scorer


class SymbolicScorer(Scorer):
    """A scorer without generalisation: 1 for given triples, ids of shape (T, 3), and 0 otherwise."""

    def __init__(self, graph: RecipeGraph, triples: np.ndarray, **kwargs: Any):
        super().__init__(graph.entities, graph.hash, **kwargs)
        keys = torch.unique(
            self._key(*torch.tensor(triples, dtype=torch.int64, device=self.device).T)
        )
        # The last key is larger than all triple keys, so searches always end at a key.
        self._keys = torch.cat([keys, keys.new_full((1,), torch.iinfo(torch.int64).max)])

    def _key(
        self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor
    ) -> torch.Tensor:
        return (relations * len(self.entities) + heads) * len(self.entities) + tails

    def _score(
        self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor
    ) -> torch.Tensor:
        keys = self._key(heads, relations, tails)
        return (self._keys[torch.searchsorted(self._keys, keys)] == keys).float()

    def table(self, relation: int | str) -> torch.Tensor:  # noqa: D102 - inherited
        size = len(self.entities)
        cells = self._keys - self.relation_ids(relation) * size**2
        table = torch.zeros(size, size, device=self.device)
        table.view(-1)[cells[(cells >= 0) & (cells < size**2)]] = 1
        return table


class FrequencyScorer(Scorer):
    """Scores a triple by how often head and tail occur in known triples (T, 3) with the relation."""

    def __init__(self, graph: RecipeGraph, triples: np.ndarray, **kwargs: Any):
        super().__init__(graph.entities, graph.hash, **kwargs)
        heads, relations, tails = torch.tensor(triples, dtype=torch.int64, device=self.device).T
        size = len(RELATIONS) * len(self.entities)
        shape = (len(RELATIONS), len(self.entities))
        self._as_head = (
            torch.bincount(relations * shape[1] + heads, minlength=size).view(shape).float()
        )
        self._as_tail = (
            torch.bincount(relations * shape[1] + tails, minlength=size).view(shape).float()
        )

    def _score(
        self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor
    ) -> torch.Tensor:
        return self._as_head[relations, heads] + self._as_tail[relations, tails]


class NeighbourScorer(TableScorer):
    """Scores a triple by known links between entities that are similar to its head and its tail.

    With ``A_r`` the 0/1 matrix of known links in relation r, shape (E, E) for E entities, ``score_r = S A_r + A_r S``,
    where ``S`` holds the cosines between rows of ``[A_combinesWith, A_componentOf, A_componentOf transposed]`` with a
    zero diagonal. A neighbour shared by n entities weighs ``n ** -power``; the power was chosen on validation splits
    (``benchmarks/link_quality.py neighbours``). All matrices are dense, (E, 3 E), for graphs up to a few thousand
    entities.

    Source: neighbourhood-based link prediction (Adamic and Adar 2003; Sarwar et al. 2001), here with two relations.
    """

    def __init__(
        self, graph: RecipeGraph, triples: np.ndarray, *, power: float = 1.0, **kwargs: Any
    ):
        """Score all triples from known triples, ids of shape (T, 3); ConfigError for a graph too large for tables."""
        size = graph.num_entities
        check_table("the neighbour rule", size)
        links = torch.zeros(len(RELATIONS), size, size)
        heads, relations, tails = torch.tensor(triples, dtype=torch.int64).T
        links[relations, heads, tails] = 1
        profiles = torch.cat([*links, links[COMPONENT_OF].T], dim=1)
        weighted = profiles * profiles.sum(0).clamp(min=1) ** (-power / 2)
        unit = torch.nn.functional.normalize(weighted, dim=1)
        alike = (unit @ unit.T).fill_diagonal_(0)
        super().__init__(alike @ links + links @ alike, graph.entities, graph.hash, **kwargs)


_UNSEEN = 0.01
"""Pseudo-count for an ingredient in no known recipe with the result."""


class VoteScorer(Scorer):
    """Scores a recipe by how many known recipes make the same result from each ingredient.

    With ``n_xc`` the number of known recipes that make c from x, and ``m_c`` the number that make c, ::

        score(a, b -> c) = log((n_ac + eps) (n_bc + eps) / (m_c + 1)).

    As P(c) is about ``m_c`` and P(x | c) about ``n_xc / m_c``, this is naive Bayes. If an entity is paired with the
    same entity, the second factor is ``eps``: no entity votes twice. Triple scores sum over the recipe's missing
    entity::

        score(a, combinesWith, b) = log sum over c of exp score(a, b -> c)
        score(x, componentOf, c) = log sum over b of exp(score(x, combinesWith, b) + score(x, b -> c))

    Triple scores need a table of all pairs, so large graphs are refused; recipe scores have no size limit. Forms and
    ``eps`` were chosen on validation recipes: ``benchmarks/link_quality.py votes``.
    """

    def __init__(self, graph: RecipeGraph, recipes: Ids, *, unseen: float = _UNSEEN, **kwargs: Any):
        """Count votes from known recipes, ids (n, 3): ingredients and result; ``unseen`` is ``eps``, above 0."""
        super().__init__(graph.entities, graph.hash, **kwargs)
        self.unseen = unseen
        one, other, result = recipes.T
        size = graph.num_entities
        votes = np.concatenate([one * size + result, (other * size + result)[one != other]])
        keys, counts = np.unique(votes, return_counts=True)
        # The last key is larger than all vote keys, so searches always end at a key.
        self._keys = torch.tensor(np.append(keys, np.iinfo(np.int64).max), device=self.device)
        self._counts = torch.tensor(np.append(counts, 0), dtype=torch.float64, device=self.device)
        self._made = torch.tensor(
            np.bincount(result, minlength=size), dtype=torch.float64, device=self.device
        )

    def votes(self, ingredients: EntityIds, results: EntityIds) -> torch.Tensor:
        """Count the known recipes that make each result from each ingredient; float64, ids broadcast."""
        keys = self.entity_ids(ingredients) * len(self.entities) + self.entity_ids(results)
        rows = torch.searchsorted(self._keys, keys)
        return torch.where(self._keys[rows] == keys, self._counts[rows], 0.0)

    def score_recipes(self, one: EntityIds, other: EntityIds, results: EntityIds) -> torch.Tensor:
        """Score recipes, float32; ids or labels broadcast, ingredients in any order."""
        a, b, c = self.entity_ids(one), self.entity_ids(other), self.entity_ids(results)
        second = torch.where(a == b, 0.0, self.votes(b, c))
        weight = (self.votes(a, c) + self.unseen) * (second + self.unseen) / (self._made[c] + 1)
        return weight.log().float()

    def _score(
        self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor
    ) -> torch.Tensor:
        return self._tables[relations, heads, tails]

    @cached_property
    def _tables(self) -> torch.Tensor:
        size = len(self.entities)
        check_table("counting the votes for triples", size)
        dense = torch.full((size, size), self.unseen, dtype=torch.float64, device=self.device)
        dense.view(-1)[self._keys[:-1]] += self._counts[:-1]
        weighted = dense / (self._made + 1)
        pairs = dense @ weighted.T
        itself = self.unseen * weighted.sum(1)
        partners = pairs.fill_diagonal_(0) @ weighted + (itself * self.unseen)[:, None] / (
            self._made + 1
        )
        tables = torch.empty(len(RELATIONS), size, size, device=self.device)
        tables[COMBINES_WITH] = (pairs + torch.diag(itself)).log()
        tables[COMPONENT_OF] = (dense * partners).log()
        return tables
