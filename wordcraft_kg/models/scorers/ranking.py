"""Ranking the true answers to test triples: metrics with intervals, by relation."""

from typing import Annotated

import msgspec
import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.progress import steps
from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.base.statistics import RESAMPLES, bootstrap, cluster_interval
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.triples import RELATIONS, triple_keys
from wordcraft_kg.models.scorers.protocol import TripleScorer

MIN_TRIPLES = 30
"""Minimum number of test triples for meaningful figures."""
_FEWEST_CLUSTERS = 5
BATCH = 1_024
"""Maximum number of queries scored at once: (BATCH, E) floats."""
CELLS = 2**23
"""Maximum number of scores in memory, up to 8 bytes each with a few copies; limits queries above 8,192 entities."""


class RankingMetrics(Record, omit_defaults=True):
    """Link prediction metrics over ranked queries; without queries, only ``queries`` is set.

    Attributes:
        queries: number of queries (triples with an open head or tail).
        mrr: mean reciprocal rank.
        hits_at_1, hits_at_3, hits_at_10: share of queries with rank <= k.
        mean_rank: mean rank, from 1.
        amri: adjusted mean rank index, 0 for a random order and 1 for a perfect order (Berrendorf et al. 2020).
        mrr_ci: 95 % interval of ``mrr``, if computed.
    """

    queries: Count
    mrr: Share | None = None
    hits_at_1: Share | None = msgspec.field(default=None, name="hits@1")
    hits_at_3: Share | None = msgspec.field(default=None, name="hits@3")
    hits_at_10: Share | None = msgspec.field(default=None, name="hits@10")
    mean_rank: Annotated[float, msgspec.Meta(ge=1)] | None = None
    amri: Annotated[float, msgspec.Meta(le=1)] | None = None
    mrr_ci: tuple[Share, Share] | None = None


def sampled(triples: Ids, size: int, seed: int = 0) -> Ids:
    """Return a sample of triples without replacement, in the given order; all triples if at most ``size``."""
    if len(triples) <= size:
        return triples
    return triples[np.sort(np.random.default_rng(seed).permutation(len(triples))[:size])]


