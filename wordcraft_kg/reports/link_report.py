"""The link-prediction report: every number of it as plain values, its pictures, and its page."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pandas as pd
import torch
from markupsafe import Markup
from numpy.typing import NDArray

from wordcraft_kg.agents.players import play_all, random_entity, recipe_oracle, scorer_players
from wordcraft_kg.artefacts import dump_json, staged_folder, write_atomically
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.errors import SplitError, WordCraftKGError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.audit import leakage, split_summary
from wordcraft_kg.graphs.folder import KG, OpenedGraph
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS, is_in
from wordcraft_kg.models.links.records import TraceRow
from wordcraft_kg.models.scorers.facts import FrequencyScorer
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.near_synonyms import NEAR_SYNONYM, near_synonym_recipes, near_synonym_triples
from wordcraft_kg.models.scorers.neighbours import NeighbourScorer
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.ranking import (
    MIN_TRIPLES,
    calibration,
    random_metrics,
    rank_triples,
    ranking_metrics,
    recipe_clusters,
    slice_masks,
    with_interval,
)
from wordcraft_kg.records import as_values
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.pages import render_page

REPORT_FORMAT = "wordcraft-kg link report 1"
RANK_BINS = ((1, 1), (2, 3), (4, 5), (6, 10), (11, 20), (21, 50), (51, 100), (101, 200), (201, 10**9))
LISTED = 8
MAP_LIMIT = 3_000
"""Entities. Above it the report leaves out what needs the scores of all pairs: matrices, map, neighbours as a
baseline, ..."""


@dataclass(frozen=True)
class LinkReport:
    """A report's numbers (``report.json``), its ranking (a row a query) and its pictures by name."""

    values: dict[str, Any]
    ranks: pd.DataFrame
    pictures: dict[str, Markup]


