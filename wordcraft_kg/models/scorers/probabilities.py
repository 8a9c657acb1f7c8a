"""Probabilities: how likely are triples and recipes that a scorer was not trained on?

Train recipes are cut into folds; each fold has a model trained without the fold. What this model
was not trained on may be true: a recipe of the fold gives it, or a recipe outside train. How often
that is so depends on the score s. Both kinds of probability are a sigmoid, ``P = σ(α + Σ_i β_i
s_i)`` with slopes ``β_i >= 0``, fitted to histograms of scores by maximum likelihood
(:func:`fit_sigmoid`), so a higher score is never less probable.

Triples. Models of different folds have different scales, so a score enters as its rank log-odds t,
the log-odds of its percentile rank among all pairs of different entities outside the train triples.
Each relation has a :class:`Curve` with three slopes for pairs of different entities, and one with a
single slope for self pairs (equal entities). A fold's model has not seen the fold's triples, which
are a share c of all true unseen triples. The rest belongs to recipes outside train, which nothing
here reads, and looks false. So the fit maximises the likelihood of ``P(labelled | t) = c P(true |
t)``. The main model has seen the folds' triples, which therefore no longer are among its
candidates; by Bayes' rule ``α`` falls by ``-log(1 - c)`` for the remaining triples.

Recipes. A recipe that the model was trained on has probability 1. Any other recipe has an
intercept for its kind: does any train recipe make the result? So a book's habits count: in a
by-goal split, a goal that train recipes make has no unseen recipe. Whether the pair makes anything
at all is left to the score: among random pairs such pairs are those of frequent entities, which
says nothing on a table, where frequent entities abound.

Results. A softmax turns recipe scores into a distribution over results, given that the pair makes
something; the temperature maximises the likelihood of the folds' recipes (Guo et al. 2017).

The page docs/explanation/recipe-scorer.md has the formulas under *Probabilities*, and
docs/explanation/planning.md uses those of recipes.

Source: Platt 1999 (the sigmoid); Elkan and Noto 2008 (partially labelled positives); Saerens,
Latinne and Decaestecker 2002 (change of base rate); King and Zeng 2001 (weights for sampled
negatives).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.special import expit, logsumexp
from threadpoolctl import threadpool_limits
from torch import Tensor, nn

from wordcraft_kg.base.records import Coefficient, Count, Record, Share, Slope
from wordcraft_kg.graphs import RELATIONS, Folds, Ids, distinct, is_in, recipe_keys
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.neighbours.pair_features import only_pair, pairs_of
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.ranking import sampled
from wordcraft_kg.models.scorers.recipes import RecipeScorer

SEGMENTS = (3.0, 6.0)
"""Log-odds at which the slope may change: the best 5 % and the best .25 % of all pairs.

Against a single slope, they lower the log loss of the cross-fitted kernel regression on test links
by .3 to 3 % (Little Alchemy 2 and `everyday`, splits 10 and 11, both relations), with a 95 %
interval (2,000 resamples of tails) above 0 in seven of the eight cases.
"""
MAX_CELLS = 2**19
"""Pairs of different entities scored per relation; more pairs are sampled uniformly."""
_HEADS = 4_096
"""Entities whose pairs are sampled in a larger book."""
MOST_OF_FOLD = 2**16
"""Most recipes of a fold, and most of its triples of a relation, that are scored.

A curve has at most four parameters; more would take minutes in a book of millions of recipes.
"""
_MIN_TRUE = 10
"""Fewest true and fewest false triples for a curve; below, only the base rate is fitted."""
_NO_SLOPE = 1e-6
"""Largest slope that counts as none."""
_KNOTS = 257
"""Stored scores that map a model's scores to log-odds."""
_RIDGE = 1e-3
"""Weight of squared parameters in the loss: those of a kind without data stay finite."""
_PAIRS = 2**15
"""Recipes scored per fold to fit the temperature."""
_PROPOSED_PAIRS = 400
"""Pairs of a fold whose proposed results are scored."""
KINDS = 2
"""Kinds of recipes, by number: whether a train recipe makes the result."""
SAMPLED = 2_500
"""Results of a fold that are scored on random tables, about."""
_FEWEST_TABLES = 4
"""Fewest sampled tables of a fold; in a large book, results are sampled instead."""
_SLOTS = 12
"""Entities on a sampled table."""

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Bins:
    """Bins of a histogram of scores; scores beyond the ends count in the first and last bin.

    Attributes:
        low: centre of the first bin.
        high: centre of the last bin.
        width: distance of two centres.
    """

    low: float
    high: float
    width: float

    @property
    def centres(self) -> _Floats:
        """Centres of the bins, shape (B,)."""
        # Half a bin beyond the end, so that the end is one of them.
        return np.arange(self.low, self.high + self.width / 2, self.width)

    def numbers(self, scores: _Floats) -> Ids:
        """Return the number of the bin in which each score falls, with the shape of ``scores``."""
        widths = (np.clip(scores, self.low, self.high) - self.low) / self.width
        return np.rint(widths).astype(np.int64)


