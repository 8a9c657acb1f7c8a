"""Ranking the true answers to test triples: metrics with intervals, by relation.

Ranks are filtered (other known answers do not compete) and realistic (ties get the mean rank), as
in Berrendorf et al. 2020, "On the ambiguity of rank-based evaluation".

The page docs/link-prediction.md explains the metrics under *Read a report*.
"""

from typing import Annotated

import msgspec
import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from scipy import sparse

from wordcraft_kg.base import ArtefactError, Count, Record, Share, steps
from wordcraft_kg.base.statistics import RESAMPLES, bootstrap, cluster_interval
from wordcraft_kg.graphs import RELATIONS, Ids, RecipeGraph, Split
from wordcraft_kg.graphs.triples import triple_keys
from wordcraft_kg.models.scorers.protocol import TripleScorer

MIN_TRIPLES = 30
"""Minimum number of test triples for meaningful metrics."""
_FEWEST_CLUSTERS = 5
"""Fewest ingredient pairs for a bootstrap interval; fewer repeat the same few samples."""
BATCH = 1_024
"""Maximum number of queries scored at once: (BATCH, E) floats."""
CELLS = 2**23
"""Maximum number of scores in memory, up to 8 bytes each with a few copies.

Above 8,192 entities this limits the number of queries scored at once.
"""


