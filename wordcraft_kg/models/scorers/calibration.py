"""Calibration: probabilities for triples, fitted to scores by models trained without these triples.

Train recipes are cut into folds; each fold has a model trained without the fold. A triple that this
model was not trained on may be true: a recipe of the fold gives it, or a recipe outside train. How
often that is so depends on the score. Models of different folds have different scales, so a score
enters as its rank log-odds t, the log-odds of its percentile rank among all pairs of different
entities outside the train triples. Each relation has a :class:`Curve` for pairs of different
entities and one for self pairs (equal entities). Slopes are ``β_i >= 0``, so probabilities never
decrease with the score.

A fold's model has not seen the fold's triples, which are a share c of all true unseen triples. The
others belong to recipes outside train, which nothing here reads, and look like negatives. So the
fit maximises the likelihood of ``P(known | t) = c P(true | t)``. The main model has seen the folds'
triples, which therefore no longer are among its candidates; by Bayes' rule ``α`` falls by ``-log(1
- c)`` for the remaining triples.

A softmax turns recipe scores into a distribution over results, given that the pair makes something;
the temperature maximises the likelihood of the folds' recipes (Guo et al. 2017).

Source: Platt 1999 (the sigmoid); Elkan and Noto 2008 (partially labelled positives); Saerens,
Latinne and Decaestecker 2002 (change of base rate).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.special import expit, logsumexp
from threadpoolctl import threadpool_limits
from torch import Tensor

from wordcraft_kg.base.records import Coefficient, Count, Record, Share, Slope
from wordcraft_kg.graphs.arrays import Ids, distinct
from wordcraft_kg.graphs.folds import Folds
from wordcraft_kg.graphs.triples import RELATIONS, is_in
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.ranking import sampled
from wordcraft_kg.models.scorers.recipe_curve import (
    MOST_OF_FOLD,
    RecipeCurve,
    fit_recipe_curve,
    score_histogram,
)
from wordcraft_kg.models.scorers.recipes import RecipeScorer, RecipeScores

SEGMENTS = (3.0, 6.0)
"""Log-odds at which the slope may change: the best 5 % and the best .25 % of all pairs."""
MAX_CELLS = 2**20
"""Pairs of different entities scored per relation; more pairs are sampled uniformly."""
_HEADS = 4_096
"""Entities whose pairs are sampled in a larger book."""
_MIN_TRUE = 10
"""Fewest true and fewest false triples for a curve; below, only the base rate is fitted."""
_MIN_GAIN = 3.0
"""Minimum gain over the base rate on held-out folds, in nats."""
END = 16.0
"""Largest log-odds; larger values are clipped. :data:`MAX_CELLS` pairs reach 14.6."""
WIDTH = 0.01
"""Bin width of log-odds."""
_KNOTS = 257
"""Stored scores that map a model's scores to log-odds."""
_RIDGE = 1e-3
"""Weight of squared slopes in the loss: a segment without true triples keeps a finite slope."""
_PAIRS = 2**15
"""Recipes scored per fold to fit the temperature."""
_PROPOSED_PAIRS = 400
"""Pairs of a fold whose proposed results are scored."""

_Floats = NDArray[np.float64]


class Curve(Record, frozen=True, kw_only=True):
    """The probability that a triple is true, by rank log-odds t: ``σ(α + Σ_i β_i s_i(t))``.

    With q the percentile rank among entity pairs, ``t = log(q / (1 - q))``; ``s_i`` is the part of
    t in the i-th segment, an interval between :data:`SEGMENTS`. The curve is for the model trained
    on all folds.

    Attributes:
        intercept: α, for triples outside the train triples.
        slopes: β by segment, a single slope, or empty for the base rate only.
        rate: base rate, the probability without scores.
        true: number of true triples in the fit.
        cells: number of triples in the fit, true or not.
        reason: why only the base rate was fitted, else empty.
    """

    intercept: Coefficient
    slopes: tuple[Slope, ...]
    rate: Share
    true: Count
    cells: Count
    reason: str = ""

    def __post_init__(self) -> None:
        if len(self.slopes) not in (0, 1, len(SEGMENTS) + 1):
            raise ValueError(f"{len(self.slopes)} `slopes`")

    def probability(self, log_odds: _Floats) -> _Floats:
        """Return probabilities, with the shape of ``log_odds`` (from :func:`rank_log_odds`)."""
        parts = _segments(log_odds, len(self.slopes))
        logits = self.intercept + parts @ np.array(self.slopes)
        return np.asarray(expit(logits))