def sampled_for(graph: RecipeGraph, triples: Ids) -> Ids:
    """Return the sample of triples to rank after training: at most 20,000, fewer above 26,000 entities."""
    return sampled(triples, min(20_000, max(1_000, 2**29 // graph.num_entities)))


def rank_triples(scorer: TripleScorer, triples: Ids, known: Ids) -> pd.DataFrame:
    """Rank each triple's true head and true tail among all entities.

    Filtered: further true answers in ``known`` do not compete. Ties get the realistic rank (mean of best and worst), so
    a constant scorer ranks like chance.

    ``triples`` (T, 3) are ranked; ``known`` (K, 3) are all true triples from train and test recipes. A score that is
    not finite raises an ArtefactError.

    Returns:
        2 T rows, first all tail queries, then all head queries, in the given order. Columns: head, relation, tail
        (ids), side, rank (realistic), optimistic, pessimistic, raw_rank (realistic, unfiltered), candidates (number of
        competing entities, including the true entity), score (for the true entity) and top (best candidate).
    """
    num_entities = len(scorer.entities)
    parts: list[pd.DataFrame] = []
    block = min(BATCH, max(1, CELLS // num_entities))
    for side, fixed, target in (("tail", 0, 2), ("head", 2, 0)):
        # Known answers by query (relation, fixed entity), as a sorted list with binary search.
        known_keys = known[:, 1] * num_entities + known[:, fixed]
        order = np.argsort(known_keys, kind="stable")
        known_keys, answers = known_keys[order], known[order, target]
        for start in steps(f"ranking {side}s", range(0, len(triples), block)):
            batch = triples[start : start + block]
            keys = batch[:, 1] * num_entities + batch[:, fixed]
            left, right = (
                np.searchsorted(known_keys, keys, "left"),
                np.searchsorted(known_keys, keys, "right"),
            )
            rows = np.repeat(np.arange(len(batch)), right - left)
            columns = answers[_ranges(left, right)]
            parts.append(_rank_batch(scorer, batch, side, rows, columns))
    if not parts:
        return pd.DataFrame(columns=["head", "relation", "tail", "side", "rank"])
    return pd.concat(parts, ignore_index=True)


def _rank_batch(
    scorer: TripleScorer, batch: Ids, side: str, rows: Ids, columns: Ids
) -> pd.DataFrame:
    everything = torch.arange(len(scorer.entities))[None, :]
    head, relation, tail = (torch.from_numpy(batch[:, i].copy())[:, None] for i in range(3))
    with torch.no_grad():
        scores = scorer.score(
            *((head, relation, everything) if side == "tail" else (everything, relation, tail))
        )
    scores = scores.cpu().double()
    # The sum of 32-bit scores is finite in 64 bits if all scores are finite.
    if not bool(torch.isfinite(scores.sum())):
        raise ArtefactError(
            "some scores are not finite numbers; train again with a lower learning rate."
        )
    target = (tail if side == "tail" else head)[:, 0]
    index = torch.arange(len(batch))
    true = scores[index, target][:, None]
    raw = _count(scores > true) + (1 + _count(scores == true)) / 2
    # The true entity is excluded as well, so only competitors are counted.
    scores[torch.from_numpy(rows), torch.from_numpy(columns)] = -torch.inf
    scores[index, target] = -torch.inf
    better, equal = _count(scores > true), _count(scores == true)
    candidates = _count(scores > -torch.inf) + 1
    scores[index, target] = true[:, 0]
    return pd.DataFrame(
        {
            "head": batch[:, 0],
            "relation": batch[:, 1],
            "tail": batch[:, 2],
            "side": side,
            "rank": (better + 1 + equal / 2).numpy(),
            "optimistic": (better + 1).numpy(),
            "pessimistic": (better + equal + 1).numpy(),
            "raw_rank": raw.numpy(),
            "candidates": candidates.numpy(),
            "score": true[:, 0].numpy(),
            "top": scores.max(dim=1).indices.numpy(),
        }
    )


def _count(mask: torch.Tensor) -> torch.Tensor:
    """Count True entries per row; 32 bits take less than half the time."""
    return mask.sum(1, dtype=torch.int32).long()


def _ranges(left: Ids, right: Ids) -> Ids:
    """Concatenate ``arange(left[i], right[i])`` for all i."""
    lengths = right - left
    ends = np.cumsum(lengths)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(left - (ends - lengths), lengths)


def mean_reciprocal_rank(ranks: pd.DataFrame) -> float:
    """Return the mean reciprocal rank over rows of :func:`rank_triples`; needs a row."""
    return float(np.mean(1 / ranks["rank"].to_numpy(dtype=float)))


def ranking_metrics(ranks: pd.DataFrame, column: str = "rank") -> RankingMetrics:
    """Return metrics over rows of :func:`rank_triples`, from a rank column."""
    rank = ranks[column].to_numpy(dtype=float)
    if not len(rank):
        return RankingMetrics(0)
    chance = float(np.sum(ranks["candidates"] - 1)) / 2
    return RankingMetrics(
        queries=len(rank),
        mrr=float(np.mean(1 / rank)),
        hits_at_1=float(np.mean(rank <= 1)),
        hits_at_3=float(np.mean(rank <= 3)),
        hits_at_10=float(np.mean(rank <= 10)),
        mean_rank=float(np.mean(rank)),
        amri=1 - float(np.sum(rank - 1)) / chance if chance else 0.0,
    )


def random_reciprocal_ranks(ranks: pd.DataFrame) -> NDArray[np.float64]:
    """Return each query's expected reciprocal rank if its n candidates are in random order, ``H_n / n``."""
    n = ranks["candidates"].to_numpy(dtype=np.int64)
    harmonic = np.concatenate([[0], np.cumsum(1 / np.arange(1, n.max(initial=1) + 1))])
    return np.asarray(harmonic[n] / n)


def random_metrics(ranks: pd.DataFrame) -> RankingMetrics:
    """Return the exact expected metrics if the candidates are in random order."""
    n = ranks["candidates"].to_numpy(dtype=float)
    if not len(n):
        return RankingMetrics(0)
    return RankingMetrics(
        queries=len(n),
        mrr=float(np.mean(random_reciprocal_ranks(ranks))),
        hits_at_1=float(np.mean(1 / n)),
        hits_at_3=float(np.mean(np.minimum(3, n) / n)),
        hits_at_10=float(np.mean(np.minimum(10, n) / n)),
        mean_rank=float(np.mean((n + 1) / 2)),
        amri=0.0,
    )


def triple_groups(split: Split, recipes: NDArray[np.bool_], triples: Ids) -> Ids:
    """Return each triple's resampling group, shape (T,): the first group with a recipe that gives the triple.

    Queries from the same recipe are dependent (mirrored combinesWith triples most), and so are recipes that the split
    holds out together, such as all recipes of a goal: intervals resample the groups of the split.

    Args:
        split: the split whose :attr:`~wordcraft_kg.graphs.splits.Split.groups` count.
        recipes: the recipes that count, such as those of the test part, bool, shape (num_recipes,).
        triples: triples that these recipes give, shape (T, 3).
    """
    graph = split.graph
    a, b, result = graph.recipes[recipes].T
    group = split.groups[recipes]
    given = np.concatenate(
        [
            np.column_stack([head, np.full(len(head), relation), tail])
            for head, relation, tail in ((a, 0, b), (b, 0, a), (a, 1, result), (b, 1, result))
        ]
    )
    keys, groups = triple_keys(given, graph.num_entities), np.tile(group, 4)
    order = np.lexsort((groups, keys))
    keys, groups = keys[order], groups[order]
    return groups[np.searchsorted(keys, triple_keys(triples, graph.num_entities))]


def with_interval(
    ranks: pd.DataFrame, clusters: Ids, *, resamples: int = RESAMPLES, seed: int = 0
) -> RankingMetrics:
    """Return :func:`ranking_metrics` with a 95 % bootstrap interval over ``clusters``, None for fewer than 5."""
    metrics = ranking_metrics(ranks)
    if len(np.unique(clusters)) < _FEWEST_CLUSTERS:
        return metrics
    reciprocal = 1 / ranks["rank"].to_numpy(dtype=float)
    means = bootstrap(reciprocal, clusters, resamples=resamples, seed=seed)
    low, high = cluster_interval(reciprocal, clusters, means)
    return msgspec.structs.replace(metrics, mrr_ci=(max(low, 0.0), high))


def slice_masks(ranks: pd.DataFrame) -> dict[str, NDArray[np.bool_]]:
    """Return row masks for metrics by relation: all, each relation, each relation with each side."""
    relation, side = ranks["relation"].to_numpy(), ranks["side"].to_numpy()
    masks = {"all": np.ones(len(ranks), dtype=bool)}
    masks |= {name: relation == i for i, name in enumerate(RELATIONS)}
    for i, name in enumerate(RELATIONS):
        masks |= {
            f"{name}, predict {which}": (relation == i) & (side == which)
            for which in ("head", "tail")
        }
    return masks