class RankingMetrics(Record, omit_defaults=True):
    """Link prediction metrics over ranked queries; without queries, only ``queries`` is set.

    Attributes:
        queries: number of queries (triples with an open head or tail).
        mrr: mean reciprocal rank.
        hits_at_1: share of queries with rank 1.
        hits_at_3: share of queries with rank 3 or better.
        hits_at_10: share of queries with rank 10 or better.
        mean_rank: mean rank, from 1.
        amri: adjusted mean rank index, 0 for a random order and 1 for a perfect order (Berrendorf
            et al. 2020).
        mrr_ci: 95 % bootstrap interval of ``mrr``; None if not computed, or for too few recipes.
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
    """Return a sample of triples without replacement.

    Args:
        triples: shape (T, 3).
        size: number of triples to keep.
        seed: seed of the draw.

    Returns:
        at most ``size`` triples, in the given order; all of them if there are no more.
    """
    if len(triples) <= size:
        return triples
    rng = np.random.default_rng(seed)
    sample = rng.permutation(len(triples))[:size]
    # In the given order, so that a sample reads like its source.
    return triples[np.sort(sample)]


def sampled_for(graph: RecipeGraph, triples: Ids) -> Ids:
    """Return a sample of triples to rank after training: at most 20,000.

    Each query scores all entities, so 2 ** 29 scores bound the time above 26,000 entities; 1,000
    triples are ranked in any case.
    """
    affordable = 2**29 // graph.num_entities
    size = min(20_000, max(1_000, affordable))
    return sampled(triples, size)


def rank_triples(scorer: TripleScorer, triples: Ids, known: Ids) -> pd.DataFrame:
    """Rank each triple's true head and true tail among all entities.

    Filtered: further true answers in ``known`` do not compete. Ties get the realistic rank (mean of
    best and worst), so a constant scorer ranks like chance.

    Args:
        scorer: scorer for the graph that the ids belong to.
        triples: the triples to rank, ids of shape (T, 3).
        known: all true triples, from train and test recipes, shape (K, 3).

    Returns:
        2 T rows, first all tail queries, then all head queries, in the given order. Columns: head,
        relation, tail (ids), side, rank (realistic), optimistic, pessimistic, raw_rank (realistic,
        unfiltered), candidates (number of competing entities, including the true entity), score
        (for the true entity) and top (best candidate).

    Raises:
        ArtefactError: if a score is not a finite number.
    """
    num_entities = len(scorer.entities)
    parts: list[pd.DataFrame] = []
    # So many queries at once that their scores of all entities fit the memory.
    affordable = max(1, CELLS // num_entities)
    block = min(BATCH, affordable)
    starts = range(0, len(triples), block)
    # Columns of a triple: the entity that a query gives, and the one that it asks for.
    for side, fixed, target in (("tail", 0, 2), ("head", 2, 0)):
        # The known answers of each query are a row of a sparse matrix.
        cells = (_query_keys(known, fixed, num_entities), known[:, target])
        shape = (len(RELATIONS) * num_entities, num_entities)
        answers = sparse.csr_array((np.ones(len(known), dtype=bool), cells), shape=shape)
        for start in steps(f"ranking {side}s", starts):
            batch = triples[start : start + block]
            # Cells (row, column) of the score block that hold known answers.
            rows, columns = answers[_query_keys(batch, fixed, num_entities)].nonzero()
            parts.append(_rank_batch(scorer, batch, side, rows, columns))
    if not parts:
        return pd.DataFrame(columns=["head", "relation", "tail", "side", "rank"])
    return pd.concat(parts, ignore_index=True)


def _query_keys(triples: Ids, column: int, num_entities: int) -> Ids:
    """Return each triple's query, its relation and one of its entities, as a number, shape (T,).

    Args:
        triples: shape (T, 3).
        column: column of the entity in the query, 0 for the head, 2 for the tail.
        num_entities: number of entities E.
    """
    return triples[:, 1] * num_entities + triples[:, column]


def _rank_batch(
    scorer: TripleScorer,
    batch: Ids,
    side: str,
    rows: Ids,
    columns: Ids,
) -> pd.DataFrame:
    """Rank true answers to a block of B queries; known answers are cells of the (B, E) scores."""
    everything = torch.arange(len(scorer.entities))[None, :]
    # Shape (B, 1) each, against which all entities broadcast.
    head, relation, tail = torch.from_numpy(batch.T[:, :, None].copy())
    query = (head, relation, everything) if side == "tail" else (everything, relation, tail)
    with torch.no_grad():
        scores = scorer.score(*query).cpu().double()
    # The sum of 32-bit scores is finite in 64 bits if all scores are finite.
    if not bool(torch.isfinite(scores.sum())):
        raise ArtefactError(
            "some scores are not finite numbers; train again with a lower learning rate."
        )
    target = (tail if side == "tail" else head)[:, 0]
    index = torch.arange(len(batch))
    true_scores = scores[index, target]
    # Shape (B, 1), to compare with each row.
    true = true_scores[:, None]
    # Unfiltered; the true entity is equal to itself, so (1 + equal) / 2 counts it once.
    all_better = _count(scores > true)
    all_equal = _count(scores == true)
    raw = all_better + (1 + all_equal) / 2
    # The true entity is excluded as well, so only competitors are counted.
    known_cells = (torch.from_numpy(rows), torch.from_numpy(columns))
    scores[known_cells] = -torch.inf
    scores[index, target] = -torch.inf
    num_better = _count(scores > true)
    equal = _count(scores == true)
    candidates = _count(scores > -torch.inf) + 1
    # The true entity competes again for the best candidate.
    scores[index, target] = true_scores
    top = scores.max(dim=1).indices
    return pd.DataFrame(
        {
            "head": batch[:, 0],
            "relation": batch[:, 1],
            "tail": batch[:, 2],
            "side": side,
            "rank": (num_better + 1 + equal / 2).numpy(),
            "optimistic": (num_better + 1).numpy(),
            "pessimistic": (num_better + equal + 1).numpy(),
            "raw_rank": raw.numpy(),
            "candidates": candidates.numpy(),
            "score": true_scores.numpy(),
            "top": top.numpy(),
        }
    )


def _count(mask: torch.Tensor) -> torch.Tensor:
    """Count True entries per row; 32 bits take less than half the time."""
    return mask.sum(1, dtype=torch.int32).long()


def mean_reciprocal_rank(ranks: pd.DataFrame) -> float:
    """Return the mean reciprocal rank over rows of :func:`rank_triples`; needs a row."""
    return float(np.mean(1 / ranks["rank"].to_numpy(dtype=float)))


def ranking_metrics(ranks: pd.DataFrame, column: str = "rank") -> RankingMetrics:
    """Return metrics over rows of :func:`rank_triples`, from the column ``column`` with ranks."""
    rank = ranks[column].to_numpy(dtype=float)
    if not len(rank):
        return RankingMetrics(0)
    # Expected sum of rank - 1 in random order; 0 if no query has a competitor.
    chance = float(np.sum(ranks["candidates"] - 1)) / 2
    reached = float(np.sum(rank - 1))
    amri = 1 - reached / chance if chance else 0.0
    return RankingMetrics(
        queries=len(rank),
        mrr=float(np.mean(1 / rank)),
        hits_at_1=float(np.mean(rank <= 1)),
        hits_at_3=float(np.mean(rank <= 3)),
        hits_at_10=float(np.mean(rank <= 10)),
        mean_rank=float(np.mean(rank)),
        amri=amri,
    )


def random_reciprocal_ranks(ranks: pd.DataFrame) -> NDArray[np.float64]:
    """Return each query's expected reciprocal rank in random order, ``H_n / n`` of n candidates."""
    n = ranks["candidates"].to_numpy(dtype=np.int64)
    # H_0 .. H_max, one table for all queries.
    parts = 1 / np.arange(1, n.max(initial=1) + 1)
    harmonic = np.concatenate([[0], np.cumsum(parts)])
    return np.asarray(harmonic[n] / n)


