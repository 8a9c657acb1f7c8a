"""The link-prediction report: the view of a link predictor with its pictures."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import KG, OpenedGraph
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.links.records import TraceRow
from wordcraft_kg.models.scorers.config import MAX_QUERIES
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.progress import stage
from wordcraft_kg.records import schema_of
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.report import Report
from wordcraft_kg.views.links import JudgedLinks, LinkView, judge_links, view_links


def make_link_report(
    scorer: TripleScorer,
    opened: OpenedGraph,
    *,
    kg: KG = "partial",
    name: str = "scorer",
    provenance: Mapping[str, str] | None = None,
    trace: Sequence[TraceRow] = (),
    max_queries: int = MAX_QUERIES,
    seed: int = 0,
) -> Report[LinkView]:
    """Evaluate a scorer on the links of a graph.

    Args:
        scorer: a scorer of this graph.
        opened: graph and split.
        kg: knowledge graph that the scorer was trained on, ``partial`` or ``full``; see
            :func:`~wordcraft_kg.views.links.judge_links`.
        name: name of the scorer in the report.
        provenance: facts for the last section.
        trace: a row for each epoch.
        max_queries: most queries to rank; 0 ranks all. See :func:`~wordcraft_kg.views.links.judge_links`.
        seed: seed of the sample of queries, the bootstrap and the map.

    Raises:
        SplitError: if fewer than 30 triples are left to evaluate it on.
    """
    judged = judge_links(scorer, opened, kg, max_queries=max_queries, seed=seed)
    view = view_links(judged, name=name, provenance=provenance, trace=trace, seed=seed)
    return Report(
        view,
        "link_report.html.j2",
        {**_pictures_of_ranks(view), **_pictures_of_training(view), **_pictures_of_all_entities(judged, seed)},
        shown={"relations": RELATIONS},
        tables={"ranks.csv": judged.labelled_ranks},
    )


def report_schema() -> dict[str, Any]:
    """Return the JSON Schema of ``report.json``."""
    return schema_of(LinkView, "urn:wordcraft-kg:link-report:1", "wordcraft-kg link-prediction report")


def _pictures_of_ranks(view: LinkView) -> dict[str, Markup]:
    return {
        "ranks": charts.grouped_bars(
            view.histogram.bins,
            view.histogram.shares,
            "filtered realistic rank",
            "Share of queries by rank of the true entity",
        ),
        "calibration": charts.reliability(
            [(row.confidence, row.accuracy, row.queries) for row in view.calibration.bins],
            "Accuracy against confidence",
        ),
    }


def _pictures_of_training(view: LinkView) -> dict[str, Markup]:
    loss = [(row.epoch, row.loss) for row in view.trace]
    valid = [(row.epoch, row.valid_mrr) for row in view.trace if row.valid_mrr is not None]
    pictures = {}
    if loss:
        pictures["loss"] = charts.lines({"loss": loss}, "epoch", "loss", "Training loss by epoch")
    if valid:
        pictures["valid"] = charts.lines({"MRR": valid}, "epoch", "validation MRR", "Validation MRR by epoch")
    return pictures


def _pictures_of_all_entities(judged: JudgedLinks, seed: int) -> dict[str, Markup]:
    if not judged.has_table:
        return {}
    graph = judged.graph
    group_of = _communities(graph, seed)
    order = np.lexsort((np.arange(graph.num_entities), group_of))
    test = judged.opened.split.held_out("test")
    pictures = {}
    for relation, name in enumerate(RELATIONS):
        held_out = np.zeros((graph.num_entities, graph.num_entities), dtype=bool)
        triples = test[test[:, 1] == relation]
        held_out[triples[:, 0], triples[:, 2]] = True
        shuffled = np.ix_(order, order)
        pictures[f"matrix_{name}"] = charts.matrix_image(
            judged.table[relation][shuffled], held_out[shuffled], f"Scores of {name} for all pairs of entities"
        )
    if np.ptp(judged.profiles):  # a scorer that gives all entities the same scores has no map
        pictures["map"] = _map(judged, group_of, seed)
    return pictures


@stage("drawing the map")
def _map(judged: JudgedLinks, group_of: Ids, seed: int) -> Markup:
    """Return a t-SNE map of the score profiles."""
    from sklearn.decomposition import PCA
    from sklearn.manifold import TSNE
    from threadpoolctl import threadpool_limits

    graph, profiles = judged.graph, judged.profiles
    # On two cores t-SNE with all threads is many times slower than with one.
    with threadpool_limits(1):
        components = min(50, *profiles.shape)
        reduced = PCA(components, random_state=seed).fit_transform(profiles)
        perplexity = min(20.0, (graph.num_entities - 1) / 3)
        points = TSNE(perplexity=perplexity, random_state=seed, init="pca", n_jobs=1).fit_transform(reduced)
    by_use = np.argsort(-graph.use_counts, kind="stable").tolist()
    return charts.labelled_points(points, graph.entities, group_of.tolist(), by_use, "Map of entities by their scores")


def _communities(graph: RecipeGraph, seed: int) -> Ids:
    """Return each entity's group, of entities crafted together (Louvain on the undirected graph), largest first."""
    import networkx as nx

    plain = nx.Graph()
    plain.add_nodes_from(range(graph.num_entities))
    plain.add_edges_from(graph.triples[:, [0, 2]].tolist())
    groups = sorted(nx.community.louvain_communities(plain, seed=seed), key=lambda group: (-len(group), min(group)))
    group_of = np.zeros(graph.num_entities, dtype=np.int64)
    for number, group in enumerate(groups):
        group_of[list(group)] = number
    return group_of
