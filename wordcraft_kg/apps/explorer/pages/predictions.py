"""The page for a model's ranks."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from operator import attrgetter
from typing import Literal, get_args

import msgspec
import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState, Paging, paging
from wordcraft_kg.apps.explorer.predictor import KNOWN, NEW, LinkPredictor
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.evaluation.scores import Known
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS, Relation, is_in, triple_keys
from wordcraft_kg.models.scorers.config import MAX_QUERIES
from wordcraft_kg.models.scorers.ranking import (
    MIN_TRIPLES,
    RankingMetrics,
    rank_triples,
    ranking_metrics,
    sampled,
)
from wordcraft_kg.models.scorers.roles import Side

ROWS_A_PAGE = 50
SCORES = 2**26
"""Maximum number of scores of a ranking's unseen or other triples (seconds): all triples of up to 3,355 entities."""
RankOrder = Literal["worst", "best", "score", "label"]
Knowledge = Literal["unseen", "learned", "all"]
Band = Literal["1", "2-10", "11-100", "101-"]
_BANDS: dict[Band, tuple[float, float]] = {
    "1": (0, 1),
    "2-10": (1, 10),
    "11-100": (10, 100),
    "101-": (100, np.inf),
}
"""Each rank band begins above the first rank."""


class RankFilter(PageState):
    """A filter for queries (links with an open ``side``).

    The part is by default any part of the book, ``new`` for links that are not in the book; ``known`` selects training
    triples, other triples, or all; ``rank`` is a range of ranks.
    """

    relation: Relation | Literal[""] = ""
    side: Side | Literal[""] = ""
    part: Known | Literal[""] = ""
    known: Knowledge = "unseen"
    entity: str = ""
    rank: Band | Literal[""] = ""


FACETS: dict[str, tuple[str, ...]] = {
    "relation": ("", *RELATIONS),
    "side": ("", *get_args(Side)),
    "part": ("", *KNOWN),
    "known": get_args(Knowledge),
    "rank": ("", *_BANDS),
}
"""Filter settings with a fixed number of values, each shown with its number of links."""


class QueriesState(RankFilter):
    """Page settings: a filter for queries, and the page in their list."""

    page: int = 1

    @property
    def chosen(self) -> RankFilter:
        """The filter alone."""
        return RankFilter(*(getattr(self, name) for name in RankFilter.__struct_fields__))


class PredictionsState(QueriesState):
    """Page settings: a filter for queries, a model, by default the first, and an order."""

    model: str = ""
    sort: RankOrder = "worst"


class RankedQuery(Record):
    """A query with the filtered, realistic rank, the best candidate, and the part with recipes for the triple."""

    head: str
    relation: Relation
    tail: str
    side: Side
    known: Known
    learned: bool
    rank: float
    candidates: Count
    score: float
    top: str


class RankSample(Record):
    """Counts of ranked and existing triples: unseen test triples, and other triples."""

    unseen: Count
    unseen_of: Count
    others: Count
    others_of: Count

    @property
    def is_whole(self) -> bool:
        """Whether all triples are ranked."""
        return (self.unseen, self.others) == (self.unseen_of, self.others_of)


class LinkRanks(Record):
    """A page of ranks; metrics and ``learned``, the count of training triples, cover all chosen queries.

    ``facets`` holds, for each setting and value, the number of links under the other chosen settings.
    """

    model: str
    has_seen_the_test_recipes: bool
    chosen: RankFilter
    facets: dict[str, dict[str, Count]]
    order: RankOrder
    metrics: RankingMetrics
    learned: Count
    sample: RankSample
    paging: Paging
    queries: tuple[RankedQuery, ...]


@dataclass(frozen=True)
class RankedTriples:
    """A model's ranks for a graph's true triples, and for the ``new`` links that it ranks first in a query.

    The tables have a row for each query, see :func:`~wordcraft_kg.models.scorers.ranking.rank_triples`; the further
    columns are ``part``, an index in ``KNOWN``, ``learned``, whether the triple is training data, and ``link``, equal
    for both directions of a symmetric link.
    """

    name: str
    split: Split
    has_seen_the_test_recipes: bool
    ranks: pd.DataFrame
    new: pd.DataFrame
    sample: RankSample

    def rows(self, chosen: RankFilter) -> pd.DataFrame:
        """Return the table rows that fit a filter; an unknown entity is an UnknownEntityError."""
        ranks = self.new if chosen.part == "new" else self.ranks
        mask = np.ones(len(ranks), dtype=bool)
        if chosen.relation:
            mask &= ranks["relation"] == RELATIONS.index(chosen.relation)
        if chosen.side:
            mask &= ranks["side"] == chosen.side
        if chosen.part:
            mask &= ranks["part"] == KNOWN.index(chosen.part)
        if chosen.known != "all":
            mask &= ranks["learned"] == (chosen.known == "learned")
        if chosen.entity:
            mask &= (ranks[["head", "tail"]] == self.split.graph.id_of(chosen.entity)).any(axis=1)
        if chosen.rank:
            low, high = _BANDS[chosen.rank]
            mask &= (ranks["rank"] > low) & (ranks["rank"] <= high)
        return ranks[mask]

    def facets(self, chosen: RankFilter) -> dict[str, dict[str, int]]:
        """Return the number of links by setting and value, with the other settings of the filter."""

        def count(name: str, value: str) -> int:
            return int(
                self.rows(msgspec.structs.replace(chosen, **{name: value}))["link"].nunique()
            )

        return {
            name: {value: count(name, value) for value in values} for name, values in FACETS.items()
        }


