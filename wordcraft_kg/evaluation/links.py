"""The figures of a link predictor: how it ranks unseen triples, with baselines, slices and checks.

:func:`judge_links` ranks once; the parts of the view (:func:`view_links`) and the pictures of the report use that.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import msgspec
import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from wordcraft_kg.agents.players import PlayerSuccess, play_all, random_entity, recipe_oracle, scorer_players
from wordcraft_kg.base.errors import SplitError, WordCraftKGError
from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.base.settings import refuse, whole
from wordcraft_kg.base.statistics import bootstrap, interval
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation.bins import OPEN_END, Bounds, binned
from wordcraft_kg.evaluation.probabilities import Reliability, view_probabilities
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.audit import Leakage, SplitSummary, leakage, split_summary
from wordcraft_kg.graphs.doses import Dose
from wordcraft_kg.graphs.folder import OpenedGraph, Taught
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS, Relation, is_in
from wordcraft_kg.models.links.records import TraceRow
from wordcraft_kg.models.scorers.baselines import FrequencyScorer, NeighbourScorer, VoteScorer
from wordcraft_kg.models.scorers.config import MAX_QUERIES
from wordcraft_kg.models.scorers.cross_fitting import folds_of
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.near_synonyms import NEAR_SYNONYM, near_synonym_recipes, near_synonym_triples
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.ranking import (
    MIN_TRIPLES,
    Calibration,
    RankingMetrics,
    calibration,
    random_metrics,
    random_reciprocal_ranks,
    rank_triples,
    ranking_metrics,
    recipe_clusters,
    sampled,
    slice_masks,
    with_interval,
)
from wordcraft_kg.models.scorers.roles import centred

LISTED = 8
MAP_LIMIT = 3_000
"""Most entities for which the scores of all pairs are used: matrices, map, neighbours as a baseline, ..."""
SEEN = ((0, 0), (1, 5), (6, 15), (16, 40), (41, 100), (101, OPEN_END))
LAYERS = ((0, 2), (3, 5), (6, 8), (9, 11), (12, OPEN_END))
RANKS = ((1, 1), (2, 3), (4, 5), (6, 10), (11, 20), (21, 50), (51, 100), (101, 200), (201, OPEN_END))
NO_NEAR_SYNONYM = "no such train recipe"

Slices = dict[str, RankingMetrics]
"""Metrics of all queries, of each relation, and of each relation and side."""


class JudgedModel(Record):
    """The model; one of the full graph has seen the triples that it is evaluated on."""

    name: str
    kg: Taught
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
    """Metrics with ties broken for and against the model, and with unfiltered ranks, where all entities compete."""

    optimistic: RankingMetrics
    pessimistic: RankingMetrics
    raw_rank: RankingMetrics


class SliceMetrics(RankingMetrics, kw_only=True):
    """Metrics of a named slice of the queries."""

    slice: str


class Comparison(Record):
    """The model against a baseline on the same queries.

    Attributes:
        baseline: its name.
        difference: MRR of the model minus that of the baseline.
        ci: its 95 % interval, by bootstrap over recipes; both answer the same resampled queries.
        verdict: ``level with`` if the interval holds 0.
    """

    baseline: str
    difference: Annotated[float, msgspec.Meta(ge=-1, le=1)]
    ci: tuple[float, float]
    verdict: Literal["above", "level with", "below"]


class DrillDown(Record):
    """Where the model works and where it does not; slices without queries are left out.

    Attributes:
        seen_in_train: by the number of training triples of the entity asked for.
        layer: by the crafting rounds to the entity asked for.
        self_combination: combinesWith of an entity with itself, and with another.
        near_synonyms: test recipes that repeat a train recipe with a near-synonym, and the others.
    """

    seen_in_train: tuple[SliceMetrics, ...]
    layer: tuple[SliceMetrics, ...]
    self_combination: tuple[SliceMetrics, ...]
    near_synonyms: tuple[SliceMetrics, ...]


class Histogram(Record):
    """Share of each relation's queries by rank."""

    bins: tuple[str, ...]
    shares: dict[Relation, tuple[Share, ...]]


class RankedTriple(Record):
    """A query: the rank and score of the true entity, and the best candidate."""

    head: str
    relation: Relation
    tail: str
    side: Literal["head", "tail"]
    rank: Annotated[float, msgspec.Meta(ge=1)]
    score: float
    top: str


