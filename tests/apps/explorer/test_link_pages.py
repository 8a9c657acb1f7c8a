"""The pages of links, pairs, ranks and two models: scores, in-sample marks, evidence, and texts."""

from itertools import product

import pytest

from tests.apps.explorer.shown import explored_by, explored_graph, look, page_of, view_by, view_of
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.apps.explorer.pages.entities import EntityState, RecipesState
from wordcraft_kg.apps.explorer.pages.link import LinkState, PairState
from wordcraft_kg.apps.explorer.predictor import NEW, recipes_giving
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, RELATIONS
from wordcraft_kg.models.scorers.ranking import rank_triples


def held_out(predictor):
    """Return the first held-out triple as ids and as a page."""
    head, relation, tail = predictor.split.held_out("test")[0].tolist()
    labels = predictor.graph.entities
    return [head, relation, tail], LinkState(labels[head], RELATIONS[relation], labels[tail])


def test_a_link_has_the_score_ranks_and_probability_that_reports_give_it(kernel):
    graph, scorer = kernel.graph, kernel.model.scorer
    triples = graph.triples[::37]
    ranks = rank_triples(scorer, triples, graph.triples)
    statuses = set()
    for row, (head, relation, tail) in enumerate(triples.tolist()):
        view = view_by(
            kernel, LinkState(graph.entities[head], RELATIONS[relation], graph.entities[tail])
        )
        link = view.link
        assert link.score == pytest.approx(float(scorer.score(head, relation, tail)))
        assert link.rank == ranks["rank"].iloc[row]
        assert view.head_rank == ranks["rank"].iloc[row + len(triples)]
        is_learned = link.known == "train"
        assert (link.status == "learned") == bool(link.reason.learned_from) == is_learned
        chance = (
            None if is_learned else pytest.approx(float(scorer.probability(head, relation, tail)))
        )
        assert link.probability == chance
        assert {row.part for row in view.recipes} >= {link.known}
        statuses.add((link.status, link.known))
    assert statuses == {("learned", "train"), ("held out", "valid"), ("held out", "test")}


def test_a_link_that_is_not_in_the_book_says_so(kernel):
    itself = view_by(kernel, LinkState("bread", "componentOf", "bread"))
    assert (itself.link.status, itself.link.known, itself.recipes) == ("itself", "new", ())
    assert itself.link.probability is not None
    other = view_by(kernel, LinkState("bread", "componentOf", "water"))
    assert (other.link.status, other.recipes) == ("not in the book", ())
    assert {row.entity for row in other.tails.best}.isdisjoint({"water"}) or other.link.rank <= 10
    for slot, ends in ((other.tails, ("bread", None)), (other.heads, (None, "water"))):
        assert (slot.head, slot.tail, len(slot.best)) == (*ends, 10)


def test_a_pair_makes_what_the_book_says_with_the_part(neighbours):
    graph, explored = neighbours.graph, explored_graph(neighbours.graph, split=neighbours.split)
    for a, b, _ in graph.recipe_labels()[::13]:
        for one, other in ((a, b), (b, a)):
            view = view_of(explored, PairState(one, other))
            assert tuple(row.recipe.result for row in view.makes) == graph.labels(
                graph.results(a, b)
            )
            assert (view.link, view.results, view.model) == (None, None, "")


def test_a_scorer_of_recipes_says_what_it_expects_how_sure_it_is_and_why(rankers):
    a, b, result = rankers.graph.labels(rankers.split.recipes("test")[0])
    view, scorer = view_by(rankers, PairState(a, b)), rankers.model.scorer
    shares = zip(scorer.entities, scorer.result_probabilities(a, b).tolist(), strict=True)
    best = sorted((share for label, share in shares if label not in (a, b)), reverse=True)[:10]
    assert [row.probability for row in view.results] == pytest.approx(best)
    assert any(row.because for row in view.results)
    assert not any(row.in_sample for row in view.results if row.known != "train")
    assert [row.part for row in view.makes if row.recipe.result == result] == ["test"]


def test_a_scorer_of_links_says_only_whether_a_pair_combines(kernel, explored):
    _, link = held_out(kernel)
    view = view_by(kernel, PairState(link.head, link.tail))
    assert (view.results, view.link.status, view.link.probability is None) == (
        None,
        "held out",
        False,
    )
    assert view.link.score == pytest.approx(
        float(kernel.model.scorer.score(link.head, COMBINES_WITH, link.tail))
    )
    assert view.link.rank == view_by(kernel, link).link.rank
    texts = [
        look(explored, PairState("flour", "water", f"kitchen-{name}")).text
        for name in ("complex", "recipes")
    ]
    assert [text.count("scores only links") for text in texts] == [1, 0]
    assert "Results, if the pair combines" in texts[1]


