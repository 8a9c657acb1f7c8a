"""Counting what each ingredient has been part of: the structure of the train recipes, without any meaning of words."""

from functools import cached_property
from typing import Any

import numpy as np
import torch

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, RELATIONS
from wordcraft_kg.models.scorers.limits import check_table
from wordcraft_kg.models.scorers.scorer import EntityIds, Scorer

UNSEEN = 0.01
"""What an ingredient counts that no known recipe of the result has."""


class VoteScorer(Scorer):
    """Scores a recipe by how often each of its ingredients has been in a recipe of its result; nothing is learned.

    With ``n_xc`` the number of known recipes of c that x is in, and ``m_c`` that of all recipes of c, ::

        score(a, b -> c) = log((n_ac + eps) (n_bc + eps) / (m_c + 1)).

    So two ingredients that vote for a result count far more than one that does so twice as often, and a vote counts
    less for a result that everything makes. As P(c) is about ``m_c`` and P(x | c) about ``n_xc / m_c``, this is naive
    Bayes. In a pair of one entity with itself the second factor is ``eps``: nobody votes twice.

    Triples are scored by what remains when the open part of the recipe is summed out::

        score(a, combinesWith, b) = log sum over c of exp score(a, b -> c)
        score(x, componentOf, c) = log sum over b of exp(score(x, combinesWith, b) + score(x, b -> c))

    They need the scores of all pairs, so large graphs are refused; recipes are scored for graphs of any size. The form
    of both scores, and ``eps``, on which the ranks of results hardly depend, were chosen on validation recipes:
    ``benchmarks/link_quality.py votes``.
    """

    def __init__(self, graph: RecipeGraph, recipes: Ids, *, unseen: float = UNSEEN, **kwargs: Any):
        """Count the votes of known recipes, shape (n, 3), rows of ``graph.recipes``; ``unseen`` is ``eps``, above 0."""
        super().__init__(graph.entities, graph.hash, **kwargs)
        self.unseen = unseen
        one, other, result = recipes.T
        size = graph.num_entities
        votes = np.concatenate([one * size + result, (other * size + result)[one != other]])
        keys, counts = np.unique(votes, return_counts=True)
        # The last key is larger than that of any vote, so that a search always ends at one.
        self._keys = torch.tensor(np.append(keys, np.iinfo(np.int64).max), device=self.device)
        self._counts = torch.tensor(np.append(counts, 0), dtype=torch.float64, device=self.device)
        self._made = torch.tensor(np.bincount(result, minlength=size), dtype=torch.float64, device=self.device)

    def votes(self, ingredients: EntityIds, results: EntityIds) -> torch.Tensor:
        """Return how many known recipes of a result an entity is in, float64, of the broadcast shape."""
        keys = self.entity_ids(ingredients) * len(self.entities) + self.entity_ids(results)
        found = torch.searchsorted(self._keys, keys)
        return torch.where(self._keys[found] == keys, self._counts[found], 0.0)

    def score_recipes(self, one: EntityIds, other: EntityIds, results: EntityIds) -> torch.Tensor:
        """Score recipes given by ids or labels, which broadcast against each other; the ingredients have no order.

        Returns:
            float32, of the broadcast shape.
        """
        a, b, c = self.entity_ids(one), self.entity_ids(other), self.entity_ids(results)
        second = torch.where(a == b, 0.0, self.votes(b, c))
        weight = (self.votes(a, c) + self.unseen) * (second + self.unseen) / (self._made[c] + 1)
        return weight.log().float()

    def _score(self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor) -> torch.Tensor:
        return self._tables[relations, heads, tails]

    @cached_property
    def _tables(self) -> torch.Tensor:
        """The scores of all triples, shape (R, E, E), by relation, head and tail."""
        size = len(self.entities)
        check_table("counting the votes for triples", size)
        dense = torch.full((size, size), self.unseen, dtype=torch.float64, device=self.device)
        dense.view(-1)[self._keys[:-1]] += self._counts[:-1]
        weighted = dense / (self._made + 1)
        pairs = dense @ weighted.T
        itself = self.unseen * weighted.sum(1)
        partners = pairs.fill_diagonal_(0) @ weighted + (itself * self.unseen)[:, None] / (self._made + 1)
        tables = torch.empty(len(RELATIONS), size, size, device=self.device)
        tables[COMBINES_WITH] = (pairs + torch.diag(itself)).log()
        tables[COMPONENT_OF] = (dense * partners).log()
        return tables