def make_link_report(
    scorer: TripleScorer,
    opened: OpenedGraph,
    *,
    kg: KG = "partial",
    name: str = "scorer",
    provenance: dict[str, Any] | None = None,
    trace: Sequence[TraceRow] = (),
    seed: int = 0,
) -> LinkReport:
    """Evaluate a scorer on the links of a graph.

    A scorer of the partial graph is judged on the test triples that training does not contain; one of the full graph
    has seen them, so it is judged on the graph's own triples and marked as remembering.

    Args:
        scorer: of this graph.
        opened: graph and split.
        kg: what the scorer was trained on, ``partial`` or ``full``.
        name: how the report calls the scorer.
        provenance: facts for the last section.
        trace: a row an epoch.
        seed: of the bootstrap and the map.

    Raises:
        SplitError: if fewer than 30 triples are left to judge it on.
    """
    graph, split = opened.graph, opened.split
    is_full = kg == "full"
    test = split.held_out("test")
    queries = graph.triples if is_full else test
    if len(queries) < MIN_TRIPLES:
        raise SplitError(
            f"only {len(queries)} unseen test triples; {MIN_TRIPLES} are needed for a figure that means something. "
            "Build the graph with a smaller --train-ratio, such as 0.7."
        )
    trained_on = opened.triples(kg)
    ranks = rank_triples(scorer, queries, graph.triples)
    sources = np.ones(graph.num_recipes, dtype=bool) if is_full else split.is_in("test")
    clusters = np.tile(recipe_clusters(graph, sources, queries), 2)
    baselines: dict[str, TripleScorer] = {"frequency": FrequencyScorer(graph, trained_on)}
    if graph.num_entities <= MAP_LIMIT:
        baselines["neighbours"] = NeighbourScorer(graph, trained_on)
    metrics = _by_slice(ranks, lambda part, mask: with_interval(part, clusters[mask], seed=seed))
    everything = split.triples_of("test") if not is_full else queries
    leaked_ranks = ranks if is_full else rank_triples(scorer, everything, graph.triples)
    summary = split_summary(split)
    leaked = 0 if is_full else summary["leaked_triples"]
    values: dict[str, Any] = {
        "format": REPORT_FORMAT,
        "model": {"name": name, "kg": kg, "has_seen_the_test_recipes": is_full},
        "graph": {
            "name": graph.name,
            "hash": graph.hash,
            "entities": graph.num_entities,
            "recipes": graph.num_recipes,
            "triples": len(graph.triples),
        },
        "split": summary,
        "queries": len(ranks),
        "triples": len(queries),
        "leaked_left_out": leaked,
        "leakage": leakage(split),
        "checks": _checks(opened, scorer, is_full),
        "metrics": metrics,
        "ties": {
            "optimistic": ranking_metrics(ranks, "optimistic"),
            "pessimistic": ranking_metrics(ranks, "pessimistic"),
            # Unfiltered, all entities compete.
            "raw_rank": ranking_metrics(ranks.assign(candidates=graph.num_entities), "raw_rank"),
        },
        "with_leaked": ranking_metrics(leaked_ranks),
        "baselines": {
            **{
                name: _by_slice(rank_triples(baseline, queries, graph.triples), lambda part, _: ranking_metrics(part))
                for name, baseline in baselines.items()
            },
            "random": _by_slice(ranks, lambda part, _: random_metrics(part)),
        },
        "near_synonym_cosine": NEAR_SYNONYM,
        "drill_down": {
            **_drill_down(opened, ranks, trained_on),
            "near_synonyms": [] if is_full else _near_synonyms(opened, ranks, queries),
        },
        "histogram": _histogram(ranks),
        "calibration": calibration(ranks),
        "best": _listed(graph, ranks.sort_values(["rank", "score"], ascending=[True, False], kind="stable")),
        "worst": _listed(graph, ranks.sort_values(["rank", "score"], ascending=[False, True], kind="stable")),
        "perhaps_missing": [],
        "self_edges": None,
        "neighbours": [],
        "kg_play": [],
        "trace": [as_values(row) for row in trace],
        "provenance": provenance or {},
    }
    pictures: dict[str, Markup] = {
        "ranks": charts.grouped_bars(
            values["histogram"]["bins"],
            values["histogram"]["shares"],
            "filtered realistic rank",
            "Share of queries by rank of the true entity",
        ),
        "calibration": charts.reliability(
            [(row["confidence"], row["accuracy"], row["queries"]) for row in values["calibration"]["bins"]],
            "Accuracy against confidence",
        ),
    }
    if trace:
        pictures["loss"] = charts.lines(
            {"loss": [(row.epoch, row.loss) for row in trace]}, "epoch", "loss", "Training loss by epoch"
        )
        points = [(row.epoch, row.valid_mrr) for row in trace if row.valid_mrr is not None]
        if points:
            pictures["valid"] = charts.lines({"MRR": points}, "epoch", "validation MRR", "Validation MRR by epoch")
    if graph.num_entities <= MAP_LIMIT:
        table = torch.stack([scorer.table(relation) for relation in range(len(RELATIONS))]).cpu().numpy()
        values["perhaps_missing"] = _perhaps_missing(graph, table)
        values["self_edges"] = _self_edges(graph, table[COMBINES_WITH])
        profiles = _profiles(table)
        values["neighbours"] = _neighbours(graph, profiles)
        values["kg_play"] = _kg_play(opened, scorer, trained_on, seed)
        pictures |= _pictures_of_all_entities(graph, table, profiles, test, seed)
    return LinkReport(values, _labelled(graph, ranks), pictures)


def write_link_report(report: LinkReport, out: Path, *, force: bool = False) -> None:
    """Write ``index.html``, ``report.json`` (checked against its schema) and ``ranks.csv`` into a folder."""
    jsonschema.validate(report.values, report_schema())
    with staged_folder(out, force=force) as folder:
        write_atomically(folder / "report.json", dump_json(report.values))
        write_atomically(folder / "index.html", render(report))
        ranks = report.ranks.to_csv(index=False, lineterminator="\n", float_format="%.6g")
        write_atomically(folder / "ranks.csv", ranks)


