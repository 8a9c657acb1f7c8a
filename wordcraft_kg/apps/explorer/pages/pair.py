"""The page for an ingredient pair: its results in the book and by a model."""

import math
from operator import attrgetter

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.apps.explorer.predictor import (
    LinkPredictor,
    PlacedRecipe,
    RankedLink,
    placed_recipes,
    recipes_giving,
)
from wordcraft_kg.base import ConfigError, Record
from wordcraft_kg.evaluation.scores import RecipeQuery, RecipeScoring, ScoredAnswer
from wordcraft_kg.graphs.triples import COMBINES_WITH

RESULTS = 10
"""Listed results by a recipe scorer."""
EXAMPLES = 4
"""Example pairs: the first is shown by default, the page links to the others."""


class PairState(PageState):
    """Page settings: two ingredients and a model.

    Attributes:
        a: label of an ingredient; without both ingredients, the page shows a pair from the book.
        b: label of the other ingredient, which may be the same.
        model: name of the model; empty for the first.
    """

    a: str = ""
    b: str = ""
    model: str = ""


class PairProfile(Record):
    """A pair with its recipes and a model's predictions.

    Attributes:
        a: label of an ingredient.
        b: label of the other ingredient.
        makes: recipes in the book with both ingredients, perhaps among others.
        model: name of the model; empty without one.
        has_seen_the_test_recipes: whether the model was trained on all recipes; False without a
            model.
        link: prediction for ``a combinesWith b``; None without a model.
        results: most plausible results, best first; None without a model, and for models that only
            score links.
        examples: other pairs, by labels.
    """

    a: str
    b: str
    makes: tuple[PlacedRecipe, ...]
    model: str
    has_seen_the_test_recipes: bool
    link: RankedLink | None
    results: tuple[ScoredAnswer, ...] | None
    examples: tuple[tuple[str, ...], ...]


def _view(explored: Explored, state: PairState) -> PairProfile:
    graph = explored.opened.graph
    (a, b), examples = _pair(explored, state)
    a_id = graph.id_of(a)
    b_id = graph.id_of(b)
    recipes = recipes_giving(graph, a_id, COMBINES_WITH, b_id)
    predictor = explored.predictor(state.model) if explored.models else None
    link = None
    results = None
    if predictor is not None:
        link = predictor.ranked(predictor.slot(a_id, COMBINES_WITH, "tail"), b_id)
        if predictor.scores_recipes:
            results = _results(explored, predictor, RecipeQuery((a, b, None)))
    return PairProfile(
        a=a,
        b=b,
        makes=placed_recipes(explored.opened.split, recipes),
        model="" if predictor is None else predictor.name,
        has_seen_the_test_recipes=predictor is not None and predictor.has_seen_the_test_recipes,
        link=link,
        results=results,
        examples=examples,
    )


def _results(
    explored: Explored, predictor: LinkPredictor, query: RecipeQuery
) -> tuple[ScoredAnswer, ...]:
    # The truth of all recipes is indexed once for each model.
    key = ("recipe scores", predictor.name)
    scoring = explored.once(key, lambda: RecipeScoring(predictor.scoring))
    return tuple(scoring.answers([query], RESULTS, is_explained=True))


def _pair(
    explored: Explored, state: PairState
) -> tuple[tuple[str, str], tuple[tuple[str, ...], ...]]:
    """Return the pair of the settings, or an example, and more examples, by labels."""
    split = explored.opened.split
    graph = explored.opened.graph
    # A model has not seen the test recipes, so they make the better examples.
    recipes = split.sets("test") if split.is_in("test").any() else graph.sets
    # The first two ingredients; the padding of a recipe of one is no entity.
    recipes = recipes[recipes[:, 1] != graph.num_entities]
    # Evenly spread, because neighbouring recipes share an ingredient.
    every = max(math.ceil(len(recipes) / EXAMPLES), 1)
    pairs = [graph.labels(pair) for pair in recipes[::every, :2].tolist()]
    examples = tuple(pairs[1:])
    if state.a and state.b:
        return (state.a, state.b), examples
    if state.a or state.b:
        raise ConfigError(
            "A pair has two ingredients, which may be equal; one ingredient is missing."
        )
    if not pairs:
        raise ConfigError("The graph has no recipe, so there is no example pair.")
    a, b = pairs[0]
    return (a, b), examples


PAGE = Page(
    "pair",
    PairState,
    _view,
    title="Pairs",
    exported=lambda _: (),
    is_there=attrgetter("opened.graph.num_recipes"),
)
