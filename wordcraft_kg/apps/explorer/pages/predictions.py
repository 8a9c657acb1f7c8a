"""The page for a model's ranks of all triples, to filter and to sort.

``rank_graph`` first: it makes the table that this page and the comparison filter.
"""

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
from wordcraft_kg.graphs.triples import (
    COMBINES_WITH,
    COMPONENT_OF,
    RELATIONS,
    Relation,
    is_in,
    triple_keys,
)
from wordcraft_kg.models.scorers.config import MAX_QUERIES, has_table
from wordcraft_kg.models.scorers.link_evidence import Side
from wordcraft_kg.models.scorers.ranking import (
    MIN_TRIPLES,
    RankingMetrics,
    rank_triples,
    ranking_metrics,
    sampled,
)

ROWS_A_PAGE = 50
SCORES = 2**26
"""Maximum number of scores of a ranking's unseen or other triples, which take seconds: all triples
of up to 3,355 entities."""
BY_LISTS = 2**22
"""The same for a recipe scorer without a table: each score is computed from neighbour lists."""
RankOrder = Literal["worst", "best", "score", "label"]
"""Worst or best rank first, highest score first, or by labels."""
Knowledge = Literal["unseen", "learned", "all"]
"""Triples outside the model's training data, training triples, or both."""
Band = Literal["1", "2-10", "11-100", "101-"]
"""A range of ranks. Realistic ranks may end in .5, so a band begins above the one before."""
_BANDS: dict[Band, tuple[float, float]] = {
    "1": (0, 1),
    "2-10": (1, 10),
    "11-100": (10, 100),
    "101-": (100, np.inf),
}
"""Bounds of each band: ranks above the first number, up to the second."""


class RankFilter(PageState):
    """A filter for queries (links with an open side); an empty text chooses all.

    Attributes:
        relation: relation of the link.
        side: the open side.
        part: part of the first recipe that gives the link; empty for all links of the book, ``new``
            for links that are not in the book.
        known: whether the link is in the model's training data.
        entity: label of head or tail.
        rank: range of ranks.
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


class PredictionsState(RankFilter):
    """Page settings: a filter for queries, the page in their list, a model, and an order.

    Attributes:
        page: page number.
        model: name of the model; empty for the first.
        sort: order of the queries.
    """

    page: int = 1
    model: str = ""
    sort: RankOrder = "worst"

    @property
    def chosen(self) -> RankFilter:
        """The filter alone."""
        return RankFilter(*(getattr(self, name) for name in RankFilter.__struct_fields__))


class RankedQuery(Record):
    """A query: a link with an open side, and the rank of its answer.

    Attributes:
        head: label of the head.
        relation: name of the relation.
        tail: label of the tail.
        side: the open side.
        known: part of the first recipe that gives the link, or ``new``.
        learned: whether the model was trained on the link.
        rank: filtered, realistic rank of the answer.
        candidates: number of entities that compete, with the answer.
        score: the model's score for the link; higher is more plausible.
        top: label of the entity with the highest score.
    """

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
    """How many triples are ranked; large graphs are sampled.

    Attributes:
        unseen: ranked unseen test triples.
        unseen_of: all unseen test triples.
        others: ranked other triples.
        others_of: all other triples.
    """

    unseen: Count
    unseen_of: Count
    others: Count
    others_of: Count

    @property
    def is_whole(self) -> bool:
        """Whether all triples are ranked."""
        return self.unseen == self.unseen_of and self.others == self.others_of


class LinkRanks(Record):
    """A page of ranks; metrics and counts cover all chosen queries, not only the listed ones.

    Attributes:
        model: name of the model.
        has_seen_the_test_recipes: whether the model was trained on all recipes.
        chosen: the filter.
        facets: number of links by setting and value, under the other chosen settings.
        order: order of the queries.
        metrics: ranking metrics.
        learned: number of queries for training triples.
        sample: how many triples are ranked.
        paging: which queries are on this page.
        queries: the queries on this page, each link once.
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
    """A model's ranks for a graph's true triples, and for links that it ranks first in a query.

    The tables have a row for each query, see
    :func:`~wordcraft_kg.models.scorers.ranking.rank_triples`; the further columns are ``part``, an
    index in ``KNOWN``, ``learned``, whether the triple is training data, and ``link``, equal for
    both directions of a symmetric link.

    Attributes:
        name: name of the model.
        split: graph and split.
        has_seen_the_test_recipes: whether the model was trained on all recipes.
        ranks: table for the graph's true triples.
        new: table for links that are not in the book, each the best answer to a query.
        sample: how many of the true triples are ranked.
    """

    name: str
    split: Split
    has_seen_the_test_recipes: bool
    ranks: pd.DataFrame
    new: pd.DataFrame
    sample: RankSample

    def rows(self, chosen: RankFilter) -> pd.DataFrame:
        """Return the table rows that fit a filter.

        Raises:
            UnknownEntityError: if the graph does not have the filter's entity.
        """
        # New links are few and all rank first, so they are a table apart.
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
            entity = self.split.graph.id_of(chosen.entity)
            mask &= (ranks[["head", "tail"]] == entity).any(axis=1)
        if chosen.rank:
            low, high = _BANDS[chosen.rank]
            mask &= (ranks["rank"] > low) & (ranks["rank"] <= high)
        return ranks[mask]

    def facets(self, chosen: RankFilter) -> dict[str, dict[str, int]]:
        """Return the number of links by setting and value, under the filter's other settings."""
        counts: dict[str, dict[str, int]] = {}
        for name, values in FACETS.items():
            counts[name] = {}
            for value in values:
                rows = self.rows(msgspec.structs.replace(chosen, **{name: value}))
                # Links, not rows: the list shows each link once.
                counts[name][value] = int(rows["link"].nunique())
        return counts


