"""Pages of entities: the list, an entity and its recipes; and the search by labels."""

import unicodedata
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState, Paging, num_pages, paging
from wordcraft_kg.apps.explorer.predictor import PlacedRecipe, PredictedSlot, placed_recipes
from wordcraft_kg.base import ConfigError, Count, Record
from wordcraft_kg.evaluation.suggestions import is_set_model
from wordcraft_kg.graphs import (
    COMBINES_WITH,
    COMPONENT_OF,
    PARTS,
    Ids,
    Part,
    RecipeGraph,
    Split,
    layers,
)
from wordcraft_kg.models.scorers.features import EntityFeatures, glove_features
from wordcraft_kg.models.scorers.link_evidence import Side

ENTITIES_A_PAGE = 200
NEAREST = 8
"""Similar entities on an entity's page."""
PREDICTED = 10
"""Predictions for each query on an entity's page."""
LISTED = 12
"""Recipes of either kind on an entity's page."""
RECIPES_A_PAGE = 100
EXPORTED = 5_000
"""Entities with pages in a static site."""
OPEN_SLOTS: tuple[tuple[int, Side], ...] = (
    (COMBINES_WITH, "tail"),
    (COMPONENT_OF, "head"),
    (COMPONENT_OF, "tail"),
)
"""Queries to a model: partners of the entity, ingredients, products."""
Use = Literal["makes", "uses"]
"""Whether recipes make an entity or use it."""


class EntitiesState(PageState):
    """Page settings: a search.

    Attributes:
        q: text in the labels, whatever its case and accents; empty for all entities.
        page: page number in the list.
    """

    q: str = ""
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
        paging: which of them are on this page.
        entities: the entities on this page.
    """

    paging: Paging
    entities: tuple[ListedEntity, ...]


def _view_list(explored: Explored, state: EntitiesState) -> EntityList:
    graph = explored.opened.graph
    ids = _matching(graph, state.q)
    shown = paging(len(ids), state.page, ENTITIES_A_PAGE)
    listed_ids = np.array(ids[shown.rows], dtype=np.int64)
    rows = zip(
        graph.labels(listed_ids.tolist()),
        layers_of(graph)[listed_ids].tolist(),
        graph.recipe_counts[listed_ids].tolist(),
        graph.use_counts[listed_ids].tolist(),
        strict=True,
    )
    return EntityList(
        paging=shown,
        entities=tuple(
            ListedEntity(label, at if at >= 0 else None, num_recipes, num_uses)
            for label, at, num_recipes, num_uses in rows
        ),
    )


def _folded(text: str) -> str:
    # NFKD separates accents from letters; the accents are then left out.
    letters = unicodedata.normalize("NFKD", text.strip().casefold())
    return "".join(letter for letter in letters if not unicodedata.combining(letter))


def _matching(graph: RecipeGraph, wanted: str) -> Sequence[int]:
    """Return the ids of the labels that a text may mean; all of them for an empty text.

    The label that equals the text comes first, then labels that begin with it, that have it at the
    start of a word, and that have it elsewhere; among these by descending use count. In the
    kitchen, "BRE" gives bread and bread crumbs.
    """
    text = _folded(wanted)
    if not text:
        return range(graph.num_entities)
    names = _folded_labels(graph)

    def key(i: int) -> tuple[bool, bool, bool, int]:
        # False sorts before True: the better match first.
        name = names[i]
        return name != text, not name.startswith(text), f" {text}" not in name, -graph.use_counts[i]

    return sorted((i for i, name in enumerate(names) if text in name), key=key)


# Four graphs, since tests and notebooks open several; a search asks for all labels at each key
# press.
@lru_cache(maxsize=4)
def _folded_labels(graph: RecipeGraph) -> Sequence[str]:
    return [_folded(label) for label in graph.entities]


@lru_cache(maxsize=4)
def layers_of(graph: RecipeGraph) -> Ids:
    """Return cached :func:`~wordcraft_kg.graphs.planner.layers`: each entity's, shape (E,)."""
    return layers(graph)


def _exported_lists(explored: Explored) -> Iterator[EntitiesState]:
    pages = num_pages(explored.opened.graph.num_entities, ENTITIES_A_PAGE)
    return (EntitiesState(page=page) for page in range(1, pages + 1))


PAGE = Page("entities", EntitiesState, _view_list, title="Entities", exported=_exported_lists)


class EntityState(PageState):
    """Page settings: an entity and a model.

    Attributes:
        entity: label; empty for the most used entity.
        model: name of the model; empty for the first.
    """

    entity: str = ""
    model: str = ""


class RecipesState(PageState):
    """Page settings: recipes of an entity.

    Attributes:
        entity: label; the page needs one.
        use: whether the recipes make or use the entity.
        part: split part of the recipes; empty for all.
        page: page number in the list.
    """

    entity: str = ""
    use: Use = "uses"
    part: Part | Literal[""] = ""
    page: int = 1


class EntityRecipes(Record):
    """Recipes that make or use an entity.

    Attributes:
        entity: label.
        use: whether the recipes make or use the entity.
        parts: number of recipes by part, whatever part is chosen; parts without recipes are left
            out.
        paging: which recipes of the chosen part are on this page.
        recipes: the recipes on this page.
    """

    entity: str
    use: Use
    parts: dict[Part, Count]
    paging: Paging
    recipes: tuple[PlacedRecipe, ...]


class AlikeEntity(Record):
    """A similar entity.

    Attributes:
        entity: label.
        cosine: cosine similarity, from -1 to 1.
    """

    entity: str
    cosine: float