def report_schema() -> dict[str, Any]:
    """Return the JSON Schema of ``report.json``."""
    text = resources.files("wordcraft_kg.reports").joinpath("schemas/link_report.schema.json").read_text("utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


def render(report: LinkReport) -> str:
    """Return the report as one self-contained HTML page."""
    values = {"report": report.values, "pictures": report.pictures, "relations": RELATIONS}
    return render_page("link_report.html.j2", **values)


def summary_values(values: dict[str, Any]) -> dict[str, Any]:
    """Return what ``evaluate-links --json`` prints, from a report's numbers."""
    slices = ("all", *RELATIONS)
    metrics = values["metrics"]
    return {
        **{
            metric: {name: metrics[name].get(metric) for name in slices}
            for metric in ("mrr", "hits@1", "hits@3", "hits@10")
        },
        "mrr_ci": {name: metrics[name].get("mrr_ci") for name in slices},
        "queries": values["queries"],
        "triples": values["triples"],
        "leaked_left_out": values["leaked_left_out"],
        "mrr_with_leaked": values["with_leaked"]["mrr"],
        "mrr_without_near_synonyms": next(
            (row["mrr"] for row in values["drill_down"]["near_synonyms"] if row["slice"] == "no such train recipe"),
            None,
        ),
        "has_seen_the_test_recipes": values["model"]["has_seen_the_test_recipes"],
        "baselines": {
            name: {slice_: table[slice_].get("mrr") for slice_ in slices} for name, table in values["baselines"].items()
        },
        "checks_passed": all(check["passed"] for check in values["checks"]),
    }


def _by_slice(ranks: pd.DataFrame, measure: Any) -> dict[str, dict[str, Any]]:
    return {name: measure(ranks[mask], mask) for name, mask in slice_masks(ranks).items()}


def _checks(opened: OpenedGraph, scorer: TripleScorer, is_full: bool) -> list[dict[str, Any]]:
    """The conditions without which the headline means nothing; a full-graph model is not asked about leaks."""
    graph, split = opened.graph, opened.split
    uncovered = np.empty(0, dtype=np.int64) if is_full else split.uncovered
    listed = f"{len(uncovered)} do not ({', '.join(graph.labels(uncovered[:6]))}): their ranks are near chance"
    checks = [
        ("graph", "the model was trained on the graph that is evaluated", scorer.graph_hash == graph.hash, ""),
        ("coverage", "every entity occurs in training", not len(uncovered), listed if len(uncovered) else "all do"),
    ]
    if not is_full:
        test = split.held_out("test")
        in_train = int(np.sum(is_in(test, split.partial, graph.num_entities)))
        symmetric = test[test[:, 1] == COMBINES_WITH]
        mirrored = int(np.sum(is_in(symmetric[:, [2, 1, 0]], split.partial, graph.num_entities)))
        no_leak = "no evaluated triple is in the training triples"
        no_mirror = "no combinesWith triple has its mirror in the training triples"
        checks += [
            ("leak", no_leak, not in_train, f"{in_train} found"),
            ("mirror", no_mirror, not mirrored, f"{mirrored} found"),
        ]
    return [{"id": key, "name": name, "passed": passed, "detail": detail} for key, name, passed, detail in checks]


def _drill_down(opened: OpenedGraph, ranks: pd.DataFrame, trained_on: Ids) -> dict[str, list[dict[str, Any]]]:
    graph = opened.graph
    target = np.where(ranks["side"] == "tail", ranks["tail"], ranks["head"]).astype(np.int64)
    seen = np.bincount(np.concatenate([trained_on[:, 0], trained_on[:, 2]]), minlength=graph.num_entities)[target]
    layer = layers(graph)[target]
    is_symmetric = (ranks["relation"] == COMBINES_WITH).to_numpy()
    is_self = (ranks["head"] == ranks["tail"]).to_numpy()

    def rows(groups: list[tuple[str, NDArray[np.bool_]]]) -> list[dict[str, Any]]:
        return [{"slice": name, **ranking_metrics(ranks[mask])} for name, mask in groups if mask.any()]

    def between(values: NDArray[np.int64], bounds: list[tuple[int, int]]) -> list[dict[str, Any]]:
        return rows(
            [
                (f"{low}" if low == high else f"{low}–{high}" if high < 10**6 else f"{low} or more", mask)
                for low, high in bounds
                for mask in [(values >= low) & (values <= high)]
            ]
        )

    top = 10**6
    return {
        "seen_in_train": between(seen, [(0, 0), (1, 5), (6, 15), (16, 40), (41, 100), (101, top)]),
        "layer": [
            *rows([("not reachable", layer < 0)]),
            *between(layer, [(0, 2), (3, 5), (6, 8), (9, 11), (12, top)]),
        ],
        "self_combination": rows([("with itself", is_symmetric & is_self), ("with another", is_symmetric & ~is_self)]),
    }


def _near_synonyms(opened: OpenedGraph, ranks: pd.DataFrame, queries: Ids) -> list[dict[str, Any]]:
    """The metrics with and without the triples of test recipes that repeat a train recipe in other words."""
    graph = opened.graph
    recipes = near_synonym_recipes(opened.split, glove_features(graph.entities))
    repeats = np.tile(near_synonym_triples(graph, recipes, queries), 2)
    if not repeats.any():  # by goal no result is in both parts, and labels may have no word vectors: nothing to tell
        return []
    groups = (("a train recipe with a near-synonym", repeats), ("no such train recipe", ~repeats))
    return [{"slice": name, **ranking_metrics(ranks[mask])} for name, mask in groups if mask.any()]


def _kg_play(opened: OpenedGraph, scorer: TripleScorer, trained_on: Ids, seed: int) -> list[dict[str, Any]]:
    """Success of players that know the scorer and nothing else, on the test tasks of depth 1, 1 and 8 distractors."""
    try:
        players = {
            **scorer_players(opened.graph, scorer, trained_on),
            "random": random_entity,
            "recipe oracle": recipe_oracle,
        }
        played = play_all(opened, players, WordCraftConfig(part="test"), (1, 8), seed=seed)
    except (
        WordCraftKGError
    ):  # no test task, too few entities for distractors, or a scorer that the checks refuse anyway
        return []
    return [{str(name): value for name, value in row.items()} for row in played.to_dict("records")]


def _histogram(ranks: pd.DataFrame) -> dict[str, Any]:
    shares = {}
    for relation, name in enumerate(RELATIONS):
        rank = ranks.loc[ranks["relation"] == relation, "rank"].to_numpy(dtype=float)
        # A realistic rank may end in .5; it counts for the bin it falls into when rounded up.
        whole = np.ceil(rank)
        shares[name] = [
            float(np.mean((whole >= low) & (whole <= high))) if len(rank) else 0.0 for low, high in RANK_BINS
        ]
    bins = [str(low) if low == high else f"{low}–{high}" if high < 10**9 else f"{low}+" for low, high in RANK_BINS]
    return {"bins": bins, "shares": shares}


def _listed(graph: RecipeGraph, ranks: pd.DataFrame) -> list[dict[str, Any]]:
    columns = ["head", "relation", "tail", "side", "rank", "score", "top"]
    shown = _labelled(graph, ranks.head(LISTED))[columns]
    return [{str(name): value for name, value in row.items()} for row in shown.to_dict("records")]


def _perhaps_missing(graph: RecipeGraph, table: NDArray[np.float32]) -> list[dict[str, Any]]:
    """The best-scored triples that the graph does not have, self edges left out, half of them of each relation."""
    found = []
    for relation, name in enumerate(RELATIONS):
        scores = table[relation].copy()
        if relation == COMBINES_WITH:
            scores = np.triu((scores + scores.T) / 2, k=1) + np.where(np.tri(len(scores), dtype=bool), -np.inf, 0)
        known = graph.triples[graph.triples[:, 1] == relation]
        scores[known[:, 0], known[:, 2]] = -np.inf
        np.fill_diagonal(scores, -np.inf)
        for flat in np.argsort(-scores, axis=None, kind="stable")[: LISTED // 2].tolist():
            head, tail = divmod(flat, len(scores))
            found.append(
                {
                    "head": graph.entities[head],
                    "relation": name,
                    "tail": graph.entities[tail],
                    "score": float(scores[head, tail]),
                }
            )
    return [row for row in found if np.isfinite(row["score"])]


def _self_edges(graph: RecipeGraph, scores: NDArray[np.float32]) -> dict[str, float]:
    symmetric = graph.triples[graph.triples[:, 1] == COMBINES_WITH]
    return {
        "top_answer_is_itself": float(np.mean(scores.argmax(axis=1) == np.arange(len(scores)))),
        "really_combines_with_itself": float(np.sum(symmetric[:, 0] == symmetric[:, 2]) / graph.num_entities),
    }


def _profiles(table: NDArray[np.float32]) -> NDArray[np.float64]:
    """Unit vectors of each entity's scores as head and as tail of both relations; any scorer has them.

    Each part is centred by row and by column, else all that it shows is which entities score high with everything.
    """
    parts = []
    for scores in table.astype(np.float64):
        centred = scores - scores.mean(axis=1, keepdims=True) - scores.mean(axis=0) + scores.mean()
        parts += [part / (centred.std() or 1.0) for part in (centred, centred.T)]
    profiles = np.concatenate(parts, axis=1)
    return profiles / np.maximum(np.linalg.norm(profiles, axis=1, keepdims=True), 1e-12)


def _neighbours(graph: RecipeGraph, profiles: NDArray[np.float64]) -> list[dict[str, Any]]:
    """Nearest neighbours of the ten most used entities."""
    most_used = np.argsort(-graph.use_counts, kind="stable")[:10]
    similar = profiles[most_used] @ profiles.T
    similar[np.arange(len(most_used)), most_used] = -np.inf
    nearest = np.argsort(-similar, axis=1, kind="stable")[:, :5]
    return [
        {"entity": graph.entities[entity], "neighbours": list(graph.labels(row))}
        for entity, row in zip(most_used.tolist(), nearest.tolist(), strict=True)
    ]


def _pictures_of_all_entities(
    graph: RecipeGraph, table: NDArray[np.float32], profiles: NDArray[np.float64], test: Ids, seed: int
) -> dict[str, Markup]:
    from sklearn.decomposition import PCA
    from sklearn.manifold import TSNE
    from threadpoolctl import threadpool_limits

    group_of = _communities(graph, seed)
    order = np.lexsort((np.arange(graph.num_entities), group_of))
    pictures = {}
    for relation, name in enumerate(RELATIONS):
        held_out = np.zeros((graph.num_entities, graph.num_entities), dtype=bool)
        triples = test[test[:, 1] == relation]
        held_out[triples[:, 0], triples[:, 2]] = True
        shuffled = np.ix_(order, order)
        pictures[f"matrix_{name}"] = charts.matrix_image(
            table[relation][shuffled], held_out[shuffled], f"Scores of {name} for all pairs of entities"
        )
    if not np.ptp(profiles):
        return pictures  # a scorer that tells no entities apart has no map
    # On two cores t-SNE with all threads is many times slower than with one.
    with threadpool_limits(1):
        components = min(50, *profiles.shape)
        reduced = PCA(components, random_state=seed).fit_transform(profiles)
        perplexity = min(20.0, (graph.num_entities - 1) / 3)
        points = TSNE(perplexity=perplexity, random_state=seed, init="pca", n_jobs=1).fit_transform(reduced)
    by_use = np.argsort(-graph.use_counts, kind="stable").tolist()
    pictures["map"] = charts.labelled_points(
        points, graph.entities, group_of.tolist(), by_use, "Map of entities by their scores"
    )
    return pictures


def _communities(graph: RecipeGraph, seed: int) -> Ids:
    """Groups of entities that are crafted together (Louvain on the graph without directions), largest first."""
    import networkx as nx

    plain = nx.Graph()
    plain.add_nodes_from(range(graph.num_entities))
    plain.add_edges_from(graph.triples[:, [0, 2]].tolist())
    groups = sorted(nx.community.louvain_communities(plain, seed=seed), key=lambda group: (-len(group), min(group)))
    group_of = np.zeros(graph.num_entities, dtype=np.int64)
    for number, group in enumerate(groups):
        group_of[list(group)] = number
    return group_of


def _labelled(graph: RecipeGraph, ranks: pd.DataFrame) -> pd.DataFrame:
    names = np.array(graph.entities, dtype=object)
    frame = ranks.copy()
    for column in ("head", "tail", "top"):
        frame[column] = names[frame[column].to_numpy(dtype=np.int64)]
    frame["relation"] = np.array(RELATIONS, dtype=object)[frame["relation"].to_numpy(dtype=np.int64)]
    return frame