class RelationCurves(Record, frozen=True, kw_only=True):
    """Calibration for a relation: from scores to rank log-odds to probabilities.

    Attributes:
        known_share: c, the known share among all true triples that a fold's model has not seen.
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


class Probabilities(Record, frozen=True, kw_only=True):
    """The file ``calibration.json``: from scores to probabilities for triples outside training.

    Attributes:
        format: name and version of the file format.
        relations: curves for combinesWith and componentOf, by relation id.
        temperature: recipe scores are divided by this number before the softmax over results; None
            without recipe scores.
        recipes: curve for recipes; None without recipe scores, and in folders from older versions.
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
        seen: Sequence["Seen"],
        *,
        seed: int = 0,
    ) -> "Probabilities":
        """Fit probability curves for the model trained on all folds.

        Args:
            whole: the model trained on all folds.
            folds: the folds; recipes outside train are only counted, never read.
            seen: scores by each fold's model on triples that it has not seen, from
                :func:`predictions`.
            seed: seed of the sampled pairs, among which scores are ranked.

        Returns:
            the curves of both relations; temperature and curve of recipes for a recipe scorer.
        """
        size = len(whole.entities)
        train = folds.triples()
        # By fold, relation, self pair or not, and bin: shape (K, 2, 2, B).
        true = np.stack([part.true for part in seen])
        others = np.stack([part.others for part in seen])
        curves: list[RelationCurves] = []
        for relation in range(len(RELATIONS)):
            share = known_share(folds, relation)
            cells, _ = _cells(size, relation, seed)
            # Self pairs do not count in ranks: most scorers set them apart from all other pairs.
            is_unknown = ~is_in(cells, train, size)
            is_distinct = cells[:, 0] != cells[:, 2]
            cells = cells[is_unknown & is_distinct]
            scores, log_odds = _score_map(_scores(whole, cells))
            # Shape (K, 2, B); index 0 holds pairs of different entities, index 1 self pairs.
            own = true[:, relation]
            rest = others[:, relation]
            # A fit of four numbers takes 28 times as long with two threads of BLAS, which wait for
            # each other at every step.
            with threadpool_limits(1, user_api="blas"):
                distinct = fit_curve(own[:, 0], rest[:, 0], share)
                # There are only E self pairs, too few for a slope in each segment.
                itself = fit_curve(own[:, 1], rest[:, 1], share, slopes=1)
            curves.append(
                RelationCurves(
                    known_share=share,
                    scores=scores,
                    rank_log_odds=log_odds,
                    distinct=distinct,
                    itself=itself,
                )
            )
        histograms = [part.recipes for part in seen if part.recipes is not None]
        recipes = None
        if histograms:
            recipes = fit_recipe_curve(histograms, folds)
        return cls(
            relations=(curves[0], curves[1]),
            temperature=_temperature(seen),
            recipes=recipes,
            covered=_covered(seen),
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
        probabilities = np.empty(values.shape)
        for relation, curves in enumerate(self.relations):
            # Linear between the stored quantiles, constant beyond the first and the last.
            log_odds = np.interp(values, curves.scores, curves.rank_log_odds)
            is_own = number == relation
            itself = is_own & is_self
            probabilities[itself] = curves.itself.probability(log_odds[itself])
            distinct = is_own & ~is_self
            probabilities[distinct] = curves.distinct.probability(log_odds[distinct])
        in_float32 = probabilities.astype(np.float32)
        return torch.from_numpy(in_float32).to(scores.device)


@dataclass(frozen=True)
class Seen:
    """Score histograms by a fold's model, for triples outside this model's training data.

    Attributes:
        true: shape (2, 2, B): the fold's triples, counted by relation, self pair (0 or 1) and bin,
            an interval of rank log-odds, see :class:`Curve`.
        others: as ``true``, for triples outside the train triples; weighted if sampled.
        results: shape (N, C): scores of C results for N pairs sampled from the fold: of all E
            entities, or of those that the scorer proposes, with -inf where there are fewer; None
            without recipe scores.
        right: shape (N, C), bool: whether the pair makes the entity; None without recipe scores.
        proposed: whether results are proposed.
        recipes: see :func:`~wordcraft_kg.models.scorers.recipe_curve.score_histogram`; None without
            recipe scores.
    """

    true: _Floats
    others: _Floats
    results: _Floats | None
    right: NDArray[np.bool_] | None
    recipes: _Floats | None
    proposed: bool = False


def predictions(scorer: TripleScorer, folds: Folds, fold: int, *, seed: int = 0) -> Seen:
    """Count a fold's triples and unknown triples by the scores of the model without the fold.

    Triples of the remaining folds are left out, because the model remembers them.

    Args:
        scorer: the model trained without the fold.
        folds: the folds; recipes outside train are not read.
        fold: number of the fold, from 0.
        seed: seed of the sample of pairs, if there are more than :data:`MAX_CELLS`.

    Returns:
        histograms of both relations; scores of results for a recipe scorer.
    """
    size = len(scorer.entities)
    train = folds.triples()
    trained_on = folds.triples([fold])
    is_of_fold = ~is_in(train, trained_on, size)
    own = train[is_of_fold]
    bins = len(_centres())
    true = np.zeros((2, 2, bins))
    others = np.zeros((2, 2, bins))
    for relation in range(len(RELATIONS)):
        cells, weights = _cells(size, relation, seed)
        is_new = ~is_in(cells, trained_on, size)
        cells = cells[is_new]
        weights = weights[is_new]
        scores = _scores(scorer, cells)
        is_self = cells[:, 0] == cells[:, 2]
        is_unknown = ~is_in(cells, train, size)
        # Ranks exclude the fold's triples, because the main model, whose scores are calibrated, has
        # seen these triples.
        among = scores[is_unknown & ~is_self]
        log_odds = rank_log_odds(scores, among)
        of_relation = own[own[:, 1] == relation]
        own_cells = sampled(of_relation, MOST_OF_FOLD, seed)
        # In a large book, each sampled triple stands for several.
        weight = len(of_relation) / max(len(own_cells), 1)
        own_scores = _scores(scorer, own_cells)
        own_log_odds = rank_log_odds(own_scores, among)
        own_is_self = own_cells[:, 0] == own_cells[:, 2]
        # Pairs of different entities first, then self pairs.
        for itself in (0, 1):
            of_kind = own_is_self == itself
            own_bins = _bin(own_log_odds[of_kind])
            counts = np.bincount(own_bins, minlength=bins)
            true[relation, itself] = weight * counts
            chosen = is_unknown & (is_self == itself)
            other_bins = _bin(log_odds[chosen])
            others[relation, itself] = np.bincount(other_bins, weights[chosen], minlength=bins)
    results, right = _results(scorer, folds, fold, seed)
    recipes = None
    if isinstance(scorer, RecipeScorer):
        recipes = score_histogram(scorer, folds, fold, seed=seed)
    return Seen(true, others, results, right, recipes, _proposes(scorer))


def known_share(folds: Folds, relation: int) -> float:
    """Return c, a fold's share among all true triples that are new to the model without the fold.

    The recipes outside train are expected to give new triples as a fold's recipes do, but fewer for
    each recipe, because more triples are known already. ``c = m / (m + m')``: a fold has m new
    triples on average; the recipes outside train have an estimated ``m' = m (outside / n_fold) (K /
    (K - 1))^-p``, for K folds with ``n_fold`` recipes each and ``outside`` recipes outside train.
    The power p says how fast the number of new triples falls with more training recipes; it comes
    from leaving out one and two folds. Recipes outside train are counted, not read.
    """
    graph = folds.split.graph
    count = folds.count
    is_train = folds.seen()
    outside = float(np.sum(~is_train))
    of_fold = float(np.sum(is_train)) / count

    def new(fold: int, *others: int) -> float:
        """Count the fold's triples that are new to a model without this fold and ``others``."""
        triples = folds.triples_of(fold)
        own = triples[triples[:, 1] == relation]
        seen = folds.triples([fold, *others])
        is_new = ~is_in(own, seen, graph.num_entities)
        return float(np.sum(is_new))

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
    ratio = outside / of_fold * falling
    return 1 / (1 + ratio)


def fit_curve(
    true: _Floats,
    others: _Floats,
    share: float,
    slopes: int = len(SEGMENTS) + 1,
) -> Curve:
    """Fit a probability curve to score histograms, or only the base rate if scores say nothing.

    Scores count as informative if a curve fitted to all other folds predicts each fold better than
    the base rate, by :data:`_MIN_GAIN` nats in all.

    Args:
        true: shape (K, B): true triples by fold and bin of rank log-odds, see :class:`Curve`.
        others: shape (K, B): the remaining triples, which include unknown true triples.
        share: share of ``true`` among all true triples, from :func:`known_share`.
        slopes: number of segments with separate slopes.

    Returns:
        the curve for the model trained on all folds.
    """
    known = float(true.sum())
    total = float(true.sum() + others.sum())
    # The main model has seen the folds' triples, so only the share 1 - c of the true triples is
    # left.
    shift = math.log1p(-share)
    start = _base(true, others, share) + shift
    base = Curve(
        intercept=start,
        slopes=(),
        rate=float(expit(start)),
        true=round(known),
        cells=round(total),
    )
    if min(known, total - known) < _MIN_TRUE:
        reason = (
            f"{known:,.0f} true triples among {total:,.0f} are too few for more than a base rate"
        )
        return msgspec.structs.replace(base, reason=reason)
    gain = 0.0
    for fold in range(len(true)):
        is_other = np.arange(len(true)) != fold
        counts = (true[is_other], others[is_other], share)
        held_out = (true[fold], others[fold], share)
        rate = _fit(*counts, slopes=0)
        curve = _fit(*counts, slopes=slopes)
        loss_of_rate, _ = _loss(rate, *held_out)
        loss_of_curve, _ = _loss(curve, *held_out)
        gain += loss_of_rate - loss_of_curve
    if gain < _MIN_GAIN:
        reason = (
            f"scores do not separate the {known:,.0f} true triples of left-out folds from false "
            "triples"
        )
        return msgspec.structs.replace(base, reason=reason)
    intercept, *fitted = _fit(true, others, share, slopes).tolist()
    return msgspec.structs.replace(base, intercept=intercept + shift, slopes=tuple(fitted))


def _base(true: _Floats, others: _Floats, share: float) -> float:
    """Return the log-odds of the base rate, with half a triple added: nothing is impossible."""
    number = true.sum()
    total = number + others.sum()
    known = (number + 0.5) / (total + 1)
    # The share of known triples; with the unknown ones among the true it is larger, up to a half.
    rate = min(known / share, 0.5)
    return math.log(rate / (1 - rate))


def _fit(true: _Floats, others: _Floats, share: float, slopes: int) -> _Floats:
    """Return intercept and slopes of P(true | t), shape (1 + slopes,), from counts (K, B)."""
    start = np.full(1 + slopes, 0.1)
    start[0] = _base(true, others, share)
    if not slopes:
        return start
    counts = (true.sum(axis=0), others.sum(axis=0), share)
    # Slopes are never negative: a higher score is never less probable.
    any_number = (None, None)
    not_negative = (0, None)
    bounds = [any_number] + [not_negative] * slopes
    fit = minimize(_loss, start, args=counts, jac=True, method="L-BFGS-B", bounds=bounds)
    return np.asarray(fit.x)


def _loss(values: _Floats, true: _Floats, others: _Floats, share: float) -> tuple[float, _Floats]:
    """Return the negative log-likelihood of counts by bin, (B,), in nats, and its gradient."""
    intercept = values[0]
    slopes = values[1:]
    inputs = _segments(_centres(), len(slopes))
    logits = intercept + inputs @ slopes
    chance = expit(logits)
    # Away from 0 and 1, where the logarithms below would be infinite.
    labelled = np.clip(share * chance, 1e-300, 1 - 1e-12)
    of_true = true @ np.log(labelled)
    of_others = others @ np.log1p(-labelled)
    likelihood = of_true + of_others
    penalty = _RIDGE / 2 * (slopes @ slopes)
    loss = -likelihood + penalty
    # d likelihood / d logit, with d labelled / d logit = labelled (1 - chance).
    of_labelled = true - others * labelled / (1 - labelled)
    by_logit = -of_labelled * (1 - chance)
    by_intercept = by_logit.sum()
    by_slopes = inputs.T @ by_logit + _RIDGE * slopes
    return float(loss), np.concatenate([[by_intercept], by_slopes])


def _results(
    scorer: TripleScorer,
    folds: Folds,
    fold: int,
    seed: int,
) -> tuple[_Floats, NDArray[np.bool_]] | tuple[None, None]:
    """Return scores of all results for sampled pairs of a fold, (N, E), and which are right."""
    if not isinstance(scorer, RecipeScores):
        return None, None
    size = len(scorer.entities)
    own = folds.recipes_of(fold)
    # A pair with several results is asked once, and has several right answers.
    pairs, of_recipe = np.unique(own[:, :2], axis=0, return_inverse=True)
    # A pair has a score for each entity, so there are fewer pairs in larger graphs.
    number = max(_PAIRS // size, 1)
    if _proposes(scorer):
        number = _PROPOSED_PAIRS
    rng = np.random.default_rng([seed, fold])
    chosen = rng.permutation(len(pairs))[:number]
    # Rows of the chosen pairs alone: those of all pairs would take a gigabyte in a large book.
    row_of = np.full(len(pairs), -1)
    row_of[chosen] = np.arange(len(chosen))
    rows = row_of[of_recipe]
    # Recipes of the chosen pairs: the row of the pair, and the result.
    is_asked = rows >= 0
    rows = rows[is_asked]
    results = own[is_asked, 2]
    asked = torch.from_numpy(pairs[chosen].copy())
    if _proposes(scorer):
        assert isinstance(scorer, RecipeScorer)
        a, b = asked.T
        ids, proposed = scorer.best_results(a, b)
        # A number for each row and result, also for the id E of missing proposals.
        stride = size + 1
        right_codes = rows * stride + results
        every_row = np.arange(len(chosen))[:, None]
        codes = every_row * stride + ids.cpu().numpy()
        return proposed.cpu().numpy().astype(np.float64), np.isin(codes, right_codes)
    right = np.zeros((len(chosen), size), dtype=bool)
    right[rows, results] = True
    # Shape (N, 1) each, against which all results broadcast.
    a, b = asked.T[..., None]
    every_result = torch.arange(size)[None]
    with torch.no_grad():
        scores = scorer.score_recipes(a, b, every_result)
    return scores.cpu().numpy().astype(np.float64), right


def _proposes(scorer: TripleScorer) -> bool:
    """Return whether a scorer proposes results of a pair, in place of a score for each entity."""
    return isinstance(scorer, RecipeScorer) and scorer.proposes_results


def _covered(seen: Sequence[Seen]) -> float | msgspec.UnsetType:
    """Return the share of pairs with a right result among the proposed ones."""
    right = [part.right for part in seen if part.proposed and part.right is not None]
    if not right:
        return msgspec.UNSET
    has_right = np.concatenate(right).any(axis=1)
    return float(np.mean(has_right))


def _temperature(seen: Sequence[Seen]) -> float | None:
    """Return the temperature whose softmax gives a right result the highest likelihood."""
    known = [
        (part.results, part.right)
        for part in seen
        if part.results is not None and part.right is not None
    ]
    if not known:
        return None
    scores, right = (np.concatenate(parts) for parts in zip(*known, strict=True))
    if any(part.proposed for part in seen):
        # A pair whose result nobody proposes says nothing about the proposed ones.
        has_right = right.any(axis=1)
        if not has_right.any():
            # In a book whose results nothing foretells, the share of covered pairs is 0, and so is
            # each probability, at any temperature.
            return 1.0
        scores = scores[has_right]
        right = right[has_right]

    def loss(log_temperature: float) -> float:
        scaled = scores * math.exp(-log_temperature)
        # A pair may have several results: the probability that one of them is drawn.
        right_only = np.where(right, scaled, -np.inf)
        of_right = logsumexp(right_only, axis=1)
        of_all = logsumexp(scaled, axis=1)
        return float(np.mean(of_all - of_right))

    best = minimize_scalar(loss, bounds=(-4.0, 4.0), method="bounded")
    return float(math.exp(best.x))


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
    least = 0.5 / (count + 1)
    share = (above + 0.5) / (count + 1)
    rank = np.clip(share, least, 1 - least)
    return np.asarray(np.log1p(-rank) - np.log(rank))


def _score_map(scores: _Floats) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return quantiles of scores, ascending, and their rank log-odds: the map of a relation."""
    if not len(scores):
        return (0.0,), (0.0,)
    # Quantiles at equal distances in log-odds, because true triples are among the very highest
    # scores.
    end = math.log(2 * len(scores) + 1)
    level_log_odds = np.linspace(-end, end, _KNOTS)
    levels = expit(level_log_odds)
    quantiles = np.quantile(scores, levels, method="nearest")
    # Ascending, each once, as interpolation needs them.
    knots = np.unique(quantiles)
    log_odds = rank_log_odds(knots, scores)
    return tuple(knots.tolist()), tuple(log_odds.tolist())


def _segments(log_odds: _Floats, slopes: int) -> _Floats:
    """Return the part of log-odds within each segment, shape (..., slopes)."""
    if slopes <= 1:
        return np.repeat(log_odds[..., None], slopes, axis=-1)
    # The first segment holds the negative log-odds; the parts sum to the log-odds.
    parts = [np.clip(log_odds, -math.inf, SEGMENTS[0])]
    ends = (*SEGMENTS[1:], math.inf)
    for low, high in zip(SEGMENTS, ends, strict=True):
        within = np.clip(log_odds, low, high)
        parts.append(within - low)
    return np.stack(parts, axis=-1)


def _centres() -> _Floats:
    """Return the centres of the bins of log-odds, shape (B,)."""
    # Half a bin beyond the end, so that the end is one of them.
    return np.arange(-END, END + WIDTH / 2, WIDTH)


def _bin(log_odds: _Floats) -> Ids:
    """Return the number of the bin in which each of the log-odds falls."""
    from_start = np.clip(log_odds, -END, END) + END
    widths = from_start / WIDTH
    return np.rint(widths).astype(np.int64)


def _cells(size: int, relation: int, seed: int) -> tuple[Ids, _Floats]:
    """Return sampled triples with all self pairs, and weights: how many triples each represents."""
    rng = np.random.default_rng([seed, relation])
    pairs = size * (size - 1)
    entities = np.arange(size)
    if pairs <= MAX_CELLS:
        number = np.arange(pairs)
    elif size <= _HEADS:
        number = distinct(rng.integers(pairs, size=MAX_CELLS))
    else:
        # Scores of an entity with many others cost little more than with one.
        entities = np.sort(rng.choice(size, _HEADS, replace=False))
        columns = rng.integers(size - 1, size=(_HEADS, MAX_CELLS // _HEADS))
        firsts = entities[:, None] * (size - 1)
        drawn = firsts + columns
        number = distinct(drawn.ravel())
    # Pair numbers count through a table without its diagonal, E - 1 columns wide.
    width = max(size - 1, 1)
    heads, column = np.divmod(number, width)
    # From the diagonal on, a column stands for the next entity.
    tails = column + (column >= heads)
    heads = np.concatenate([heads, entities])
    tails = np.concatenate([tails, entities])
    # A sampled pair, or self pair, stands for several ones.
    of_pairs = np.full(len(number), pairs / max(len(number), 1))
    of_entities = np.full(len(entities), size / max(len(entities), 1))
    weights = np.concatenate([of_pairs, of_entities])
    relations = np.full(len(heads), relation)
    return np.column_stack([heads, relations, tails]), weights


def _scores(scorer: TripleScorer, triples: Ids) -> _Floats:
    """Score triples, (T, 3), in blocks, so that memory does not grow with T."""
    num_blocks = max(1, len(triples) // 2**18)
    blocks = np.array_split(triples, num_blocks)
    parts = []
    with torch.no_grad():
        for block in blocks:
            heads, relations, tails = torch.from_numpy(block.copy()).T
            scores = scorer.score(heads, relations, tails)
            parts.append(scores.cpu().numpy())
    return np.concatenate(parts).astype(np.float64)