def random_metrics(ranks: pd.DataFrame) -> RankingMetrics:
    """Return the expected metrics if the candidates are in random order: computed, not sampled."""
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
    """Return the resampling group of each triple: the first group with a recipe that gives it.

    Queries from the same recipe are dependent (mirrored combinesWith triples most), and so are
    recipes that the split holds out together, such as all recipes of a goal: intervals resample the
    groups of the split.

    Args:
        split: the split whose :attr:`~wordcraft_kg.graphs.splits.Split.groups` count.
        recipes: shape (num_recipes,), bool: the recipes that count, such as those of the test part.
        triples: shape (T, 3); a recipe that counts gives each of them.

    Returns:
        shape (T,): group numbers, as in ``split.groups``.
    """
    graph = split.graph
    rows, recipe_triples = graph.triples_by_recipe(recipes)
    keys = triple_keys(recipe_triples, graph.num_entities)
    groups = split.groups[recipes][rows]
    # Sorted by triple and then by group, so that the search finds the first group of each triple.
    order = np.lexsort((groups, keys))
    query_keys = triple_keys(triples, graph.num_entities)
    place = np.searchsorted(keys[order], query_keys)
    return groups[order[place]]


def with_interval(
    ranks: pd.DataFrame,
    clusters: Ids,
    *,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> RankingMetrics:
    """Return :func:`ranking_metrics` with a 95 % bootstrap interval of the MRR.

    Args:
        ranks: rows of :func:`rank_triples`.
        clusters: shape (rows,): clusters of dependent queries, from :func:`triple_groups`.
        resamples: number of bootstrap samples.
        seed: seed of the samples.

    Returns:
        the metrics; ``mrr_ci`` is None for fewer than 5 clusters.
    """
    metrics = ranking_metrics(ranks)
    if len(np.unique(clusters)) < _FEWEST_CLUSTERS:
        return metrics
    reciprocal = 1 / ranks["rank"].to_numpy(dtype=float)
    means = bootstrap(reciprocal, clusters, resamples=resamples, seed=seed)
    low, high = cluster_interval(reciprocal, clusters, means)
    return msgspec.structs.replace(metrics, mrr_ci=(max(low, 0.0), high))


def slice_masks(ranks: pd.DataFrame) -> dict[str, NDArray[np.bool_]]:
    """Return row masks for metrics: all, each relation, and each relation with each side."""
    relation = ranks["relation"].to_numpy()
    side = ranks["side"].to_numpy()
    masks = {"all": np.ones(len(ranks), dtype=bool)}
    for number, name in enumerate(RELATIONS):
        masks[name] = relation == number
    for name in RELATIONS:
        for slot in ("head", "tail"):
            masks[f"{name}, predict {slot}"] = masks[name] & (side == slot)
    return masks
