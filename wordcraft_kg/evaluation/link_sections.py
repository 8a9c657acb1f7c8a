"""Sections of a link-prediction report: query groups, lists of triples, and play by the scores."""

from collections.abc import Iterable, Iterator
from typing import Annotated, Literal

import msgspec
import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from wordcraft_kg.agents import players
from wordcraft_kg.agents.evaluation import PlayerSuccess, play_all
from wordcraft_kg.base import Count, Record, Share, WordCraftKGError
from wordcraft_kg.base.statistics import bootstrap, cluster_interval, wilson_interval
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation.agent_metrics import OPEN_END, Bounds, binned, goal_groups
from wordcraft_kg.evaluation.ranked_links import RankedLinks, labelled
from wordcraft_kg.graphs import COMBINES_WITH, RELATIONS, Ids, RecipeGraph, Relation, layers
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.near_synonyms import near_synonym_recipes, near_synonym_triples
from wordcraft_kg.models.scorers.ranking import (
    RankingMetrics,
    random_reciprocal_ranks,
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


def view_probabilities(
    scorer: CrossFitted, graph: RecipeGraph, trained_on: Ids
) -> tuple[Reliability, ...]:
    """Compare predicted probabilities with true triples outside training.

    Args:
        scorer: a cross-fitted scorer.
        graph: the graph, whose triples are true.
        trained_on: training triples, shape (T, 3).

    Returns:
        A record for each relation and kind of pair; empty for a scorer without probabilities.
    """
    if scorer.probabilities is None:
        return ()
    size = graph.num_entities
    every = torch.arange(size)
    is_self = np.eye(size, dtype=bool)
    rows = []
    for relation, name in enumerate(RELATIONS):
        chances = scorer.probability(every[:, None], relation, every[None, :]).cpu().numpy()
        # Triples in training are no test: the scorer has seen that they are true.
        is_asked = ~_table(trained_on, relation, size)
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
            bins = _bins(predicted, observed)
            errors = sum(row.triples * abs(row.probability - row.observed) for row in bins)
            rows.append(
                Reliability(
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
            )
    return tuple(rows)


def _table(triples: Ids, relation: int, size: int) -> NDArray[np.bool_]:
    """Return a relation's triples as a dense table (E, E); only small graphs come here."""
    heads, _, tails = triples[triples[:, 1] == relation].T
    table = np.zeros((size, size), dtype=bool)
    table[heads, tails] = True
    return table


def _bins(predicted: NDArray[np.float64], is_true: NDArray[np.bool_]) -> tuple[ReliabilityBin, ...]:
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
    rows = []
    for group in np.split(order, starts):
        size = len(group)
        true = int(is_true[group].sum())
        mean = float(predicted[group].mean())
        # Wilson's interval is valid for shares near 0, where the normal one reaches below 0.
        low, high = wilson_interval(true, size)
        rows.append(ReliabilityBin(mean, true / size, low, high, size))
    return tuple(rows)


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
LINKS_TO = "componentOf,"
"""Beginning of the names of componentOf queries by goal."""
Verdict = Literal["above", "no significant difference", "below"]


class BaselineComparison(Record):
    """A link predictor beside a baseline on the same queries.

    Attributes:
        baseline: the baseline's name.
        difference: MRR of the link predictor minus that of the baseline.
        ci: 95 % interval, by bootstrap over groups of recipes; both models answer the same
            resampled queries.
        verdict: `no significant difference` (at 5 %) if the interval contains 0.
    """

    baseline: str
    difference: Annotated[float, msgspec.Meta(ge=-1, le=1)]
    ci: tuple[float, float]
    verdict: Verdict

    @property
    def compared(self) -> str:
        """Verdict before the baseline's name: ``above``, or ``no significant difference from``."""
        if self.verdict == "no significant difference":
            return f"{self.verdict} from"
        return self.verdict


class SliceMetrics(RankingMetrics, kw_only=True):
    """Ranking metrics for a named group of queries (a slice).

    Attributes:
        slice: the group's name.
    """

    slice: str


class DrillDown(Record):
    """Ranking metrics for groups of queries; groups without queries are left out.

    Attributes:
        seen_in_train: by the number of training triples with the answer.
        layer: by the crafting rounds to the answer.
        self_combination: combinesWith of an entity with itself, and with another entity.
        near_synonyms: test recipes that repeat a train recipe with a near-synonym, and all others;
            empty for a model trained on the full graph.
        other_book: componentOf links to goals that another book in the training makes, and to all
            other goals; empty without another book.
    """

    seen_in_train: tuple[SliceMetrics, ...]
    layer: tuple[SliceMetrics, ...]
    self_combination: tuple[SliceMetrics, ...]
    near_synonyms: tuple[SliceMetrics, ...]
    other_book: tuple[SliceMetrics, ...] = ()


class RankedTriple(Record):
    """A query with the rank of the true entity.

    Attributes:
        head: the head.
        relation: the relation.
        tail: the tail.
        side: the open slot, whose entity was ranked.
        rank: filtered rank of the true entity, from 1; ties share their mean rank.
        score: score of the true entity.
        top: the best candidate.
    """

    head: str
    relation: Relation
    tail: str
    side: Literal["head", "tail"]
    rank: Annotated[float, msgspec.Meta(ge=1)]
    score: float
    top: str


class ScoredPair(Record):
    """A triple outside the graph, with its score.

    Attributes:
        head: the head.
        relation: the relation.
        tail: the tail.
        score: the score, on the scorer's own scale.
    """

    head: str
    relation: Relation
    tail: str
    score: float


def comparisons_of(links: RankedLinks, seed: int) -> tuple[BaselineComparison, ...]:
    """Compare a link predictor with each baseline by reciprocal ranks, the best baseline first.

    ``seed`` is the seed of the bootstrap.
    """
    reciprocal_ranks = _reciprocal(links.ranks)
    baselines = {name: _reciprocal(ranks) for name, ranks in links.baseline_ranks.items()}
    # The expectation over random orders, and not one order: its own luck would widen the interval.
    baselines["random"] = random_reciprocal_ranks(links.ranks)
    best_first = sorted(baselines, key=lambda name: -float(baselines[name].mean()))
    rows = []
    for name in best_first:
        difference = reciprocal_ranks - baselines[name]
        means = bootstrap(difference, links.clusters, seed=seed)
        low, high = cluster_interval(difference, links.clusters, means)
        verdict: Verdict = "no significant difference"
        if low > 0:
            verdict = "above"
        elif high < 0:
            verdict = "below"
        row = BaselineComparison(
            baseline=name,
            difference=float(difference.mean()),
            ci=(low, high),
            verdict=verdict,
        )
        rows.append(row)
    return tuple(rows)


def _reciprocal(ranks: pd.DataFrame) -> NDArray[np.float64]:
    return np.asarray(1 / ranks["rank"].to_numpy(dtype=float))


def drill_down_of(links: RankedLinks, seed: int) -> DrillDown:
    """Return ranking metrics for query groups; ``seed`` is the bootstrap seed."""
    graph = links.graph
    ranks = links.ranks
    trained_on = links.trained_on
    # The answer of each query is the entity in the open slot.
    asks_tail = ranks["side"] == "tail"
    target = np.where(asks_tail, ranks["tail"], ranks["head"]).astype(np.int64)
    # A triple counts for both of its ends, and twice for an entity with itself.
    ends = np.concatenate([trained_on[:, 0], trained_on[:, 2]])
    uses = np.bincount(ends, minlength=graph.num_entities)
    train_uses = uses[target]
    layer = layers(graph)[target]
    is_symmetric = (ranks["relation"] == COMBINES_WITH).to_numpy()
    is_self = (ranks["head"] == ranks["tail"]).to_numpy()

    def between(values: Ids, bounds: Bounds) -> Iterator[tuple[str, NDArray[np.bool_]]]:
        return binned(values, bounds, more=" or more")

    def slices(groups: Iterable[tuple[str, NDArray[np.bool_]]]) -> tuple[SliceMetrics, ...]:
        rows = []
        for name, mask in groups:
            if mask.any():
                metrics = with_interval(ranks[mask], links.clusters[mask], seed=seed)
                rows.append(SliceMetrics(**msgspec.structs.asdict(metrics), slice=name))
        return tuple(rows)

    pairs = [("with itself", is_symmetric & is_self), ("with another", is_symmetric & ~is_self)]
    return DrillDown(
        seen_in_train=slices(between(train_uses, SEEN)),
        layer=slices([("not reachable", layer < 0), *between(layer, _LAYERS)]),
        self_combination=slices(pairs),
        # With all recipes in training every test recipe repeats a train recipe: itself.
        near_synonyms=() if links.is_full else slices(_near_synonyms(links)),
        other_book=slices(_by_other_book(links)),
    )


def _by_other_book(links: RankedLinks) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield componentOf queries whose goal another book makes, and all other componentOf queries.

    The goal is the tail.
    """
    goals = links.ranks["tail"].to_numpy(dtype=np.int64)
    is_part = (links.ranks["relation"] != COMBINES_WITH).to_numpy()
    # combinesWith says nothing about a goal, so only componentOf queries are grouped.
    groups = goal_groups(links.graph, goals, links.made_by_other_books)
    for name, mask in groups.items():
        yield f"{LINKS_TO} {name}", mask & is_part


def _near_synonyms(links: RankedLinks) -> list[tuple[str, NDArray[np.bool_]]]:
    graph = links.graph
    recipes = near_synonym_recipes(links.opened.split, glove_features(graph.entities))
    # Both queries of a triple, tails before heads.
    repeats = np.tile(near_synonym_triples(graph, recipes, links.queries), 2)
    if not repeats.any():  # as in a split by goal, or without word vectors
        return []
    return [("a train recipe with a near-synonym", repeats), (NO_NEAR_SYNONYM, ~repeats)]


def listed_triples(links: RankedLinks, *, ascending: bool) -> tuple[RankedTriple, ...]:
    """Return the best-ranked (ascending) or worst-ranked queries, one for each fact.

    A fact's queries for head and tail, and a combinesWith triple and its mirror, are one fact.
    """
    order = links.ranks.sort_values(
        ["rank", "score"], ascending=[ascending, not ascending], kind="stable"
    )
    ends = order[["head", "tail"]].copy()
    is_mirrored = order["relation"] == COMBINES_WITH
    # Sorted ends are equal for a triple and its mirror, so duplicates show.
    ends[is_mirrored] = np.sort(ends[is_mirrored], axis=1)
    order = order[~ends.assign(relation=order["relation"]).duplicated()]
    fields = list(RankedTriple.__struct_fields__)
    shown = labelled(links.graph, order.head(LISTED))[fields]
    # Lists of plain numbers: a record of NumPy numbers has no JSON form.
    columns = [shown[name].tolist() for name in shown]
    return tuple(RankedTriple(*row) for row in zip(*columns, strict=True))


def perhaps_missing_of(links: RankedLinks) -> tuple[ScoredPair, ...]:
    """Return the best-scored triples outside the graph, equally many for each relation.

    Such a triple may be a recipe that the book lacks.
    """
    graph = links.graph
    pairs = []
    for relation, name in enumerate(RELATIONS):
        scores = links.table[relation].copy()
        if relation == COMBINES_WITH:
            # Both directions are one fact: their mean stands above the diagonal, nothing below.
            mean_scores = (scores + scores.T) / 2
            scores = np.where(np.tri(len(scores), dtype=bool), -np.inf, mean_scores)
        is_own = graph.triples[:, 1] == relation
        heads, _, tails = graph.triples[is_own].T
        scores[heads, tails] = -np.inf
        # An entity with itself: models without an idea of roles score these pairs highest.
        np.fill_diagonal(scores, -np.inf)
        best_first = np.argsort(-scores, axis=None, kind="stable")
        for flat in best_first[: LISTED // 2].tolist():
            head, tail = divmod(flat, len(scores))
            score = float(scores[head, tail])
            # A small graph may have fewer free pairs than rows in the list.
            if np.isfinite(score):
                head_label = graph.entities[head]
                tail_label = graph.entities[tail]
                pairs.append(ScoredPair(head_label, name, tail_label, score))
    return tuple(pairs)


def play_by_scores(links: RankedLinks, seed: int) -> tuple[PlayerSuccess, ...]:
    """Evaluate players that choose by the scores alone, on test tasks of one recipe.

    Tables have 1 and 8 distractors. Rows by goals of another book are those of the best pair and of
    nearest words, which knows no book.
    """
    try:
        words = players.words_player(links.graph, players.knowledge_of(links.scorer))
        playing = {
            **players.scorer_players(links.graph, links.scorer, links.trained_on),
            "random": players.random_entity,
            players.FEWEST_USES: players.fewest_uses(links.opened.split),
            **words,
            "recipe oracle": players.recipe_oracle,
        }
        world = World(links.opened, WordCraftConfig(part="test"))
        groups = goal_groups(links.graph, world.tasks.goals, links.made_by_other_books)
        rows = play_all(world, playing, (1, 8), seed=seed, groups=groups)
        grouped = (players.BEST_PAIR, *words)
        return tuple(row for row in rows if not row.goals or row.player in grouped)
    except WordCraftKGError:
        # Without test tasks, with too few entities for distractors, or with a scorer that fails the
        # checks: the ranks are valid without play.
        return ()
