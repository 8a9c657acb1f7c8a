"""A player for open-ended play that knows another book's recipes, and learns from its attempts."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import expit, log_softmax, logsumexp

from wordcraft_kg.agents.discovery import BestPairDiscoverer, Floats, Pair
from wordcraft_kg.graphs import COMPONENT_OF, Ids
from wordcraft_kg.models.recipes.inductive import LabelledScorer

CANDIDATES = 16
"""Number of results per pair that the player considers; others are improbable."""
PRIOR = {
    "constant": (-9.0, 1.0),
    "results": (0.35, 0.005),
    "uses": (0.6, 0.0125),
    "strange": (1.0, 0.0625),
    "words": (1.2, 0.25),
    "recorded": (0.0, 1.0),
    "itself": (0.0, 0.25),
}
"""Mean and variance of each feature's weight before the first attempt.

Means come from pairs of ``everyday`` with a scorer of Little Alchemy 2, variances from exploring
``everyday``.

The feature ``uses`` counts a + a twice.

| feature | meaning |
|---|---|
| results | log Σ_c exp(score of a + b -> c) over candidate results c that are not known |
| uses | log(1 + recipes that use a) + log(1 + recipes that use b), in the scorer's book |
| strange | number of ingredients outside the scorer's book |
| words | word cosine of a and b |
| recorded | 1 if the scorer's book has a recipe of a + b |
| itself | 1 if a equals b |
"""
FREE = 5
"""Number of random attempts at the start of a run."""
COVER = 5
"""Every how many attempts the player uses an entity that it has tried least.

Everything may depend on one entity.
"""
DOUBT = 2.0
"""How much a candidate result loses by failed attempts, in nats for a factor e of failures.