def rank_graph(predictor: LinkPredictor, max_triples: int | None = None) -> RankedTriples:
    """Rank all triples in the graph, those that the model was trained on and others.

    Large graphs are sampled. Unseen test triples have a sample of their own, as in the
    link-prediction report: they are few, and a common sample would have hardly any.

    Args:
        predictor: the model.
        max_triples: most ranked triples of either sample; None for as many as take seconds.

    Returns:
        the ranks; equal models and graphs have equal samples.

    Raises:
        ArtefactError: if a score is not a finite number.
    """
    split = predictor.split
    graph = split.graph
    unseen = split.held_out("test")
    other_triples = graph.triples[~is_in(graph.triples, unseen, graph.num_entities)]
    if max_triples is None:
        # Not more than the report ranks (a triple has two queries), and less for many entities,
        # which all get scores.
        is_by_lists = predictor.scores_recipes and not has_table(graph.num_entities)
        affordable = (BY_LISTS if is_by_lists else SCORES) // max(graph.num_entities, 1)
        max_triples = min(MAX_QUERIES // 2, max(MIN_TRIPLES, affordable))
    samples = [sampled(triples, max_triples) for triples in (unseen, other_triples)]
    ranked_triples = np.concatenate(samples)
    ranks = rank_triples(predictor.model.scorer, ranked_triples, graph.triples)
    new = _first_new(predictor, ranks)
    return RankedTriples(
        name=predictor.name,
        split=split,
        has_seen_the_test_recipes=predictor.has_seen_the_test_recipes,
        ranks=_described(predictor, ranks),
        new=_described(predictor, new),
        sample=RankSample(
            unseen=len(samples[0]),
            unseen_of=len(unseen),
            others=len(samples[1]),
            others_of=len(other_triples),
        ),
    )


def _first_new(predictor: LinkPredictor, ranks: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each link outside the book that has the highest score in a query."""
    if not len(ranks):
        return ranks
    is_tail = ranks["side"] == "tail"
    new = ranks.assign(
        head=ranks["head"].where(is_tail, ranks["top"]),
        tail=ranks["tail"].where(~is_tail, ranks["top"]),
    )
    # Where the answer itself has the highest score, the link is in the book.
    is_other = (new[["head", "tail"]] != ranks[["head", "tail"]]).any(axis=1)
    is_self_result = (new["relation"] == COMPONENT_OF) & (new["head"] == new["tail"])
    if not predictor.graph.has_self_results:
        # Books drop recipes that make their ingredient.
        is_other &= ~is_self_result
    new = new[is_other]
    new = new.drop_duplicates(["head", "relation", "tail", "side"])
    # A copy, because arrays of pandas may be read-only, which torch warns about.
    ids = (torch.from_numpy(new[name].to_numpy(copy=True)) for name in ("head", "relation", "tail"))
    with torch.no_grad():
        scores = predictor.model.scorer.score(*ids).cpu().double().numpy()
    # In the query for a new link, the true answer does not compete: one candidate less.
    return new.assign(rank=1.0, candidates=new["candidates"] - 1, score=scores)


def _described(predictor: LinkPredictor, ranks: pd.DataFrame) -> pd.DataFrame:
    """Add the columns ``part``, ``learned`` and ``link`` of :class:`RankedTriples` to a table."""
    triples = ranks[["head", "relation", "tail"]].to_numpy(dtype=np.int64)
    part = predictor.split.part_of(triples)
    is_symmetric = triples[:, 1:2] == COMBINES_WITH
    # Sorted ends give both directions of a symmetric link the same key.
    ends = triples[:, [0, 2]]
    ends = np.where(is_symmetric, np.sort(ends, axis=1), ends)
    link = triple_keys(np.insert(ends, 1, triples[:, 1], axis=1), predictor.graph.num_entities)
    return ranks.assign(
        part=np.where(part < 0, NEW, part), learned=predictor.learned(triples), link=link
    )


def view_link_ranks(
    ranked: RankedTriples, chosen: RankFilter, order: RankOrder = "worst", page: int = 1
) -> LinkRanks:
    """Return a page with one rank for each link, and metrics for all chosen queries.

    New links all have rank 1, so ``worst`` and ``best`` order them by descending score.

    Args:
        ranked: ranks of all triples.
        chosen: filter for queries.
        order: order of the queries.
        page: page number in their list, from 1.

    Returns:
        the queries on the page.

    Raises:
        UnknownEntityError: if the filter has an entity that is not in the graph.
        ConfigError: if the list has no such page.
    """
    order = "score" if chosen.part == "new" and order in ("worst", "best") else order
    ranks = ranked.rows(chosen)
    # Of a link's rows, one for each side and direction, the first in the order stays.
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
    def column(name: str) -> NDArray[np.float64]:
        return ranks[name].to_numpy(dtype=float)

    rank = column("rank")
    score = column("score")
    # np.lexsort sorts by the last key first. Ids are in the order of labels.
    keys: dict[RankOrder, tuple[NDArray[np.float64], ...]] = {
        "worst": (score, -rank),
        "best": (-score, rank),
        "score": (-score,),
        "label": (column("tail"), column("head"), column("relation")),
    }
    return np.lexsort(keys[order])


def ranked_queries(graph: RecipeGraph, rows: pd.DataFrame) -> Iterator[RankedQuery]:
    """Yield rows of a table of ranks as records, with labels for entity ids."""
    labels = graph.entities
    for row in rows.to_dict("records"):
        yield RankedQuery(
            head=labels[row["head"]],
            relation=RELATIONS[row["relation"]],
            tail=labels[row["tail"]],
            side=row["side"],
            known=KNOWN[row["part"]],
            learned=row["learned"],
            rank=row["rank"],
            candidates=row["candidates"],
            score=row["score"],
            top=labels[row["top"]],
        )


def ranked_by(explored: Explored, name: str) -> RankedTriples:
    """Return ranks for all triples by a model, which take seconds and are kept.

    Raises:
        ConfigError: if there is no model, or it has too many entities to compare.
        UnknownEntityError: if no model has this name.
        ArtefactError: if a score is not a finite number.
    """
    predictor = explored.predictor(name)
    return explored.once(("ranks", predictor.name), lambda: rank_graph(predictor))


def _view(explored: Explored, state: PredictionsState) -> LinkRanks:
    return view_link_ranks(ranked_by(explored, state.model), state.chosen, state.sort, state.page)


def _exported(explored: Explored) -> Iterator[PredictionsState]:
    # The first model has the empty name of the plain address. One setting at a time: combinations
    # would be too many files.
    models = ("", *list(explored.models)[1:])
    orders: tuple[RankOrder, ...] = ("worst", "best")
    for name, sort in product(models, orders):
        plain = PredictionsState(model=name, sort=sort)
        yield plain
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
