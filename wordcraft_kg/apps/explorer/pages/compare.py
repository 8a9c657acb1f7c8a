"""Two models compared on the same queries: which one is better, and where they differ most."""

from collections.abc import Iterator
from typing import Literal, get_args

import numpy as np

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, Paging, paging
from wordcraft_kg.apps.explorer.pages.predictions import (
    ROWS_A_PAGE,
    QueriesState,
    RankedQuery,
    RankedTriples,
    RankFilter,
    RankSample,
    ranked_by,
    ranked_queries,
)
from wordcraft_kg.apps.explorer.predictor import LinkPredictor
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError, SplitError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.evaluation import ranked_links
from wordcraft_kg.graphs.splits import Part
from wordcraft_kg.models.scorers.ranking import RankingMetrics, ranking_metrics

Better = Literal["either", "one", "other"]
"""Which model ranks the answer better; ``either`` includes equal ranks."""


class CompareState(QueriesState):
    """Page settings: a filter for queries, two models, and which one ranks the answer better.

    Attributes:
        part: part of the book with the triple; empty for all. New links are of one model, so they
            cannot be compared.
        one: name of a model; empty for the first.
        other: name of another model; empty for the second.
        better: which model ranks the listed queries better.
    """

    part: Part | Literal[""] = ""
    one: str = ""
    other: str = ""
    better: Better = "either"


class ComparedRanks(Record):
    """Two models' ranks for the same queries.

    Metrics and counts cover all filtered queries, not only the listed ones.

    Attributes:
        models: names of the two models, in the order of all pairs below.
        chosen: the filter. With ``known``, both models were trained on the triple, or neither.
        listed: which of the filtered queries are listed.
        metrics: ranking metrics of each model.
        better: numbers of queries that each model ranks better.
        learned: number of queries for triples that either model was trained on.
        sample: how many triples are ranked.
        paging: which of the listed queries are on this page.
        queries: each query by both models, the largest difference in reciprocal rank first.
    """

    models: tuple[str, str]
    chosen: RankFilter
    listed: Better
    metrics: tuple[RankingMetrics, RankingMetrics]
    better: tuple[Count, Count]
    learned: Count
    sample: RankSample
    paging: Paging
    queries: tuple[tuple[RankedQuery, RankedQuery], ...]


class ModelsCompared(Record):
    """Two models' ranks, and their comparison.

    Attributes:
        headline: comparison as by the command ``compare``; None without enough test triples.
        without_headline: reason why there is no comparison; empty if there is one.
        ranks: the ranks.
    """

    headline: ranked_links.LinkComparison | None
    without_headline: str
    ranks: ComparedRanks


def view_compared_ranks(
    one: RankedTriples,
    other: RankedTriples,
    chosen: RankFilter,
    better: Better = "either",
    page: int = 1,
) -> ComparedRanks:
    """Compare two models' ranks of the same triples.

    Args:
        one: ranks by a model.
        other: ranks of the same triples by the other model.
        chosen: filter for queries.
        better: which model ranks the listed queries better.
        page: page number in their list, from 1.

    Returns:
        the largest differences first, and each link once.

    Raises:
        GraphMismatchError: if the two ranks are of different triples.
        UnknownEntityError: if the filter has an entity that is not in the graph.
        ConfigError: if the list has no such page.
    """
    keys = ["head", "relation", "tail", "side"]
    are_same = one.ranks[keys].equals(other.ranks[keys])
    if one.split.hash != other.split.hash or not are_same:
        raise GraphMismatchError(
            f"'{one.name}' and '{other.name}' rank different triples. "
            "Select two models of one graph folder."
        )
    # Both tables have the same rows, see above, but the filters for rank and training data may
    # choose different ones.
    ranks = one.rows(chosen)
    other_ranks = other.rows(chosen)
    queries = ranks.index.intersection(other_ranks.index)
    ranks = ranks.loc[queries]
    other_ranks = other_ranks.loc[queries]
    # Reciprocal ranks, as in the MRR: a difference among the first ranks counts most.
    gain = (1 / ranks["rank"] - 1 / other_ranks["rank"]).to_numpy(dtype=float)
    is_listed = {
        "either": np.ones(len(gain), dtype=bool),
        "one": gain > 0,
        "other": gain < 0,
    }[better]
    by_gain = np.argsort(-np.abs(gain), kind="stable")
    # A link has a row for each side, a symmetric link also for each direction: the largest
    # difference is kept.
    ordered = ranks.iloc[by_gain[is_listed[by_gain]]].drop_duplicates("link")
    shown = paging(len(ordered), page, ROWS_A_PAGE)
    rows = ordered.index[shown.rows]
    graph = one.split.graph
    pairs = zip(
        ranked_queries(graph, ranks.loc[rows]),
        ranked_queries(graph, other_ranks.loc[rows]),
        strict=True,
    )
    return ComparedRanks(
        models=(one.name, other.name),
        chosen=chosen,
        listed=better,
        metrics=(ranking_metrics(ranks), ranking_metrics(other_ranks)),
        better=(int((gain > 0).sum()), int((gain < 0).sum())),
        learned=int((ranks["learned"] | other_ranks["learned"]).sum()),
        sample=one.sample,
        paging=shown,
        queries=tuple(pairs),
    )


def _has_two_models(explored: Explored) -> bool:
    return len(explored.models) > 1


def _view(explored: Explored, state: CompareState) -> ModelsCompared:
    if not _has_two_models(explored):
        raise ConfigError(
            "This page needs two models; "
            "start with two of `wordcraft-kg explore GRAPH --model FOLDER`."
        )
    # If only one model is given, the first model that differs from it is the other.
    names = list(explored.models)
    first = state.one or next(name for name in names if name != state.other)
    second = state.other or next(name for name in names if name != first)
    predictor = explored.predictor(first)
    other_predictor = explored.predictor(second)
    # The comparison resamples test triples, which takes seconds.
    key = ("compared", predictor.name, other_predictor.name)
    headline, reason = explored.once(key, lambda: _headline(predictor, other_predictor))
    ranks = view_compared_ranks(
        ranked_by(explored, predictor.name),
        ranked_by(explored, other_predictor.name),
        state.chosen,
        state.better,
        state.page,
    )
    return ModelsCompared(headline=headline, without_headline=reason, ranks=ranks)


def _headline(
    one: LinkPredictor, other: LinkPredictor
) -> tuple[ranked_links.LinkComparison | None, str]:
    contenders = [ranked_links.Contender(model.name, [model.model]) for model in (one, other)]
    try:
        return ranked_links.compare(contenders), ""
    except SplitError as error:
        # Without unseen test triples there is nothing to test, but there still are ranks to show.
        return None, str(error)


def _questions(explored: Explored) -> Iterator[tuple[str, CompareState]]:
    yield "Which links do {} and {} rank differently?".format(*explored.models), CompareState()


PAGE = Page(
    "compare",
    CompareState,
    _view,
    title="Compare",
    exported=lambda _: [CompareState(better=better) for better in get_args(Better)],
    questions=_questions,
    is_there=_has_two_models,
)