Chosen on worlds of ``everyday`` with a scorer of Little Alchemy 2, by the area under the curve.
"""
# Results by componentOf scores, of which the CANDIDATES best by recipe scores are kept.
_LIKELY = 64
_NONE = -12.0  # score of a candidate that is known already
_STEPS = 3  # of Newton's method after each attempt; the weights change little
_STEP = 1.0  # largest change of a weight in a step


class RecipeDiscoverer(BestPairDiscoverer):
    """A player of pairs that probably make something new and useful; it learns from its attempts.

    A pair with features x (:data:`PRIOR`) makes something new with probability ``p = σ(w · x)``.
    After each attempt, w is the most probable value given the outcomes so far, success or failure,
    and normal priors (Bayesian logistic regression). The player tries the untried pair with the
    largest

    ``p(a, b) (1 + Σ_c P(c | a, b) log(1 + uses(c)))``.

    c runs over likely results that are not known. Its score loses ``DOUBT log(1 + n_c)``: n_c is
    the sum of P(c | a, b) over the attempts so far that made nothing new, since a world may lack
    things of the scorer's book, or make them otherwise. P is the softmax of their scores, and
    uses(c) counts recipes in the scorer's book that use c. The first :data:`FREE` attempts are
    random. Every :data:`COVER` attempts, only pairs with an entity in the fewest attempts count.

    The player knows the labels of known entities only. Candidate results come from the scorer's
    book alone.
    """

    def __init__(self, labelled: LabelledScorer):
        """Take a recipe scorer that describes the labels of all entities."""
        self._scorer, self._own, self._rows = labelled
        self._knowledge = self._scorer.knowledge
        self._uses = self._knowledge.log_uses().double().numpy()
        self._width = min(CANDIDATES, self._own)
        self._scored: dict[Pair, tuple[NDArray[np.int64], Floats]] = {}
        self._links: dict[int, torch.Tensor] = {}
        # Two columns: mean and variance of each weight.
        self._mean, self._variance = np.array(list(PRIOR.values())).T

    def begin(self, base: Sequence[int], rng: np.random.Generator) -> None:  # noqa: D102
        self._results = np.empty((0, self._width), dtype=np.int64)
        self._scores = np.empty((0, self._width))
        self._fixed = np.empty((0, len(PRIOR) - 1))
        self._is_known = np.zeros(self._own, dtype=bool)
        self._failures = np.zeros(self._own)
        self._attempts = np.zeros(len(self._rows), dtype=np.int64)
        # Features and outcome of each attempt so far.
        self._seen = np.empty((0, len(PRIOR)))
        self._made = np.empty(0)
        self._weights = self._mean.copy()
        super().begin(base, rng)

    def learn(self, entity: int) -> None:  # noqa: D102
        super().learn(entity)
        row = self._rows[entity]
        partners = self._rows[self.known]
        # Entities outside the scorer's book are never candidate results.
        if row < self._own:
            self._is_known[row] = True
        self._score(row, partners)
        scored = [self._scored[_ordered(row, partner)] for partner in partners.tolist()]
        results = [results_of_pair for results_of_pair, _ in scored]
        scores = [scores_of_pair for _, scores_of_pair in scored]
        partner_ids = torch.from_numpy(partners)
        # Entities of the pair that the scorer's book lacks.
        num_foreign = (partners >= self._own).astype(np.float64)
        if row >= self._own:
            num_foreign += 1
        # In the order of `PRIOR`, without its second feature.
        fixed = [
            np.ones(len(partners)),
            self._uses[row] + self._uses[partners],
            num_foreign,
            self._knowledge.word_cosines(row, partner_ids).numpy(),
            self._knowledge.have_recipes(row, partner_ids).numpy(),
            partners == row,
        ]
        self._results = np.concatenate([self._results, results])
        self._scores = np.concatenate([self._scores, scores])
        self._fixed = np.concatenate([self._fixed, np.column_stack(fixed)])

    def choose(self) -> Pair:  # noqa: D102
        pair = super().choose()
        number = np.array([self.chosen])
        scores = self._scores_of_new(number)
        self._expected = np.exp(log_softmax(scores[0]))
        self._seen = np.concatenate([self._seen, self._features(number, scores)])
        self._attempts[list(pair)] += 1
        return pair

    def values(self, untried: Ids) -> Floats:
        """Return the expected worth of n pairs by their numbers, shape (n,).

        All are equal in a random start; else they are positive, or -1 for pairs that do not count.
        """
        number = len(self._made) + 1
        if number <= FREE:
            return np.zeros(len(untried))
        scores = self._scores_of_new(untried)
        shares = np.exp(log_softmax(scores, axis=1))
        uses = self._uses[self._results[untried]]
        gains = 1 + (shares * uses).sum(axis=1)
        chances = expit(self._features(untried, scores) @ self._weights)
        values = chances * gains
        if number % COVER == 0:
            attempts = self._attempts[self.pairs[untried]].min(axis=1)
            values[attempts > attempts.min()] = -1
        return np.asarray(values)

    def _scores_of_new(self, pairs: Ids) -> Floats:
        """Return the scores of the results of n pairs as new entities, (n,) -> (n, width)."""
        # A result that was expected in vain is less likely with every pair.
        doubt = DOUBT * np.log1p(self._failures)
        results = self._results[pairs]
        doubted = self._scores[pairs] - doubt[results]
        # A known result is nothing new; -inf would make a pair without other candidates undefined.
        return np.where(self._is_known[results], _NONE, doubted)

    def _features(self, pairs: Ids, scores: Floats) -> Floats:
        """Return the features of n pairs, shape (n, len(PRIOR)), by :meth:`_scores_of_new`."""
        # The second feature changes with each attempt; all others stay.
        return np.insert(self._fixed[pairs], 1, logsumexp(scores, axis=1), axis=1)

    def observe(self, pair: Pair, new: Sequence[int]) -> None:  # noqa: D102
        if not new:
            self._failures[self._results[self.chosen]] += self._expected
        self._made = np.append(self._made, len(new) > 0)
        self._fit()
        super().observe(pair, new)

    def _score(self, row: int, partners: NDArray[np.int64]) -> None:
        """Keep likely results with each partner and their scores, which are equal in all runs."""
        unscored = [
            row_of_partner
            for row_of_partner in dict.fromkeys(partners.tolist())
            if _ordered(row, row_of_partner) not in self._scored
        ]
        if not unscored:
            return
        # A result that is likely by the links of both ingredients is scored as a recipe.
        fit = self._links_of([row]) + self._links_of(unscored)
        candidates = fit[:, : self._own].topk(min(_LIKELY, self._own), dim=1).indices
        # Shape (n, 1), against the n rows of likely results.
        partner_ids = torch.tensor(unscored)[:, None]
        scored = self._scorer.score_recipes(torch.tensor(row), partner_ids, candidates)
        scores, best = scored.topk(self._width, dim=1)
        results = candidates.gather(1, best)
        scored_pairs = zip(unscored, results.numpy(), scores.numpy(), strict=True)
        for partner, results_of_pair, scores_of_pair in scored_pairs:
            self._scored[_ordered(row, partner)] = (results_of_pair, scores_of_pair)

    def _links_of(self, entities: Sequence[int]) -> torch.Tensor:
        """Return componentOf scores of n entities, (n, E), each computed once."""
        new = [entity for entity in dict.fromkeys(entities) if entity not in self._links]
        if new:
            every = torch.arange(self._knowledge.num_entities)
            scores = self._knowledge.link_scores(COMPONENT_OF, torch.tensor(new), every)
            self._links |= zip(new, scores, strict=True)
        return torch.stack([self._links[entity] for entity in entities])

    def _fit(self) -> None:
        weights = self._weights
        for _ in range(_STEPS):
            chances = expit(self._seen @ weights)
            # Gradient and Hessian of the negative log posterior: data, then the normal prior.
            data_gradient = self._seen.T @ (chances - self._made)
            prior_gradient = (weights - self._mean) / self._variance
            gradient = data_gradient + prior_gradient
            variances = chances * (1 - chances)
            curvature = (self._seen.T * variances) @ self._seen
            hessian = curvature + np.diag(1 / self._variance)
            step = np.linalg.solve(hessian, gradient)
            # Newton's method overshoots where outcomes are all equal, so steps are limited.
            excess = np.abs(step).max() / _STEP
            weights = weights - step / max(1.0, excess)
        self._weights = weights


def _ordered(first: int, second: int) -> Pair:
    return (first, second) if first <= second else (second, first)
