"""A pair of entities: what it makes, and what a model says that it makes."""

from wordcraft_kg.apps.explorer import asked
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, State, nowhere
from wordcraft_kg.apps.explorer.views.pairs import PairProfile, view_pair
from wordcraft_kg.base.errors import ConfigError


class Pair(State):
    """A pair.

    Attributes:
        a: label of an ingredient; without both an example is shown.
        b: label of the other one, which may be the same.
        model: the model to ask; the first if it is empty.
    """

    a: str = ""
    b: str = ""
    model: str = ""


def _view(explored: Explored, state: Pair) -> PairProfile:
    split, a, b = explored.opened.split, state.a, state.b
    if not a and not b:
        recipes = split.recipes("test") if split.is_in("test").any() else split.graph.recipes
        if not len(recipes):
            raise ConfigError("The graph has no recipe, and so no pair that makes something.")
        a, b = split.graph.labels(recipes[0, :2].tolist())
    elif not a or not b:
        raise ConfigError("A pair has two ingredients, which may be the same; one of them is missing.")
    if not explored.models:
        return view_pair(split, a, b)
    predictor = asked.predictor(explored, state.model)
    return view_pair(split, a, b, predictor, asked.recipe_scoring(explored, predictor.name))


def has_recipes(explored: Explored) -> bool:
    """Return whether any pair makes something."""
    return explored.opened.graph.num_recipes > 0


PAGE = Page("pair", Pair, _view, title="Pairs", exported=nowhere, is_there=has_recipes)