def test_suggestions_for_the_book_are_made_once(explored):
    page = PAGES["suggestions"]
    first, again = (page.view(explored, page.state(model="kitchen-recipes")) for _ in range(2))
    assert first.answer.suggestions
    assert first.answer is again.answer


def test_a_book_without_a_split_has_pages_too(of_recipes):
    predictor = of_recipes(
        [("a", "b", "c"), ("b", "a", "d"), ("b", "c", "d"), ("a", "d", "e")], kind="none"
    )
    explored = explored_by(predictor)
    assert all(
        look(explored, state).text for state in (LinkState(), PairState(), RecipesState("a"))
    )
    assert "are in the training data" in look(explored, EntityState("a")).text
    pair = view_by(predictor, PairState("b", "a"))
    assert [(row.recipe.result, row.part) for row in pair.makes] == [("c", "train"), ("d", "train")]
    assert pair.has_seen_the_test_recipes


def test_without_a_model_entities_and_pairs_are_still_shown(kitchen_folder):
    explored = Explored.open(kitchen_folder)
    view = view_of(explored, EntityState("bread"))
    assert (view.model, view.slots, view.nearest) == ("", (), ())
    assert view.made_by.paging.total
    assert view.by_words
    assert "Nearest by word vectors" in look(explored, EntityState("bread")).text
    assert "In the book" in look(explored, PairState("flour", "water")).text
    with pytest.raises(ConfigError, match="--model FOLDER"):
        view_of(explored, LinkState())
    assert not page_of(LinkState()).is_there(explored)


def test_a_graph_without_recipes_has_no_pair_in_the_menu():
    explored = explored_graph([])
    assert not PAGES["pair"].is_there(explored)
    for state in (EntityState(), PairState()):
        with pytest.raises(ConfigError, match="The graph has no"):
            view_of(explored, state)


SLOTS = list(product(range(0, 80, 9), range(len(RELATIONS)), ("head", "tail")))


def test_the_best_leave_out_what_was_learned(neighbours):
    flour = neighbours.graph.id_of("flour")
    slot = neighbours.slot(flour, COMBINES_WITH, "tail")
    labels = neighbours.graph.entities
    by_score = sorted(range(len(labels)), key=lambda i: (-slot.scores[i], i))
    answers = neighbours.best(slot, top=12)
    expected = [labels[i] for i in by_score if not slot.learned[i]][:12]
    assert [row.entity for row in answers.best] == expected
    assert "learned" not in {row.status for row in answers.best}
    assert (answers.head, answers.relation, answers.tail) == ("flour", "combinesWith", None)


def test_beside_the_best_stands_what_is_true_and_was_not_learned(neighbours):
    compared = 0
    for entity, relation, side in SLOTS:
        slot = neighbours.slot(entity, relation, side)
        found = neighbours.best(slot, truth=1_000)
        true = [
            i
            for i in range(neighbours.graph.num_entities)
            if slot.part[i] != NEW and not slot.learned[i]
        ]
        assert {row.entity for row in found.truth} == {neighbours.graph.entities[i] for i in true}
        assert found.true_unlearned == len(true)
        assert found.true_learned == int(slot.learned.sum())
        assert [row.rank for row in found.truth] == sorted(row.rank for row in found.truth)
        assert {(row.status, row.known) for row in found.truth} <= {
            ("held out", "valid"),
            ("held out", "test"),
        }
        assert neighbours.best(slot, truth=2).truth == found.truth[:2]
        compared += len(true)
    assert compared > 20


def test_each_prediction_names_links_of_training_that_speak_for_it(neighbours):
    known, named = {(a, b) for a, b, _ in neighbours.split.recipes("train").tolist()}, 0
    slot = neighbours.slot(3, COMBINES_WITH, "tail")
    for row in neighbours.best(slot, witnesses=3).best:
        assert not row.reason.learned_from
        for witness in row.reason.witnesses:
            pair = sorted(neighbours.graph.id_of(label) for label in (witness.head, witness.tail))
            assert tuple(pair) in known
            assert witness.recipes
            named += 1
    assert named > 10
    assert neighbours.best(slot, witnesses=0).best[0].reason is None


def test_the_recipes_of_a_link_are_those_that_give_its_triple(neighbours):
    graph = neighbours.graph
    for head, relation, tail in graph.triples[::11].tolist():
        expected = [
            row
            for row, (a, b, c) in enumerate(graph.recipes.tolist())
            if (relation == COMBINES_WITH and (head, tail) in {(a, b), (b, a)})
            or (relation == COMPONENT_OF and head in (a, b) and tail == c)
        ]
        assert recipes_giving(graph, head, relation, tail).tolist() == expected