def rank_graph(predictor: LinkPredictor, max_triples: int | None = None) -> RankedTriples:
    """Rank all triples in the graph; large graphs are sampled, with a separate sample for unseen test triples."""
    split = predictor.split
    graph = split.graph
    unseen = split.held_out("test")
    others = graph.triples[~is_in(graph.triples, unseen, graph.num_entities)]
    if max_triples is None:
        max_triples = min(MAX_QUERIES // 2, max(MIN_TRIPLES, SCORES // max(graph.num_entities, 1)))
    taken = [sampled(triples, max_triples) for triples in (unseen, others)]
    chosen = np.concatenate(taken)
    ranks = rank_triples(predictor.model.scorer, chosen, graph.triples)
    ranks, new = (_described(predictor, rows) for rows in (ranks, _first_new(predictor, ranks)))
    sample = RankSample(len(taken[0]), len(unseen), len(taken[1]), len(others))
    return RankedTriples(
        predictor.name, split, predictor.has_seen_the_test_recipes, ranks, new, sample
    )


def _first_new(predictor: LinkPredictor, ranks: pd.DataFrame) -> pd.DataFrame:
    if not len(ranks):
        return ranks
    is_tail = ranks["side"] == "tail"
    new = ranks.assign(
        head=ranks["head"].where(is_tail, ranks["top"]),
        tail=ranks["tail"].where(~is_tail, ranks["top"]),
    )
    new = new[(new[["head", "tail"]] != ranks[["head", "tail"]]).any(axis=1)]
    new = new.drop_duplicates(["head", "relation", "tail", "side"])
    ids = (torch.from_numpy(new[name].to_numpy(copy=True)) for name in ("head", "relation", "tail"))
    with torch.no_grad():
        scores = predictor.model.scorer.score(*ids).cpu().double().numpy()
    return new.assign(rank=1.0, candidates=new["candidates"] - 1, score=scores)


def _described(predictor: LinkPredictor, ranks: pd.DataFrame) -> pd.DataFrame:
    triples = ranks[["head", "relation", "tail"]].to_numpy(dtype=np.int64)
    part = predictor.split.part_of(triples)
    is_symmetric = triples[:, 1:2] == COMBINES_WITH
    ends = np.where(is_symmetric, np.sort(triples[:, [0, 2]], axis=1), triples[:, [0, 2]])
    link = triple_keys(np.insert(ends, 1, triples[:, 1], axis=1), predictor.graph.num_entities)
    return ranks.assign(
        part=np.where(part < 0, NEW, part), learned=predictor.learned(triples), link=link
    )


def view_link_ranks(
    ranked: RankedTriples, chosen: RankFilter, order: RankOrder = "worst", page: int = 1
) -> LinkRanks:
    """Return a page with one rank for each link, the first in the order, and metrics for all chosen queries.

    New links all have rank 1, so ``worst`` and ``best`` order them by descending score.
    """
    order = "score" if chosen.part == "new" and order in ("worst", "best") else order
    ranks = ranked.rows(chosen)
    ordered = ranks.iloc[_order(ranks, order)].drop_duplicates("link")
    shown = paging(len(ordered), page, ROWS_A_PAGE)
    return LinkRanks(
        model=ranked.name,
        has_seen_the_test_recipes=ranked.has_seen_the_test_recipes,
        chosen=chosen,
        facets=ranked.facets(chosen),
        order=order,
        metrics=ranking_metrics(ranks),
        learned=int(ranks["learned"].sum()),
        sample=ranked.sample,
        paging=shown,
        queries=tuple(ranked_queries(ranked.split.graph, ordered.iloc[shown.rows])),
    )


def _order(ranks: pd.DataFrame, order: RankOrder) -> Ids:
    rank, score = (ranks[name].to_numpy(dtype=float) for name in ("rank", "score"))
    keys: dict[RankOrder, tuple[NDArray[np.float64], ...]] = {
        "worst": (score, -rank),
        "best": (-score, rank),
        "score": (-score,),
        "label": tuple(ranks[name].to_numpy(dtype=float) for name in ("tail", "head", "relation")),
    }
    return np.lexsort(keys[order])


def ranked_queries(graph: RecipeGraph, rows: pd.DataFrame) -> Iterator[RankedQuery]:
    """Yield rows of a table of ranks as records, with labels for entity ids."""
    labels, numbers = graph.entities, ("learned", "rank", "candidates", "score")
    for row in rows.to_dict("records"):
        yield RankedQuery(
            head=labels[row["head"]],
            relation=RELATIONS[row["relation"]],
            tail=labels[row["tail"]],
            side=row["side"],
            known=KNOWN[row["part"]],
            top=labels[row["top"]],
            **{name: row[name] for name in numbers},
        )


def ranked_by(explored: Explored, name: str) -> RankedTriples:
    """Return cached ranks for all triples by a model."""
    predictor = explored.predictor(name)
    return explored.once(("ranks", predictor.name), lambda: rank_graph(predictor))


def _view(explored: Explored, state: PredictionsState) -> LinkRanks:
    return view_link_ranks(ranked_by(explored, state.model), state.chosen, state.sort, state.page)


def _exported(explored: Explored) -> Iterator[PredictionsState]:
    for name, sort in product(("", *list(explored.models)[1:]), get_args(RankOrder)[:2]):
        yield (plain := PredictionsState(model=name, sort=sort))
        for setting, values in FACETS.items():
            yield from (msgspec.structs.replace(plain, **{setting: value}) for value in values)


PAGE = Page(
    "predictions",
    PredictionsState,
    _view,
    title="Predictions",
    exported=_exported,
    is_there=attrgetter("models"),
)
