"""Recipes of pairs that a book lacks: which pairs to look at, and how probable their results are.

``P(a + b -> c) = P(a combines with b) · P(c | a + b makes something)``. The first factor is the
calibrated probability of a link, the second a softmax at the fitted temperature over the results
that neighbours, and the pair encoder if there is one, propose. Among all pairs of a book this
product finds far more of the missing recipes than the curve of recipes, which is fitted to random
tables (docs/evidence/suggestions.md).

Candidates come from known recipes with an ingredient replaced by a similar one, so the cost grows
with recipes, not with pairs of entities.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, Ids, are_among, distinct, recipe_keys
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted, folds_of
from wordcraft_kg.models.scorers.neighbours.lists import Lists
from wordcraft_kg.models.scorers.neighbours.results import CANDIDATES, results_of
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.scorer import Scorer

Floats = NDArray[np.float64]

PAIRS = 5_000
"""Pairs, by their likeness to known pairs, whose link is scored. On `everyday` 5,000, 20,000 and
40,000 pairs give equally many removed recipes among the first 100."""
LIKELY = 1_000
"""Of these, the pairs whose results are scored: those that most probably combine."""
RESULTS = 16
"""Results that each side proposes for a pair of many."""
SHORTLIST = 150
"""Ingredients whose pairs are compared for a goal, by their link to it."""
GOAL_PAIRS = 300
"""Of their pairs, those with the best recipe scores for the goal."""
EVERY_PAIR = 300
"""Entities of which all pairs are looked at; of more, those like known pairs."""


class LikelyRecipes(NamedTuple):
    """Recipes with their probabilities, best first, and those of the pairs that they come from.

    Attributes:
        rows: ids, shape (n, 3), the smaller ingredient first.
        probabilities: shape (n,).
        combines: shape (m,), the probability that each pair makes something, best first.
    """

    rows: Ids
    probabilities: Floats
    combines: Floats


@dataclass(frozen=True)
class RecipeFinder:
    """Finds recipes of pairs outside a book.

    Attributes:
        scorer: a recipe scorer with calibrated probabilities.
        whole: its scorer of all train recipes.
        book: recipes that are no suggestions, ids of shape (n, 3).
        allows_self_results: whether a result may be its own ingredient.
    """

    scorer: CrossFitted
    whole: RecipeScorer
    book: Ids
    allows_self_results: bool = False

    @classmethod
    def of(cls, scorer: Scorer, book: Ids, *, allows_self_results: bool = False) -> "RecipeFinder":
        """Return the finder of a model.

        Args:
            scorer: scorer of the model.
            book: recipes of the book, which are not suggested.
            allows_self_results: whether a recipe may make one of its own ingredients.

        Raises:
            ConfigError: if the model has no probabilities.
        """
        folds = folds_of(scorer)
        probabilities = folds.probabilities if folds else None
        if folds is None or probabilities is None or probabilities.temperature is None:
            raise ConfigError(
                f"{scorer.name} has no probabilities: it was trained on all recipes, or without "
                "folds. Suggestions are ranked by them; train with `wordcraft-kg train-recipes` on "
                "a graph folder that has test recipes."
            )
        assert isinstance(folds.whole, RecipeScorer)
        return cls(folds, folds.whole, book, allows_self_results)

    @property
    def size(self) -> int:
        """Number of entities."""
        return len(self.scorer.entities)

    @cached_property
    def lists(self) -> Lists:
        """Neighbours of all entities."""
        return self.whole.knowledge.lists()

    @cached_property
    def learned(self) -> Ids:
        """Ingredients and results of the recipes that the model knows, ids of shape (3, n)."""
        # Lists have int32 ids, whose products would overflow.
        return np.array([self.lists.first, self.lists.second, self.lists.result], dtype=np.int64)

    @cached_property
    def known(self) -> Ids:
        """Keys of the book's recipes, ascending."""
        return np.sort(recipe_keys(*self.book.T, num_entities=self.size))

    @cached_property
    def known_pairs(self) -> Ids:
        """Keys of the book's pairs, ascending, one for each recipe."""
        return self.known // self.size

    @cached_property
    def again(self) -> float:
        """Share of the book's pairs that make several things: so often a known pair makes more."""
        pairs = distinct(self.known_pairs)
        several = distinct(self.known_pairs[1:][np.diff(self.known_pairs) == 0])
        return len(several) / max(len(pairs), 1)

    # --- pairs to look at, ids of shape (n, 2) ----------------------------------------------------

    def pairs_like_known(self) -> Ids:
        """Return unknown pairs that come from a known pair by a similar ingredient."""
        first, second, _ = self.learned
        return self._likeliest([self._replaced(first, second), self._replaced(second, first)])

    def pairs_with(self, item: int) -> Ids:
        """Return unknown pairs of an item: partners like its own, and those of similar items."""
        first, second, _ = self.learned
        is_own = (first == item) | (second == item)
        partners = (first + second - item)[is_own]
        parts = [self._replaced(partners, np.full_like(partners, item))]
        likeness = np.zeros(len(self.lists.norms))
        near = self.lists.used.ids[item]
        likeness[near[near >= 0]] = self.lists.used.alike[item][near >= 0]
        likeness[item] = 0
        for ingredient, partner in ((first, second), (second, first)):
            is_near = (likeness[ingredient] > 0) & (partner < self.size)
            keys = self._pair_keys(np.full(int(is_near.sum()), item), partner[is_near])
            parts.append((keys, likeness[ingredient[is_near]]))
        return self._likeliest(parts)

    def pairs_for(self, goal: int) -> Ids:
        """Return pairs with the best recipe scores for a goal, of the ingredients linked to it."""
        links = self.whole.score(torch.arange(self.size), COMPONENT_OF, goal)
        links[goal] = -torch.inf
        shortlist = torch.topk(links, min(SHORTLIST, self.size - 1)).indices.sort().values
        pairs = torch.tensor(list(combinations_with_replacement(shortlist.tolist(), 2)))
        scores = self.whole.score_recipes(pairs[:, 0], pairs[:, 1], torch.tensor(goal))
        best = torch.topk(scores, min(GOAL_PAIRS, len(pairs))).indices
        return pairs[best].numpy()

    def pairs_of(self, entities: Ids) -> Ids:
        """Return the unknown pairs of entities, in ascending order; of many those like known."""
        if len(entities) > EVERY_PAIR:
            pairs = self.pairs_like_known()
            return pairs[np.isin(pairs, entities).all(axis=1)]
        rows = np.array(list(combinations_with_replacement(np.sort(entities).tolist(), 2)))
        return rows[~are_among(self._pair_keys(*rows.T), self.known_pairs)]

    def _pair_keys(self, a: Ids, b: Ids) -> Ids:
        return np.minimum(a, b) * self.size + np.maximum(a, b)

    def _replaced(self, replaced: Ids, partners: Ids) -> tuple[Ids, Floats]:
        """Return keys and likeness of pairs with neighbours in place of an ingredient."""
        neighbours = self.lists.used.ids[replaced].astype(np.int64)
        partner_rows = np.broadcast_to(partners[:, None], neighbours.shape)
        # Entities of other books come last, and are none of this one.
        is_own = (neighbours >= 0) & (np.maximum(neighbours, partner_rows) < self.size)
        keys = self._pair_keys(neighbours[is_own], partner_rows[is_own])
        return keys, self.lists.used.alike[replaced][is_own].astype(np.float64)

    def _likeliest(self, parts: Sequence[tuple[Ids, Floats]]) -> Ids:
        """Return unknown pairs by their summed weights, best first, from parts of keys, weights."""
        keys = np.concatenate([part_keys for part_keys, _ in parts])
        weights = np.concatenate([part_weights for _, part_weights in parts])
        pairs = distinct(keys)
        totals = np.bincount(np.searchsorted(pairs, keys), weights, len(pairs))
        totals[are_among(pairs, self.known_pairs)] = 0
        best = np.argsort(-totals, kind="stable")[:PAIRS]
        best = best[totals[best] > 0]
        return np.column_stack(np.divmod(pairs[best], self.size))

    # --- their results ----------------------------------------------------------------------------

    def likely(self, pairs: Ids, *, goal: int | None = None) -> LikelyRecipes:
        """Return the recipes of pairs that the book lacks, the most probable first.

        Args:
            pairs: ids, shape (n, 2), the smaller first.
            goal: the only result to return; None for all.
        """
        combines = self._combines(pairs)
        order = np.argsort(-combines, kind="stable")[:LIKELY]
        pairs, combines = pairs[order], combines[order]
        a, b = torch.from_numpy(pairs.copy()).T.contiguous()
        knowledge = self.whole.knowledge
        # One pair has time for all of its candidates.
        number = CANDIDATES if len(pairs) == 1 else RESULTS
        results, scores = results_of(knowledge, a, b, number=number)
        if goal is not None and not knowledge.has_result_ranker:
            # Neighbours propose unseen goals seldom, and the recipe ranker scores them, too.
            goal_scores = self.whole.score_recipes(a, b, torch.tensor(goal))
            scores = torch.cat(
                [scores.masked_fill(results == goal, -torch.inf), goal_scores[:, None]], 1
            )
            results = torch.cat([results, torch.full((len(a), 1), goal)], 1)
        shares = self._shares(pairs, results.numpy(), scores)
        probabilities = np.clip(combines[:, None] * shares, 0, 1)
        is_listed = probabilities > 0
        if goal is not None:
            is_listed &= results.numpy() == goal
        row, column = np.nonzero(is_listed)
        values = probabilities[row, column]
        rows = np.column_stack([pairs[row], results.numpy()[row, column]])
        best = np.argsort(-values, kind="stable")
        return LikelyRecipes(rows[best], values[best], combines)

    def _combines(self, pairs: Ids) -> Floats:
        """Return the probability that each pair makes something outside the book, shape (n,)."""
        a, b = torch.from_numpy(pairs.copy()).T.contiguous()
        combines = self.scorer.probability(a, COMBINES_WITH, b).numpy().astype(np.float64)
        # The model remembers what a known pair makes, which is no evidence for more.
        combines[are_among(self._pair_keys(*pairs.T), self.known_pairs)] = self.again
        return combines

    def _shares(self, pairs: Ids, results: Ids, scores: torch.Tensor) -> Floats:
        """Return the probability of each result outside the book, if its pair makes one, (n, C)."""
        keys = recipe_keys(pairs[:, :1], pairs[:, 1:], results, num_entities=self.size)
        is_out = are_among(keys, self.known) | (results == self.size)
        if not self.allows_self_results:
            # Books drop such recipes.
            is_out |= (results[:, :, None] == pairs[:, None]).any(axis=2)
        probabilities = self.scorer.probabilities
        assert probabilities is not None
        assert probabilities.temperature is not None
        scores = scores.masked_fill(torch.from_numpy(is_out), -torch.inf)
        shares = torch.softmax(scores.double() / probabilities.temperature, 1)
        # A pair whose results are all known has no other: NaN.
        shares = shares.nan_to_num(0)
        covered = probabilities.covered
        return shares.numpy() * (covered if isinstance(covered, float) else 1.0)
