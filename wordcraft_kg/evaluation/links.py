"""Evaluation of a link predictor: ranking metrics, baselines, query groups, and validity checks."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Literal

import msgspec
import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from wordcraft_kg.base import Count, Record, Share, quoted
from wordcraft_kg.base.statistics import bootstrap, cluster_interval, wilson_interval
from wordcraft_kg.evaluation.agent_metrics import (
    OPEN_END,
    binned,
    goal_groups,
)
from wordcraft_kg.evaluation.ranked_links import RankedLinks, labelled
from wordcraft_kg.graphs import (
    COMBINES_WITH,
    RELATIONS,
    Ids,
    PlayedGraph,
    Relation,
    SplitSummary,
    TrainedOn,
    is_in,
    layers,
)
from wordcraft_kg.graphs.audit import Leakage, leakage, split_summary
from wordcraft_kg.models.scorers.cross_fitting import FoldsRecord, folds_of
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.near_synonyms import (
    near_synonym_recipes,
    near_synonym_triples,
)
from wordcraft_kg.models.scorers.ranking import (
    RankingMetrics,
    random_metrics,
    random_reciprocal_ranks,
    rank_triples,
    ranking_metrics,
    sampled,
    slice_masks,
    with_interval,
)

_BINS = 8
_LEAST = 5.0
"""Least expected number of true triples per point, if possible."""


class ReliabilityBin(Record):
    """A group of triples with similar probability.

    Attributes:
        probability: mean predicted probability.
        observed: share of true triples.
        low, high: 95 % interval of `observed` (Wilson).
        triples: number of triples.
    """

    probability: Share
    observed: Share
    low: Share
    high: Share
    triples: Count


class Reliability(Record):
    """Predicted and observed numbers of true triples of a relation, outside the training triples.

    combinesWith counts a single direction.

    Attributes:
        relation: the relation.
        pairs: two different entities, or an entity with itself.
        triples: number of triples.
        expected: number of true triples by the probabilities.
        observed: number of true triples: recipes outside train give them.
        base_rate: constant probability that ignores the scores.
        ece: expected calibration error over `bins`: mean distance of predicted and observed, by
            triples.
        log_loss: mean ``-log(probability of the observed outcome)``, nats.
        base_log_loss: the same for the base rate.
        reason: why all triples have the base rate as probability, or empty.
        bins: groups of triples by probability, with about equal expected numbers of true triples.
    """

    relation: Relation
    pairs: Literal["distinct", "itself"]
    triples: Count
    expected: float
    observed: Count
    base_rate: Share
    ece: Share
    log_loss: float
    base_log_loss: float
    reason: str
    bins: tuple[ReliabilityBin, ...]


def reliability_of(links: RankedLinks) -> Iterator[Reliability]:
    """Compare predicted probabilities with true triples outside training.

    Yields:
        A record for each relation and kind of pair; none for a model without probabilities, of the
        full graph, or of a graph too large to score all pairs.
    """
    scorer = folds_of(links.scorer)
    if links.is_full or not links.has_table or scorer is None or scorer.probabilities is None:
        return
    graph = links.graph
    size = graph.num_entities
    every = torch.arange(size)
    is_self = np.eye(size, dtype=bool)
    for relation, name in enumerate(RELATIONS):
        chances = scorer.probability(every[:, None], relation, every[None, :]).cpu().numpy()
        # Triples in training are no test: the scorer has seen that they are true.
        is_asked = ~_table(links.train_sample.triples, relation, size)
        if relation == COMBINES_WITH:  # both directions are the same fact
            is_asked &= np.tri(size, dtype=bool)
        is_true = _table(graph.triples, relation, size)
        curves = scorer.probabilities.relations[relation]
        # Entities with themselves have a calibration of their own: they are true at another rate.
        for pairs, is_kind, curve in (
            ("distinct", ~is_self, curves.distinct),
            ("itself", is_self, curves.itself),
        ):
            cells = is_asked & is_kind
            # float64, because the sum of millions of small probabilities loses digits in float32.
            predicted = chances[cells].astype(np.float64)
            if not len(predicted):
                continue
            observed = is_true[cells]
            bins = tuple(_bins(predicted, observed))
            errors = sum(row.triples * abs(row.probability - row.observed) for row in bins)
            yield Reliability(
                relation=name,
                pairs=pairs,  # type: ignore[arg-type]
                triples=len(predicted),
                expected=float(predicted.sum()),
                observed=int(observed.sum()),
                base_rate=curve.rate,
                ece=errors / len(predicted),
                log_loss=_log_loss(predicted, observed),
                base_log_loss=_log_loss(np.full(len(predicted), curve.rate), observed),
                reason=curve.reason,
                bins=bins,
            )


def _table(triples: Ids, relation: int, size: int) -> NDArray[np.bool_]:
    """Return a relation's triples as a dense table (E, E); only small graphs come here."""
    heads, _, tails = triples[triples[:, 1] == relation].T
    table = np.zeros((size, size), dtype=bool)
    table[heads, tails] = True
    return table


