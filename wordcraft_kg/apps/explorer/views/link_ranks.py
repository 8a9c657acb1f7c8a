"""The ranks of all triples of a graph by a model, as a table to filter and sort; and those of two models."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from wordcraft_kg.apps.explorer.views.paging import Paging, paging
from wordcraft_kg.apps.explorer.views.predictor import LinkPredictor
from wordcraft_kg.base.errors import GraphMismatchError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import PARTS, Part, Split
from wordcraft_kg.graphs.triples import RELATIONS, Relation, is_in
from wordcraft_kg.models.scorers.config import MAX_QUERIES
from wordcraft_kg.models.scorers.ranking import MIN_TRIPLES, RankingMetrics, rank_triples, ranking_metrics, sampled
from wordcraft_kg.models.scorers.roles import Side

ROWS_A_PAGE = 50
SCORES = 2**26
"""Scores that are computed for the triples of a kind, so that a ranking takes seconds: all of up to 3,355 entities."""
RankOrder = Literal["worst", "best", "score", "label"]
Knowledge = Literal["unseen", "learned", "all"]
Better = Literal["either", "one", "other"]


class RankFilter(Record):
    """Which queries are looked at; an empty text does not choose.

    Attributes:
        relation: relation of the triple.
        side: what is asked for.
        part: the part whose recipes give the triple, the first of several.
        known: whether the model was trained on it.
        entity: label of its head or tail.
    """

    relation: Relation | Literal[""] = ""
    side: Side | Literal[""] = ""
    part: Part | Literal[""] = ""
    known: Knowledge = "all"
    entity: str = ""


class RankedQuery(Record):
    """A query: a true triple, one of whose entities is asked for.

    Attributes:
        known: the part whose recipes give it.
        learned: whether the model was trained on it.
        rank: filtered, with realistic ties.
        candidates: number of entities that compete.
        top: the best candidate.
    """

    head: str
    relation: Relation
    tail: str
    side: Side
    known: Part
    learned: bool
    rank: float
    candidates: Count
    score: float
    top: str


class RankSample(Record):
    """How many triples are ranked of those that could be: of the unseen test triples, and of all others."""

    unseen: Count
    unseen_of: Count
    others: Count
    others_of: Count

    @property
    def is_whole(self) -> bool:
        """Whether all are ranked."""
        return (self.unseen, self.others) == (self.unseen_of, self.others_of)


class LinkRanks(Record):
    """Some of a model's ranks.

    Attributes:
        model: its name.
        has_seen_the_test_recipes: whether it was trained on all recipes.
        chosen: the filter.
        order: from the worst or the best rank, the highest score, or alphabetically.
        metrics: figures of all chosen queries, not only of the listed ones.
        learned: how many of the chosen queries are for triples that the model was trained on.
        sample: how many triples are ranked at all.
        paging: which queries are listed.
        queries: these.
    """

    model: str
    has_seen_the_test_recipes: bool
    chosen: RankFilter
    order: RankOrder
    metrics: RankingMetrics
    learned: Count
    sample: RankSample
    paging: Paging
    queries: tuple[RankedQuery, ...]


class ComparedQuery(Record):
    """A query and its ranks by two models, with what each takes for the best candidate."""

    head: str
    relation: Relation
    tail: str
    side: Side
    known: Part
    learned_by_one: bool
    learned_by_other: bool
    rank_one: float
    rank_other: float
    top_one: str
    top_other: str


class ComparedRanks(Record):
    """The ranks of the same queries by two models.

    Attributes:
        one: name of a model.
        other: name of the other one.
        chosen: the filter; ``known`` is what both have learned, or neither.
        better: queries that one of them ranks better, or all.
        metrics_one: figures of one for all chosen queries, before ``better`` chooses among them.
        metrics_other: those of the other.
        learned: how many of these queries are for triples that one of them was trained on.
        better_one: how many of these queries the one ranks better.
        better_other: how many of these queries the other ranks better.
        queries: the listed ones, the largest difference of the reciprocal rank first.
    """

    one: str
    other: str
    chosen: RankFilter
    better: Better
    metrics_one: RankingMetrics
    metrics_other: RankingMetrics
    learned: Count
    better_one: Count
    better_other: Count
    sample: RankSample
    paging: Paging
    queries: tuple[ComparedQuery, ...]


@dataclass(frozen=True)
class RankedTriples:
    """The ranks of the triples of a graph by a model.

    Attributes:
        name: name of the model.
        split: graph and split.
        has_seen_the_test_recipes: whether the model was trained on all recipes.
        ranks: a row for each query, see :func:`~wordcraft_kg.models.scorers.ranking.rank_triples`; besides, the part
            (its number) and whether it is learned.
        sample: how many triples are ranked.
    """

    name: str
    split: Split
    has_seen_the_test_recipes: bool
    ranks: pd.DataFrame
    sample: RankSample

    @property
    def graph(self) -> RecipeGraph:
        """The graph of the triples."""
        return self.split.graph

    def mask(self, chosen: RankFilter) -> NDArray[np.bool_]:
        """Return which queries a filter chooses, shape (Q,).

        Raises:
            UnknownEntityError: if the graph does not have its entity.
        """
        ranks = self.ranks
        mask = np.ones(len(ranks), dtype=bool)
        if chosen.relation:
            mask &= ranks["relation"].to_numpy() == RELATIONS.index(chosen.relation)
        if chosen.side:
            mask &= ranks["side"].to_numpy() == chosen.side
        if chosen.part:
            mask &= ranks["part"].to_numpy() == PARTS.index(chosen.part)
        if chosen.known != "all":
            mask &= ranks["learned"].to_numpy() == (chosen.known == "learned")
        if chosen.entity:
            entity = self.graph.id_of(chosen.entity)
            mask &= (ranks["head"].to_numpy() == entity) | (ranks["tail"].to_numpy() == entity)
        return mask


def rank_graph(predictor: LinkPredictor, max_triples: int | None = None) -> RankedTriples:
    """Rank all triples of the graph of a model, those that it has learned and those that it has not.

    Of very many, the unseen test triples are sampled, as for the link-prediction report, and so are the others, apart.

    Args:
        predictor: the model.
        max_triples: most triples of either kind. Default: as many as the report ranks, and fewer of many entities.
    """
    split = predictor.split
    graph = split.graph
    unseen = split.held_out("test")
    others = graph.triples[~is_in(graph.triples, unseen, graph.num_entities)]
    if max_triples is None:
        max_triples = min(MAX_QUERIES // 2, max(MIN_TRIPLES, SCORES // max(graph.num_entities, 1)))
    taken = [sampled(triples, max_triples) for triples in (unseen, others)]
    chosen = np.concatenate(taken)
    ranks = rank_triples(predictor.model.scorer, chosen, graph.triples)
    part, learned = split.part_of(chosen), predictor.learned(chosen)
    ranks = ranks.assign(part=np.tile(part, 2)[: len(ranks)], learned=np.tile(learned, 2)[: len(ranks)])
    sample = RankSample(len(taken[0]), len(unseen), len(taken[1]), len(others))
    return RankedTriples(predictor.name, split, predictor.has_seen_the_test_recipes, ranks, sample)


def view_link_ranks(ranked: RankedTriples, chosen: RankFilter, order: RankOrder = "worst", page: int = 1) -> LinkRanks:
    """List some of a model's ranks, with the figures of all that the filter chooses.

    Raises:
        UnknownEntityError: if the graph does not have the entity of the filter.
        ConfigError: if there is no such page.
    """
    ranks = ranked.ranks[ranked.mask(chosen)]
    shown = paging(len(ranks), page, ROWS_A_PAGE)
    rows = ranks.iloc[_order(ranks, order)[shown.rows]]
    return LinkRanks(
        model=ranked.name,
        has_seen_the_test_recipes=ranked.has_seen_the_test_recipes,
        chosen=chosen,
        order=order,
        metrics=ranking_metrics(ranks),
        learned=int(ranks["learned"].sum()),
        sample=ranked.sample,
        paging=shown,
        queries=tuple(_queries(ranked.graph, rows)),
    )


def _order(ranks: pd.DataFrame, order: RankOrder) -> Ids:
    """Return the order of queries, shape (Q,)."""
    rank, score = (ranks[name].to_numpy(dtype=float) for name in ("rank", "score"))
    keys: dict[RankOrder, tuple[NDArray[np.float64], ...]] = {
        "worst": (score, -rank),
        "best": (-score, rank),
        "score": (-score,),
        "label": tuple(ranks[name].to_numpy(dtype=float) for name in ("tail", "head", "relation")),
    }
    return np.lexsort(keys[order])


def _queries(graph: RecipeGraph, rows: pd.DataFrame) -> list[RankedQuery]:
    names = ("head", "relation", "tail", "side", "part", "learned", "rank", "candidates", "score", "top")
    return [
        RankedQuery(
            head=graph.entities[head],
            relation=RELATIONS[relation],
            tail=graph.entities[tail],
            side=side,
            known=PARTS[part],  # type: ignore[arg-type]
            learned=learned,
            rank=rank,
            candidates=candidates,
            score=score,
            top=graph.entities[top],
        )
        for head, relation, tail, side, part, learned, rank, candidates, score, top in zip(
            *(rows[name].tolist() for name in names), strict=True
        )
    ]


def check_comparable(one: LinkPredictor, other: LinkPredictor) -> None:
    """Refuse two models whose ranks are of other triples.

    Raises:
        GraphMismatchError: naming both.
    """
    for what, left, right in (
        ("graphs", one.graph.hash, other.graph.hash),
        ("splits", one.split.hash, other.split.hash),
    ):
        if left != right:
            raise GraphMismatchError(
                f"'{one.name}' and '{other.name}' were trained on different {what} ({left[:12]}, {right[:12]}); their "
                "ranks cannot be compared. Take two models of one graph folder."
            )


def view_compared_ranks(
    one: RankedTriples, other: RankedTriples, chosen: RankFilter, better: Better = "either", page: int = 1
) -> ComparedRanks:
    """List queries by how differently two models rank them.

    Args:
        one: ranks of a model.
        other: those of the other one, of the same triples.
        chosen: which queries; with ``known`` those whose triple both models have learned, or neither.
        better: those that one of the two ranks better.
        page: number of the page.

    Raises:
        GraphMismatchError: if they are of other triples.
        UnknownEntityError: if the graph does not have the entity of the filter.
        ConfigError: if there is no such page.
    """
    keys = ["head", "relation", "tail", "side"]
    if one.split.hash != other.split.hash or not one.ranks[keys].equals(other.ranks[keys]):
        raise GraphMismatchError(
            f"the ranks of '{one.name}' and '{other.name}' are of other triples. Take two models of one graph folder."
        )
    mask = one.mask(chosen) & other.mask(chosen)
    left, right = one.ranks[mask], other.ranks[mask]
    gain = (1 / left["rank"] - 1 / right["rank"]).to_numpy(dtype=float)
    listed = {"either": np.ones(len(gain), dtype=bool), "one": gain > 0, "other": gain < 0}[better]
    rows = np.flatnonzero(listed)
    shown = paging(len(rows), page, ROWS_A_PAGE)
    rows = rows[np.argsort(-np.abs(gain[rows]), kind="stable")][shown.rows]
    pairs = zip(_queries(one.graph, left.iloc[rows]), _queries(one.graph, right.iloc[rows]), strict=True)
    return ComparedRanks(
        one=one.name,
        other=other.name,
        chosen=chosen,
        better=better,
        metrics_one=ranking_metrics(left),
        metrics_other=ranking_metrics(right),
        learned=int((left["learned"].to_numpy(dtype=bool) | right["learned"].to_numpy(dtype=bool)).sum()),
        better_one=int((gain > 0).sum()),
        better_other=int((gain < 0).sum()),
        sample=one.sample,
        paging=shown,
        queries=tuple(
            ComparedQuery(
                head=a.head,
                relation=a.relation,
                tail=a.tail,
                side=a.side,
                known=a.known,
                learned_by_one=a.learned,
                learned_by_other=b.learned,
                rank_one=a.rank,
                rank_other=b.rank,
                top_one=a.top,
                top_other=b.top,
            )
            for a, b in pairs
        ),
    )
