"""The table of all ranks: its headline is the report's, its filters choose what they say, and two
models beside."""

from itertools import product

import pytest

from wordcraft_kg.apps.explorer.pages import predictions
from wordcraft_kg.apps.explorer.pages.predictions import (
    RankFilter,
    rank_graph,
    ranked_queries,
    view_link_ranks,
)
from wordcraft_kg.graphs.triples import RELATIONS, is_in
from wordcraft_kg.models.scorers.ranking import MIN_TRIPLES, rank_triples

UNSEEN = RankFilter(part="test")


@pytest.fixture(scope="module")
def ranked(neighbours):
    return rank_graph(neighbours)


def pages(ranked, chosen, **options):
    number = view_link_ranks(ranked, chosen, **options).paging.pages
    shown = (view_link_ranks(ranked, chosen, page=page, **options) for page in range(1, number + 1))
    return [query for page in shown for query in page.queries]


@pytest.fixture(scope="module")
def everything(ranked):
    return list(ranked_queries(ranked.split.graph, ranked.ranks))


def link_of(query):
    ends = (query.head, query.tail)
    return (query.relation, *(sorted(ends) if query.relation == "combinesWith" else ends))


def key_of(query):
    return query.head, query.relation, query.tail, query.side


@pytest.mark.parametrize(("each", "ranked"), [(50, 50), (0, MIN_TRIPLES)])
def test_of_many_entities_fewer_triples_are_ranked(neighbours, monkeypatch, each, ranked):
    monkeypatch.setattr(predictions, "SCORES", each * neighbours.graph.num_entities)
    assert rank_graph(neighbours).sample.unseen == ranked


def test_all_triples_are_ranked_on_both_sides_as_reports_rank_them(neighbours, everything):
    graph, labels = neighbours.graph, neighbours.graph.entities
    ranks = rank_triples(neighbours.model.scorer, graph.triples, graph.triples)
    ranks["learned"] = is_in(
        ranks[["head", "relation", "tail"]].to_numpy(), neighbours.split.partial, len(labels)
    )
    expected = {
        (labels[row.head], RELATIONS[row.relation], labels[row.tail], row.side): row
        for row in ranks.itertuples()
    }
    assert len(everything) == 2 * len(graph.triples) == len(expected)
    for query in everything:
        row = expected[key_of(query)]
        assert (query.rank, query.score, query.candidates) == (row.rank, row.score, row.candidates)
        assert (query.top, query.learned) == (labels[row.top], row.learned)


COMBINED = list(
    product(
        ("", "combinesWith"),
        ("", "head"),
        ("", "train", "valid", "test"),
        ("all", "learned", "unseen"),
        ("", "water"),
        ("", "2-10"),
    )
)
# 18 of 192, which have all pairs of values of any two filters, and no filter at all.
FILTERS = [RankFilter(*values) for values in (COMBINED[0], *COMBINED[2::11])]


@pytest.mark.parametrize(
    "chosen",
    [
        pytest.param(chosen, marks=pytest.mark.slow if number % 3 else [], id=str(chosen))
        for number, chosen in enumerate(FILTERS)
    ],
)
def test_a_filter_chooses_what_it_says(ranked, everything, chosen):
    def fits(query):
        return (
            chosen.relation in ("", query.relation)
            and chosen.side in ("", query.side)
            and chosen.part in ("", query.known)
            and (chosen.known == "all" or query.learned == (chosen.known == "learned"))
            and (not chosen.entity or chosen.entity in (query.head, query.tail))
            and (not chosen.rank or 1 < query.rank <= 10)
        )

    view = view_link_ranks(ranked, chosen)
    expected = [query for query in everything if fits(query)]
    assert view.metrics.queries == len(expected)
    assert view.paging.total == len({link_of(query) for query in expected})
    assert view.learned == sum(query.learned for query in expected)
    assert all(fits(query) for query in view.queries)
    if expected:
        assert view.metrics.mrr == pytest.approx(
            sum(1 / query.rank for query in expected) / len(expected)
        )


@pytest.mark.parametrize(
    ("order", "key"),
    [
        ("worst", lambda query: (-query.rank, query.score)),
        ("best", lambda query: (query.rank, -query.score)),
        ("score", lambda query: -query.score),
        ("label", lambda query: (query.relation, query.head, query.tail)),
    ],
)
def test_queries_are_sorted_as_asked(ranked, order, key):
    keys = [key(query) for query in pages(ranked, UNSEEN, order=order)]
    assert keys == sorted(keys)


def test_new_links_are_the_candidates_before_a_true_answer(neighbours, ranked, everything):
    true = {(*key_of(query)[:3],) for query in everything}
    first = {
        (q.top, *key_of(q)[1:]) if q.side == "head" else (q.head, q.relation, q.top, q.side)
        for q in everything
    }
    new = list(ranked_queries(ranked.split.graph, ranked.rows(RankFilter(part="new", known="all"))))
    # Reading drops recipes that make their ingredient, so no entity is a component of itself.
    dropped = {key for key in first if key[0] == key[2] and key[1] == "componentOf"}
    new_keys = {key for key in first if key[:3] not in true}
    assert {key_of(query) for query in new} == new_keys - dropped
    assert {(query.rank, query.known) for query in new} == {(1.0, "new")}
    for q in new[::40]:
        assert q.score == pytest.approx(
            float(neighbours.model.scorer.score(q.head, q.relation, q.tail))
        )
    assert (scores := [q.score for q in pages(ranked, RankFilter(part="new"))]) == sorted(
        scores, reverse=True
    )