def _bins(predicted: NDArray[np.float64], is_true: NDArray[np.bool_]) -> Iterator[ReliabilityBin]:
    # Bins of equal expected true triples, not of equal width or size: nearly all triples are very
    # improbable, and a bin without true triples says nothing about its share.
    order = np.argsort(predicted, kind="stable")
    ascending = predicted[order]
    expected = predicted.sum()
    count = int(np.clip(expected / _LEAST, 1, _BINS))
    # A triple's bin is given by the expected true triples before it.
    before = np.cumsum(ascending) - ascending
    place = before / expected * count
    # Rounding can lift the last places to the number of bins.
    number = np.minimum(place.astype(np.int64), count - 1)
    starts = np.flatnonzero(np.diff(number)) + 1
    for group in np.split(order, starts):
        size = len(group)
        true = int(is_true[group].sum())
        mean = float(predicted[group].mean())
        # Wilson's interval is valid for shares near 0, where the normal one reaches below 0.
        low, high = wilson_interval(true, size)
        yield ReliabilityBin(mean, true / size, low, high, size)


def _log_loss(predicted: NDArray[np.float64], is_true: NDArray[np.bool_]) -> float:
    # A probability of exactly 0 or 1 that is wrong would make the mean infinite.
    chance = np.clip(predicted, 1e-12, 1 - 1e-7)
    return float(-np.mean(np.where(is_true, np.log(chance), np.log1p(-chance))))


# Rows of each list of triples: what fits on a screen.
LISTED = 8
# Bounds double roughly: the counts of an entity's triples are spread over orders of magnitude.
SEEN = ((0, 0), (1, 5), (6, 15), (16, 40), (41, 100), (101, OPEN_END))
_LAYERS = ((0, 2), (3, 5), (6, 8), (9, 11), (12, OPEN_END))
NO_NEAR_SYNONYM = "no such train recipe"
Masks = dict[str, NDArray[np.bool_]]
"""Groups of queries by name, each of shape (2 T,)."""
Slices = dict[str, RankingMetrics]
"""Metrics by the name of a group of queries, such as a relation."""
Verdict = Literal["above", "no significant difference from", "below"]


class BaselineComparison(Record):
    """A link predictor beside a baseline on the same queries.

    Attributes:
        baseline: the baseline's name.
        difference: MRR of the link predictor minus that of the baseline.
        ci: 95 % interval, by bootstrap over groups of recipes; both models answer the same
            resampled queries.
        verdict: the link predictor is `above` the baseline, `below` it, or has `no significant
            difference from` it (at 5 %): the interval contains 0.
    """

    baseline: str
    difference: Annotated[float, msgspec.Meta(ge=-1, le=1)]
    ci: tuple[float, float]
    verdict: Verdict


def comparisons_of(links: RankedLinks) -> Iterator[BaselineComparison]:
    """Compare a link predictor with each baseline by reciprocal ranks, the best baseline first."""
    reciprocal_ranks = _reciprocal(links.ranks)
    baselines = {name: _reciprocal(ranks) for name, ranks in links.baseline_ranks.items()}
    # The expectation over random orders, and not one order: its own luck would widen the interval.
    baselines["random"] = random_reciprocal_ranks(links.ranks)
    # The best baseline first.
    for name in sorted(baselines, key=lambda name: -float(baselines[name].mean())):
        difference = reciprocal_ranks - baselines[name]
        means = bootstrap(difference, links.clusters)
        low, high = cluster_interval(difference, links.clusters, means)
        verdict: Verdict = "no significant difference from"
        if low > 0:
            verdict = "above"
        elif high < 0:
            verdict = "below"
        yield BaselineComparison(name, float(difference.mean()), (low, high), verdict)


