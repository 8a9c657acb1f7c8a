"""Baseline scorers without learning: facts, counts, neighbours, votes and the recipe kernel.

The page docs/evidence/parts.md#baselines measures them.
"""

from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.statistics import standardised
from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, RELATIONS, Ids, RecipeGraph
from wordcraft_kg.graphs.arrays import are_among, different_ingredients
from wordcraft_kg.graphs.triples import triple_keys
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.kernel import completion, profiles
from wordcraft_kg.models.scorers.neighbours.regression import link_factors
from wordcraft_kg.models.scorers.score_limits import check_table
from wordcraft_kg.models.scorers.scorer import EntityIds, Scorer


class SymbolicScorer(Scorer):
    """A scorer without generalisation: 1 for given triples and 0 otherwise."""

    def __init__(self, graph: RecipeGraph, triples: np.ndarray, **kwargs: Any):
        """Keep the triples, ids of shape (T, 3); ``kwargs`` are ``device`` and ``name``."""
        super().__init__(graph.entities, graph.hash, **kwargs)
        # Sorted keys need memory for T triples, a table for E * E pairs.
        self._keys = np.sort(triple_keys(triples, graph.num_entities))

    def _score(
        self,
        heads: torch.Tensor,
        relations: torch.Tensor,
        tails: torch.Tensor,
    ) -> torch.Tensor:
        size = len(self.entities)
        # As in `triple_keys`, for ids of any shape.
        keys = (relations * size + heads) * size + tails
        is_known = are_among(keys.cpu().numpy(), self._keys)
        return torch.from_numpy(is_known).float().to(self.device)


class FrequencyScorer(Scorer):
    """Scores a triple by how often head and tail occur in known triples with the relation.

    With one slot open, candidates are ranked by their number of training triples in that slot: the
    baseline that a link predictor has to beat.
    """

    def __init__(self, graph: RecipeGraph, triples: np.ndarray, **kwargs: Any):
        """Count heads and tails of triples, ids of shape (T, 3); ``kwargs`` as in ``Scorer``."""
        super().__init__(graph.entities, graph.hash, **kwargs)
        ids = torch.tensor(triples, dtype=torch.int64, device=self.device)
        heads, relations, tails = ids.T
        size = len(self.entities)

        def count(ends: torch.Tensor) -> torch.Tensor:
            """Return how many triples have each entity at this end, shape (R, E)."""
            cells = relations * size + ends
            counts = torch.bincount(cells, minlength=len(RELATIONS) * size)
            return counts.view(len(RELATIONS), size).float()

        self._as_head = count(heads)
        self._as_tail = count(tails)

    def _score(
        self,
        heads: torch.Tensor,
        relations: torch.Tensor,
        tails: torch.Tensor,
    ) -> torch.Tensor:
        return self._as_head[relations, heads] + self._as_tail[relations, tails]


class NeighbourScorer(TableScorer):
    """Scores a triple by known links between entities that are similar to its head and its tail.

    With ``A_r`` the 0/1 matrix of known links in relation r, shape (E, E) for E entities, ``score_r
    = S A_r + A_r S``, where ``S`` holds the cosines between rows of ``[A_combinesWith,
    A_componentOf, A_componentOf transposed]`` with a zero diagonal: entities are similar to the
    extent that they share neighbours, and no entity is similar to itself. A neighbour shared by n
    entities weighs ``n ** -power``; the power was chosen on validation splits
    (``benchmarks/link_quality.py neighbours``). All matrices are dense, (E, 3 E), for graphs up to
    a few thousand entities.

    Source: neighbourhood-based link prediction (Adamic and Adar 2003; Sarwar et al. 2001), here
    with two relations.
    """

    def __init__(
        self,
        graph: RecipeGraph,
        triples: np.ndarray,
        *,
        power: float = 1.0,
        **kwargs: Any,
    ):
        """Score all triples from known triples.

        Args:
            graph: the graph that the ids belong to.
            triples: known triples, ids of shape (T, 3).
            power: weight of a neighbour that n entities share is ``n ** -power``.
            kwargs: ``device`` and ``name``, as in ``Scorer``.

        Raises:
            ConfigError: if the graph is too large for a score table.
        """
        size = graph.num_entities
        check_table("the neighbour rule", size)
        links = torch.zeros(len(RELATIONS), size, size)
        heads, relations, tails = torch.tensor(triples, dtype=torch.int64).T
        links[relations, heads, tails] = 1
        # combinesWith is symmetric, so its transpose would count the same neighbours twice.
        profiles = torch.cat([*links, links[COMPONENT_OF].T], dim=1)
        # Half the power in each factor of the dot product of two profiles.
        shared_by = profiles.sum(0).clamp(min=1)
        weighted = profiles * shared_by ** (-power / 2)
        unit = torch.nn.functional.normalize(weighted, dim=1)
        alike = (unit @ unit.T).fill_diagonal_(0)
        scores = alike @ links + links @ alike
        super().__init__(scores, graph.entities, graph.hash, **kwargs)


