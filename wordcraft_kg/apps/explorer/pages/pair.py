"""The page for an ingredient pair."""

from operator import attrgetter

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.apps.explorer.predictor import (
    PlacedRecipe,
    RankedLink,
    placed_recipes,
    recipes_giving,
)
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Record
from wordcraft_kg.evaluation.queries import RecipeQuery
from wordcraft_kg.evaluation.recipe_scores import RecipeScoring, ScoredRecipe, view_open_recipe
from wordcraft_kg.graphs.triples import COMBINES_WITH

RESULTS = 10
EXAMPLES = 4


class PairState(PageState):
    """Page settings: two ingredients and a model, by default the first; without ingredients, a pair from the book."""

    a: str = ""
    b: str = ""
    model: str = ""


class PairProfile(Record):
    """A pair with recipes, a model's score for the link, and (from recipe scorers) results, best first; other pairs."""

    a: str
    b: str
    makes: tuple[PlacedRecipe, ...]
    model: str
    has_seen_the_test_recipes: bool
    link: RankedLink | None
    results: tuple[ScoredRecipe, ...] | None
    examples: tuple[tuple[str, ...], ...]


def _view(explored: Explored, state: PairState) -> PairProfile:
    split, graph, (a, b) = explored.opened.split, explored.opened.graph, (state.a, state.b)
    recipes = split.recipes("test") if split.is_in("test").any() else graph.recipes
    every = max(-(-len(recipes) // EXAMPLES), 1)
    first, *examples = [graph.labels(pair) for pair in recipes[::every, :2].tolist()] or [()]
    if not a and not b:
        if not first:
            raise ConfigError("The graph has no recipe, so there is no example pair.")
        a, b = first
    elif not a or not b:
        raise ConfigError(
            "A pair has two ingredients, which may be equal; one ingredient is missing."
        )
    one, other = graph.id_of(a), graph.id_of(b)
    makes = placed_recipes(split, recipes_giving(graph, one, COMBINES_WITH, other))
    if not explored.models:
        return PairProfile(a, b, makes, "", False, None, None, tuple(examples))
    predictor, results = explored.predictor(state.model), None
    if predictor.scores_recipes:
        scoring = explored.once(
            ("recipe scores", predictor.name), lambda: RecipeScoring.of(predictor.scoring)
        )
        results = view_open_recipe(scoring, RecipeQuery(a, b, None), RESULTS).top
    link = predictor.ranked(predictor.slot(one, COMBINES_WITH, "tail"), other)
    return PairProfile(
        a,
        b,
        makes,
        predictor.name,
        predictor.has_seen_the_test_recipes,
        link,
        results,
        tuple(examples),
    )


PAGE = Page(
    "pair",
    PairState,
    _view,
    title="Pairs",
    exported=lambda _: (),
    is_there=attrgetter("opened.graph.num_recipes"),
)
