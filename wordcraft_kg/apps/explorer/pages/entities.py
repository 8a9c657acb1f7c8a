"""The entity list, and the search for entities by their labels."""

import unicodedata
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Literal

import numpy as np

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState, Paging, num_pages, paging
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.graphs import Ids, RecipeGraph, layers

EntityOrder = Literal["label", "layer", "recipes", "uses"]
"""Ascending label or layer (entities that cannot be made come last), or descending number of
recipes or uses."""
ENTITIES_A_PAGE = 200


class EntitiesState(PageState):
    """Page settings: a filter and an order.

    Attributes:
        q: text in the labels; empty for all entities.
        sort: order, see :data:`EntityOrder`.
        page: page number in the list.
    """

    q: str = ""
    sort: EntityOrder = "label"
    page: int = 1


class ListedEntity(Record):
    """An entity in the list.

    Attributes:
        entity: label.
        layer: crafting layer, 0 for the base; None if the entity cannot be made from the base.
        recipes: number of recipes that make the entity.
        uses: number of recipes that use the entity.
    """

    entity: str
    layer: Count | None
    recipes: Count
    uses: Count


class EntityList(Record):
    """A page of the entities whose labels contain a text.

    Attributes:
        wanted: the text; empty for all entities.
        order: order of the entities.
        paging: which of them are on this page.
        entities: the entities on this page.
    """

    wanted: str
    order: EntityOrder
    paging: Paging
    entities: tuple[ListedEntity, ...]


def list_entities(
    graph: RecipeGraph, wanted: str = "", order: EntityOrder = "label", page: int = 1
) -> EntityList:
    """List entities page by page.

    Args:
        graph: graph with the entities.
        wanted: text in the labels, whatever its case and accents; empty for all entities.
        order: order of the entities; ties are in the order of labels.
        page: page number, from 1.

    Returns:
        the entities on the page.

    Raises:
        ConfigError: if the list has no such page.
    """
    ids = _matching(graph, wanted)
    layer = layers_of(graph)
    keys: dict[str, Ids] = {
        "label": ids,
        # Layer -1 means that an entity cannot be made: the last place, not the first.
        "layer": np.where(layer < 0, graph.num_entities, layer)[ids],
        "recipes": -graph.recipe_counts[ids],
        "uses": -graph.use_counts[ids],
    }
    shown = paging(len(ids), page, ENTITIES_A_PAGE)
    # Ids are in the order of labels, so a stable sort breaks ties by label.
    listed_ids = ids[np.argsort(keys[order], kind="stable")][shown.rows]
    rows = zip(
        graph.labels(listed_ids.tolist()),
        layer[listed_ids].tolist(),
        graph.recipe_counts[listed_ids].tolist(),
        graph.use_counts[listed_ids].tolist(),
        strict=True,
    )
    entities = tuple(
        ListedEntity(
            entity=label,
            layer=at if at >= 0 else None,
            recipes=num_recipes,
            uses=num_uses,
        )
        for label, at, num_recipes, num_uses in rows
    )
    return EntityList(wanted=wanted, order=order, paging=shown, entities=entities)


def search_entities(graph: RecipeGraph, wanted: str, limit: int = 10) -> tuple[str, ...]:
    """Return the labels that a text may mean.

    Args:
        graph: graph with the entities.
        wanted: text in the labels, whatever its case and accents; empty for no entity.
        limit: most labels to return.

    Returns:
        the label that equals the text, then labels that begin with it, that have it at the start of
        a word, and that have it elsewhere; among these by descending use count. In the kitchen,
        "BRE" gives bread and bread crumbs.
    """
    text = _folded(wanted)
    if not text:
        return ()
    names = _folded_labels(graph)
    use_counts = graph.use_counts

    def key(i: int) -> tuple[bool, bool, bool, int, int]:
        # False sorts before True: the better match first. The id at the end makes the order total.
        name = names[i]
        return (
            name != text,
            not name.startswith(text),
            f" {text}" not in name,
            -use_counts[i],
            i,
        )

    return graph.labels(sorted(_matching(graph, wanted).tolist(), key=key)[:limit])


def _folded(text: str) -> str:
    # NFKD separates accents from letters; the accents are then left out.
    letters = unicodedata.normalize("NFKD", text.strip().casefold())
    return "".join(letter for letter in letters if not unicodedata.combining(letter))


def _matching(graph: RecipeGraph, wanted: str) -> Ids:
    text = _folded(wanted)
    matches = [i for i, name in enumerate(_folded_labels(graph)) if text in name]
    # The type for an empty list, of which NumPy would make floats.
    return np.array(matches, dtype=np.int64)


# Four graphs, since tests and notebooks open several; a search asks for all labels at each key
# press.
@lru_cache(maxsize=4)
def _folded_labels(graph: RecipeGraph) -> Sequence[str]:
    return [_folded(label) for label in graph.entities]


@lru_cache(maxsize=4)
def layers_of(graph: RecipeGraph) -> Ids:
    """Return cached :func:`~wordcraft_kg.graphs.planner.layers`: each entity's, shape (E,)."""
    return layers(graph)


def _view(explored: Explored, state: EntitiesState) -> EntityList:
    return list_entities(explored.opened.graph, state.q, state.sort, state.page)


def _exported(explored: Explored) -> Iterator[EntitiesState]:
    pages = num_pages(explored.opened.graph.num_entities, ENTITIES_A_PAGE)
    for order in ("label", "layer", "recipes", "uses"):
        yield from (EntitiesState(sort=order, page=page) for page in range(1, pages + 1))


PAGE = Page("entities", EntitiesState, _view, title="Entities", exported=_exported)