_COMPLETION = 0.5
"""Weight of completion in the recipe kernel."""
_TINY = 1e-12
_UNSEEN = 0.01
"""Pseudo-count for an ingredient in no known recipe with the result; ranks hardly depend on it."""


class VoteScorer(Scorer):
    """Scores a recipe by how many known recipes make the same result from each ingredient.

    With ``n_xc`` the number of known recipes that make c from x, and ``m_c`` the number that make
    c, ::

        score(a, b -> c) = log((n_ac + eps) (n_bc + eps) / (m_c + 1)).

    So two ingredients that vote for a result count far more than a single ingredient that votes
    twice as often, and a vote counts less for a result with many recipes. As P(c) is about ``m_c``
    and P(x | c) about ``n_xc / m_c``, this is naive Bayes. If an entity is paired with the same
    entity, the second factor is ``eps``: no entity votes twice. Triple scores sum over the recipe's
    missing entity::

        score(a, combinesWith, b) = log sum over c of exp score(a, b -> c)
        score(x, componentOf, c)
            = log sum over b of exp(score(x, combinesWith, b) + score(x, b -> c))

    Triple scores need a table of all pairs, so large graphs are refused; recipe scores have no size
    limit. Forms and ``eps`` were chosen on validation recipes: ``benchmarks/link_quality.py
    votes``.
    """

    def __init__(self, graph: RecipeGraph, recipes: Ids, *, unseen: float = _UNSEEN, **kwargs: Any):
        """Count votes from known recipes.

        Args:
            graph: the graph that the ids belong to.
            recipes: known recipes, rows of ``graph.sets``.
            unseen: the pseudo-count ``eps``, above 0.
            kwargs: ``device`` and ``name``, as in ``Scorer``.
        """
        super().__init__(graph.entities, graph.hash, **kwargs)
        self.unseen = unseen
        size = graph.num_entities
        result = recipes[:, -1]
        # A recipe with twice the same ingredient is one vote.
        rows, ingredients = different_ingredients(recipes, size)
        votes = ingredients * size + result[rows]
        keys, counts = np.unique(votes, return_counts=True)
        # The last key is larger than all vote keys, so searches always end at a key.
        keys = np.append(keys, np.iinfo(np.int64).max)
        counts = np.append(counts, 0)
        self._keys = torch.tensor(keys, device=self.device)
        self._counts = torch.tensor(counts, dtype=torch.float64, device=self.device)
        self._made = torch.tensor(
            np.bincount(result, minlength=size),
            dtype=torch.float64,
            device=self.device,
        )

    def votes(self, ingredients: EntityIds, results: EntityIds) -> torch.Tensor:
        """Count known recipes that make a result from an ingredient; float64, ids broadcast.

        Raises:
            UnknownEntityError: for a label or id that the scorer does not know.
        """
        ingredient_ids = self.entity_ids(ingredients)
        result_ids = self.entity_ids(results)
        keys = ingredient_ids * len(self.entities) + result_ids
        rows = torch.searchsorted(self._keys, keys)
        is_known = self._keys[rows] == keys
        return torch.where(is_known, self._counts[rows], 0.0)

    def score_recipes(self, one: EntityIds, other: EntityIds, results: EntityIds) -> torch.Tensor:
        """Score recipes by ids or labels.

        Args:
            one: an ingredient: one entity, a sequence, or an array or tensor of ids of any shape.
            other: the second ingredient; the order of ingredients does not matter.
            results: the result; the three arguments broadcast against each other.

        Returns:
            float32 log scores with the broadcast shape.

        Raises:
            UnknownEntityError: for a label or id that the scorer does not know.
        """
        a = self.entity_ids(one)
        b = self.entity_ids(other)
        c = self.entity_ids(results)
        first = self.votes(a, c)
        # No entity votes twice.
        second = torch.where(a == b, 0.0, self.votes(b, c))
        votes = (first + self.unseen) * (second + self.unseen)
        weight = votes / (self._made[c] + 1)
        return weight.log().float()

    def _score(
        self,
        heads: torch.Tensor,
        relations: torch.Tensor,
        tails: torch.Tensor,
    ) -> torch.Tensor:
        return self._tables[relations, heads, tails]

    @cached_property
    def _tables(self) -> torch.Tensor:
        """Scores of all triples, shape (R, E, E): by relation, head and tail."""
        size = len(self.entities)
        check_table("counting the votes for triples", size)
        # n_xc + eps for all x and c; the last key is the sentinel.
        dense = torch.full((size, size), self.unseen, dtype=torch.float64, device=self.device)
        cells = self._keys[:-1]
        dense.view(-1)[cells] += self._counts[:-1]
        recipe_counts = self._made + 1
        weighted = dense / recipe_counts
        # Self pairs have eps as their second factor, so they are summed apart from the product.
        pairs = (dense @ weighted.T).fill_diagonal_(0)
        itself = self.unseen * weighted.sum(1)
        self_partners = (itself * self.unseen)[:, None] / recipe_counts
        partners = pairs @ weighted + self_partners
        all_pairs = pairs + torch.diag(itself)
        components = dense * partners
        tables = torch.empty(len(RELATIONS), size, size, device=self.device)
        tables[COMBINES_WITH] = all_pairs.log()
        tables[COMPONENT_OF] = components.log()
        return tables


