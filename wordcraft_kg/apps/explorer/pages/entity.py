"""Pages for an entity and its recipes."""

from collections.abc import Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState, Paging, paging
from wordcraft_kg.apps.explorer.pages.entities import layers_of
from wordcraft_kg.apps.explorer.predictor import PlacedRecipe, PredictedSlot, placed_recipes
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.graphs.splits import PARTS, Part, Split
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF
from wordcraft_kg.models.scorers.features import EntityFeatures, glove_features
from wordcraft_kg.models.scorers.roles import Side

NEAREST = 8
PREDICTED = 10
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


class EntityState(PageState):
    """Page settings: an entity, by default the most used; a model; ``learned`` lists training links, too."""

    entity: str = ""
    model: str = ""
    learned: bool = False


class RecipesState(PageState):
    """Page settings: an entity, its use (recipes that make or use it), and a split part."""

    entity: str = ""
    use: Use = "uses"
    part: Part | Literal[""] = ""
    page: int = 1


class EntityRecipes(Record):
    """Recipes that make or use an entity, and their number by part."""

    entity: str
    use: Use
    parts: dict[Part, Count]
    paging: Paging
    recipes: tuple[PlacedRecipe, ...]


class AlikeEntity(Record):
    """A similar entity with the cosine."""

    entity: str
    cosine: float


class EntityProfile(Record):
    """An entity, with predictions for partners, ingredients and products.

    ``layer`` and ``crafts`` (of the cheapest derivation) need a reachable entity, ``by_words`` a vector; else None.
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

    @property
    def held_out(self) -> int:
        """Number of recipes outside the train part."""
        parts = [*self.made_by.parts.items(), *self.used_in.parts.items()]
        return sum(count for part, count in parts if part != "train")

    @property
    def has_probabilities(self) -> bool:
        """Whether any prediction has a probability."""
        return any(row.probability is not None for slot in self.slots for row in slot.best)


def _view(explored: Explored, state: EntityState) -> EntityProfile:
    split, graph = explored.opened.split, explored.opened.graph
    if not graph.num_entities:
        raise ConfigError("The graph has no entities.")
    label = state.entity or graph.entities[int(graph.use_counts.argmax())]
    entity = graph.id_of(label)
    layer, words = (
        int(layers_of(graph)[entity]),
        explored.once("words", lambda: glove_features(graph.entities)),
    )
    predictor = explored.predictor(state.model) if explored.models else None
    slots: tuple[PredictedSlot, ...] = ()
    nearest: tuple[AlikeEntity, ...] = ()
    if predictor is not None:
        slots = tuple(
            predictor.best(
                predictor.slot(entity, *which), with_learned=state.learned, top=PREDICTED
            )
            for which in OPEN_SLOTS
        )
        nearest = _alike(graph.entities, predictor.evidence.roles.nearest(entity, NEAREST))
    return EntityProfile(
        entity=label,
        base=bool((graph.base_ids == entity).any()),
        layer=layer if layer >= 0 else None,
        crafts=len(explored.planner().derivation(entity).steps) if layer >= 0 else None,
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
    graph = split.graph
    rows = graph.recipes_of(state.entity) if state.use == "makes" else graph.uses_of(state.entity)
    counts = np.bincount(split.parts[rows], minlength=len(PARTS)).tolist()
    chosen = rows if not state.part else rows[split.parts[rows] == PARTS.index(state.part)]
    shown = paging(len(chosen), state.page, size)
    return EntityRecipes(
        entity=state.entity,
        use=state.use,
        parts={name: count for name, count in zip(PARTS, counts, strict=True) if count},  # type: ignore[misc]
        paging=shown,
        recipes=placed_recipes(split, chosen[shown.rows]),
    )


def near_by_words(
    words: EntityFeatures, entity: int, limit: int = NEAREST
) -> list[tuple[int, float]]:
    """Return ids and cosines by word vector similarity; empty for an entity without a vector."""
    if not words.known[entity]:
        return []
    cosines: NDArray[np.float32] = words.unit_vectors @ words.unit_vectors[entity]
    others = np.flatnonzero(words.known)
    order = others[np.argsort(-cosines[others], kind="stable")]
    return [
        (other, float(cosines[other])) for other in order[: limit + 1].tolist() if other != entity
    ][:limit]


def _alike(labels: tuple[str, ...], neighbours: list[tuple[int, float]]) -> tuple[AlikeEntity, ...]:
    return tuple(AlikeEntity(labels[other], cosine) for other, cosine in neighbours)


def _exported(explored: Explored) -> Iterator[EntityState]:
    yield from (EntityState(label) for label in explored.opened.graph.entities[:EXPORTED])


def _exported_recipes(explored: Explored) -> Iterator[RecipesState]:
    graph = explored.opened.graph
    counts = zip(graph.recipe_counts.tolist(), graph.use_counts.tolist(), strict=True)
    uses: tuple[Use, ...] = ("makes", "uses")
    for label, both in zip(graph.entities[:EXPORTED], counts, strict=False):
        for use, count in zip(uses, both, strict=True):
            if count > LISTED:
                yield from (
                    RecipesState(label, use, page=page)
                    for page in range(1, -(-count // RECIPES_A_PAGE) + 1)
                )


def _questions(explored: Explored) -> Iterator[tuple[str, EntityState]]:
    graph = explored.opened.graph
    for hub in graph.labels(np.argsort(-graph.use_counts, kind="stable")[:1]):
        yield f"What combines with {hub}?", EntityState(hub)


PAGE = Page(
    "entity", EntityState, _view, subject="entity", exported=_exported, questions=_questions
)
RECIPES = Page("recipes", RecipesState, _view_recipes, subject="entity", exported=_exported_recipes)
