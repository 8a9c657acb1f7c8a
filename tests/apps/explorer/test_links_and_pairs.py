"""A link: score, ranks, status, recipes and evidence; a pair: results and predictions."""

from collections.abc import Callable

import pytest

from tests.apps.explorer.shown import explored_by, explored_graph, view_of
from wordcraft_kg.apps.explorer.pages.link import Link, LinkProfile
from wordcraft_kg.apps.explorer.pages.pair import Pair, PairProfile
from wordcraft_kg.apps.explorer.predictor import LinkPredictor
from wordcraft_kg.base.records import checked_values
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted
from wordcraft_kg.models.scorers.ranking import rank_triples


def link_of(predictor: LinkPredictor, *labels: str) -> LinkProfile:
    """Return the link of head, relation and tail."""
    view = view_of(explored_by(predictor), Link(*labels))  # type: ignore[arg-type]
    checked_values(view)
    return view


def held_out(predictor: LinkPredictor) -> tuple[list[int], tuple[str, str, str]]:
    """Return the first held-out triple as ids and labels."""
    head, relation, tail = predictor.split.held_out("test")[0].tolist()
    labels = predictor.graph.entities
    return [head, relation, tail], (labels[head], RELATIONS[relation], labels[tail])


def pair_of(predictor: LinkPredictor, a: str, b: str) -> PairProfile:
    view = view_of(explored_by(predictor), Pair(a, b))
    checked_values(view)
    return view


def test_a_link_has_the_score_and_ranks_that_reports_give_it(kernel: LinkPredictor):
    graph = kernel.graph
    triples = graph.triples[::37]
    ranks = rank_triples(kernel.model.scorer, triples, graph.triples)
    statuses = set()
    for row, (head, relation, tail) in enumerate(triples.tolist()):
        found = link_of(kernel, graph.entities[head], RELATIONS[relation], graph.entities[tail])
        assert found.score == pytest.approx(float(kernel.model.scorer.score(head, relation, tail)))
        assert found.as_tail.rank == ranks["rank"].iloc[row]
        assert found.as_head.rank == ranks["rank"].iloc[row + len(triples)]
        assert found.as_head.candidates == ranks["candidates"].iloc[row + len(triples)]
        assert (found.status == "learned") == found.reason.is_in_sample == (found.known == "train")
        assert {row.part for row in found.recipes} >= {found.known}
        statuses.add((found.status, found.known))
    assert statuses == {("learned", "train"), ("held out", "valid"), ("held out", "test")}


def test_a_learned_link_is_memory_and_has_no_probability(kernel: LinkPredictor):
    a, b, _ = kernel.graph.labels(kernel.split.recipes("train")[0])
    found = link_of(kernel, a, "combinesWith", b)
    assert (found.status, found.probability) == ("learned", None)
    assert found.reason.learned_from[0] in [tuple(row)[:3] for row in kernel.graph.recipe_labels()]


def test_a_link_that_is_held_out_has_a_probability_and_its_recipes(kernel: LinkPredictor):
    ids, labels = held_out(kernel)
    found = link_of(kernel, *labels)
    assert (found.status, {row.part for row in found.recipes}) == ("held out", {"test"})
    assert found.probability == pytest.approx(float(kernel.model.scorer.probability(*ids)))
    assert not found.reason.is_in_sample
    assert found.reason.witnesses


def test_a_link_that_is_not_in_the_book_says_so(kernel: LinkPredictor):
    found = link_of(kernel, "bread", "componentOf", "bread")
    assert (found.status, found.known, found.recipes) == ("itself", "new", ())
    assert found.probability is not None
    other = link_of(kernel, "bread", "componentOf", "water")
    assert (other.status, other.recipes) == ("not in the book", ())
    assert {row.entity for row in other.tails.best}.isdisjoint({"water"}) or other.as_tail.rank <= 10


def test_candidates_of_both_open_slots_stand_beside(kernel: LinkPredictor):
    found = link_of(kernel, "flour", "componentOf", "bread")
    assert (found.tails.head, found.tails.tail, len(found.tails.best)) == ("flour", None, 10)
    assert (found.heads.head, found.heads.tail, len(found.heads.best)) == (None, "bread", 10)


def test_a_model_of_the_full_graph_is_marked(all_seeing: LinkPredictor):
    found = link_of(all_seeing, *held_out(all_seeing)[1])
    assert (found.has_seen_the_test_recipes, found.status, found.known) == (True, "learned", "test")
    assert found.reason.is_in_sample


def test_a_pair_makes_what_the_book_says_with_the_part(neighbours: LinkPredictor):
    graph, explored = neighbours.graph, explored_graph(neighbours.graph, split=neighbours.split)
    for a, b, _ in graph.recipe_labels()[::13]:
        for one, other in ((a, b), (b, a)):
            found = view_of(explored, Pair(one, other))
            assert tuple(row.result for row in found.makes) == graph.labels(graph.results(a, b))
            assert (found.link, found.results, found.model) == (None, None, "")


def test_a_scorer_of_recipes_says_what_it_expects_how_sure_it_is_and_why(rankers: LinkPredictor):
    a, b, result = rankers.graph.labels(rankers.split.recipes("test")[0])
    found = pair_of(rankers, a, b)
    assert found.results is not None
    scorer = rankers.model.scorer
    assert isinstance(scorer, CrossFitted)
    shares = scorer.result_probabilities(a, b)
    assert [row.probability for row in found.results] == pytest.approx(sorted(shares.tolist(), reverse=True)[:10])
    assert any(row.because for row in found.results)
    assert not any(row.in_sample for row in found.results if row.known != "train")
    assert [row.part for row in found.makes if row.result == result] == ["test"]


def test_what_a_scorer_of_recipes_has_learned_is_memory(rankers: LinkPredictor):
    a, b, result = rankers.graph.labels(rankers.split.recipes("train")[0])
    found = pair_of(rankers, a, b)
    assert found.results is not None
    assert {row.result for row in found.results if row.in_sample} >= {result}
    assert found.link is not None
    assert (found.link.status, found.link.probability) == ("learned", None)


def test_a_scorer_of_links_says_only_whether_a_pair_combines(kernel: LinkPredictor):
    _, (a, _, b) = held_out(kernel)
    found = pair_of(kernel, a, b)
    assert found.results is None
    assert found.link is not None
    assert (found.link.status, found.link.probability is None) == ("held out", False)
    assert found.link.score == pytest.approx(float(kernel.model.scorer.score(a, COMBINES_WITH, b)))
    ranks = rank_triples(kernel.model.scorer, kernel.split.held_out("test")[:1], kernel.graph.triples)
    assert found.link.rank.rank == ranks["rank"].iloc[0]


def test_an_entity_may_be_paired_with_itself(kernel: LinkPredictor):
    found = pair_of(kernel, "bread", "bread")
    assert found.link is not None
    assert found.link.status in ("itself", "held out", "learned")


def test_a_pair_of_a_book_without_a_split_is_known(of_recipes: Callable[..., LinkPredictor]):
    whole = pair_of(of_recipes([("a", "b", "c"), ("a", "b", "d")], kind="none"), "b", "a")
    assert [(row.result, row.part) for row in whole.makes] == [("c", "train"), ("d", "train")]
    assert whole.has_seen_the_test_recipes
