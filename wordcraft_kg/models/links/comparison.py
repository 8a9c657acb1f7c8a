"""Comparing two link predictors on the same queries."""

from typing import Any

import numpy as np

from wordcraft_kg.errors import ConfigError, GraphMismatchError, SplitError
from wordcraft_kg.models.links.folder import OpenedModel
from wordcraft_kg.models.scorers.ranking import MIN_TRIPLES, rank_triples, ranking_metrics, recipe_clusters
from wordcraft_kg.statistics import bootstrap, interval


def compare(a: OpenedModel, b: OpenedModel, *, resamples: int = 1_000, seed: int = 0) -> dict[str, Any]:
    """Rank the unseen test triples with both models and bootstrap the difference of their reciprocal ranks.

    Both are resampled together, a recipe pair at a time: the difference is judged on the same queries, which is much
    sharper than comparing two separate intervals.

    Returns:
        ``a`` and ``b`` (name, metrics), ``queries``, ``difference`` of MRR (a - b), its 95 % interval
        ``difference_ci``, and ``probability_a_better``, the share of resamples in which a is ahead (ties count half).

    Raises:
        GraphMismatchError: if they were trained on different graphs or splits.
        SplitError: if the split leaves no unseen triples.
    """
    if resamples < 1:
        raise ConfigError(f"--resamples {resamples}: expected 1 or more.")
    if seed < 0:
        raise ConfigError(f"--seed {seed}: expected 0 or more.")
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
            "split and a smaller --train-ratio, such as 0.7."
        )
    ranks = [rank_triples(model.scorer, queries, graph.triples) for model in (a, b)]
    clusters = np.tile(recipe_clusters(graph, split.is_in("test"), queries), 2)
    gain = 1 / ranks[0]["rank"].to_numpy(dtype=float) - 1 / ranks[1]["rank"].to_numpy(dtype=float)
    means = bootstrap(gain, clusters, resamples=resamples, seed=seed)
    return {
        **{
            side: {
                "name": model.scorer.name,
                "has_seen_the_test_recipes": model.kg == "full",
                **ranking_metrics(ranked),
            }
            for side, model, ranked in (("a", a, ranks[0]), ("b", b, ranks[1]))
        },
        "queries": len(gain),
        "difference": float(gain.mean()),
        "difference_ci": list(interval(means)),
        "probability_a_better": float(np.mean(means > 0) + np.mean(means == 0) / 2),
    }
