"""The entity list."""

import unicodedata
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Literal

import numpy as np

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState, Paging, paging
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.recipe_graph import RecipeGraph

EntityOrder = Literal["label", "layer", "recipes", "uses"]
ENTITIES_A_PAGE = 200


class EntitiesState(PageState):
    """Page settings: a text in labels (``q``), and an order: ascending label or layer, descending recipes or uses."""

    q: str = ""
    sort: EntityOrder = "label"
    page: int = 1


class ListedEntity(Record):
    """An entity with its crafting layer (None if it cannot be made from the base) and its numbers of recipes."""

    entity: str
    layer: Count | None
    recipes: Count
    uses: Count


class EntityList(Record):
    """A page of the entities whose labels contain a text."""

    wanted: str
    order: EntityOrder
    paging: Paging
    entities: tuple[ListedEntity, ...]


def list_entities(
    graph: RecipeGraph, wanted: str = "", order: EntityOrder = "label", page: int = 1
) -> EntityList:
    """List entities with a text in the label, ignoring case and accents; an empty text lists all."""
    ids, layer = _matching(graph, wanted), layers_of(graph)
    keys: dict[str, Ids] = {
        "label": ids,
        "layer": np.where(layer < 0, graph.num_entities, layer)[ids],
        "recipes": -graph.recipe_counts[ids],
        "uses": -graph.use_counts[ids],
    }
    shown = paging(len(ids), page, ENTITIES_A_PAGE)
    chosen = ids[np.argsort(keys[order], kind="stable")][shown.rows]
    columns = (values[chosen].tolist() for values in (layer, graph.recipe_counts, graph.use_counts))
    rows = zip(graph.labels(chosen.tolist()), *columns, strict=True)
    entities = tuple(
        ListedEntity(label, at if at >= 0 else None, made, used) for label, at, made, used in rows
    )
    return EntityList(wanted, order, shown, entities)


def search_entities(graph: RecipeGraph, wanted: str, limit: int = 10) -> tuple[str, ...]:
    """Return labels that match a text: equal, at the beginning, at a word start, elsewhere; ties by use count."""
    text = _folded(wanted)
    if not text:
        return ()
    names, used = _folded_labels(graph), graph.use_counts

    def key(i: int) -> tuple[bool, bool, bool, int, int]:
        name = names[i]
        return name != text, not name.startswith(text), f" {text}" not in name, -used[i], i

    return graph.labels(sorted(_matching(graph, wanted).tolist(), key=key)[:limit])


def _folded(text: str) -> str:
    apart = unicodedata.normalize("NFKD", text.strip().casefold())
    return "".join(letter for letter in apart if not unicodedata.combining(letter))


def _matching(graph: RecipeGraph, wanted: str) -> Ids:
    text = _folded(wanted)
    return np.array(
        [i for i, name in enumerate(_folded_labels(graph)) if text in name], dtype=np.int64
    )


@lru_cache(maxsize=4)
def _folded_labels(graph: RecipeGraph) -> Sequence[str]:
    return [_folded(label) for label in graph.entities]


@lru_cache(maxsize=4)
def layers_of(graph: RecipeGraph) -> Ids:
    """Return cached :func:`~wordcraft_kg.graphs.planner.layers`."""
    return layers(graph)


def _view(explored: Explored, state: EntitiesState) -> EntityList:
    return list_entities(explored.opened.graph, state.q, state.sort, state.page)


def _exported(explored: Explored) -> Iterator[EntitiesState]:
    pages = -(-explored.opened.graph.num_entities // ENTITIES_A_PAGE)
    for order in ("label", "layer", "recipes", "uses"):
        yield from (EntitiesState(sort=order, page=page) for page in range(1, pages + 1))


PAGE = Page("entities", EntitiesState, _view, title="Entities", exported=_exported)
