"""A pair: what it makes, and what scorers of recipes and of links say of it."""

from collections.abc import Callable

import pytest

from wordcraft_kg.apps.explorer.views.pairs import PairProfile, view_pair
from wordcraft_kg.apps.explorer.views.predictor import LinkPredictor
from wordcraft_kg.base.errors import UnknownEntityError
from wordcraft_kg.base.records import checked_values
from wordcraft_kg.evaluation.recipe_scores import RecipeScoring
from wordcraft_kg.graphs.triples import COMBINES_WITH
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted
from wordcraft_kg.models.scorers.ranking import rank_triples


def pair_of(predictor: LinkPredictor, a: str, b: str) -> PairProfile:
    recipes = RecipeScoring.of(predictor.scoring) if predictor.scores_recipes else None
    return view_pair(predictor.split, a, b, predictor, recipes)


def test_a_pair_makes_what_the_book_says_with_the_part(neighbours: LinkPredictor):
    graph = neighbours.graph
    for a, b, _ in graph.recipe_labels()[::13]:
        for one, other in ((a, b), (b, a)):
            found = view_pair(neighbours.split, one, other)
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
    assert not any(row.memory for row in found.results if row.known != "train")
    assert [row.part for row in found.makes if row.result == result] == ["test"]
    checked_values(found)


def test_what_a_scorer_of_recipes_has_learned_is_memory(rankers: LinkPredictor):
    a, b, result = rankers.graph.labels(rankers.split.recipes("train")[0])
    found = pair_of(rankers, a, b)
    assert found.results is not None
    assert {row.result for row in found.results if row.memory} >= {result}
    assert found.link is not None
    assert (found.link.status, found.link.probability) == ("learned", None)


def test_a_scorer_of_links_says_only_whether_a_pair_combines(kernel: LinkPredictor):
    head, _, tail = kernel.split.held_out("test")[0].tolist()
    a, b = kernel.graph.labels([head, tail])
    found = pair_of(kernel, a, b)
    assert found.results is None
    assert found.link is not None
    assert found.link.score == pytest.approx(float(kernel.model.scorer.score(a, COMBINES_WITH, b)))
    assert found.link.status == "held out"
    assert found.link.probability is not None
    ranks = rank_triples(kernel.model.scorer, kernel.split.held_out("test")[:1], kernel.graph.triples)
    assert found.link.rank.rank == ranks["rank"].iloc[0]


def test_an_entity_may_be_paired_with_itself(kernel: LinkPredictor):
    found = pair_of(kernel, "bread", "bread")
    assert found.link is not None
    assert found.link.status in ("itself", "held out", "learned")


def test_an_unknown_ingredient_is_refused(kernel: LinkPredictor):
    with pytest.raises(UnknownEntityError, match="no entity 'braed'"):
        pair_of(kernel, "bread", "braed")


def test_hostile_labels_and_a_book_without_a_split(hostile: LinkPredictor, of_recipes: Callable[..., LinkPredictor]):
    for label in hostile.graph.entities:
        found = pair_of(hostile, label, hostile.graph.entities[0])
        assert (found.a, found.b) == (label, hostile.graph.entities[0])
        checked_values(found)
    whole = pair_of(of_recipes([("a", "b", "c"), ("a", "b", "d")], kind="none"), "b", "a")
    assert [(row.result, row.part) for row in whole.makes] == [("c", "train"), ("d", "train")]
    assert whole.has_seen_the_test_recipes
