"""Two models compared."""

from collections.abc import Iterator
from typing import Literal

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
from wordcraft_kg.evaluation import link_comparison
from wordcraft_kg.graphs.splits import Part
from wordcraft_kg.models.scorers.ranking import RankingMetrics, ranking_metrics

Better = Literal["either", "one", "other"]


class CompareState(QueriesState):
    """Page settings: a filter for queries, two models (default: the first two), and which ranks the answer better."""

    part: Part | Literal[""] = ""
    one: str = ""
    other: str = ""
    better: Better = "either"


class ComparedRanks(Record):
    """Two models' ranks for the same queries, by descending difference in reciprocal rank.

    Metrics and counts cover all filtered queries: ``better`` those that each model ranks better, ``learned`` triples
    that either model was trained on.
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
    """Two models' ranks, and their comparison or the reason why there is none."""

    headline: link_comparison.LinkComparison | None
    without_headline: str
    ranks: ComparedRanks


def view_compared_ranks(
    one: RankedTriples,
    other: RankedTriples,
    chosen: RankFilter,
    better: Better = "either",
    page: int = 1,
) -> ComparedRanks:
    """Compare two models' ranks of the same triples, the largest differences first; else a GraphMismatchError."""
    keys = ["head", "relation", "tail", "side"]
    if one.split.hash != other.split.hash or not one.ranks[keys].equals(other.ranks[keys]):
        raise GraphMismatchError(
            f"'{one.name}' and '{other.name}' rank different triples. Select two models of one graph folder."
        )
    left, right = one.rows(chosen), other.rows(chosen)
    both = left.index.intersection(right.index)
    left, right = left.loc[both], right.loc[both]
    gain = (1 / left["rank"] - 1 / right["rank"]).to_numpy(dtype=float)
    listed = {"either": np.ones(len(gain), dtype=bool), "one": gain > 0, "other": gain < 0}[better]
    by_gain = np.argsort(-np.abs(gain), kind="stable")
    ordered = left.iloc[by_gain[listed[by_gain]]].drop_duplicates("link")
    shown = paging(len(ordered), page, ROWS_A_PAGE)
    rows = ordered.index[shown.rows]
    first, second = (ranked_queries(one.split.graph, ranks.loc[rows]) for ranks in (left, right))
    return ComparedRanks(
        models=(one.name, other.name),
        chosen=chosen,
        listed=better,
        metrics=(ranking_metrics(left), ranking_metrics(right)),
        better=(int((gain > 0).sum()), int((gain < 0).sum())),
        learned=int((left["learned"] | right["learned"]).sum()),
        sample=one.sample,
        paging=shown,
        queries=tuple(zip(first, second, strict=True)),
    )


def _has_two_models(explored: Explored) -> bool:
    return len(explored.models) > 1


def _view(explored: Explored, state: CompareState) -> ModelsCompared:
    if not _has_two_models(explored):
        raise ConfigError(
            "This page needs two models; start with two of `wordcraft-kg explore GRAPH --model FOLDER`."
        )
    names = list(explored.models)
    first = state.one or next(name for name in names if name != state.other)
    second = state.other or next(name for name in names if name != first)
    one, other = explored.predictor(first), explored.predictor(second)

    headline, why = explored.once(("compared", one.name, other.name), lambda: _headline(one, other))
    one_ranks, other_ranks = ranked_by(explored, one.name), ranked_by(explored, other.name)
    ranks = view_compared_ranks(one_ranks, other_ranks, state.chosen, state.better, state.page)
    return ModelsCompared(headline, why, ranks)


def _headline(
    one: LinkPredictor, other: LinkPredictor
) -> tuple[link_comparison.LinkComparison | None, str]:
    contenders = [link_comparison.Contender(model.name, [model.model]) for model in (one, other)]
    try:
        return link_comparison.compare(contenders), ""
    except SplitError as error:
        return None, str(error)


def _exported(_: Explored) -> Iterator[CompareState]:
    yield from (CompareState(better=better) for better in ("either", "one", "other"))


def _questions(explored: Explored) -> Iterator[tuple[str, CompareState]]:
    yield "Which links do {} and {} rank differently?".format(*explored.models), CompareState()


PAGE = Page(
    "compare",
    CompareState,
    _view,
    title="Compare",
    exported=_exported,
    questions=_questions,
    is_there=_has_two_models,
)
