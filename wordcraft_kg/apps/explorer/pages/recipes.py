"""All recipes of an entity, page by page."""

from collections.abc import Iterator
from typing import Literal

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, State
from wordcraft_kg.apps.explorer.pages.entity import EXPORTED
from wordcraft_kg.apps.explorer.views.entities import LISTED, RECIPES_A_PAGE, EntityRecipes, Use, view_entity_recipes
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.splits import Part


class Recipes(State):
    """Recipes of an entity.

    Attributes:
        entity: its label.
        use: whether they make it or use it.
        part: their part; all if it is empty.
        page: number of the page.
    """

    entity: str = ""
    use: Use = "uses"
    part: Part | Literal[""] = ""
    page: int = 1


def _view(explored: Explored, state: Recipes) -> EntityRecipes:
    if not state.entity:
        raise ConfigError("The address names no entity; expected one such as /recipes/water.")
    return view_entity_recipes(explored.opened.split, state.entity, state.use, state.page, part=state.part)


def _exported(explored: Explored) -> Iterator[Recipes]:
    graph = explored.opened.graph
    for label, made, used in zip(
        graph.entities[:EXPORTED], graph.recipe_counts.tolist(), graph.use_counts.tolist(), strict=False
    ):
        for use, count in (("makes", made), ("uses", used)):
            if count > LISTED:
                pages = range(1, -(-count // RECIPES_A_PAGE) + 1)
                yield from (Recipes(label, use, page=page) for page in pages)  # type: ignore[arg-type]


PAGE = Page("recipes", Recipes, _view, subject="entity", exported=_exported)