LOG_ODDS = Bins(-16.0, 16.0, 0.01)
"""Bins of rank log-odds; :data:`MAX_CELLS` pairs reach 13.9."""
NATS = Bins(-20.0, 30.0, 0.05)
"""Bins of recipe scores."""


class Curve(Record, frozen=True, kw_only=True):
    """The probability that a triple is true, by rank log-odds t: ``σ(α + Σ_i β_i s_i(t))``.

    With q the percentile rank among entity pairs, ``t = log(q / (1 - q))``; ``s_i`` is the part of
    t in the i-th segment, an interval between :data:`SEGMENTS`. The curve is for the model trained
    on all folds.

    Attributes:
        intercept: α, for triples outside the train triples.
        slopes: β by segment, or a single slope; 0 for the base rate only.
        rate: base rate, the probability without scores.
        true: number of true triples in the fit.
        cells: number of triples in the fit, true or not.
        reason: why only the base rate was fitted, else empty.
    """

    intercept: Coefficient
    slopes: tuple[Slope, ...] = (0.0,)
    rate: Share
    true: Count
    cells: Count
    reason: str = ""

    def __post_init__(self) -> None:
        if len(self.slopes) not in (1, len(SEGMENTS) + 1):
            raise ValueError(f"{len(self.slopes)} `slopes`")

    def probability(self, log_odds: _Floats) -> _Floats:
        """Return probabilities, with the shape of ``log_odds`` (from :func:`rank_log_odds`)."""
        parts = _segments(log_odds, len(self.slopes))
        return np.asarray(expit(self.intercept + parts @ np.array(self.slopes)))


class RelationCurves(Record, frozen=True, kw_only=True):
    """Calibration for a relation: from scores to rank log-odds to probabilities.

    Attributes:
        known_share: c, the labelled share among all true triples that a fold's model has not seen.
        scores: score quantiles for the model trained on all folds, ascending; at least one.
        rank_log_odds: each quantile's percentile rank, as log-odds; never falling.
        distinct: curve for pairs of different entities.
        itself: curve for self pairs (head and tail are equal).
    """

    known_share: Share
    scores: Annotated[tuple[Coefficient, ...], msgspec.Meta(min_length=1)]
    rank_log_odds: tuple[Coefficient, ...]
    distinct: Curve
    itself: Curve

    def __post_init__(self) -> None:
        if len(self.scores) != len(self.rank_log_odds):
            raise ValueError(
                f"{len(self.scores)} `scores` for {len(self.rank_log_odds)} `rank_log_odds`"
            )
        # Between scores in another order, interpolation returns any number.
        for name, values in (("scores", self.scores), ("rank_log_odds", self.rank_log_odds)):
            if list(values) != sorted(values):
                raise ValueError(f"`{name}` that are not ascending")


