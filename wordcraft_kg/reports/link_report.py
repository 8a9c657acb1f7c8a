"""The link-prediction report: the view of a link predictor with its pictures."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.records import schema_of
from wordcraft_kg.evaluation.communities import Communities, communities_of
from wordcraft_kg.evaluation.link_comparison import LinkComparison
from wordcraft_kg.evaluation.links import LinkView, view_links
from wordcraft_kg.evaluation.ranked_links import RankedLinks, rank_links
from wordcraft_kg.graphs.doses import Dose
from wordcraft_kg.graphs.folder import OpenedGraph, Taught
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.links.records import TraceRow
from wordcraft_kg.models.scorers.config import MAX_QUERIES
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.glossary import GLOSSARY
from wordcraft_kg.reports.pages import Report, render_page

SEARCHABLE = 30_000
"""Most queries whose ranks are put into the page, for its search."""
PLAYERS = {
    "v": "ingredient scores alone (v)",
    "u": "combination scores alone (u)",
    "u+v, self edges kept": "both (u + v), self edges kept",
    "u+v, self edges observed": "both (u + v), self edges where training has them",
    "w, best pair": "recipes (w): the best pair",
    "u+v, self edges dropped": "both (u + v), self edges dropped",
    "random": "any slot at random",
    "recipe oracle": "recipe oracle",
}
"""Names of the players in words."""


def make_link_report(
    scorer: TripleScorer,
    opened: OpenedGraph,
    *,
    kg: Taught = "partial",
    dose: Dose | None = None,
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
        kg: knowledge graph of its training, see :func:`~wordcraft_kg.evaluation.ranked_links.rank_links`.
        dose: the recipes of its training, if these are not all of that graph.
        name: name of the scorer in the report.
        provenance: facts for the last section.
        trace: a row for each epoch.
        max_queries: most queries to rank; 0 ranks all.
        seed: seed of the sample of queries, the bootstrap and the map.

    Raises:
        SplitError: if fewer than 30 triples are left to evaluate it on.
    """
    judged = rank_links(scorer, opened, kg, dose=dose, max_queries=max_queries, seed=seed)
    view = view_links(judged, name=name, provenance=provenance, trace=trace, seed=seed)
    graph, communities = judged.graph, None
    if judged.has_table:
        communities = communities_of(graph.entities, graph.triples[:, [0, 2]], graph.use_counts, seed)
    pictures_of_entities = _pictures_of_entities(judged, communities, seed) if communities else {}
    return Report(
        view,
        "link_report.html.j2",
        {
            **_pictures_of_ranks(view),
            **_pictures_of_probabilities(view),
            **_pictures_of_training(view),
            **pictures_of_entities,
        },
        shown={
            "relations": RELATIONS,
            "players": PLAYERS,
            "communities": communities,
            "legend": communities.legend(charts.COLOURS) if communities else (),
            "matrix_order": graph.labels(communities.order) if communities else (),
            "searchable": _searchable(judged),
        },
        tables={"ranks.csv": judged.labelled_ranks},
    )


def report_schema() -> dict[str, Any]:
    """Return the JSON Schema of ``report.json``."""
    return schema_of(LinkView, "urn:wordcraft-kg:link-report:1", "wordcraft-kg link-prediction report")


def _pictures_of_probabilities(view: LinkView) -> dict[str, Markup]:
    if not view.probabilities:
        return {}
    series = {
        f"{row.relation}{', itself' if row.pairs == 'itself' else ''}": [
            (found.probability, found.observed, found.low, found.high, found.triples) for found in row.bins
        ]
        for row in view.probabilities
        if not row.reason
    }
    return {"probabilities": charts.log_reliability(series, "Share of true triples against their probability")}


def _pictures_of_ranks(view: LinkView) -> dict[str, Markup]:
    compared = [(view.model.name, view.metrics["all"])]
    compared += [(GLOSSARY[row.baseline].name, view.baselines[row.baseline]["all"]) for row in view.comparisons]
    return {
        "baselines": charts.intervals(
            [(name, (found.mrr or 0.0, *(found.mrr_ci or (None, None)))) for name, found in compared],
            "filtered MRR, with 95 % intervals",
            "Filtered MRR of the model and of each baseline",
            reference=view.metrics["all"].mrr,
        ),
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
    loss = [(row.epoch, row.loss, None, None) for row in view.trace]
    valid = [(row.epoch, row.valid_mrr, None, None) for row in view.trace if row.valid_mrr is not None]
    pictures = {}
    if loss:
        pictures["loss"] = charts.curves({"loss": loss}, "epoch", "training loss", "Training loss by epoch")
    if valid:
        pictures["valid"] = charts.curves({"MRR": valid}, "epoch", "validation MRR", "Validation MRR by epoch")
    return pictures


def _searchable(judged: RankedLinks) -> dict[str, Any] | None:
    """Return all ranks as the page's search reads them; None if they are too many for a page."""
    ranks = judged.ranks
    if len(ranks) > SEARCHABLE:
        return None
    sides = ("head", "tail")
    by_rank = ranks.assign(side=(ranks["side"] == "tail").astype(int)).sort_values("rank", kind="stable")
    columns = ("head", "relation", "tail", "side", "rank", "top")
    rows = zip(*(by_rank[column].tolist() for column in columns), strict=True)
    return {
        "entities": judged.graph.entities,
        "relations": RELATIONS,
        "sides": sides,
        "rows": [list(row) for row in rows],
    }


def _pictures_of_entities(judged: RankedLinks, communities: Communities, seed: int) -> dict[str, Markup]:
    graph, order = judged.graph, communities.order
    groups = list(zip(communities.names, communities.sizes, strict=True))
    test = judged.opened.split.held_out("test")
    pictures = {}
    for relation, name in enumerate(RELATIONS):
        held_out = np.zeros((graph.num_entities, graph.num_entities), dtype=bool)
        triples = test[test[:, 1] == relation]
        held_out[triples[:, 0], triples[:, 2]] = True
        shuffled = np.ix_(order, order)
        pictures[f"matrix_{name}"] = charts.matrix_image(
            judged.table[relation][shuffled], held_out[shuffled], groups, f"Scores of {name} for all pairs of entities"
        )
    if np.ptp(judged.profiles):  # a scorer that gives all entities the same scores has no map
        pictures["map"] = _map(judged, communities, seed)
    return pictures


@stage("drawing the map")
def _map(judged: RankedLinks, communities: Communities, seed: int) -> Markup:
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
    return charts.labelled_points(
        points, graph.entities, communities.group_of.tolist(), by_use, "Map of entities by their scores"
    )


def comparison_page(view: LinkComparison) -> str:
    """Return the page: a table of all models, their MRR, and their differences to the first."""
    mrr = charts.intervals(
        [(model.name, (model.mrr or 0.0, *(model.mrr_ci or (None, None)))) for model in view.models],
        "filtered MRR, 95 % over recipes",
        "MRR of each model with its interval",
    )
    differences = charts.intervals(
        [(model.name, (model.difference or 0.0, *(model.difference_ci or (None, None)))) for model in view.models],
        f"difference of MRR to {view.models[0].name}, paired",
        f"Difference of each model's MRR to that of {view.models[0].name} with its interval",
        reference=0.0,
    )
    return render_page("link_comparison.html.j2", report=view, mrr=mrr, differences=differences)
