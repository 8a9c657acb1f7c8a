"""All entities, page by page: searched by their labels, and sorted."""

from collections.abc import Iterator

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, State
from wordcraft_kg.apps.explorer.views.entity_list import ENTITIES_A_PAGE, EntityList, EntityOrder, list_entities


class Entities(State):
    """Some of the entities.

    Attributes:
        q: text in their labels.
        sort: by what they are sorted.
        page: number of the page.
    """

    q: str = ""
    sort: EntityOrder = "label"
    page: int = 1


def _view(explored: Explored, state: Entities) -> EntityList:
    return list_entities(explored.opened.graph, state.q, state.sort, state.page)


def _exported(explored: Explored) -> Iterator[Entities]:
    pages = -(-explored.opened.graph.num_entities // ENTITIES_A_PAGE)
    for order in ("label", "layer", "recipes", "uses"):
        yield from (Entities(sort=order, page=page) for page in range(1, pages + 1))


PAGE = Page("entities", Entities, _view, title="Entities", exported=_exported)