class EntityProfile(Record):
    """An entity, with its recipes and predictions for partners, ingredients and products.

    Attributes:
        entity: label.
        base: whether the entity is a base entity.
        layer: crafting layer, 0 for the base; None if the entity cannot be made.
        crafts: number of crafts in the cheapest derivation; None if the entity cannot be made.
        made_by: some of the recipes that make the entity.
        used_in: some of the recipes that use the entity.
        model: name of the model; empty without one.
        has_seen_the_test_recipes: whether the model was trained on all recipes; False without a
            model.
        slots: predictions for the queries in :data:`OPEN_SLOTS`; empty without a model, and for a
            model of sets, which suggests recipes.
        nearest: most similar entities by the model; empty without a model.
        by_words: most similar entities by word vectors; None if no word of the label has a vector.
    """

    entity: str
    base: bool
    layer: Count | None
    crafts: Count | None
    made_by: EntityRecipes
    used_in: EntityRecipes
    model: str
    has_seen_the_test_recipes: bool
    slots: tuple[PredictedSlot, ...]
    nearest: tuple[AlikeEntity, ...]
    by_words: tuple[AlikeEntity, ...] | None


def _view(explored: Explored, state: EntityState) -> EntityProfile:
    split = explored.opened.split
    graph = explored.opened.graph
    if not graph.num_entities:
        raise ConfigError("The graph has no entities.")
    label = state.entity or graph.entities[int(graph.use_counts.argmax())]
    entity = graph.id_of(label)
    layer = int(layers_of(graph)[entity])
    is_reachable = layer >= 0
    # Reading word vectors takes seconds.
    words = explored.once("words", lambda: glove_features(graph.entities))
    predictor = explored.predictor(state.model) if explored.models else None
    slots: tuple[PredictedSlot, ...] = ()
    nearest: tuple[AlikeEntity, ...] = ()
    if predictor is not None and not is_set_model(predictor.model):
        scored = [predictor.slot(entity, relation, side) for relation, side in OPEN_SLOTS]
        slots = tuple(predictor.best(slot, top=PREDICTED) for slot in scored)
        nearest = _alike(graph.entities, predictor.evidence.roles.nearest(entity, NEAREST))
    return EntityProfile(
        entity=label,
        base=bool((graph.base_ids == entity).any()),
        layer=layer if is_reachable else None,
        crafts=len(explored.planner().derivation(entity).steps) if is_reachable else None,
        made_by=_recipes(split, RecipesState(label, "makes"), LISTED),
        used_in=_recipes(split, RecipesState(label, "uses"), LISTED),
        model="" if predictor is None else predictor.name,
        has_seen_the_test_recipes=predictor is not None and predictor.has_seen_the_test_recipes,
        slots=slots,
        nearest=nearest,
        by_words=_alike(graph.entities, near_by_words(words, entity))
        if words.known[entity]
        else None,
    )


def _view_recipes(explored: Explored, state: RecipesState) -> EntityRecipes:
    if not state.entity:
        raise ConfigError("The address has no entity; expected an address such as /recipes/water.")
    return _recipes(explored.opened.split, state, RECIPES_A_PAGE)


def _recipes(split: Split, state: RecipesState, size: int) -> EntityRecipes:
    """Return a page of ``size`` recipes."""
    graph = split.graph
    rows_of = graph.recipes_of if state.use == "makes" else graph.uses_of
    rows = rows_of(state.entity)
    # Counts of all parts, before the filter: the page links to the other parts.
    counts = np.bincount(split.parts[rows], minlength=len(PARTS)).tolist()
    part_rows = rows[split.parts[rows] == PARTS.index(state.part)] if state.part else rows
    shown = paging(len(part_rows), state.page, size)
    return EntityRecipes(
        entity=state.entity,
        use=state.use,
        parts={
            name: count  # type: ignore[misc]
            for name, count in zip(PARTS, counts, strict=True)
            if count
        },
        paging=shown,
        recipes=placed_recipes(split, part_rows[shown.rows]),
    )


def near_by_words(
    words: EntityFeatures, entity: int, limit: int = NEAREST
) -> list[tuple[int, float]]:
    """Return the entities with the most similar word vectors.

    Args:
        words: word vectors of all E entities.
        entity: id of an entity with a vector.
        limit: most entities to return.

    Returns:
        ids and cosines, the largest cosine first, ties in the order of ids; entities without
        vectors are left out.
    """
    cosines: NDArray[np.float32] = words.unit_vectors @ words.unit_vectors[entity]
    candidates = np.flatnonzero(words.known)
    candidates = candidates[candidates != entity]
    order = candidates[np.argsort(-cosines[candidates], kind="stable")]
    return [(candidate, float(cosines[candidate])) for candidate in order[:limit].tolist()]


def _alike(labels: tuple[str, ...], neighbours: list[tuple[int, float]]) -> tuple[AlikeEntity, ...]:
    return tuple(AlikeEntity(labels[neighbour], cosine) for neighbour, cosine in neighbours)


def _exported_recipes(explored: Explored) -> Iterator[RecipesState]:
    graph = explored.opened.graph
    counts: dict[Use, list[int]] = {
        "makes": graph.recipe_counts.tolist(),
        "uses": graph.use_counts.tolist(),
    }
    for entity, label in enumerate(graph.entities[:EXPORTED]):
        for use, numbers in counts.items():
            # The entity's page lists all recipes of a short list.
            if numbers[entity] > LISTED:
                for page in range(1, num_pages(numbers[entity], RECIPES_A_PAGE) + 1):
                    yield RecipesState(label, use, page=page)


ENTITY = Page(
    "entity",
    EntityState,
    _view,
    subject="entity",
    exported=lambda explored: map(EntityState, explored.opened.graph.entities[:EXPORTED]),
)
RECIPES = Page("recipes", RecipesState, _view_recipes, subject="entity", exported=_exported_recipes)
