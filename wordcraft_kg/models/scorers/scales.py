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
    """Return scaled scores for all entity pairs in a relation: shape (E, E), row = head.

    ``scale`` is ``standardise`` (mean 0, deviation 1), ``ranks`` (percentile ranks among all pairs), ``log-softmax``
    (over heads, for each tail) or ``none``. Self edges have equal head and tail: ``keep`` all scores, keep only
    ``observed`` pairs (training triples, shape (T, 3)), or ``drop`` all. Dropped scores become the mean over pairs of
    different entities.
    """
    one_of("scale", scale, get_args(Scale))
    one_of("self_edges", self_edges, get_args(SelfEdges))
    scores = scorer.table(relation).detach().cpu().numpy().astype(np.float64)
    if scale == "ranks":
        _, group, counts = np.unique(scores, return_inverse=True, return_counts=True)
        middle = np.cumsum(counts) - (counts - 1) / 2  # equal scores share their mean rank
        scores = middle[group].reshape(scores.shape)
    elif scale == "log-softmax":
        scores = scores - scores.max(axis=0)
        scores -= np.log(np.exp(scores).sum(axis=0))
    table = (scores if scale == "none" else standardised(scores)).astype(np.float32)
    if self_edges != "keep":
        dropped = _dropped_self_edges(len(table), relation, self_edges, observed)
        different = table[~np.eye(len(table), dtype=bool)]
        table[dropped, dropped] = different.mean() if scale == "none" and len(table) > 1 else 0
    return torch.from_numpy(table)


FACTORED_SCALES: tuple[Scale, ...] = ("standardise", "none")
"""Scales that need no table of all pairs."""


@dataclass(frozen=True)
class ScaledFactors:
    """Scaled scores for a relation as matrix factors: a pair scores ``left[head] · right[tail] - shift``.

    Attributes:
        left, right: factors, shape (E, m).
        shift: the same for all pairs, shape ().
        dropped: shape (E,), bool: True if :attr:`itself` replaces the score of the entity with itself.
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
    """Return scaled scores for a relation as factors, without a table; arguments as in :func:`scaled_table`.

    With X and Y the factors, scores sum to ``Σ x · Σ y`` and squared scores to the sum over all entries in ``XᵀX *
    YᵀY``, both without self pairs. Raises ConfigError for a scale that needs a table.
    """
    one_of("scale", scale, FACTORED_SCALES)
    one_of("self_edges", self_edges, get_args(SelfEdges))
    left, right = (part.detach().cpu() for part in scorer.factors(relation))
    x, y = left.double(), right.double()
    loops = (x * y).sum(dim=1)
    pairs = max(len(x) * (len(x) - 1), 1)
    mean = (x.sum(dim=0) @ y.sum(dim=0) - loops.sum()) / pairs
    square = ((x.T @ x) * (y.T @ y)).sum() - (loops**2).sum()
    variance = square / pairs - mean**2
    # Equal up to rounding, which must not be amplified.
    deviation = variance.sqrt() if variance > 1e-12 * square / pairs else torch.ones_like(mean)
    dropped = torch.zeros(len(left), dtype=torch.bool)
    if self_edges != "keep":
        dropped[
            torch.from_numpy(_dropped_self_edges(len(left), relation, self_edges, observed))
        ] = True
    if scale == "none":
        return ScaledFactors(left, right, torch.zeros(()), dropped, mean.float())
    return ScaledFactors(
        (x / deviation).float(), right, (mean / deviation).float(), dropped, torch.zeros(())
    )


def _dropped_self_edges(
    size: int, relation: int, self_edges: SelfEdges, observed: Ids | None
) -> Ids:
    kept = np.zeros(size, dtype=bool)
    if self_edges == "observed":
        if observed is None:
            raise ConfigError(
                "`self_edges` 'observed' needs the scorer's training triples: give `observed` (for the partial graph, "
                "split.partial), or choose keep or drop."
            )
        loops = (observed[:, 1] == relation) & (observed[:, 0] == observed[:, 2])
        kept[observed[loops, 0]] = True
    return np.flatnonzero(~kept)
