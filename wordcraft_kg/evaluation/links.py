"""The figures of a link predictor: metrics, baselines, slices and checks."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from wordcraft_kg.agents.players import PlayerSuccess
from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.evaluation.link_sections import (
    NO_NEAR_SYNONYM,
    Comparison,
    DrillDown,
    RankedTriple,
    ScoredPair,
    SelfEdges,
    comparisons_of,
    drill_down_of,
    listed_triples,
    perhaps_missing_of,
    play_by_scores,
    self_edges_of,
)
from wordcraft_kg.evaluation.probabilities import Reliability, view_probabilities
from wordcraft_kg.evaluation.ranked_links import RankedLinks
from wordcraft_kg.graphs.audit import Leakage, SplitSummary, leakage, split_summary
from wordcraft_kg.graphs.folder import TrainedOn
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS, Relation, is_in
from wordcraft_kg.models.links.records import TraceRow
from wordcraft_kg.models.scorers.cross_fitting import folds_of
from wordcraft_kg.models.scorers.near_synonyms import NEAR_SYNONYM
from wordcraft_kg.models.scorers.ranking import (
    Calibration,
    RankingMetrics,
    calibration,
    random_metrics,
    rank_triples,
    ranking_metrics,
    sampled,
    slice_masks,
    with_interval,
)

_Slices = dict[str, RankingMetrics]
"""Metrics of all queries, of each relation, and of each relation and side."""


class JudgedModel(Record):
    """The model; a model of the full graph has seen the evaluation triples."""

    name: str
    kg: TrainedOn
    has_seen_the_test_recipes: bool


class JudgedGraph(Record):
    """The graph and its size."""

    name: str
    hash: Hash
    entities: Count
    recipes: Count
    triples: Count


class Check(Record):
    """A condition for the headline to be valid."""

    id: Literal["graph", "coverage", "leak", "mirror"]
    name: str
    passed: bool
    detail: str


class Ties(Record):
    """Metrics with ties broken for and against the model, and with unfiltered ranks."""

    optimistic: RankingMetrics
    pessimistic: RankingMetrics
    raw_rank: RankingMetrics


class Memory(Record):
    """MRR of train triples with and without them in training.

    Attributes:
        folds: fold count of the train recipes.
        queries: number of queries for train triples without a recipe outside their fold.
        in_sample_mrr: MRR of the model of all train recipes.
        left_out_mrr: MRR of the models without the fold: a forecast of ``test_mrr``.
    """

    folds: Count
    queries: Count
    in_sample_mrr: Share
    left_out_mrr: Share
    test_mrr: Share


class LinkView(Record):
    """The link-prediction report (``report.json``).

    Attributes:
        queries: number of queries, two for each of ``triples``.
        sampled_from: count of all triples if a uniform sample is ranked, else None.
        without_pairs: whether the graph is too large for the scores of all pairs; dependent parts are empty or None.
        leaked_left_out: number of triples of the test recipes that are also in training.
        metrics: filtered metrics with realistic ties.
        memory: of a cross-fitted model, like ``probabilities``, else None or empty.
        with_leaked: metrics with the leaked triples.
        comparisons: the model against each baseline, the best baseline first.
        perhaps_missing: the best-scored triples outside the graph.
        kg_play: success of players that use the scorer alone.
        trace: a row for each epoch of the training.
        provenance: facts about the training.
    """

    format: Literal["wordcraft-kg link report 1"]
    model: JudgedModel
    graph: JudgedGraph
    split: SplitSummary
    queries: Count
    triples: Count
    sampled_from: Count | None
    without_pairs: bool
    leaked_left_out: Count
    leakage: dict[Relation, Leakage]
    checks: Annotated[tuple[Check, ...], msgspec.Meta(min_length=2)]
    metrics: _Slices
    ties: Ties
    memory: Memory | None
    probabilities: tuple[Reliability, ...]
    with_leaked: RankingMetrics
    baselines: dict[str, _Slices]
    comparisons: Annotated[tuple[Comparison, ...], msgspec.Meta(min_length=1)]
    near_synonym_cosine: float
    drill_down: DrillDown
    calibration: Calibration
    best: tuple[RankedTriple, ...]
    worst: tuple[RankedTriple, ...]
    perhaps_missing: tuple[ScoredPair, ...]
    self_edges: SelfEdges | None
    kg_play: tuple[PlayerSuccess, ...]
    trace: tuple[TraceRow, ...]
    provenance: dict[str, str]


class LinkSummary(Record):
    """A report headline; metrics by slice, None without queries."""

    mrr: dict[str, Share | None]
    hits_at_1: dict[str, Share | None] = msgspec.field(name="hits@1")
    hits_at_3: dict[str, Share | None] = msgspec.field(name="hits@3")
    hits_at_10: dict[str, Share | None] = msgspec.field(name="hits@10")
    mrr_ci: dict[str, tuple[Share, Share] | None]
    queries: Count
    triples: Count
    sampled_from: Count | None
    leaked_left_out: Count
    mrr_with_leaked: Share | None
    mrr_without_near_synonyms: Share | None
    has_seen_the_test_recipes: bool
    baselines: dict[str, dict[str, Share | None]]
    comparisons: tuple[Comparison, ...]
    checks_passed: bool
    report: str


def view_links(
    judged: RankedLinks,
    *,
    name: str = "scorer",
    provenance: Mapping[str, str] | None = None,
    trace: Sequence[TraceRow] = (),
    seed: int = 0,
) -> LinkView:
    """Return all numbers of the report; ``seed`` is the bootstrap and player seed."""
    graph, ranks = judged.graph, judged.ranks
    split = split_summary(judged.opened.split)

    def measure(part: pd.DataFrame, mask: NDArray[np.bool_]) -> RankingMetrics:
        return with_interval(part, judged.clusters[mask], seed=seed)

    baselines = {name: _by_slice(found, measure) for name, found in judged.baseline_ranks.items()}
    return LinkView(
        format="wordcraft-kg link report 1",
        model=JudgedModel(name, judged.kg, judged.is_full),
        graph=JudgedGraph(graph.name, graph.hash, graph.num_entities, graph.num_recipes, len(graph.triples)),
        split=split,
        queries=len(ranks),
        triples=len(judged.queries),
        sampled_from=judged.population if judged.population > len(judged.queries) else None,
        without_pairs=not judged.has_table,
        leaked_left_out=0 if judged.is_full else split.leaked_triples,
        leakage=leakage(judged.opened.split),
        checks=tuple(_checks(judged)),
        metrics=_by_slice(ranks, measure),
        ties=_ties(judged),
        memory=_memory(judged),
        probabilities=_probabilities(judged),
        with_leaked=_with_leaked(judged),
        baselines={**baselines, "random": _by_slice(ranks, lambda part, _: random_metrics(part))},
        comparisons=comparisons_of(judged, seed),
        near_synonym_cosine=NEAR_SYNONYM,
        drill_down=drill_down_of(judged, seed),
        calibration=calibration(ranks),
        best=listed_triples(judged, ascending=True),
        worst=listed_triples(judged, ascending=False),
        perhaps_missing=perhaps_missing_of(judged) if judged.has_table else (),
        self_edges=self_edges_of(judged) if judged.has_table else None,
        kg_play=play_by_scores(judged, seed) if judged.has_table else (),
        trace=tuple(trace),
        provenance=dict(provenance or {}),
    )


def summarise_links(view: LinkView, report: str) -> LinkSummary:
    """Return a view headline and its report path."""
    slices = ("all", *RELATIONS)
    metrics = {name: view.metrics[name] for name in slices}
    by_slice: dict[str, Any] = {
        figure: {name: getattr(row, figure) for name, row in metrics.items()}
        for figure in ("mrr", "hits_at_1", "hits_at_3", "hits_at_10", "mrr_ci")
    }
    others = [row.mrr for row in view.drill_down.near_synonyms if row.slice == NO_NEAR_SYNONYM]
    return LinkSummary(
        **by_slice,
        queries=view.queries,
        triples=view.triples,
        sampled_from=view.sampled_from,
        leaked_left_out=view.leaked_left_out,
        mrr_with_leaked=view.with_leaked.mrr,
        mrr_without_near_synonyms=others[0] if others else None,
        has_seen_the_test_recipes=view.model.has_seen_the_test_recipes,
        baselines={name: {part: table[part].mrr for part in slices} for name, table in view.baselines.items()},
        comparisons=view.comparisons,
        checks_passed=all(check.passed for check in view.checks),
        report=report,
    )


def _checks(judged: RankedLinks) -> Iterator[Check]:
    """Yield the checks, without leak checks for a model of the full graph."""
    graph = judged.graph
    yield Check(
        "graph", "the model was trained on the graph that is evaluated", judged.scorer.graph_hash == graph.hash, ""
    )
    if judged.kg != "none":  # coverage of an untrained model is undefined
        uncovered = np.setdiff1d(
            np.arange(graph.num_entities) if not judged.is_full else [], judged.train_sample.recipes
        )
        listed = f"{len(uncovered)} do not ({', '.join(graph.labels(uncovered[:6]))}): their ranks are near chance"
        covered = not len(uncovered)
        yield Check("coverage", "every entity occurs in training", covered, "all do" if covered else listed)
    if judged.is_full:
        return
    test = judged.queries
    symmetric = test[test[:, 1] == COMBINES_WITH]
    in_train, mirrored = (
        int(np.sum(is_in(triples, judged.trained_on, graph.num_entities)))
        for triples in (test, symmetric[:, [2, 1, 0]])
    )
    no_leak = "no evaluated triple is in the training triples"
    yield Check("leak", no_leak, not in_train, f"{in_train} found")
    no_mirror = "no combinesWith triple has its mirror in the training triples"
    yield Check("mirror", no_mirror, not mirrored, f"{mirrored} found")


def _ties(judged: RankedLinks) -> Ties:
    unfiltered = judged.ranks.assign(candidates=judged.graph.num_entities)
    optimistic, pessimistic = (ranking_metrics(judged.ranks, ties) for ties in ("optimistic", "pessimistic"))
    return Ties(optimistic, pessimistic, ranking_metrics(unfiltered, "raw_rank"))


def _by_slice(ranks: pd.DataFrame, measure: Callable[[pd.DataFrame, NDArray[np.bool_]], RankingMetrics]) -> _Slices:
    return {name: measure(ranks[mask], mask) for name, mask in slice_masks(ranks).items()}


def _with_leaked(judged: RankedLinks) -> RankingMetrics:
    """Return the metrics of all triples of the test recipes, leaked triples included."""
    if judged.is_full:
        return ranking_metrics(judged.ranks)
    split, size = judged.opened.split, judged.graph.num_entities
    everything = split.triples_of("test")
    leaked = everything[~is_in(everything, split.held_out("test"), size)]
    # Equal shares of leaked and other triples make a uniform sample.
    leaked = sampled(leaked, round(len(leaked) * len(judged.queries) / judged.population))
    ranks = rank_triples(judged.scorer, leaked, judged.graph.triples)
    return ranking_metrics(pd.concat([judged.ranks, ranks], ignore_index=True) if len(ranks) else judged.ranks)


def _probabilities(judged: RankedLinks) -> tuple[Reliability, ...]:
    folds = folds_of(judged.scorer)
    if judged.is_full or not judged.has_table or folds is None:
        return ()
    return view_probabilities(folds, judged.graph, judged.trained_on)


def _memory(judged: RankedLinks) -> Memory | None:
    folds, test_mrr = folds_of(judged.scorer), ranking_metrics(judged.ranks).mrr
    if judged.is_full or folds is None:
        return None
    record = folds.record
    if record.mrr is None or record.in_sample_mrr is None or test_mrr is None:
        return None
    return Memory(record.count, record.queries, record.in_sample_mrr, record.mrr, test_mrr)