class RecipeCurve(Record, frozen=True, kw_only=True):
    """The probability ``σ(α_kind + β s)`` of a recipe with the score s, in nats.

    Attributes:
        intercepts: α of each kind, see :data:`KINDS`, in nats.
        slope: β, 0 or more.
        shift: is added to α for the model trained on all folds, which leaves another number of
            recipes unseen.
    """

    intercepts: tuple[Coefficient, Coefficient]
    slope: Slope
    shift: Coefficient

    def log_probabilities(
        self,
        knowledge: RecipeKnowledge,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        pairs: tuple[Tensor, Tensor] | None = None,
        *,
        prior: float = 0.0,
    ) -> Tensor:
        """Return the log-probability that each pair of slots makes the goal.

        Args:
            knowledge: features and rankers of M models.
            goal: ids, shape (B,).
            table: entity ids in the slots, shape (B, A), E for empty slots.
            model: which model to use, shape (B,). Model 0 was trained on all folds, all further
                ones without a fold.
            pairs: first and second slot of P pairs, shape (P,) each; None for all pairs.
            prior: is added to α, in nats, for results that are more likely than results of random
                pairs.

        Returns:
            shape (B, P), in nats: 0 for known recipes. Pairs with an empty slot have no meaning.
        """
        features = knowledge.features(goal, table, model, pairs)
        scores = knowledge.ranker().of_models(features, model)
        intercepts = torch.tensor(self.intercepts, device=scores.device)
        kinds = knowledge.kinds(features)
        shift = torch.where(model == 0, self.shift, 0.0)[:, None] + prior
        log_odds = intercepts[kinds] + shift + self.slope * scores
        is_trained_on = knowledge.feature(features, "makes") > 0
        # A known recipe is certain: log 1 = 0.
        return nn.functional.logsigmoid(log_odds).masked_fill(is_trained_on, 0)


@dataclass(frozen=True)
class HeldOut:
    """Scores by a fold's model of what this model was not trained on.

    Attributes:
        positives: shape (2, 2, B): the fold's triples, counted by relation, self pair (0 or 1) and
            bin of :data:`LOG_ODDS`.
        unlabelled: as ``positives``, for triples outside the train triples; weighted if sampled.
        results: shape (N, C): scores of C candidates for N pairs sampled from the fold, with -inf
            where there are fewer; empty without recipe scores.
        is_right: shape (N, C), bool: whether the pair makes the candidate; empty likewise.
        recipes: see :func:`recipe_histogram`; empty likewise.
        proposes: whether the candidates are proposed results, not all entities.
    """

    positives: _Floats
    unlabelled: _Floats
    results: _Floats = field(default_factory=lambda: np.zeros((0, 0)))
    is_right: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))
    recipes: _Floats = field(default_factory=lambda: np.zeros(0))
    proposes: bool = False