class KernelScorer(TableScorer):
    """A link scorer by kernel ridge regression: a closed-form solution without training steps.

    Both scores are the standardised regression of :func:`~.neighbours.regression.link_factors` by
    similarities; combinesWith adds half the standardised :func:`~.kernel.completion`, a score for
    ingredient pairs by known pairs with the same result. Do not pass test recipes.
    """

    def __init__(
        self,
        graph: RecipeGraph,
        recipes: Ids,
        vectors: NDArray[np.floating] | None = None,
        **kwargs: Any,
    ):
        """Compute the score table from training recipes.

        Args:
            graph: the graph that the ids belong to.
            recipes: training recipes, ids (n, 3), such as ``split.recipes("train")``.
            vectors: the entities' word vectors, shape (E, D), zeros for unknown words; None for
                scores by recipes alone.
            kwargs: ``device`` and ``name``, as in ``Scorer``.

        Raises:
            ConfigError: if the graph is too large for a score table, or the vectors do not have a
                row for each entity.
        """
        size = graph.num_entities
        check_table("the recipe kernel", size)
        if vectors is None:
            vectors = np.zeros((size, 0))
        if vectors.ndim != 2 or len(vectors) != size:
            raise ConfigError(
                f"`vectors` have shape {vectors.shape}; expected {size:,} rows, a row per entity. "
                "Make vectors from the graph's labels, by make_features."
            )
        norms = np.linalg.norm(vectors, axis=1, keepdims=True)
        units = (vectors / np.maximum(norms, _TINY)).astype(np.float32)
        rows = profiles(recipes, size).astype(np.float32)
        # All directions: with the recipe scorer's 256, the MRR is a quarter lower.
        factors, _ = link_factors(recipes, rows, units, rank=size)
        # Both terms are standardised first: their scales have nothing to do with each other.
        combines = standardised(factors.pair_left @ factors.right.T)
        combines += _COMPLETION * standardised(completion(recipes, size))
        component = standardised(factors.left @ factors.right.T)
        scores = torch.from_numpy(np.stack([combines, component])).float()
        settings = {"name": "recipe kernel", **kwargs}
        super().__init__(scores, graph.entities, graph.hash, **settings)
