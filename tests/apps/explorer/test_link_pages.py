"""The pages of entities, links, pairs, ranks and two models: texts, in-sample marks and evidence."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.apps.explorer.shown import explored_by, explored_graph, look, page_of, view_of
from tests.apps.people.stored import at_once
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.pages import PAGES, predictions
from wordcraft_kg.apps.explorer.pages.compare import Compare
from wordcraft_kg.apps.explorer.pages.entity import Entity, Recipes
from wordcraft_kg.apps.explorer.pages.link import Link
from wordcraft_kg.apps.explorer.pages.pair import Pair
from wordcraft_kg.apps.explorer.pages.predictions import Predictions
from wordcraft_kg.apps.explorer.predictor import LinkPredictor
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.evaluation.links import view_links
from wordcraft_kg.evaluation.ranked_links import rank_links

MANY = [(f"part {i % 7}", f"other {i % 5}", f"thing {i}") for i in range(35)]


def test_the_headline_of_predictions_is_that_of_the_report(explored: Explored):
    for name, one in explored.models.items():
        report = view_links(rank_links(one.model.scorer, one.model.opened))
        view = view_of(explored, Predictions(model=name, part="test"))
        assert view.metrics.mrr == pytest.approx(report.metrics["all"].mrr)
        assert f"{view.metrics.mrr:.3f}" in look(explored, Predictions(model=name)).text


def test_ranks_of_what_was_learned_are_marked_as_memory(explored: Explored):
    assert "ranks are in-sample" not in look(explored, Predictions()).text
    some = look(explored, Predictions(known="all"))
    assert "of these queries are for training triples: these ranks are in-sample" in some.text
    assert "All of these queries" in look(explored, Predictions(known="learned")).text


def test_a_model_of_the_full_graph_says_that_it_has_seen_everything(of_recipes: Callable[..., LinkPredictor]):
    explored = explored_by(of_recipes(MANY, kg="full", kind="by-recipe-plain"))
    page = look(explored, Predictions())
    assert "no triple in the book is unseen" in page.text
    assert PAGES["predictions"].address(Predictions(known="learned")) in page.links
    assert "was trained on all recipes" in look(explored, Entity("part 1")).text
    a, b, result = explored.opened.graph.labels(explored.opened.split.recipes("test")[0])
    assert "was trained on this link: the score is in-sample" in look(explored, Link(a, "combinesWith", b)).text
    pair = look(explored, Pair(a, b))
    assert "recipes in the book are in-sample" in pair.text
    assert result in pair.text


def test_a_book_without_a_split_has_pages_too(of_recipes: Callable[..., LinkPredictor]):
    explored = explored_by(of_recipes([("a", "b", "c"), ("b", "c", "d"), ("a", "d", "e")], kg="full", kind="none"))
    assert "This model was trained on all recipes" in look(explored, Predictions()).text
    for state in (Entity("a"), Link(), Pair(), Recipes("a")):
        assert look(explored, state).text
    assert "are in the training data" in look(explored, Entity("a")).text


def test_a_model_with_folds_shows_probabilities_and_one_without_does_not(
    explored: Explored, of_recipes: Callable[..., LinkPredictor]
):
    assert "%" in look(explored, Entity("bread")).text
    assert view_of(explored, Entity("bread")).has_probabilities
    plain = explored_by(of_recipes(MANY, kind="by-recipe-plain"))
    assert not view_of(plain, Entity("part 1")).has_probabilities
    test = plain.opened.split.held_out("test")[0]
    head, tail = plain.opened.graph.labels(test[[0, 2]])
    assert view_of(plain, Link(head, "combinesWith", tail)).probability is None


def test_a_scorer_of_links_says_that_it_cannot_say_what_a_pair_makes(explored: Explored):
    links = look(explored, Pair("flour", "water", "kitchen-complex"))
    assert "kitchen-complex scores only links" in links.text
    recipes = look(explored, Pair("flour", "water", "kitchen-recipes"))
    assert "scores only links" not in recipes.text
    assert "Results, if the pair combines" in recipes.text


def test_without_a_model_entities_and_pairs_are_still_shown(kitchen_folder: Path):
    explored = Explored.open(kitchen_folder)
    assert "Nearest by word vectors" in look(explored, Entity("bread")).text
    assert "In the book" in look(explored, Pair("flour", "water")).text
    for state in (Predictions(), Link(), Compare()):
        with pytest.raises(ConfigError, match="--model FOLDER"):
            view_of(explored, state)
        assert not page_of(state).is_there(explored)


def test_a_model_compared_with_itself_does_not_differ(explored: Explored):
    view = view_of(explored, Compare(one="kitchen-recipes", other="kitchen-recipes"))
    assert view.headline is not None
    assert view.headline.models[1].difference == 0
    assert (view.ranks.better_one, view.ranks.better_other) == (0, 0)
    assert view_of(explored, Compare(other="kitchen-complex")).ranks.one == "kitchen-recipes"


def test_too_few_unseen_triples_leave_no_headline(of_recipes: Callable[..., LinkPredictor]):
    rows = [(f"part {i % 3}", f"other {i % 4}", f"thing {i}") for i in range(9)]
    predictor = of_recipes(rows, kind="by-recipe-plain")
    explored = Explored(predictor.model.opened, {"model": predictor, "again": predictor})
    view = view_of(explored, Compare())
    assert view.headline is None
    assert "No headline: only" in look(explored, Compare()).text


def test_many_recipes_of_an_entity_are_on_pages_of_their_own():
    explored = explored_graph([("hub", f"part {i:04}", f"thing {i:04}") for i in range(600)])
    page = look(explored, Entity("hub"))
    assert "12 of 600 shown" in page.text
    assert len(page.page.encode()) < 100 * 1024
    assert PAGES["recipes"].address(Recipes("hub")) in page.links
    assert "501 to 600 of 600 recipes" in look(explored, Recipes("hub", page=6)).text
    assert set(PAGES["recipes"].states(explored)) == {Recipes("hub", page=page) for page in range(1, 7)}


def test_ranks_are_made_once_however_many_ask(
    kitchen_folder: Path, links_folder: Path, monkeypatch: pytest.MonkeyPatch
):
    explored = Explored.open(kitchen_folder, [links_folder])
    made = []
    rank_graph = predictions.rank_graph
    monkeypatch.setattr(predictions, "rank_graph", lambda predictor: made.append(1) or rank_graph(predictor))
    views = []
    at_once(lambda: views.append(view_of(explored, Predictions())), 6)
    assert (len(made), len(views)) == (1, 6)
    assert all(view == views[0] for view in views)


def test_a_graph_without_recipes_has_no_pair_in_the_menu():
    explored = explored_graph([])
    assert not PAGES["pair"].is_there(explored)
    for state in (Entity(), Pair()):
        with pytest.raises(ConfigError, match="The graph has no"):
            view_of(explored, state)


def test_what_speaks_for_a_prediction_is_named_beside_it(explored: Explored):
    state = Entity("bread", model="kitchen-recipes")
    text, named = look(explored, state).text, 0
    for slot, row in [(one, row) for one in view_of(explored, state).slots for row in one.best]:
        assert row.reason is not None
        for witness in row.reason.witnesses:
            head, tail = slot.head or row.entity, slot.tail or row.entity
            like = (head, witness.head) if witness.tail == tail else (tail, witness.tail)
            recipe = witness.recipes[0]
            shown = f"{like[0]} is like {like[1]}: {recipe.ingredient_a} + {recipe.ingredient_b} → {recipe.result}"
            assert shown in text
            named += 1
    assert named > 10


def test_a_link_shows_how_far_each_train_recipe_speaks_for_it(explored: Explored):
    split = explored.opened.split
    head, _, tail = split.held_out("test")[0].tolist()
    a, b = split.graph.labels(np.array([head, tail]))
    state = Link(a, "combinesWith", b, "kitchen-recipes")
    view, text = view_of(explored, state), look(explored, state).text
    assert view.reason.witnesses
    for witness in view.reason.witnesses:
        assert f"{witness.head} combinesWith {witness.tail}" in text
        assert f"{witness.weight:.3f} {100 * witness.share:.0f} %" in text
