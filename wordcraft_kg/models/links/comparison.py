"""Comparing two link predictors on the same queries."""

import msgspec
import numpy as np

from wordcraft_kg.errors import GraphMismatchError, SplitError
from wordcraft_kg.models.links.folder import OpenedModel
from wordcraft_kg.models.scorers.ranking import (
    MIN_TRIPLES,
    RankingMetrics,
    rank_triples,
    ranking_metrics,
    recipe_clusters,
)
from wordcraft_kg.records import Count, Record, Share
from wordcraft_kg.settings import whole
from wordcraft_kg.statistics import bootstrap, interval


class ComparedModel(RankingMetrics, kw_only=True):
    """A model's metrics on the shared queries."""

    name: str
    has_seen_the_test_recipes: bool


class LinkComparison(Record):
    """Two models on the same queries.

    Attributes:
        a: the first model.
        b: the second model.
        queries: number of queries.
        difference: difference of MRR, a - b.
        difference_ci: its 95 % interval.
        probability_a_better: share of resamples in which a is ahead; ties count half.
    """

    a: ComparedModel
    b: ComparedModel
    queries: Count
    difference: float
    difference_ci: tuple[float, float]
    probability_a_better: Share


def compare(a: OpenedModel, b: OpenedModel, *, resamples: int = 1_000, seed: int = 0) -> LinkComparison:
    """Rank the unseen test triples with both models and bootstrap the difference of their reciprocal ranks.

    Both are resampled together, one recipe pair at a time: the difference is taken on the same queries, which is much
    more precise than comparing two separate intervals.

    Raises:
        ConfigError: if a setting is out of range.
        GraphMismatchError: if they were trained on different graphs or splits.
        SplitError: if the split leaves too few unseen triples.
    """
    whole("resamples", resamples, 1)
    whole("seed", seed, 0)
    for what, left, right in (
        ("graphs", a.opened.graph.hash, b.opened.graph.hash),
        ("splits", a.opened.split.hash, b.opened.split.hash),
    ):
        if left != right:
            raise GraphMismatchError(
                f"'{a.scorer.name}' and '{b.scorer.name}' were trained on different {what} "
                f"({left[:12]}, {right[:12]}); their figures cannot be compared. Train both on one graph folder."
            )
    graph, split = a.opened.graph, a.opened.split
    queries = split.held_out("test")
    if len(queries) < MIN_TRIPLES:
        raise SplitError(
            f"only {len(queries)} unseen test triples to compare on; {MIN_TRIPLES} are needed. Build the graph with a "
            "split and a smaller `train_ratio`, such as 0.7."
        )
    ranks = [rank_triples(model.scorer, queries, graph.triples) for model in (a, b)]
    clusters = np.tile(recipe_clusters(graph, split.is_in("test"), queries), 2)
    gain = 1 / ranks[0]["rank"].to_numpy(dtype=float) - 1 / ranks[1]["rank"].to_numpy(dtype=float)
    means = bootstrap(gain, clusters, resamples=resamples, seed=seed)
    one, other = (
        ComparedModel(
            **msgspec.structs.asdict(ranking_metrics(ranked)),
            name=model.scorer.name,
            has_seen_the_test_recipes=model.kg == "full",
        )
        for model, ranked in zip((a, b), ranks, strict=True)
    )
    return LinkComparison(
        a=one,
        b=other,
        queries=len(gain),
        difference=float(gain.mean()),
        difference_ci=interval(means),
        probability_a_better=float(np.mean(means > 0) + np.mean(means == 0) / 2),
    )
