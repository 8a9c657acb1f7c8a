"""Evaluation of a link predictor: ranking metrics, baselines, query groups, and validity checks."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from wordcraft_kg.agents.evaluation import PlayerSuccess
from wordcraft_kg.base import Count, Hash, Record, Share, quoted
from wordcraft_kg.evaluation import link_sections
from wordcraft_kg.evaluation.link_sections import Reliability, view_probabilities
from wordcraft_kg.evaluation.ranked_links import RankedLinks
from wordcraft_kg.graphs import COMBINES_WITH, RELATIONS, Relation, SplitSummary, TrainedOn, is_in
from wordcraft_kg.graphs.audit import Leakage, leakage, split_summary
from wordcraft_kg.models.links.records import TraceRow
from wordcraft_kg.models.scorers.cross_fitting import folds_of
from wordcraft_kg.models.scorers.near_synonyms import NEAR_SYNONYM
from wordcraft_kg.models.scorers.ranking import (
    RankingMetrics,
    random_metrics,
    rank_triples,
    ranking_metrics,
    sampled,
    slice_masks,
    with_interval,
)

FEW_TEST_RECIPES = 50
"""A verdict on fewer test recipes is marked: it may differ with another seed of the split."""
_Slices = dict[str, RankingMetrics]
"""Metrics for all queries, for each relation, and for each relation and side."""


class EvaluatedModel(Record):
    """The evaluated model.

    Attributes:
        name: the model's name.
        kg: training graph: full, partial or none.
        has_seen_the_test_recipes: whether the full graph was used in training, so that all queries
            are memory.
    """

    name: str
    kg: TrainedOn
    has_seen_the_test_recipes: bool


class EvaluatedGraph(Record):
    """The evaluated graph.

    Attributes:
        name: the graph's name.
        hash: content hash.
        entities: number of entities.
        recipes: number of recipes.
        triples: number of triples.
    """

    name: str
    hash: Hash
    entities: Count
    recipes: Count
    triples: Count


class Check(Record):
    """A condition that must hold for the report's main metrics to be valid.

    Attributes:
        id: name for programs.
        name: the condition in words.
        passed: whether the condition holds.
        detail: the values that decide, or empty.
    """

    id: Literal["graph", "coverage", "leak", "mirror"]
    name: str
    passed: bool
    detail: str


class Ties(Record):
    """Ranking metrics with other treatments of ties and known answers.

    Attributes:
        optimistic: ties are broken for the model.
        pessimistic: ties are broken against the model.
        raw_rank: known true answers compete with the answer of the query.
    """

    optimistic: RankingMetrics
    pessimistic: RankingMetrics
    raw_rank: RankingMetrics


class InSample(Record):
    """MRR of a cross-fitted model on train triples, with and without these triples in training.

    Attributes:
        folds: number of folds.
        queries: query count for train triples that no recipe outside their fold gives.
        in_sample_mrr: MRR with the model of all train recipes.
        left_out_mrr: MRR with the models trained without the query's fold; often below `test_mrr`,
            so not a forecast.
        test_mrr: MRR on the unseen test triples.
    """

    folds: Count
    queries: Count
    in_sample_mrr: Share
    left_out_mrr: Share
    test_mrr: Share


class LinkView(Record):
    """All numbers in a link-prediction report (``report.json``).

    Attributes:
        format: name and version of the format.
        model: the evaluated model.
        graph: the evaluated graph.
        split: size of the split's parts.
        queries: query count, two per ranked triple.
        triples: number of ranked triples.
        sampled_from: number of triples behind a uniform sample; None if all are ranked.
        without_pairs: whether the graph is too large to score all pairs; fields that need all pairs
            are empty or None.
        leaked_left_out: number of test recipe triples left out because they are also in training.
        leakage: triples of test recipes that training contains, by relation.
        checks: conditions for valid metrics.
        metrics: metrics with filtered ranks; equal scores share their mean rank.
        ties: metrics with other treatments of ties and known answers.
        in_sample: memory of a cross-fitted model; None for other models.
        probabilities: calibration of a cross-fitted model; empty for other models.
        with_leaked: metrics with the leaked triples included.
        baselines: metrics of each baseline.
        comparisons: differences between the model and each baseline, the best baseline first.
        near_synonym_cosine: least cosine of two labels that count as near-synonyms.
        drill_down: metrics for groups of queries.
        best, worst: the best-ranked and the worst-ranked queries.
        perhaps_missing: the best-scored triples outside the graph, perhaps missing recipes.
        kg_play: success rates for players that choose by the scores alone.
        trace: a row for each training epoch.
        provenance: facts about the training, by name.
    """

    format: Literal["wordcraft-kg link report 1"]
    model: EvaluatedModel
    graph: EvaluatedGraph
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
    in_sample: InSample | None
    probabilities: tuple[Reliability, ...]
    with_leaked: RankingMetrics
    baselines: dict[str, _Slices]
    comparisons: Annotated[tuple[link_sections.BaselineComparison, ...], msgspec.Meta(min_length=1)]
    near_synonym_cosine: float
    drill_down: link_sections.DrillDown
    best: tuple[link_sections.RankedTriple, ...]
    worst: tuple[link_sections.RankedTriple, ...]
    perhaps_missing: tuple[link_sections.ScoredPair, ...]
    kg_play: tuple[PlayerSuccess, ...]
    trace: tuple[TraceRow, ...]
    provenance: dict[str, str]


def view_links(
    links: RankedLinks,
    *,
    name: str = "scorer",
    provenance: Mapping[str, str] | None = None,
    trace: Sequence[TraceRow] = (),
    seed: int = 0,
) -> LinkView:
    """Return all numbers in a link-prediction report.

    Args:
        links: the ranked queries.
        name: the model's name in the report.
        provenance: facts about the training; None for none.
        trace: a row for each training epoch.
        seed: seed of the bootstrap and of the players.

    Returns:
        The numbers, for :func:`~wordcraft_kg.reports.link_report.make_link_report`.

    Raises:
        ArtefactError: if a score is not a finite number.
    """
    graph = links.graph
    ranks = links.ranks
    split = split_summary(links.opened.split)

    def measure(part: pd.DataFrame, mask: NDArray[np.bool_]) -> RankingMetrics:
        return with_interval(part, links.clusters[mask], seed=seed)

    # All models are resampled with the same seed, so intervals differ only by the ranks.
    baselines = {name: _by_slice(ranks, measure) for name, ranks in links.baseline_ranks.items()}
    # Random order has a formula, so its metrics need no interval.
    baselines["random"] = _by_slice(ranks, lambda part, _: random_metrics(part))
    return LinkView(
        format="wordcraft-kg link report 1",
        model=EvaluatedModel(name, links.kg, links.is_full),
        graph=EvaluatedGraph(
            graph.name, graph.hash, graph.num_entities, graph.num_recipes, len(graph.triples)
        ),
        split=split,
        queries=len(ranks),
        triples=len(links.queries),
        sampled_from=links.population if links.population > len(links.queries) else None,
        without_pairs=not links.has_table,
        leaked_left_out=0 if links.is_full else split.leaked_triples,
        leakage=leakage(links.opened.split),
        checks=tuple(_checks(links)),
        metrics=_by_slice(ranks, measure),
        ties=_ties(links),
        in_sample=_in_sample(links),
        probabilities=_probabilities(links),
        with_leaked=_with_leaked(links),
        baselines=baselines,
        comparisons=link_sections.comparisons_of(links, seed),
        near_synonym_cosine=NEAR_SYNONYM,
        drill_down=link_sections.drill_down_of(links, seed),
        best=link_sections.listed_triples(links, ascending=True),
        worst=link_sections.listed_triples(links, ascending=False),
        perhaps_missing=link_sections.perhaps_missing_of(links) if links.has_table else (),
        kg_play=link_sections.play_by_scores(links, seed) if links.has_table else (),
        trace=tuple(trace),
        provenance=dict(provenance or {}),
    )


def has_few_test_recipes(view: LinkView) -> bool:
    """Return whether fewer than :data:`FEW_TEST_RECIPES` test recipes decide the comparisons.

    A model of the full graph is compared on all recipes, and has seen them.
    """
    return not view.model.has_seen_the_test_recipes and view.split.test_recipes < FEW_TEST_RECIPES


def summarise_links(view: LinkView, report: str) -> dict[str, Any]:
    """Return the main results for all queries and each relation, and the report's path.

    A result is None without queries of the relation.
    """
    # The names that the field uses in text; records have names that Python allows.
    slices = ("all", *RELATIONS)
    names = {
        "mrr": "mrr",
        "hits@1": "hits_at_1",
        "hits@3": "hits_at_3",
        "hits@10": "hits_at_10",
        "mrr_ci": "mrr_ci",
    }
    metrics = {}
    for name, field in names.items():
        metrics[name] = {part: getattr(view.metrics[part], field) for part in slices}
    baselines = {}
    for name, table in view.baselines.items():
        baselines[name] = {part: table[part].mrr for part in slices}
    distant_mrr = [
        row.mrr
        for row in view.drill_down.near_synonyms
        if row.slice == link_sections.NO_NEAR_SYNONYM
    ]
    return {
        **metrics,
        "queries": view.queries,
        "triples": view.triples,
        "sampled_from": view.sampled_from,
        "leaked_left_out": view.leaked_left_out,
        "mrr_with_leaked": view.with_leaked.mrr,
        "mrr_without_near_synonyms": distant_mrr[0] if distant_mrr else None,
        "has_seen_the_test_recipes": view.model.has_seen_the_test_recipes,
        "baselines": baselines,
        "comparisons": view.comparisons,
        "checks_passed": all(check.passed for check in view.checks),
        "report": report,
    }


def _checks(links: RankedLinks) -> Iterator[Check]:
    graph = links.graph
    yield Check(
        "graph",
        "the model was trained on the graph that is evaluated",
        links.scorer.graph_hash == graph.hash,
        "",
    )
    if links.kg != "none":  # an untrained model has no coverage
        # The full graph covers all its entities by definition.
        entities = np.arange(0 if links.is_full else graph.num_entities)
        uncovered = np.setdiff1d(entities, links.train_sample.sets)
        detail = "all do"
        if len(uncovered):
            listed = ", ".join(map(quoted, graph.labels(uncovered[:6])))
            detail = f"{len(uncovered)} do not ({listed}): their ranks are near chance"
        yield Check("coverage", "every entity occurs in training", not len(uncovered), detail)
    if links.is_full:
        return
    # Evaluated triples are chosen without leaks: these checks guard this code and its inputs.
    test = links.queries
    in_train = int(np.sum(is_in(test, links.trained_on, graph.num_entities)))
    # A symmetric model knows a triple if it has seen the mirror.
    mirrors = test[test[:, 1] == COMBINES_WITH][:, [2, 1, 0]]
    mirrored = int(np.sum(is_in(mirrors, links.trained_on, graph.num_entities)))
    no_leak = "no evaluated triple is in the training triples"
    yield Check("leak", no_leak, not in_train, f"{in_train} found")
    no_mirror = "no combinesWith triple has its mirror in the training triples"
    yield Check("mirror", no_mirror, not mirrored, f"{mirrored} found")


def _ties(links: RankedLinks) -> Ties:
    # Without the filter all entities are candidates, which adjusted metrics need to know.
    unfiltered = links.ranks.assign(candidates=links.graph.num_entities)
    return Ties(
        optimistic=ranking_metrics(links.ranks, "optimistic"),
        pessimistic=ranking_metrics(links.ranks, "pessimistic"),
        raw_rank=ranking_metrics(unfiltered, "raw_rank"),
    )


def _by_slice(
    ranks: pd.DataFrame, measure: Callable[[pd.DataFrame, NDArray[np.bool_]], RankingMetrics]
) -> _Slices:
    return {name: measure(ranks[mask], mask) for name, mask in slice_masks(ranks).items()}


def _with_leaked(links: RankedLinks) -> RankingMetrics:
    # Nothing is left out for a model of the full graph.
    if links.is_full:
        return ranking_metrics(links.ranks)
    split = links.opened.split
    size = links.graph.num_entities
    everything = split.triples_of("test")
    leaked = everything[~is_in(everything, split.held_out("test"), size)]
    # Sampling leaked and unseen triples in equal shares makes a uniform sample.
    leaked = sampled(leaked, round(len(leaked) * len(links.queries) / links.population))
    ranks = rank_triples(links.scorer, leaked, links.graph.triples)
    if not len(ranks):
        return ranking_metrics(links.ranks)
    return ranking_metrics(pd.concat([links.ranks, ranks], ignore_index=True))


def _probabilities(links: RankedLinks) -> tuple[Reliability, ...]:
    folds = folds_of(links.scorer)
    # Probabilities are of triples outside training, which a model of the full graph does not have.
    if links.is_full or not links.has_table or folds is None:
        return ()
    return view_probabilities(folds, links.graph, links.trained_on)


def _in_sample(links: RankedLinks) -> InSample | None:
    folds = folds_of(links.scorer)
    test_mrr = ranking_metrics(links.ranks).mrr
    if links.is_full or folds is None:
        return None
    record = folds.record
    if record.mrr is None or record.in_sample_mrr is None or test_mrr is None:
        return None
    return InSample(record.count, record.queries, record.in_sample_mrr, record.mrr, test_mrr)
