"""Calibration of a cross-fitted scorer's triple probabilities, outside the training data.

The page docs/evidence/recipe-scorer.md shows its figures; docs/explanation/recipe-scorer.md has the
formulas.
"""

from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.base.statistics import wilson_interval
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS, Relation
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted

_BINS = 8
_LEAST = 5.0
"""Least expected number of true triples per point, if possible."""


class ReliabilityBin(Record):
    """A group of triples with similar probability.

    Attributes:
        probability: mean predicted probability.
        observed: share of true triples.
        low, high: 95 % interval of `observed` (Wilson).
        triples: number of triples.
    """

    probability: Share
    observed: Share
    low: Share
    high: Share
    triples: Count


class Reliability(Record):
    """Predicted and observed numbers of true triples of a relation, outside the training triples.

    combinesWith counts a single direction.

    Attributes:
        relation: the relation.
        pairs: two different entities, or an entity with itself.
        triples: number of triples.
        expected: number of true triples by the probabilities.
        observed: number of true triples: recipes outside train give them.
        base_rate: constant probability that ignores the scores.
        ece: expected calibration error over `bins`: mean distance of predicted and observed, by
            triples.
        log_loss: mean ``-log(probability of the observed outcome)``, nats.
        base_log_loss: the same for the base rate.
        reason: why all triples have the base rate as probability, or empty.
        bins: groups of triples by probability, with about equal expected numbers of true triples.
    """

    relation: Relation
    pairs: Literal["distinct", "itself"]
    triples: Count
    expected: float
    observed: Count
    base_rate: Share
    ece: Share
    log_loss: float
    base_log_loss: float
    reason: str
    bins: tuple[ReliabilityBin, ...]


def view_probabilities(
    scorer: CrossFitted, graph: RecipeGraph, trained_on: Ids
) -> tuple[Reliability, ...]:
    """Compare predicted probabilities with true triples outside training.

    Args:
        scorer: a cross-fitted scorer.
        graph: the graph, whose triples are true.
        trained_on: training triples, shape (T, 3).

    Returns:
        A record for each relation and kind of pair; empty for a scorer without probabilities.
    """
    if scorer.probabilities is None:
        return ()
    size = graph.num_entities
    every = torch.arange(size)
    is_self = np.eye(size, dtype=bool)
    # Pairs of things; half-products of chains are none.
    is_thing = ~graph.is_half_product
    rows = []
    for relation, name in enumerate(RELATIONS):
        chances = scorer.probability(every[:, None], relation, every[None, :]).cpu().numpy()
        # Triples in training are no test: the scorer has seen that they are true.
        is_asked = ~_table(trained_on, relation, size) & is_thing[:, None] & is_thing
        if relation == COMBINES_WITH:  # both directions are the same fact
            is_asked &= np.tri(size, dtype=bool)
        is_true = _table(graph.triples, relation, size)
        curves = scorer.probabilities.relations[relation]
        # Entities with themselves have a calibration of their own: they are true at another rate.
        for pairs, is_kind, curve in (
            ("distinct", ~is_self, curves.distinct),
            ("itself", is_self, curves.itself),
        ):
            cells = is_asked & is_kind
            # float64, because the sum of millions of small probabilities loses digits in float32.
            predicted = chances[cells].astype(np.float64)
            if not len(predicted):
                continue
            observed = is_true[cells]
            bins = _bins(predicted, observed)
            errors = sum(row.triples * abs(row.probability - row.observed) for row in bins)
            rows.append(
                Reliability(
                    relation=name,
                    pairs=pairs,  # type: ignore[arg-type]
                    triples=len(predicted),
                    expected=float(predicted.sum()),
                    observed=int(observed.sum()),
                    base_rate=curve.rate,
                    ece=errors / len(predicted),
                    log_loss=_log_loss(predicted, observed),
                    base_log_loss=_log_loss(np.full(len(predicted), curve.rate), observed),
                    reason=curve.reason,
                    bins=bins,
                )
            )
    return tuple(rows)


def _table(triples: Ids, relation: int, size: int) -> NDArray[np.bool_]:
    """Return a relation's triples as a dense table (E, E); only small graphs come here."""
    heads, _, tails = triples[triples[:, 1] == relation].T
    table = np.zeros((size, size), dtype=bool)
    table[heads, tails] = True
    return table


def _bins(predicted: NDArray[np.float64], is_true: NDArray[np.bool_]) -> tuple[ReliabilityBin, ...]:
    # Bins of equal expected true triples, not of equal width or size: nearly all triples are very
    # improbable, and a bin without true triples says nothing about its share.
    order = np.argsort(predicted, kind="stable")
    ascending = predicted[order]
    expected = predicted.sum()
    count = int(np.clip(expected / _LEAST, 1, _BINS))
    # A triple's bin is given by the expected true triples before it.
    before = np.cumsum(ascending) - ascending
    place = before / expected * count
    # Rounding can lift the last places to the number of bins.
    number = np.minimum(place.astype(np.int64), count - 1)
    starts = np.flatnonzero(np.diff(number)) + 1
    rows = []
    for group in np.split(order, starts):
        size = len(group)
        true = int(is_true[group].sum())
        mean = float(predicted[group].mean())
        # Wilson's interval is valid for shares near 0, where the normal one reaches below 0.
        low, high = wilson_interval(true, size)
        rows.append(ReliabilityBin(mean, true / size, low, high, size))
    return tuple(rows)


def _log_loss(predicted: NDArray[np.float64], is_true: NDArray[np.bool_]) -> float:
    # A probability of exactly 0 or 1 that is wrong would make the mean infinite.
    chance = np.clip(predicted, 1e-12, 1 - 1e-7)
    return float(-np.mean(np.where(is_true, np.log(chance), np.log1p(-chance))))
