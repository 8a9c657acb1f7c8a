"""A common scale for scores, so that several scorers and relations can be mixed."""

from dataclasses import dataclass
from typing import get_args

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import one_of
from wordcraft_kg.base.statistics import standardised
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.scorers.config import Scale, SelfEdges
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer


def scaled_table(
    scorer: TripleScorer,
    relation: int,
    scale: Scale = "standardise",
    *,
    self_edges: SelfEdges = "keep",
    observed: Ids | None = None,
) -> Tensor:
    """Return scaled scores for all entity pairs in a relation.

    Args:
        scorer: any scorer.
        relation: relation id.
        scale: ``standardise`` scores to mean 0 and deviation 1 over pairs of different entities;
            ``ranks`` standardises percentile ranks among all pairs; ``log-softmax`` standardises
            the log-softmax over the heads of each tail; ``none`` leaves scores unchanged.
        self_edges: scores of entities with themselves: ``keep`` all of them, keep only ``observed``
            ones, or ``drop`` all. A dropped score becomes the mean over pairs of different
            entities.
        observed: the scorer's training triples, shape (T, 3); None is enough unless ``self_edges``
            is ``observed``.

    Returns:
        float32, shape (E, E), row = head, on the CPU.

    Raises:
        ConfigError: for an unknown scale or treatment of self edges, or if ``observed`` is missing.
    """
    one_of("scale", scale, get_args(Scale))
    one_of("self_edges", self_edges, get_args(SelfEdges))
    # In 64 bits, because the mean over millions of pairs would lose digits in 32.
    scores = scorer.table(relation).detach().cpu().numpy().astype(np.float64)
    if scale == "ranks":
        _, group, counts = np.unique(scores, return_inverse=True, return_counts=True)
        # Equal scores share their mean rank.
        middle = np.cumsum(counts) - (counts - 1) / 2
        scores = middle[group].reshape(scores.shape)
    elif scale == "log-softmax":
        # Without the maximum first, large scores would overflow in exp.
        scores = scores - scores.max(axis=0)
        scores -= np.log(np.exp(scores).sum(axis=0))
    table = (scores if scale == "none" else standardised(scores)).astype(np.float32)
    if self_edges != "keep":
        dropped = _dropped_self_edges(len(table), relation, self_edges, observed)
        different = table[~np.eye(len(table), dtype=bool)]
        # Standardised scores have the mean 0 without rounding; a single entity has no other pair.
        has_mean = scale == "none" and len(table) > 1
        table[dropped, dropped] = different.mean() if has_mean else 0
    return torch.from_numpy(table)


FACTORED_SCALES: tuple[Scale, ...] = ("standardise", "none")
"""Scales that need no table of all pairs."""


@dataclass(frozen=True)
class ScaledFactors:
    """Scaled scores for a relation as factors: a pair scores ``left[head] · right[tail] - shift``.

    Attributes:
        left: factors of heads, shape (E, m), float32.
        right: factors of tails, shape (E, m), float32.
        shift: the same for all pairs, shape ().
        dropped: shape (E,), bool: True if :attr:`itself` replaces the score of the entity with
            itself.
        itself: score for these self pairs, shape ().
    """

    left: Tensor
    right: Tensor
    shift: Tensor
    dropped: Tensor
    itself: Tensor


def scaled_factors(
    scorer: FactoredScorer,
    relation: int,
    scale: Scale = "standardise",
    *,
    self_edges: SelfEdges = "keep",
    observed: Ids | None = None,
) -> ScaledFactors:
    """Return the scores of :func:`scaled_table` as factors, for graphs too large for a table.

    Mean and deviation follow from moments of the factors. With X and Y the factors, scores sum to
    ``Σ x · Σ y``, and squared scores to the sum over all entries in ``XᵀX * YᵀY``, both without
    self pairs.

    Args:
        scorer: any scorer with factors.
        relation: relation id.
        scale: one of :data:`FACTORED_SCALES`, as in :func:`scaled_table`.
        self_edges: as in :func:`scaled_table`.
        observed: as in :func:`scaled_table`.

    Raises:
        ConfigError: for a scale that needs a table, an unknown treatment of self edges, or if
            ``observed`` is missing.
    """
    one_of("scale", scale, FACTORED_SCALES)
    one_of("self_edges", self_edges, get_args(SelfEdges))
    left, right = (part.detach().cpu() for part in scorer.factors(relation))
    # Differences of large sums follow, which 32 bits would round away.
    x = left.double()
    y = right.double()
    loops = (x * y).sum(dim=1)
    pairs = max(len(x) * (len(x) - 1), 1)
    mean = (x.sum(dim=0) @ y.sum(dim=0) - loops.sum()) / pairs
    of_all = ((x.T @ x) * (y.T @ y)).sum()
    square = of_all - (loops**2).sum()
    variance = square / pairs - mean**2
    # A smaller variance means scores that are equal up to rounding, which must not be amplified.
    has_spread = variance > 1e-12 * square / pairs
    deviation = variance.sqrt() if has_spread else torch.ones_like(mean)
    dropped = torch.zeros(len(left), dtype=torch.bool)
    if self_edges != "keep":
        rows = _dropped_self_edges(len(left), relation, self_edges, observed)
        dropped[torch.from_numpy(rows)] = True
    zero = torch.zeros(())
    if scale == "none":
        return ScaledFactors(left, right, shift=zero, dropped=dropped, itself=mean.float())
    scaled = (x / deviation).float()
    return ScaledFactors(scaled, right, (mean / deviation).float(), dropped, itself=zero)


def _dropped_self_edges(
    size: int, relation: int, self_edges: SelfEdges, observed: Ids | None
) -> Ids:
    """Return the entities whose scores with themselves are dropped, ascending."""
    is_kept = np.zeros(size, dtype=bool)
    if self_edges == "observed":
        if observed is None:
            raise ConfigError(
                "`self_edges` 'observed' needs the scorer's training triples: give `observed` "
                "(for the partial graph, split.partial), or choose keep or drop."
            )
        heads, relations, tails = observed.T
        loops = heads[(relations == relation) & (heads == tails)]
        is_kept[loops] = True
    return np.flatnonzero(~is_kept)
