"""A link: its score, ranks, status, recipes and reasons."""

import pytest

from wordcraft_kg.apps.explorer.views.link_profiles import view_link_profile
from wordcraft_kg.apps.explorer.views.predictor import LinkPredictor
from wordcraft_kg.base.errors import UnknownEntityError
from wordcraft_kg.base.records import checked_values
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.scorers.ranking import rank_triples


def test_a_link_has_the_score_and_ranks_that_reports_give_it(kernel: LinkPredictor):
    graph = kernel.graph
    triples = graph.triples[::37]
    ranks = rank_triples(kernel.model.scorer, triples, graph.triples)
    statuses = set()
    for row, (head, relation, tail) in enumerate(triples.tolist()):
        found = view_link_profile(kernel, graph.entities[head], RELATIONS[relation], graph.entities[tail])
        assert found.score == pytest.approx(float(kernel.model.scorer.score(head, relation, tail)))
        assert found.as_tail.rank == ranks["rank"].iloc[row]
        assert found.as_head.rank == ranks["rank"].iloc[row + len(triples)]
        assert found.as_head.candidates == ranks["candidates"].iloc[row + len(triples)]
        assert (found.status == "learned") == found.reason.is_memory == (found.known == "train")
        assert {row.part for row in found.recipes} >= {found.known}
        statuses.add((found.status, found.known))
    assert statuses == {("learned", "train"), ("held out", "valid"), ("held out", "test")}


def test_a_learned_link_is_memory_and_has_no_probability(kernel: LinkPredictor):
    a, b, _ = kernel.graph.labels(kernel.split.recipes("train")[0])
    found = view_link_profile(kernel, a, "combinesWith", b)
    assert (found.status, found.probability) == ("learned", None)
    assert found.reason.learned_from[0] in [tuple(row)[:3] for row in kernel.graph.recipe_labels()]


def test_a_link_that_is_held_out_has_a_probability_and_its_recipes(kernel: LinkPredictor):
    head, relation, tail = kernel.split.held_out("test")[0].tolist()
    found = view_link_profile(kernel, kernel.graph.entities[head], RELATIONS[relation], kernel.graph.entities[tail])
    assert found.status == "held out"
    assert found.probability == pytest.approx(float(kernel.model.scorer.probability(head, relation, tail)))
    assert found.recipes
    assert {row.part for row in found.recipes} == {"test"}
    assert not found.reason.is_memory
    assert found.reason.witnesses


def test_a_link_that_is_not_in_the_book_says_so(kernel: LinkPredictor):
    found = view_link_profile(kernel, "bread", "componentOf", "bread")
    assert (found.status, found.known, found.recipes) == ("itself", "new", ())
    assert found.probability is not None
    other = view_link_profile(kernel, "bread", "componentOf", "water")
    assert (other.status, other.recipes) == ("not in the book", ())
    assert {row.entity for row in other.tails.best}.isdisjoint({"water"}) or other.as_tail.rank <= 10
    checked_values(other)


def test_candidates_of_both_open_slots_stand_beside(kernel: LinkPredictor):
    found = view_link_profile(kernel, "flour", "componentOf", "bread")
    assert (found.tails.head, found.tails.tail, len(found.tails.best)) == ("flour", None, 10)
    assert (found.heads.head, found.heads.tail, len(found.heads.best)) == (None, "bread", 10)


def test_a_model_of_the_full_graph_is_marked(all_seeing: LinkPredictor):
    head, relation, tail = all_seeing.split.held_out("test")[0].tolist()
    labels = all_seeing.graph.entities
    found = view_link_profile(all_seeing, labels[head], RELATIONS[relation], labels[tail])
    assert (found.has_seen_the_test_recipes, found.status, found.known) == (True, "learned", "test")
    assert found.reason.is_memory


def test_an_unknown_end_is_refused(kernel: LinkPredictor):
    with pytest.raises(UnknownEntityError, match="no entity 'braed'"):
        view_link_profile(kernel, "bread", "combinesWith", "braed")


def test_hostile_labels_stay_what_they_are(hostile: LinkPredictor):
    for label in hostile.graph.entities:
        found = view_link_profile(hostile, label, "combinesWith", hostile.graph.entities[0])
        assert found.head == label
        checked_values(found)
