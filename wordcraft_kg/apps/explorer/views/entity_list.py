"""The entities of a graph as a list, and the search for one by its label."""

import unicodedata
from collections.abc import Sequence
from functools import lru_cache
from typing import Literal

import numpy as np

from wordcraft_kg.apps.explorer.views.paging import Paging, paging
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.recipe_graph import RecipeGraph

EntityOrder = Literal["label", "layer", "recipes", "uses"]
ENTITIES_A_PAGE = 200


class ListedEntity(Record):
    """An entity; its layer is None if it cannot be made from the base."""

    entity: str
    layer: Count | None
    recipes: Count
    uses: Count


class EntityList(Record):
    """Some entities.

    Attributes:
        wanted: text in their labels.
        order: by what they are sorted: alphabetically, by layer from the base, or from the most recipes or uses.
        paging: which of them are shown.
    """

    wanted: str
    order: EntityOrder
    paging: Paging
    entities: tuple[ListedEntity, ...]


def list_entities(graph: RecipeGraph, wanted: str = "", order: EntityOrder = "label", page: int = 1) -> EntityList:
    """List the entities whose labels contain a text, whatever its case and accents; without a text all of them."""
    ids, layer = _matching(graph, wanted), _layers(graph)
    keys: dict[str, Ids] = {
        "label": ids,
        "layer": np.where(layer < 0, graph.num_entities, layer)[ids],
        "recipes": -graph.recipe_counts[ids],
        "uses": -graph.use_counts[ids],
    }
    found = paging(len(ids), page, ENTITIES_A_PAGE)
    chosen = ids[np.argsort(keys[order], kind="stable")][found.rows]
    columns = (values[chosen].tolist() for values in (layer, graph.recipe_counts, graph.use_counts))
    rows = zip(graph.labels(chosen.tolist()), *columns, strict=True)
    entities = tuple(ListedEntity(label, at if at >= 0 else None, made, used) for label, at, made, used in rows)
    return EntityList(wanted, order, found, entities)


def search_entities(graph: RecipeGraph, wanted: str, limit: int = 10) -> tuple[str, ...]:
    """Return the labels that a text may mean: the label itself, then those that begin with it, then words, then parts.

    Among equals, the most used come first.

    Example:
        >>> search_entities(RecipeGraph.from_book(open_book("kitchen")), "BRE", limit=2)
        ('bread', 'bread crumbs')
    """
    text = folded(wanted)
    if not text:
        return ()
    names, used = _folded(graph), graph.use_counts
    ids = _matching(graph, wanted).tolist()
    return graph.labels(sorted(ids, key=lambda i: (_rank(names[i], text), -used[i], i))[:limit])


def _rank(name: str, text: str) -> int:
    if name == text:
        return 0
    if name.startswith(text):
        return 1
    return 2 if f" {text}" in name else 3


def folded(text: str) -> str:
    """Return a text without case, accents and outer spaces, as searches compare it."""
    apart = unicodedata.normalize("NFKD", text.strip().casefold())
    return "".join(letter for letter in apart if not unicodedata.combining(letter))


def _matching(graph: RecipeGraph, wanted: str) -> Ids:
    text = folded(wanted)
    return np.array([i for i, name in enumerate(_folded(graph)) if text in name], dtype=np.int64)


@lru_cache(maxsize=4)
def _folded(graph: RecipeGraph) -> Sequence[str]:
    return [folded(label) for label in graph.entities]


def layer_of(graph: RecipeGraph, entity: int) -> int | None:
    """Return the round in which an entity can first be made; None if it cannot."""
    layer = int(_layers(graph)[entity])
    return layer if layer >= 0 else None


@lru_cache(maxsize=4)
def _layers(graph: RecipeGraph) -> Ids:
    return layers(graph)
