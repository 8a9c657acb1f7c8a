"""The page for a model's ranks."""

from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, Paging, State, paging
from wordcraft_kg.apps.explorer.predictor import LinkPredictor
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import PARTS, Part, Split
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS, Relation, is_in
from wordcraft_kg.models.scorers.config import MAX_QUERIES
from wordcraft_kg.models.scorers.ranking import MIN_TRIPLES, RankingMetrics, rank_triples, ranking_metrics, sampled
from wordcraft_kg.models.scorers.roles import Side

ROWS_A_PAGE = 50
SCORES = 2**26
"""Maximum number of scores of a ranking's unseen or other triples (seconds): all triples of up to 3,355 entities."""
RankOrder = Literal["worst", "best", "score", "label"]
Knowledge = Literal["unseen", "learned", "all"]


class RankFilter(State):
    """A filter for queries (links with an open ``side``); ``known`` selects training triples, other triples, or all."""

    relation: Relation | Literal[""] = ""
    side: Side | Literal[""] = ""
    part: Part | Literal[""] = ""
    known: Knowledge = "unseen"
    entity: str = ""


class Queries(RankFilter):
    """Page settings: a filter for queries, and the page in their list."""

    page: int = 1

    @property
    def chosen(self) -> RankFilter:
        """The filter alone."""
        return RankFilter(self.relation, self.side, self.part, self.known, self.entity)


class Predictions(Queries):
    """Page settings: a filter for queries, a model, by default the first, and an order."""

    model: str = ""
    sort: RankOrder = "worst"


class RankedQuery(Record):
    """A query with the filtered, realistic rank, the best candidate, and the part with recipes for the triple."""

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
    """A page of ranks; metrics and ``learned``, the count of training triples, cover all chosen queries."""

    model: str
    has_seen_the_test_recipes: bool
    chosen: RankFilter
    order: RankOrder
    metrics: RankingMetrics
    learned: Count
    sample: RankSample
    paging: Paging
    queries: tuple[RankedQuery, ...]


@dataclass(frozen=True)
class RankedTriples:
    """A model's ranks for a graph's true triples.

    The table has a row for each query, see :func:`~wordcraft_kg.models.scorers.ranking.rank_triples`; the further
    columns are ``part``, an index in ``PARTS``, and ``learned``, whether the triple is training data.
    """

    name: str
    split: Split
    has_seen_the_test_recipes: bool
    ranks: pd.DataFrame
    sample: RankSample

    def mask(self, chosen: RankFilter) -> NDArray[np.bool_]:
        """Return which table rows fit a filter, shape (Q,), bool; an unknown entity is an UnknownEntityError."""
        ranks, mask = self.ranks, np.ones(len(self.ranks), dtype=bool)
        if chosen.relation:
            mask &= ranks["relation"] == RELATIONS.index(chosen.relation)
        if chosen.side:
            mask &= ranks["side"] == chosen.side
        if chosen.part:
            mask &= ranks["part"] == PARTS.index(chosen.part)
        if chosen.known != "all":
            mask &= ranks["learned"] == (chosen.known == "learned")
        if chosen.entity:
            mask &= (ranks[["head", "tail"]] == self.split.graph.id_of(chosen.entity)).any(axis=1)
        return np.asarray(mask)


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
    part, learned = split.part_of(chosen), predictor.learned(chosen)
    ranks = ranks.assign(part=np.tile(part, 2)[: len(ranks)], learned=np.tile(learned, 2)[: len(ranks)])
    sample = RankSample(len(taken[0]), len(unseen), len(taken[1]), len(others))
    return RankedTriples(predictor.name, split, predictor.has_seen_the_test_recipes, ranks, sample)


def view_link_ranks(ranked: RankedTriples, chosen: RankFilter, order: RankOrder = "worst", page: int = 1) -> LinkRanks:
    """Return a page with one rank for each link, the first in the order, and metrics for all chosen queries."""
    ranks = ranked.ranks[ranked.mask(chosen)]
    ordered = first_of_each_link(ranks.iloc[_order(ranks, order)])
    shown = paging(len(ordered), page, ROWS_A_PAGE)
    rows = ordered.iloc[shown.rows]
    return LinkRanks(
        model=ranked.name,
        has_seen_the_test_recipes=ranked.has_seen_the_test_recipes,
        chosen=chosen,
        order=order,
        metrics=ranking_metrics(ranks),
        learned=int(ranks["learned"].sum()),
        sample=ranked.sample,
        paging=shown,
        queries=tuple(ranked_queries(ranked.split.graph, rows)),
    )


def first_of_each_link(ranks: pd.DataFrame) -> pd.DataFrame:
    """Return the first row for each link; symmetric links have four queries, others two."""
    ends, is_symmetric = ranks[["head", "tail"]].to_numpy(), (ranks["relation"] == COMBINES_WITH).to_numpy()
    ends = np.where(is_symmetric[:, None], np.sort(ends, axis=1), ends)
    links = pd.DataFrame(np.column_stack([ranks["relation"], ends]))
    return ranks[~links.duplicated().to_numpy()]


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
            known=PARTS[row["part"]],  # type: ignore[arg-type]
            top=labels[row["top"]],
            **{name: row[name] for name in numbers},
        )


def ranked_by(explored: Explored, name: str) -> RankedTriples:
    """Return cached ranks for all triples by a model."""
    predictor = explored.predictor(name)
    return explored.once(("ranks", predictor.name), lambda: rank_graph(predictor))


def _view(explored: Explored, state: Predictions) -> LinkRanks:
    return view_link_ranks(ranked_by(explored, state.model), state.chosen, state.sort, state.page)


def _exported(explored: Explored) -> Iterator[Predictions]:
    for name in ("", *list(explored.models)[1:]):
        for sort in ("best", "worst"):
            yield Predictions(model=name, sort=sort)
            yield from (Predictions(model=name, relation=relation, sort=sort) for relation in RELATIONS)


PAGE = Page("predictions", Predictions, _view, title="Predictions", exported=_exported, is_there=attrgetter("models"))