def _reciprocal(ranks: pd.DataFrame) -> NDArray[np.float64]:
    return np.asarray(1 / ranks["rank"].to_numpy(dtype=float))


def drill_down_of(links: RankedLinks) -> dict[str, Slices]:
    """Return ranking metrics for groups of queries, by kind of group; none without queries.

    - ``seen_in_train``: by the number of training triples with the answer.
    - ``layer``: by the crafting rounds to the answer.
    - ``self_combination``: combinesWith of an entity with itself, and with another entity.
    - ``near_synonyms``: test recipes that repeat a train recipe with a near-synonym, and all
      others; not for a model trained on the full graph.
    - ``other_book``: componentOf links to goals that another book in the training makes, and to all
      other goals.
    """
    graph = links.graph
    ranks = links.ranks
    trained_on = links.train_sample.triples
    # The answer of each query is the entity in the open slot.
    asks_tail = ranks["side"] == "tail"
    target = np.where(asks_tail, ranks["tail"], ranks["head"]).astype(np.int64)
    # A triple counts for both of its ends, and twice for an entity with itself.
    ends = np.concatenate([trained_on[:, 0], trained_on[:, 2]])
    uses = np.bincount(ends, minlength=graph.num_entities)
    layer = layers(graph)[target]
    is_symmetric = (ranks["relation"] == COMBINES_WITH).to_numpy()
    is_self = (ranks["head"] == ranks["tail"]).to_numpy()
    # The goal is the tail of componentOf; combinesWith says nothing about a goal.
    goals = ranks["tail"].to_numpy(dtype=np.int64)
    by_book = goal_groups(graph, goals, links.made_by_other_books)
    groups: dict[str, Masks] = {
        "seen_in_train": dict(binned(uses[target], SEEN)),
        "layer": {"not reachable": layer < 0, **dict(binned(layer, _LAYERS))},
        "self_combination": {
            "with itself": is_symmetric & is_self,
            "with another": is_symmetric & ~is_self,
        },
        "near_synonyms": _near_synonyms(links),
        "other_book": {
            f"componentOf, {name}": mask & ~is_symmetric for name, mask in by_book.items()
        },
    }
    drill_down = {}
    for kind, masks in groups.items():
        asked = {name: mask for name, mask in masks.items() if mask.any()}
        if asked:
            drill_down[kind] = _with_intervals(links, ranks, asked)
    return drill_down


def _with_intervals(links: RankedLinks, ranks: pd.DataFrame, masks: Masks) -> Slices:
    """Return metrics of ranks of the links' queries, for each group of queries."""
    # All models are resampled with the same seed, so intervals differ only by the ranks.
    return {name: with_interval(ranks[mask], links.clusters[mask]) for name, mask in masks.items()}


def _near_synonyms(links: RankedLinks) -> Masks:
    # With all recipes in training every test recipe repeats a train recipe: itself.
    if links.is_full:
        return {}
    graph = links.graph
    recipes = near_synonym_recipes(links.opened.split, glove_features(graph.entities))
    # Both queries of a triple, tails before heads.
    repeats = np.tile(near_synonym_triples(graph, recipes, links.queries), 2)
    if not repeats.any():  # as in a split by goal, or without word vectors
        return {}
    return {"a train recipe with a near-synonym": repeats, NO_NEAR_SYNONYM: ~repeats}


class ListedTriple(Record, omit_defaults=True):
    """A triple in a list of examples.

    Attributes:
        head: the head.
        relation: the relation.
        tail: the tail.
        score: the scorer's score, on its own scale.
        side: the open slot, whose entity was ranked; None for a triple that was not ranked.
        rank: filtered rank of the true entity, from 1; ties share their mean rank.
        top: the best candidate.
    """

    head: str
    relation: Relation
    tail: str
    score: float
    side: Literal["head", "tail"] | None = None
    rank: Annotated[float, msgspec.Meta(ge=1)] | None = None
    top: str | None = None