class ScoredPair(Record):
    """A triple that is not in the graph."""

    head: str
    relation: Relation
    tail: str
    score: float


class SelfEdges(Record):
    """Share of entities whose best combinesWith answer is the entity itself, and of those that combine with it."""

    top_answer_is_itself: Share
    really_combines_with_itself: Share


class Neighbours(Record):
    """An entity and its nearest neighbours."""

    entity: str
    neighbours: tuple[str, ...]


class Memory(Record):
    """What a model remembers and what it can tell: MRR of train triples with and without them in training.

    Attributes:
        folds: number of folds of the train recipes.
        queries: number of queries for train triples that no recipe outside their fold gives.
        in_sample_mrr: MRR of the model of all train recipes, which has seen them.
        left_out_mrr: MRR of the models that have been trained without the fold: a forecast of ``test_mrr``.
        test_mrr: MRR of the unseen test triples.
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
        triples: number of triples ranked.
        sampled_from: number of triples of which they are a uniform sample; None if all are ranked.
        without_pairs: whether the graph has too many entities for the parts that need the scores of all pairs.
        leaked_left_out: number of triples of the test recipes that training contains; they are not evaluated.
        metrics: filtered metrics with realistic ties.
        memory: what a cross-fitted model remembers and what it can tell; None for others.
        probabilities: how the probabilities of a cross-fitted model agree with what is true; empty for others.
        with_leaked: metrics if the leaked triples were evaluated too.
        baselines: metrics of baselines by name.
        comparisons: the model against each baseline, the best baseline first.
        calibration: calibration of the softmax over the candidates.
        best: the best ranked queries.
        worst: the worst ranked queries.
        perhaps_missing: the best-scored triples that are not in the graph. Like the next two, it is empty or None above
            :data:`MAP_LIMIT` entities.
        self_edges: how often the best answer is the entity itself, a known failure.
        neighbours: nearest neighbours of the ten most used entities.
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
    metrics: Slices
    ties: Ties
    memory: Memory | None
    probabilities: tuple[Reliability, ...]
    with_leaked: RankingMetrics
    baselines: dict[str, Slices]
    comparisons: Annotated[tuple[Comparison, ...], msgspec.Meta(min_length=1)]
    near_synonym_cosine: float
    drill_down: DrillDown
    histogram: Histogram
    calibration: Calibration
    best: tuple[RankedTriple, ...]
    worst: tuple[RankedTriple, ...]
    perhaps_missing: tuple[ScoredPair, ...]
    self_edges: SelfEdges | None
    neighbours: tuple[Neighbours, ...]
    kg_play: tuple[PlayerSuccess, ...]
    trace: tuple[TraceRow, ...]
    provenance: dict[str, str]


class LinkSummary(Record):
    """The headline of a report; dictionaries are by slice, with None for a slice without queries."""

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


@dataclass(frozen=True)
class JudgedLinks:
    """A scorer's ranking of the triples that it is evaluated on, and what several parts of a view need of it.

    Attributes:
        scorer: the scorer.
        opened: graph and split.
        kg: knowledge graph that the scorer was trained on, if any.
        population: number of triples that it could be evaluated on.
        queries: triples that it is evaluated on, shape (T, 3): all of them, or a uniform sample.
        ranks: a row for each query, see :func:`~wordcraft_kg.models.scorers.ranking.rank_triples`.
        dose: the recipes that the scorer was trained on.
    """

    scorer: TripleScorer
    opened: OpenedGraph
    kg: Taught
    population: int
    queries: Ids
    ranks: pd.DataFrame
    dose: Dose

    @property
    def graph(self) -> RecipeGraph:
        """The graph whose triples are ranked."""
        return self.opened.graph

    @property
    def is_full(self) -> bool:
        """Whether the scorer has seen all triples."""
        return self.kg == "full"

    @property
    def trained_on(self) -> Ids:
        """The triples that the scorer has seen, shape (T, 3)."""
        return self.dose.triples

    @property
    def observed(self) -> Ids:
        """The triples that it holds to be true, shape (T, 3): those of its training, or of its opinions."""
        observed: Ids | None = getattr(self.scorer, "observed", None)
        return self.trained_on if observed is None else observed

    @property
    def has_table(self) -> bool:
        """Whether the graph is small enough for the scores of all pairs."""
        return self.graph.num_entities <= MAP_LIMIT

    @cached_property
    def table(self) -> NDArray[np.float32]:
        """Scores of all pairs, shape (2, E, E), by relation, head and tail."""
        return torch.stack([self.scorer.table(relation) for relation in range(len(RELATIONS))]).cpu().numpy()

    @cached_property
    def profiles(self) -> NDArray[np.float64]:
        """Unit vectors of each entity's scores as head and as tail of both relations, shape (E, 4 E).

        Each part is centred by row and by column; otherwise it would mainly show which entities score high overall.
        """
        parts = []
        for scores in self.table.astype(np.float64):
            rows = centred(scores)
            parts += [part / (rows.std() or 1.0) for part in (rows, rows.T)]
        profiles = np.concatenate(parts, axis=1)
        return profiles / np.maximum(np.linalg.norm(profiles, axis=1, keepdims=True), 1e-12)

    @cached_property
    def clusters(self) -> Ids:
        """The pair of each query, by which intervals are resampled; shape (2 T,)."""
        split = self.opened.split
        sources = np.ones(self.graph.num_recipes, dtype=bool) if self.is_full else split.is_in("test")
        return np.tile(recipe_clusters(self.graph, sources, self.queries), 2)

    @cached_property
    def baseline_ranks(self) -> dict[str, pd.DataFrame]:
        """Rankings of the same queries by baselines that know the same triples, by name.

        Beside a scorer that was taught no recipe, they know those of the train recipes.
        """
        known = self.opened.dose("partial") if self.kg == "none" else self.dose
        scorers: dict[str, TripleScorer] = {"frequency": FrequencyScorer(self.graph, known.triples)}
        if self.has_table:
            scorers["votes"] = VoteScorer(self.graph, known.recipes)
            scorers["neighbours"] = NeighbourScorer(self.graph, known.triples)
        return {name: rank_triples(scorer, self.queries, self.graph.triples) for name, scorer in scorers.items()}

    @property
    def labelled_ranks(self) -> pd.DataFrame:
        """``ranks`` with labels instead of ids."""
        return _labelled(self.graph, self.ranks)


def judge_links(
    scorer: TripleScorer,
    opened: OpenedGraph,
    kg: Taught = "partial",
    *,
    dose: Dose | None = None,
    max_queries: int = MAX_QUERIES,
    seed: int = 0,
) -> JudgedLinks:
    """Rank the triples that a scorer is evaluated on.

    A scorer of the partial graph is evaluated on the test triples that training does not contain. One of the full graph
    has seen these, so it is evaluated on the graph's own triples, which measures memory and is marked as such.

    Args:
        scorer: a scorer of the graph.
        opened: graph and split.
        kg: knowledge graph that the scorer was trained on.
        dose: the recipes that it was trained on, if these are not all of that graph. They change neither the triples
            nor the filter, so figures of different doses can be compared.
        max_queries: most queries to rank, two for each triple; of more, a uniform sample of the triples is ranked. 0
            ranks all.
        seed: seed of that sample.

    Raises:
        ConfigError: if ``max_queries`` is too small for a meaningful figure.
        SplitError: if fewer than 30 triples are left to evaluate it on.
    """
    if whole("max_queries", max_queries, 0) and max_queries < 2 * MIN_TRIPLES:
        raise refuse("max_queries", max_queries, f"0 for all, or {2 * MIN_TRIPLES} or more")
    everything = opened.graph.triples if kg == "full" else opened.split.held_out("test")
    queries = sampled(everything, max_queries // 2, seed) if max_queries else everything
    if len(queries) < MIN_TRIPLES:
        raise SplitError(_too_few(len(queries), opened, kg))
    ranks = rank_triples(scorer, queries, opened.graph.triples)
    return JudgedLinks(scorer, opened, kg, len(everything), queries, ranks, dose or opened.dose(kg))


def _too_few(found: int, opened: OpenedGraph, kg: Taught) -> str:
    needed = f"a meaningful figure needs at least {MIN_TRIPLES}."
    if kg == "full":
        return f"only {found} triples in the whole graph; {needed} Use a recipe book with more recipes."
    ratio = "such as 0.7" if opened.split.config.train_ratio > 0.7 else "or use a recipe book with more recipes"
    return f"only {found} unseen test triples; {needed} Build the graph with a smaller `train_ratio`, {ratio}."


def view_links(
    judged: JudgedLinks,
    *,
    name: str = "scorer",
    provenance: Mapping[str, str] | None = None,
    trace: Sequence[TraceRow] = (),
    seed: int = 0,
) -> LinkView:
    """Return all numbers of the report.

    Args:
        judged: the ranking.
        name: name of the scorer in the report.
        provenance: facts for the last section.
        trace: a row for each epoch.
        seed: seed of the bootstrap and the players.
    """
    graph, ranks = judged.graph, judged.ranks
    split = split_summary(judged.opened.split)
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
        metrics=_headline(judged, seed),
        ties=Ties(
            ranking_metrics(ranks, "optimistic"),
            ranking_metrics(ranks, "pessimistic"),
            # Unfiltered, all entities compete.
            ranking_metrics(ranks.assign(candidates=graph.num_entities), "raw_rank"),
        ),
        memory=_memory(judged),
        probabilities=_probabilities(judged),
        with_leaked=_with_leaked(judged),
        baselines=_baselines(judged, seed),
        comparisons=_comparisons(judged, seed),
        near_synonym_cosine=NEAR_SYNONYM,
        drill_down=_drill_down(judged, seed),
        histogram=_histogram(ranks),
        calibration=calibration(ranks),
        best=_listed(judged, ascending=True),
        worst=_listed(judged, ascending=False),
        perhaps_missing=_perhaps_missing(judged) if judged.has_table else (),
        self_edges=_self_edges(judged) if judged.has_table else None,
        neighbours=_neighbours(judged) if judged.has_table else (),
        kg_play=_kg_play(judged, seed) if judged.has_table else (),
        trace=tuple(trace),
        provenance=dict(provenance or {}),
    )


def summarise_links(view: LinkView, report: str) -> LinkSummary:
    """Return the headline of a view, and where its report is."""
    slices = ("all", *RELATIONS)
    metrics = {name: view.metrics[name] for name in slices}
    others = [row.mrr for row in view.drill_down.near_synonyms if row.slice == NO_NEAR_SYNONYM]
    return LinkSummary(
        mrr={name: row.mrr for name, row in metrics.items()},
        hits_at_1={name: row.hits_at_1 for name, row in metrics.items()},
        hits_at_3={name: row.hits_at_3 for name, row in metrics.items()},
        hits_at_10={name: row.hits_at_10 for name, row in metrics.items()},
        mrr_ci={name: row.mrr_ci for name, row in metrics.items()},
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


def _checks(judged: JudgedLinks) -> Iterator[Check]:
    """Yield the checks; a model of the full graph is not checked for leaks."""
    graph = judged.graph
    yield Check(
        "graph", "the model was trained on the graph that is evaluated", judged.scorer.graph_hash == graph.hash, ""
    )
    if judged.kg != "none":  # without training there is nothing to occur in
        uncovered = np.setdiff1d(np.arange(graph.num_entities) if not judged.is_full else [], judged.dose.recipes)
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


def _by_slice(ranks: pd.DataFrame, measure: Callable[[pd.DataFrame, NDArray[np.bool_]], RankingMetrics]) -> Slices:
    return {name: measure(ranks[mask], mask) for name, mask in slice_masks(ranks).items()}


def _headline(judged: JudgedLinks, seed: int) -> Slices:
    return _by_slice(judged.ranks, lambda part, mask: with_interval(part, judged.clusters[mask], seed=seed))


def _with_leaked(judged: JudgedLinks) -> RankingMetrics:
    """Return the metrics of all triples of the test recipes, including those in training; of as many as are ranked."""
    if judged.is_full:
        return ranking_metrics(judged.ranks)
    split, size = judged.opened.split, judged.graph.num_entities
    everything = split.triples_of("test")
    leaked = everything[~is_in(everything, split.held_out("test"), size)]
    # The same share of them as of the others, so that both together are a uniform sample too.
    leaked = sampled(leaked, round(len(leaked) * len(judged.queries) / judged.population))
    ranks = rank_triples(judged.scorer, leaked, judged.graph.triples)
    return ranking_metrics(pd.concat([judged.ranks, ranks], ignore_index=True) if len(ranks) else judged.ranks)


def _probabilities(judged: JudgedLinks) -> tuple[Reliability, ...]:
    folds = folds_of(judged.scorer)
    if judged.is_full or not judged.has_table or folds is None:
        return ()
    return view_probabilities(folds, judged.graph, judged.trained_on)


def _memory(judged: JudgedLinks) -> Memory | None:
    folds, test_mrr = folds_of(judged.scorer), ranking_metrics(judged.ranks).mrr
    if judged.is_full or folds is None:
        return None
    record = folds.record
    if record.mrr is None or record.in_sample_mrr is None or test_mrr is None:
        return None
    return Memory(record.count, record.queries, record.in_sample_mrr, record.mrr, test_mrr)


def _baselines(judged: JudgedLinks, seed: int) -> dict[str, Slices]:
    tables = {
        name: _by_slice(ranks, lambda part, mask: with_interval(part, judged.clusters[mask], seed=seed))
        for name, ranks in judged.baseline_ranks.items()
    }
    return {**tables, "random": _by_slice(judged.ranks, lambda part, _: random_metrics(part))}


def _comparisons(judged: JudgedLinks, seed: int) -> tuple[Comparison, ...]:
    """Compare the model with each baseline, query by query."""
    found = 1 / judged.ranks["rank"].to_numpy(dtype=float)
    others = {name: 1 / ranks["rank"].to_numpy(dtype=float) for name, ranks in judged.baseline_ranks.items()}
    others["random"] = random_reciprocal_ranks(judged.ranks)
    best_first = sorted(others, key=lambda name: -float(others[name].mean()))
    rows = []
    for name in best_first:
        difference = found - others[name]
        low, high = interval(bootstrap(difference, judged.clusters, seed=seed))
        verdict: Literal["above", "level with", "below"] = "above" if low > 0 else "below" if high < 0 else "level with"
        rows.append(Comparison(name, float(difference.mean()), (low, high), verdict))
    return tuple(rows)


def _drill_down(judged: JudgedLinks, seed: int) -> DrillDown:
    graph, ranks, trained_on = judged.graph, judged.ranks, judged.trained_on
    target = np.where(ranks["side"] == "tail", ranks["tail"], ranks["head"]).astype(np.int64)
    seen = np.bincount(np.concatenate([trained_on[:, 0], trained_on[:, 2]]), minlength=graph.num_entities)[target]
    layer = layers(graph)[target]
    is_symmetric = (ranks["relation"] == COMBINES_WITH).to_numpy()
    is_self = (ranks["head"] == ranks["tail"]).to_numpy()

    def between(values: Ids, bounds: Bounds) -> Iterator[tuple[str, NDArray[np.bool_]]]:
        return binned(values, bounds, more=" or more")

    def slices(groups: Iterable[tuple[str, NDArray[np.bool_]]]) -> tuple[SliceMetrics, ...]:
        found = (
            (name, with_interval(ranks[mask], judged.clusters[mask], seed=seed)) for name, mask in groups if mask.any()
        )
        return tuple(SliceMetrics(**msgspec.structs.asdict(metrics), slice=name) for name, metrics in found)

    return DrillDown(
        seen_in_train=slices(between(seen, SEEN)),
        layer=slices([("not reachable", layer < 0), *between(layer, LAYERS)]),
        self_combination=slices([("with itself", is_symmetric & is_self), ("with another", is_symmetric & ~is_self)]),
        near_synonyms=() if judged.is_full else slices(_near_synonyms(judged)),
    )


def _near_synonyms(judged: JudgedLinks) -> list[tuple[str, NDArray[np.bool_]]]:
    graph = judged.graph
    recipes = near_synonym_recipes(judged.opened.split, glove_features(graph.entities))
    repeats = np.tile(near_synonym_triples(graph, recipes, judged.queries), 2)
    if not repeats.any():  # split by goal, no result is in both parts; and labels may have no word vectors
        return []
    return [("a train recipe with a near-synonym", repeats), (NO_NEAR_SYNONYM, ~repeats)]


def _histogram(ranks: pd.DataFrame) -> Histogram:
    shares: dict[Relation, tuple[float, ...]] = {}
    for relation, name in enumerate(RELATIONS):
        rank = ranks.loc[ranks["relation"] == relation, "rank"].to_numpy(dtype=float)
        # A realistic rank may end in .5; it is rounded up to find its bin.
        masks = [mask for _, mask in binned(np.ceil(rank).astype(np.int64), RANKS)]
        shares[name] = tuple(float(np.mean(mask)) if len(rank) else 0.0 for mask in masks)
    return Histogram(tuple(name for name, _ in binned(np.empty(0, dtype=np.int64), RANKS)), shares)


def _listed(judged: JudgedLinks, *, ascending: bool) -> tuple[RankedTriple, ...]:
    order = judged.ranks.sort_values(["rank", "score"], ascending=[ascending, not ascending], kind="stable")
    shown = _labelled(judged.graph, order.head(LISTED))[list(RankedTriple.__struct_fields__)]
    return tuple(RankedTriple(*row) for row in zip(*(shown[name].tolist() for name in shown), strict=True))


def _perhaps_missing(judged: JudgedLinks) -> tuple[ScoredPair, ...]:
    """Return the best-scored triples that are not in the graph, without self edges, half of them of each relation."""
    graph, found = judged.graph, []
    for relation, name in enumerate(RELATIONS):
        scores = judged.table[relation].copy()
        if relation == COMBINES_WITH:
            scores = np.triu((scores + scores.T) / 2, k=1) + np.where(np.tri(len(scores), dtype=bool), -np.inf, 0)
        known = graph.triples[graph.triples[:, 1] == relation]
        scores[known[:, 0], known[:, 2]] = -np.inf
        np.fill_diagonal(scores, -np.inf)
        for flat in np.argsort(-scores, axis=None, kind="stable")[: LISTED // 2].tolist():
            head, tail = divmod(flat, len(scores))
            found.append(ScoredPair(graph.entities[head], name, graph.entities[tail], float(scores[head, tail])))
    return tuple(pair for pair in found if np.isfinite(pair.score))


def _self_edges(judged: JudgedLinks) -> SelfEdges:
    graph, scores = judged.graph, judged.table[COMBINES_WITH]
    symmetric = graph.triples[graph.triples[:, 1] == COMBINES_WITH]
    return SelfEdges(
        top_answer_is_itself=float(np.mean(scores.argmax(axis=1) == np.arange(len(scores)))),
        really_combines_with_itself=float(np.sum(symmetric[:, 0] == symmetric[:, 2]) / graph.num_entities),
    )


def _neighbours(judged: JudgedLinks) -> tuple[Neighbours, ...]:
    """Return the nearest neighbours of the ten most used entities."""
    graph, profiles = judged.graph, judged.profiles
    most_used = np.argsort(-graph.use_counts, kind="stable")[:10]
    similar = profiles[most_used] @ profiles.T
    similar[np.arange(len(most_used)), most_used] = -np.inf
    nearest = np.argsort(-similar, axis=1, kind="stable")[:, :5]
    return tuple(
        Neighbours(graph.entities[entity], graph.labels(row))
        for entity, row in zip(most_used.tolist(), nearest.tolist(), strict=True)
    )


def _kg_play(judged: JudgedLinks, seed: int) -> tuple[PlayerSuccess, ...]:
    """Return the success of players that use the scorer alone, on test tasks of depth 1 with 1 and 8 distractors."""
    try:
        players = {
            **scorer_players(judged.graph, judged.scorer, judged.observed),
            "random": random_entity,
            "recipe oracle": recipe_oracle,
        }
        return play_all(World(judged.opened, WordCraftConfig(part="test")), players, (1, 8), seed=seed)
    except WordCraftKGError:
        # No test task, too few entities for distractors, or a scorer that fails the checks.
        return ()


def _labelled(graph: RecipeGraph, ranks: pd.DataFrame) -> pd.DataFrame:
    names = np.array(graph.entities, dtype=object)
    frame = ranks.copy()
    for column in ("head", "tail", "top"):
        frame[column] = names[frame[column].to_numpy(dtype=np.int64)]
    frame["relation"] = np.array(RELATIONS, dtype=object)[frame["relation"].to_numpy(dtype=np.int64)]
    return frame
