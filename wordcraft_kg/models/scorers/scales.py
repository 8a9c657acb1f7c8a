"""A common scale for scores, so that several scorers and relations can be mixed."""

from typing import get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.base import ConfigError, one_of
from wordcraft_kg.base.statistics import standardised
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.score_limits import Scale, SelfEdges


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
    dropped = np.flatnonzero(_dropped(len(scorer.entities), relation, self_edges, observed))
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
    if len(dropped):
        different = table[~np.eye(len(table), dtype=bool)]
        # Standardised scores have the mean 0 without rounding; a single entity has no other pair.
        has_mean = scale == "none" and len(table) > 1
        table[dropped, dropped] = different.mean() if has_mean else 0
    return torch.from_numpy(table)


FACTORED_SCALES: tuple[Scale, ...] = ("standardise", "ranks", "none")
"""Scales that need no table of all pairs."""
KNOTS = 512
"""Even steps in rank between two of which ranks are interpolated."""
SIDE = 1_024
"""Heads, and tails, of the pairs whose scores stand for all where there is no table.

The rank of a score among a million pairs differs from its rank among all by about .0005 of the
range.
"""


def sampled_scaling(
    scorer: TripleScorer,
    relation: int,
    scale: Scale = "standardise",
    *,
    self_edges: SelfEdges = "keep",
    observed: Ids | None = None,
) -> dict[str, Tensor]:
    """Return the scaling of :func:`scaled_table`, from evenly spread pairs instead of all.

    Args:
        scorer: any scorer; :data:`SIDE` squared pairs are scored, or all pairs if there are fewer.
        relation: relation id.
        scale: one of :data:`FACTORED_SCALES`, as in :func:`scaled_table`.
        self_edges: as in :func:`scaled_table`.
        observed: as in :func:`scaled_table`.

    Returns:
        tensors by name. A scaled score is ``(score - shift) / deviation``, shape () each. Of
        entities that are True in ``dropped``, shape (E,), the score with themselves is ``itself``,
        shape (). Scores that become ranks have ``knots``, scores in ascending order, and their
        standardised percentile ranks ``heights``, shape (K,) each, see :func:`interpolated`.

    Raises:
        ConfigError: for a scale that needs a table, an unknown treatment of self edges, or if
            ``observed`` is missing.
    """
    one_of("scale", scale, FACTORED_SCALES)
    size = len(scorer.entities)
    length = min(SIDE, size)
    side = torch.arange(length) * size // length
    # A column of heads and a row of tails: scorers have short cuts for such a grid.
    scores = scorer.score(side[:, None], relation, side[None]).detach().cpu().flatten()
    is_different = (side[:, None] != side).flatten()
    scaling = {
        "shift": torch.zeros(()),
        "deviation": torch.ones(()),
        "dropped": torch.from_numpy(_dropped(size, relation, self_edges, observed)),
        "itself": torch.zeros(()),
    }
    if scale == "ranks":
        knots, heights = _rank_knots(scores.numpy(), is_different.numpy())
        return scaling | {"knots": knots, "heights": heights}
    # In 64 bits, because the mean over a million pairs would lose digits in 32.
    pair_scores = scores[is_different].double()
    # A graph of a single entity has no pair of two.
    if not len(pair_scores):
        return scaling
    mean = pair_scores.mean().float()
    if scale == "none":
        return scaling | {"itself": mean}
    scaling["shift"] = mean
    deviation = pair_scores.std(correction=0).float()
    # Scores that are equal up to rounding must not be amplified.
    if bool(deviation > 1e-6 * pair_scores.abs().amax()):
        scaling["deviation"] = deviation
    return scaling


def interpolated(scores: Tensor, knots: Tensor, heights: Tensor) -> Tensor:
    """Return heights at scores: linear between knots, constant before the first and after the last.

    Args:
        scores: shape (B, A).
        knots: scores in ascending order, each row's own, shape (B, K); K is 2 or more. Equal knots
            at the end fill a row.
        heights: heights of the knots, shape (B, K).

    Returns:
        shape (B, A).
    """
    # The first knot that is not smaller: a score that equals a knot gets its height exactly.
    last = knots.shape[1] - 1
    above = torch.searchsorted(knots, scores).clamp_(1, last)
    below = above - 1
    low = knots.gather(1, below)
    width = knots.gather(1, above) - low
    # Between equal knots, which fill a row, the upper height counts.
    within = (scores - low) / width
    share = torch.where(width > 0, within, 1.0).clamp_(0, 1)
    height_below = heights.gather(1, below)
    height_above = heights.gather(1, above)
    return torch.lerp(height_below, height_above, share)


def _rank_knots(
    scores: NDArray[np.float32],
    is_different: NDArray[np.bool_],
) -> tuple[Tensor, Tensor]:
    """Return scores and their standardised ranks, shape (3 · KNOTS,) each, in ascending order.

    Args:
        scores: scores of pairs, shape (n,).
        is_different: whether a pair has two entities, shape (n,): these have mean 0, deviation 1.
    """
    values, group, counts = np.unique(scores, return_inverse=True, return_counts=True)
    # Equal scores share their mean rank.
    ends = np.cumsum(counts)
    ranks = ends - (counts - 1) / 2
    pair_ranks = ranks[group[is_different]]
    mean = ranks.mean()
    deviation = 0.0
    # A graph of a single entity has no pair of two.
    if len(pair_ranks):
        mean = pair_ranks.mean()
        deviation = pair_ranks.std()
    # Equal ranks become 0, without a division by 0.
    scale = deviation if deviation > 0 else 1.0
    standard = (ranks - mean) / scale
    # Knots at evenly spaced ranks.
    knot_ranks = np.linspace(1, ends[-1], KNOTS)
    steps = np.searchsorted(ends, knot_ranks)
    # Beside a score that many pairs share, ranks jump: its neighbours are knots as well.
    beside = np.concatenate([steps - 1, steps, steps + 1])
    within = beside.clip(0, len(values) - 1)
    knot_places = np.unique(within)
    # The last knot fills the row: a shape that does not depend on the scores.
    filled = np.pad(knot_places, (0, 3 * KNOTS - len(knot_places)), mode="edge")
    knots = torch.from_numpy(values[filled])
    heights = torch.from_numpy(standard[filled].astype(np.float32))
    return knots, heights


def _dropped(
    size: int,
    relation: int,
    self_edges: SelfEdges,
    observed: Ids | None,
) -> NDArray[np.bool_]:
    """Return which entities' scores with themselves are dropped, shape (E,).

    Raises:
        ConfigError: for an unknown treatment of self edges, or if ``observed`` is missing.
    """
    one_of("self_edges", self_edges, get_args(SelfEdges))
    is_dropped = np.full(size, self_edges != "keep")
    if self_edges == "observed":
        if observed is None:
            raise ConfigError(
                "`self_edges` 'observed' needs the scorer's training triples: give `observed` "
                "(for the partial graph, split.partial), or choose keep or drop."
            )
        heads, relations, tails = observed.T
        loops = heads[(relations == relation) & (heads == tails)]
        is_dropped[loops] = False
    return is_dropped