Listed = tuple[ListedTriple, ...]
"""A list of examples, the most telling first."""


def listed_triples(links: RankedLinks) -> dict[str, Listed]:
    """Return the lists `best`, `worst` and `perhaps_missing`, whose triples are different facts.

    A triple's queries for head and tail, and a combinesWith triple and its mirror, are one fact.
    """
    tables = {"perhaps_missing": _perhaps_missing(links)}
    for name, is_best in (("best", True), ("worst", False)):
        order = links.ranks.sort_values(
            ["rank", "score"], ascending=[is_best, not is_best], kind="stable"
        )
        ends = order[["head", "tail"]].copy()
        is_mirrored = order["relation"] == COMBINES_WITH
        # Sorted ends are equal for a triple and its mirror, so duplicates show.
        ends[is_mirrored] = np.sort(ends[is_mirrored], axis=1)
        order = order[~ends.assign(relation=order["relation"]).duplicated()]
        tables[name] = order.head(LISTED)[list(ListedTriple.__struct_fields__)]
    # Rows of plain numbers: a record of NumPy numbers has no JSON form.
    return {
        name: msgspec.convert(labelled(links.graph, table).to_dict("records"), Listed)
        for name, table in tables.items()
    }


def _perhaps_missing(links: RankedLinks) -> pd.DataFrame:
    """Return the best-scored triples outside the graph, equally many for each relation.

    Such a triple may be a recipe that the book lacks. Empty for a graph too large for all pairs.
    """
    size = links.graph.num_entities
    rows = []
    for relation in range(len(RELATIONS)) if links.has_table else ():
        scores = links.scorer.table(relation).cpu().numpy()
        is_new = ~_table(links.graph.triples, relation, size)
        # An entity with itself: models without an idea of roles score these pairs highest.
        np.fill_diagonal(is_new, False)
        if relation == COMBINES_WITH:
            # Both directions are one fact: their mean stands above the diagonal.
            scores = (scores + scores.T) / 2
            is_new = np.triu(is_new)
        pairs = np.flatnonzero(is_new)
        order = np.argsort(-scores.ravel()[pairs], kind="stable")
        for pair in pairs[order[: LISTED // 2]].tolist():
            head, tail = divmod(pair, size)
            rows.append((head, relation, tail, float(scores[head, tail])))
    return pd.DataFrame(rows, columns=["head", "relation", "tail", "score"])


FEW_TEST_RECIPES = 50
"""A verdict on fewer test recipes is marked: it may differ with another seed of the split."""


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


class LinkView(Record):
    """All numbers in a link-prediction report (``report.json``).

    Attributes:
        format: name and version of the format.
        model: the evaluated model.
        graph: the evaluated graph and its split.
        entities: number of entities.
        split: size of the split's parts.
        queries: query count, two per ranked triple.
        triples: number of ranked triples.
        sampled_from: number of triples behind a uniform sample; None if all are ranked.
        without_pairs: whether the graph is too large to score all pairs; fields that need all pairs
            are empty or None.
        leaked_left_out: number of test recipe triples left out because they are also in training.
        leakage: triples of test recipes that training contains, by relation.
        checks: conditions for valid metrics.
        metrics: metrics with filtered ranks for all queries, each relation, and each relation and
            side; equal scores share their mean rank.
        with_leaked: metrics with the leaked triples included; None if none are left out.
        folds: MRR of a cross-fitted model on train triples, with and without them in training; None
            for other models.
        probabilities: calibration of a cross-fitted model; empty for other models.
        baselines: metrics of each baseline.
        comparisons: differences between the model and each baseline, the best baseline first.
        drill_down: metrics for groups of queries by kind of group, see :func:`drill_down_of`.
        best, worst: the best-ranked and the worst-ranked queries, one for each fact.
        perhaps_missing: the best-scored triples outside the graph, perhaps missing recipes.
        provenance: facts about the training, by name.
    """

    format: Literal["wordcraft-kg link report 1"]
    model: EvaluatedModel
    graph: PlayedGraph
    entities: Count
    split: SplitSummary
    queries: Count
    triples: Count
    sampled_from: Count | None
    without_pairs: bool
    leaked_left_out: Count
    leakage: dict[Relation, Leakage]
    checks: Annotated[tuple[Check, ...], msgspec.Meta(min_length=2)]
    metrics: Slices
    with_leaked: RankingMetrics | None
    folds: FoldsRecord | None
    probabilities: tuple[Reliability, ...]
    baselines: dict[str, Slices]
    comparisons: Annotated[tuple[BaselineComparison, ...], msgspec.Meta(min_length=1)]
    drill_down: dict[str, Slices]
    best: Listed
    worst: Listed
    perhaps_missing: Listed
    provenance: dict[str, str]

    @property
    def has_few_test_recipes(self) -> bool:
        """Whether fewer than :data:`FEW_TEST_RECIPES` test recipes decide the comparisons.

        A model of the full graph is compared on all recipes, and has seen them.
        """
        is_unseen = not self.model.has_seen_the_test_recipes
        return is_unseen and self.split.test_recipes < FEW_TEST_RECIPES


def view_links(
    links: RankedLinks,
    *,
    name: str = "scorer",
    provenance: Mapping[str, str] | None = None,
) -> LinkView:
    """Return all numbers in a link-prediction report.

    Args:
        links: the ranked queries.
        name: the model's name in the report.
        provenance: facts about the training; None for none.

    Returns:
        The numbers, for :func:`~wordcraft_kg.reports.link_report.make_link_report`.

    Raises:
        ArtefactError: if a score is not a finite number.
    """
    ranks = links.ranks
    split = split_summary(links.opened.split)
    scorer = folds_of(links.scorer)
    folds = None
    # Some scorers have folds whose links nobody has ranked.
    if scorer is not None and not links.is_full and scorer.record.mrr is not None:
        folds = scorer.record

    # The same queries in the same order, so the masks are those of the baselines, too.
    masks = slice_masks(ranks)
    baselines = {
        baseline: _with_intervals(links, table, masks)
        for baseline, table in links.baseline_ranks.items()
    }
    # Random order has a formula, so its metrics need no interval.
    baselines["random"] = {part: random_metrics(ranks[mask]) for part, mask in masks.items()}
    return LinkView(
        format="wordcraft-kg link report 1",
        model=EvaluatedModel(name, links.kg, links.is_full),
        graph=PlayedGraph.of(links.opened),
        entities=links.graph.num_entities,
        split=split,
        queries=len(ranks),
        triples=len(links.queries),
        sampled_from=links.sampled_from,
        without_pairs=not links.has_table,
        leaked_left_out=0 if links.is_full else split.leaked_triples,
        leakage=leakage(links.opened.split),
        checks=tuple(_checks(links)),
        metrics=_with_intervals(links, ranks, masks),
        with_leaked=_with_leaked(links),
        folds=folds,
        probabilities=tuple(reliability_of(links)),
        baselines=baselines,
        comparisons=tuple(comparisons_of(links)),
        drill_down=drill_down_of(links),
        provenance=dict(provenance or {}),
        **listed_triples(links),
    )


def _with_leaked(links: RankedLinks) -> RankingMetrics | None:
    """Return metrics with the leaked triples included; None if none are left out."""
    split = links.opened.split
    everything = split.triples_of("test")
    leaked = everything[~is_in(everything, split.held_out("test"), links.graph.num_entities)]
    if links.is_full or not len(leaked):
        return None
    # Sampling leaked and unseen triples in equal shares makes a uniform sample.
    share = len(links.queries) / links.population
    leaked = sampled(leaked, max(1, round(len(leaked) * share)))
    ranks = rank_triples(links.scorer, leaked, links.graph.triples)
    return ranking_metrics(pd.concat([links.ranks, ranks]))


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
    in_train = int(np.sum(is_in(test, links.train_sample.triples, graph.num_entities)))
    # A symmetric model knows a triple if it has seen the mirror.
    mirrors = test[test[:, 1] == COMBINES_WITH][:, [2, 1, 0]]
    mirrored = int(np.sum(is_in(mirrors, links.train_sample.triples, graph.num_entities)))
    yield Check(
        "leak",
        "no evaluated triple is in the training triples",
        not in_train,
        f"{in_train} found",
    )
    yield Check(
        "mirror",
        "no combinesWith triple has its mirror in the training triples",
        not mirrored,
        f"{mirrored} found",
    )