class Probabilities(Record, frozen=True, kw_only=True):
    """The file ``calibration.json``: from scores to probabilities outside the training data.

    Attributes:
        format: name and version of the file format.
        relations: curves for combinesWith and componentOf, by relation id.
        temperature: recipe scores are divided by this number before the softmax over results; None
            without recipe scores.
        recipes: curve for recipes; None without recipe scores.
        covered: share of a fold's pairs with a result among those that the scorer proposes; absent
            if it scores all entities.
    """

    format: Literal["wordcraft-kg calibration 1"] = "wordcraft-kg calibration 1"
    relations: tuple[RelationCurves, RelationCurves]
    temperature: Annotated[float, msgspec.Meta(ge=1e-3, le=1e3)] | None = None
    recipes: RecipeCurve | None = None
    covered: Share | msgspec.UnsetType = msgspec.UNSET

    @classmethod
    def fit(
        cls,
        whole: TripleScorer,
        folds: Folds,
        held_out: Sequence[HeldOut],
        *,
        seed: int = 0,
    ) -> "Probabilities":
        """Fit probability curves for the model trained on all folds.

        Args:
            whole: the model trained on all folds.
            folds: the folds; recipes outside train are only counted, never read.
            held_out: scores by each fold's model, from :func:`score_fold`.
            seed: seed of the sampled pairs, among which scores are ranked.

        Returns:
            the curves of both relations; temperature and curve of recipes for a recipe scorer.
        """
        size = len(whole.entities)
        train = folds.triples()
        # By fold, relation, self pair or not, and bin: shape (K, 2, 2, B).
        positives = np.stack([part.positives for part in held_out])
        unlabelled = np.stack([part.unlabelled for part in held_out])
        curves: list[RelationCurves] = []
        for relation in range(len(RELATIONS)):
            share = known_share(folds, relation)
            cells, _ = _cells(size, relation, seed)
            # Self pairs do not count in ranks: most scorers set them apart from all other pairs.
            is_new = ~is_in(cells, train, size) & (cells[:, 0] != cells[:, 2])
            scores, log_odds = _score_map(_scores(whole, cells[is_new]))
            curves.append(
                RelationCurves(
                    known_share=share,
                    scores=scores,
                    rank_log_odds=log_odds,
                    distinct=fit_curve(
                        positives[:, relation, 0], unlabelled[:, relation, 0], share
                    ),
                    # There are only E self pairs, too few for a slope in each segment.
                    itself=fit_curve(
                        positives[:, relation, 1], unlabelled[:, relation, 1], share, 1
                    ),
                )
            )
        relations = (curves[0], curves[1])
        if not len(held_out[0].recipes):
            return cls(relations=relations)
        temperature, covered = _fit_results(held_out)
        return cls(
            relations=relations,
            temperature=temperature,
            recipes=fit_recipe_curve([part.recipes for part in held_out], folds),
            covered=covered if held_out[0].proposes else msgspec.UNSET,
        )

    def predict(self, scores: Tensor, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        """Return the probabilities of triples outside the training data.

        Args:
            scores: scores by the model trained on all folds.
            heads: entity ids.
            relations: relation ids.
            tails: entity ids; the four arguments broadcast against each other.

        Returns:
            float32, with the broadcast shape, on the scores' device.
        """
        together = torch.broadcast_tensors(scores, heads, relations, tails)
        values, head, number, tail = (part.cpu().numpy() for part in together)
        is_self = head == tail
        probabilities = np.empty(values.shape, dtype=np.float32)
        for relation, curves in enumerate(self.relations):
            # Linear between the stored quantiles, constant beyond the first and the last.
            log_odds = np.interp(values, curves.scores, curves.rank_log_odds)
            for curve, is_kind in ((curves.distinct, ~is_self), (curves.itself, is_self)):
                cells = (number == relation) & is_kind
                probabilities[cells] = curve.probability(log_odds[cells])
        return torch.from_numpy(probabilities).to(scores.device)


# --- a fold's scores ------------------------------------------------------------------------------


def score_fold(scorer: TripleScorer, folds: Folds, fold: int, *, seed: int = 0) -> HeldOut:
    """Count a fold's triples and unlabelled triples by the scores of the model without the fold.

    Triples of the remaining folds are left out, because the model remembers them.

    Args:
        scorer: the model trained without the fold.
        folds: the folds; recipes outside train are not read.
        fold: number of the fold, from 0.
        seed: seed of the sample of pairs, if there are more than :data:`MAX_CELLS`.

    Returns:
        histograms of both relations; scores of results and recipes for a recipe scorer.
    """
    size = len(scorer.entities)
    train = folds.triples()
    trained_on = folds.triples([fold])
    held_out = train[~is_in(train, trained_on, size)]
    num_bins = len(LOG_ODDS.centres)
    positives = np.zeros((2, 2, num_bins))
    unlabelled = np.zeros((2, 2, num_bins))
    for relation in range(len(RELATIONS)):
        cells, weights = _cells(size, relation, seed)
        # Ranks exclude the fold's triples, because the main model, whose scores are calibrated, has
        # seen these triples.
        is_new = ~is_in(cells, train, size)
        cells = cells[is_new]
        weights = weights[is_new]
        scores = _scores(scorer, cells)
        is_self = cells[:, 0] == cells[:, 2]
        ranked = scores[~is_self]
        fold_triples = held_out[held_out[:, 1] == relation]
        sample = sampled(fold_triples, MOST_OF_FOLD, seed)
        # In a large book, each sampled triple stands for several.
        weight = len(fold_triples) / max(len(sample), 1)
        for counts, rows, values, weight_of_row in (
            (positives, sample, _scores(scorer, sample), np.full(len(sample), weight)),
            (unlabelled, cells, scores, weights),
        ):
            bins = LOG_ODDS.numbers(rank_log_odds(values, ranked))
            # Pairs of different entities have number 0, self pairs 1.
            kinds = (rows[:, 0] == rows[:, 2]).astype(np.int64)
            np.add.at(counts[relation], (kinds, bins), weight_of_row)
    if not isinstance(scorer, RecipeScorer):
        return HeldOut(positives, unlabelled)
    results, is_right = _candidates(scorer, folds, fold, seed)
    recipes = recipe_histogram(scorer, folds, fold, seed=seed)
    return HeldOut(positives, unlabelled, results, is_right, recipes, scorer.proposes_results)


def known_share(folds: Folds, relation: int) -> float:
    """Return c, a fold's share among all true triples that are new to the model without the fold.

    The recipes outside train are expected to give new triples as a fold's recipes do, but fewer for
    each recipe, because more triples are known already. ``c = m / (m + m')``: a fold has m new
    triples on average; the recipes outside train have an estimated ``m' = m (outside / n_fold) (K /
    (K - 1))^-p``, for K folds with ``n_fold`` recipes each and ``outside`` recipes outside train.
    The power p says how fast the number of new triples falls with more training recipes; it comes
    from leaving out one and two folds. Recipes outside train are counted, not read.
    """
    count = folds.count
    is_train = folds.seen()
    outside = float(np.sum(~is_train))
    fold_size = float(np.sum(is_train)) / count

    def new(fold: int, *further: int) -> float:
        """Count the fold's triples that are new to a model without it and ``further`` folds."""
        triples = folds.triples_of(fold)
        triples = triples[triples[:, 1] == relation]
        trained_on = folds.triples([fold, *further])
        return float(np.sum(~is_in(triples, trained_on, folds.split.graph.num_entities)))

    without_one = sum(new(fold) for fold in range(count))
    falling = 1.0
    # Two folds leave no recipes after leaving out two, so p is 0 and nothing falls.
    if count > 2 and without_one:
        without_two = sum(new(fold, (fold + 1) % count) for fold in range(count))
        # How the numbers of new triples and of training recipes change from two left out to one.
        fewer_new = math.log(without_two / without_one)
        more_recipes = math.log((count - 1) / (count - 2))
        power = fewer_new / more_recipes
        # From one fold left out to none.
        growth = count / (count - 1)
        falling = growth**-power
    return 1 / (1 + outside / fold_size * falling)


def recipe_histogram(scorer: RecipeScorer, folds: Folds, fold: int, *, seed: int = 0) -> _Floats:
    """Count scores of recipes that the scorer has not seen, by kind.

    Args:
        scorer: trained without ``fold``.
        folds: folds of the train recipes.
        fold: number of the fold that the scorer was trained without.
        seed: seed of the random tables.

    Returns:
        shape (KINDS, 2, bins of :data:`NATS`). Axis 1: pairs on random tables with each result,
        without train recipes, weighted so that they stand for all pairs; and the recipes of the
        fold.
    """
    size = len(scorer.entities)
    counts = np.zeros((KINDS, 2, len(NATS.centres)))
    train_keys = recipe_keys(*folds.recipes().T, num_entities=size)

    def cells_of(
        goal: Tensor, table: Tensor, pairs: tuple[Tensor, Tensor] | None
    ) -> tuple[Ids, Ids]:
        """Return kinds and bins of slot pairs (P,) of tables (B, A) for goals (B,): (B, P) each."""
        scores, kinds = scorer.score_pairs(goal, table, pairs)
        return kinds.cpu().numpy(), NATS.numbers(scores.cpu().numpy())

    with torch.no_grad():
        fold_recipes = folds.recipes_of(fold)
        sample = sampled(fold_recipes, MOST_OF_FOLD, seed)
        recipes = torch.from_numpy(sample.copy())
        # A recipe is a table of two slots.
        cells = cells_of(recipes[:, 2], recipes[:, :2], only_pair(recipes.device))
        # Unlike `counts[cells] += 1`, `add.at` counts a cell each time it occurs. In a large book,
        # each sampled recipe stands for several.
        np.add.at(counts[:, 1], cells, len(fold_recipes) / max(len(sample), 1))

        num_slots = min(_SLOTS, size)
        num_tables = max(SAMPLED // size, _FEWEST_TABLES)
        rng = np.random.default_rng([seed, fold])
        goals = torch.arange(size)
        max_goals = SAMPLED // _FEWEST_TABLES
        if size > max_goals:
            goals = torch.from_numpy(rng.permutation(size)[:max_goals])
        weights = _pair_weights(num_slots, size, num_tables * len(goals) / size)
        for _ in range(num_tables):
            slots = torch.from_numpy(rng.permutation(size)[:num_slots])
            kinds, bins = cells_of(goals, slots.expand(len(goals), num_slots), None)
            first, second = pairs_of(num_slots, slots.device)
            a = slots[None, first].numpy()
            b = slots[None, second].numpy()
            results = goals.numpy()[:, None]
            is_train = np.isin(recipe_keys(a, b, results, num_entities=size), train_keys)
            # A result on the table is no goal, and no task teaches the ranker that a + b makes
            # no a.
            is_counted = ~is_train & (a != results) & (b != results)
            weight_of_pair = np.broadcast_to(weights, bins.shape)
            cells = (kinds[is_counted], bins[is_counted])
            np.add.at(counts[:, 0], cells, weight_of_pair[is_counted])
    return counts


def _pair_weights(num_slots: int, size: int, tables: float) -> _Floats:
    """Return how many pairs of entities each slot pair of a random table stands for, shape (P,).

    A sampled result stands for several results, so ``tables`` is the number of tables for each of
    all results, and may be a fraction.
    """
    first, second = pairs_of(num_slots, torch.device("cpu"))
    # Pairs of an entity with itself are far rarer than others, but not on a table: each has its own
    # weight.
    is_self = (first == second).numpy()
    num_pairs = size * (size - 1) / 2
    distinct_weight = num_pairs / max((~is_self).sum() * tables, 1)
    self_weight = size / (num_slots * tables)
    return np.where(is_self, self_weight, distinct_weight)


def _candidates(
    scorer: RecipeScorer, folds: Folds, fold: int, seed: int
) -> tuple[_Floats, NDArray[np.bool_]]:
    """Return scores of candidates for sampled pairs of a fold, (N, C), and which are right."""
    size = len(scorer.entities)
    recipes = folds.recipes_of(fold)
    # A pair with several results is asked once, and has several right answers.
    pairs = np.unique(recipes[:, :2], axis=0)
    # Where a pair has a score for each entity, there are fewer pairs in larger graphs.
    number = _PROPOSED_PAIRS if scorer.proposes_results else max(_PAIRS // size, 1)
    rng = np.random.default_rng([seed, fold])
    a, b = pairs[rng.permutation(len(pairs))[:number]].T
    with torch.no_grad():
        ids, scores = scorer.candidate_results(torch.from_numpy(a), torch.from_numpy(b))
    # A key for each recipe, also for the id E of missing candidates.
    keys = recipe_keys(a[:, None], b[:, None], ids.cpu().numpy(), num_entities=size + 1)
    right_keys = recipe_keys(*recipes.T, num_entities=size + 1)
    return scores.cpu().numpy().astype(np.float64), np.isin(keys, right_keys)


# --- curves ---------------------------------------------------------------------------------------


def fit_sigmoid(
    positives: _Floats,
    unlabelled: _Floats,
    inputs: _Floats,
    start: Sequence[float],
    *,
    share: float = 1.0,
) -> _Floats:
    """Fit ``P(true | s) = σ(α_k + Σ_i β_i s_i)`` to histograms of K kinds, by maximum likelihood.

    Of the true ones only a ``share`` c is labelled, so ``P(positive | s) = c P(true | s)``.

    Args:
        positives: counts by kind and bin, shape (K, B).
        unlabelled: the same for all else, among which a share of 1 - c of the true ones is.
        inputs: s_i at the centres of the bins, shape (B, S).
        start: α of each kind and all β_i, from which the search starts.
        share: c, above 0 and at most 1.

    Returns:
        α of each kind and all β_i, shape (K + S,).
    """
    num_kinds = len(positives)
    # log 0 where all true ones are labelled: then nothing unlabelled is true.
    with np.errstate(divide="ignore"):
        log_missed = np.log1p(-share)

    def loss(values: _Floats) -> tuple[float, _Floats]:
        """Return the regularised negative log-likelihood in nats, and its gradient."""
        log_odds = values[:num_kinds, None] + inputs @ values[num_kinds:]
        log_true = -np.logaddexp(0, -log_odds)
        log_false = -np.logaddexp(0, log_odds)
        log_positive = math.log(share) + log_true
        log_unlabelled = np.logaddexp(log_false, log_missed + log_true)
        likelihood = positives * log_positive + unlabelled * log_unlabelled
        # Derivatives by the log-odds, in logarithms, so that no quotient is 0 / 0.
        positive_error = positives * np.exp(log_false)
        unlabelled_error = unlabelled * np.exp(log_positive + log_false - log_unlabelled)
        error = unlabelled_error - positive_error
        gradient = np.append(error.sum(axis=1), error.sum(axis=0) @ inputs)
        penalty = _RIDGE / 2 * values @ values
        return float(penalty - likelihood.sum()), gradient + _RIDGE * values

    # A higher score is never less probable, so slopes are bounded.
    bounds = [(None, None)] * num_kinds + [(0, None)] * inputs.shape[1]
    # A fit of few numbers takes 28 times as long with two threads of BLAS, which wait for each
    # other at every step.
    with threadpool_limits(1, user_api="blas"):
        fit = minimize(loss, np.array(start), jac=True, method="L-BFGS-B", bounds=bounds)
    return np.asarray(fit.x)


def fit_curve(
    positives: _Floats,
    unlabelled: _Floats,
    share: float,
    num_slopes: int = len(SEGMENTS) + 1,
) -> Curve:
    """Fit a probability curve to score histograms, or only the base rate if scores say nothing.

    Args:
        positives: shape (K, B): the folds' triples by fold and bin of :data:`LOG_ODDS`.
        unlabelled: shape (K, B): the remaining triples, which include unknown true triples.
        share: share of ``positives`` among all true triples, from :func:`known_share`.
        num_slopes: number of segments with separate slopes.

    Returns:
        the curve for the model trained on all folds.
    """
    # Together the folds are a single kind.
    labelled = positives.sum(axis=0, keepdims=True)
    is_rest = unlabelled.sum(axis=0, keepdims=True)
    num_positives = float(labelled.sum())
    total = num_positives + float(is_rest.sum())
    # The base rate with half a triple added: nothing is impossible. With the unknown triples among
    # the true ones it is larger than the share of labelled triples, up to a half.
    labelled_rate = (num_positives + 0.5) / (total + 1)
    rate = min(labelled_rate / share, 0.5)
    base = math.log(rate / (1 - rate))
    # The main model has seen the folds' triples, so only the share 1 - c of the true triples is
    # left.
    shift = math.log1p(-share)
    curve = Curve(
        intercept=base + shift,
        rate=float(expit(base + shift)),
        true=round(num_positives),
        cells=round(total),
    )
    if min(num_positives, total - num_positives) < _MIN_TRUE:
        reason = (
            f"{num_positives:,.0f} true triples among {total:,.0f} are too few for more than a "
            "base rate"
        )
        return msgspec.structs.replace(curve, reason=reason)
    inputs = _segments(LOG_ODDS.centres, num_slopes)
    start = [base] + [0.1] * num_slopes
    intercept, *slopes = fit_sigmoid(labelled, is_rest, inputs, start, share=share).tolist()
    # Bounded by 0, where the search ends up to rounding.
    if max(slopes) < _NO_SLOPE:
        reason = (
            f"scores do not separate the {num_positives:,.0f} true triples of left-out folds from "
            "false triples"
        )
        return msgspec.structs.replace(curve, reason=reason)
    return msgspec.structs.replace(curve, intercept=intercept + shift, slopes=tuple(slopes))


def fit_recipe_curve(histograms: Sequence[_Floats], folds: Folds) -> RecipeCurve:
    """Fit a curve to each fold's :func:`recipe_histogram`, by maximum likelihood."""
    counts = np.sum(histograms, axis=0)
    # Few pairs make a given result, so the search starts at small probabilities.
    start = (-12.0,) * KINDS + (1.0,)
    fit = fit_sigmoid(counts[:, 1], counts[:, 0], NATS.centres[:, None], start)
    new_goal, known_goal, slope = fit.tolist()
    # The curve was fitted where a fold's recipes are unseen, seen / count of them on average. With
    # all folds, the recipes outside train are.
    is_seen = folds.seen()
    num_seen = max(int(is_seen.sum()), 1)
    num_unseen = max(int((~is_seen).sum()), 1)
    shift = math.log(num_unseen * folds.count / num_seen)
    return RecipeCurve(intercepts=(new_goal, known_goal), slope=slope, shift=shift)


def _fit_results(held_out: Sequence[HeldOut]) -> tuple[float, float]:
    """Return how results of pairs become probabilities.

    Returns:
        the temperature whose softmax gives a right result the highest likelihood; and the share of
        pairs with a right result among the candidates.
    """
    scores = np.concatenate([part.results for part in held_out])
    is_right = np.concatenate([part.is_right for part in held_out])
    # A pair whose result nobody proposes says nothing about the proposed ones.
    has_right = is_right.any(axis=1)
    covered = float(np.mean(has_right))
    if not has_right.any():
        # In a book whose results nothing foretells, the share of covered pairs is 0, and so is
        # each probability, at any temperature.
        return 1.0, covered
    scores = scores[has_right]
    is_right = is_right[has_right]

    def loss(log_temperature: float) -> float:
        scaled = scores * math.exp(-log_temperature)
        # A pair may have several results: the probability that one of them is drawn.
        right_mass = logsumexp(np.where(is_right, scaled, -np.inf), axis=1)
        return float(np.mean(logsumexp(scaled, axis=1) - right_mass))

    best = minimize_scalar(loss, bounds=(-4.0, 4.0), method="bounded")
    return math.exp(best.x), covered


# --- ranks and samples ----------------------------------------------------------------------------


def rank_log_odds(scores: _Floats, among: _Floats) -> _Floats:
    """Return ``log(q / (1 - q))`` for percentile ranks q within ``among``; ties count half.

    The result has the shape of ``scores`` and is finite, also beyond the best and the worst of
    ``among``.
    """
    ordered = np.sort(among)
    count = len(among)
    # In ascending order, one search after the other ends nearby in memory: four times faster.
    order = np.argsort(scores, axis=None)
    ascending = scores.ravel()[order]
    below = np.searchsorted(ordered, ascending, "left")
    not_above = np.searchsorted(ordered, ascending, "right")
    above = np.empty(scores.shape)
    above.flat[order] = count - (below + not_above) / 2
    # Half a pair away from 0 and 1, whose log-odds are infinite.
    lowest = 0.5 / (count + 1)
    share = (above + 0.5) / (count + 1)
    rank = np.clip(share, lowest, 1 - lowest)
    return np.asarray(np.log1p(-rank) - np.log(rank))


def _score_map(scores: _Floats) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return quantiles of scores, ascending, and their rank log-odds: the map of a relation."""
    if not len(scores):
        return (0.0,), (0.0,)
    # Quantiles at equal distances in log-odds, because true triples are among the very highest
    # scores.
    end = math.log(2 * len(scores) + 1)
    levels = expit(np.linspace(-end, end, _KNOTS))
    # Ascending, each once, as interpolation needs them.
    knots = np.unique(np.quantile(scores, levels, method="nearest"))
    return tuple(knots.tolist()), tuple(rank_log_odds(knots, scores).tolist())


def _segments(log_odds: _Floats, number: int) -> _Floats:
    """Return the part of log-odds within each segment, shape (..., number)."""
    ends = SEGMENTS[: number - 1]
    # The first segment holds the negative log-odds; the parts sum to the log-odds.
    lows = (-math.inf, *ends)
    highs = (*ends, math.inf)
    starts = (0.0, *ends)
    parts = [
        np.clip(log_odds, low, high) - start
        for low, high, start in zip(lows, highs, starts, strict=True)
    ]
    return np.stack(parts, axis=-1)


def _cells(size: int, relation: int, seed: int) -> tuple[Ids, _Floats]:
    """Return sampled triples with all self pairs, and weights: how many triples each represents."""
    rng = np.random.default_rng([seed, relation])
    num_pairs = size * (size - 1)
    entities = np.arange(size)
    if size > _HEADS:
        # Scores of an entity with many others cost little more than with one.
        entities = np.sort(rng.choice(size, _HEADS, replace=False))
    # Pair numbers count through a table without its diagonal, E - 1 columns wide.
    columns = np.arange(size - 1)
    affordable = MAX_CELLS // max(len(entities), 1)
    if len(columns) > affordable:
        columns = rng.integers(size - 1, size=(len(entities), affordable))
    numbers = entities[:, None] * (size - 1) + columns
    number = distinct(numbers.ravel())
    width = max(size - 1, 1)
    heads, column = np.divmod(number, width)
    # From the diagonal on, a column stands for the next entity.
    tails = column + (column >= heads)
    heads = np.concatenate([heads, entities])
    tails = np.concatenate([tails, entities])
    # A sampled pair, or self pair, stands for several ones.
    pair_weights = np.full(len(number), num_pairs / max(len(number), 1))
    self_weights = np.full(len(entities), size / max(len(entities), 1))
    weights = np.concatenate([pair_weights, self_weights])
    relations = np.full(len(heads), relation)
    return np.column_stack([heads, relations, tails]), weights


def _scores(scorer: TripleScorer, triples: Ids) -> _Floats:
    """Score triples, (T, 3), in blocks, so that memory does not grow with T."""
    blocks = np.array_split(triples, max(1, len(triples) // 2**18))
    parts = []
    with torch.no_grad():
        for block in blocks:
            heads, relations, tails = torch.from_numpy(block.copy()).T
            parts.append(scorer.score(heads, relations, tails).cpu().numpy())
    return np.concatenate(parts).astype(np.float64)
