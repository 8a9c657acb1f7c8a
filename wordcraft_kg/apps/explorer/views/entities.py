"""An entity: how it is made, what it is used for, what a model predicts for it, and what is like it."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.apps.explorer.views.entity_list import layer_of
from wordcraft_kg.apps.explorer.views.paging import Paging, paging
from wordcraft_kg.apps.explorer.views.predictor import LinkPredictor, PredictedSlot
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.planner import Planner
from wordcraft_kg.graphs.splits import PARTS, Part, Split
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF
from wordcraft_kg.models.scorers.features import EntityFeatures
from wordcraft_kg.models.scorers.roles import Side

NEAREST = 8
"""Entities that are listed as alike."""
PREDICTED = 10
"""Entities that are listed for an open slot."""
LISTED = 12
"""Recipes of either kind that are listed beside the rest."""
RECIPES_A_PAGE = 100
OPEN_SLOTS: tuple[tuple[int, Side], ...] = ((COMBINES_WITH, "tail"), (COMPONENT_OF, "head"), (COMPONENT_OF, "tail"))
"""What is asked of a model for an entity: its partners, its ingredients, and what it is an ingredient of."""
Use = Literal["makes", "uses"]
"""Whether recipes make an entity or use it."""


class PlacedRecipe(Record):
    """A recipe, and the part that it is in."""

    ingredient_a: str
    ingredient_b: str
    result: str
    part: Part

    def partner(self, entity: str) -> str:
        """Return the other ingredient than an entity, which may be the same one."""
        return self.ingredient_b if self.ingredient_a == entity else self.ingredient_a


class EntityRecipes(Record):
    """Recipes of an entity.

    Attributes:
        entity: its label.
        use: whether they make the entity or use it.
        parts: how many there are in each part that has any.
        paging: which of them are listed.
        recipes: the listed ones.
    """

    entity: str
    use: Use
    parts: dict[Part, Count]
    paging: Paging
    recipes: tuple[PlacedRecipe, ...]

    @property
    def total(self) -> int:
        """How many there are."""
        return self.paging.total


class AlikeEntity(Record):
    """An entity and the cosine to the one that it is compared with."""

    entity: str
    cosine: float


class EntityProfile(Record):
    """An entity.

    Attributes:
        entity: its label.
        base: whether it is a base entity.
        layer: round in which it can first be made; None if it cannot.
        crafts: number of steps of its cheapest derivation; None if it cannot be made.
        made_by: recipes that make it.
        used_in: recipes that use it.
        model: name of the model that was asked; empty without one.
        has_seen_the_test_recipes: whether that was trained on all recipes.
        slots: what it predicts for the open slots of the entity.
        nearest: the entities most like it to the model.
        by_words: the entities most like it by their words; None if its words have no vector.
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
        """Number of its recipes that are not in the train part."""
        return sum(
            count for found in (self.made_by, self.used_in) for part, count in found.parts.items() if part != "train"
        )

    @property
    def has_probabilities(self) -> bool:
        """Whether the model knows probabilities."""
        return any(row.probability is not None for slot in self.slots for row in slot.best)


def view_entity_profile(
    split: Split,
    label: str,
    *,
    planner: Planner,
    words: EntityFeatures,
    predictor: LinkPredictor | None = None,
    with_learned: bool = False,
    listed: int = LISTED,
) -> EntityProfile:
    """Return what is known of an entity, and what a model says of it.

    Args:
        split: graph and split.
        label: its label.
        planner: the cheapest derivations of the graph.
        words: vectors of the entities' words.
        predictor: the model to ask; None to ask none.
        with_learned: list predictions that the model was trained on, too.
        listed: the most recipes of each kind to list.

    Raises:
        UnknownEntityError: if the graph has no entity of this label.
    """
    graph = split.graph
    entity = graph.id_of(label)
    layer = layer_of(graph, entity)
    slots: tuple[PredictedSlot, ...] = ()
    nearest: tuple[AlikeEntity, ...] = ()
    if predictor is not None:
        slots = tuple(
            predictor.best(predictor.slot(entity, *which), with_learned=with_learned, top=PREDICTED)
            for which in OPEN_SLOTS
        )
        nearest = _alike(graph.entities, predictor.evidence.roles.nearest(entity, NEAREST))
    return EntityProfile(
        entity=label,
        base=bool((graph.base_ids == entity).any()),
        layer=layer,
        crafts=None if layer is None else len(planner.derivation(entity).steps),
        made_by=view_entity_recipes(split, label, "makes", size=listed),
        used_in=view_entity_recipes(split, label, "uses", size=listed),
        model="" if predictor is None else predictor.name,
        has_seen_the_test_recipes=predictor is not None and predictor.has_seen_the_test_recipes,
        slots=slots,
        nearest=nearest,
        by_words=_alike(graph.entities, near_by_words(words, entity)) if words.known[entity] else None,
    )


def view_entity_recipes(
    split: Split, label: str, use: Use, page: int = 1, *, part: Part | Literal[""] = "", size: int = RECIPES_A_PAGE
) -> EntityRecipes:
    """List recipes of an entity, page by page; those of one part if it is given.

    Raises:
        UnknownEntityError: if the graph has no entity of this label.
        ConfigError: if there is no such page.
    """
    graph = split.graph
    rows = graph.recipes_of(label) if use == "makes" else graph.uses_of(label)
    counts = np.bincount(split.parts[rows], minlength=len(PARTS)).tolist()
    chosen = rows if not part else rows[split.parts[rows] == PARTS.index(part)]
    shown = paging(len(chosen), page, size)
    return EntityRecipes(
        entity=label,
        use=use,
        parts={name: count for name, count in zip(PARTS, counts, strict=True) if count},  # type: ignore[misc]
        paging=shown,
        recipes=placed_recipes(split, chosen[shown.rows]),
    )


def placed_recipes(split: Split, rows: Ids) -> tuple[PlacedRecipe, ...]:
    """Return recipes of a split by their rows, with their parts."""
    recipes = split.graph.recipe_labels(split.graph.recipes[rows])
    parts = (PARTS[part] for part in split.parts[rows].tolist())
    return tuple(PlacedRecipe(*recipe, part) for recipe, part in zip(recipes, parts, strict=True))  # type: ignore[arg-type]


def near_by_words(words: EntityFeatures, entity: int, limit: int = NEAREST) -> list[tuple[int, float]]:
    """Return the entities most like one by the cosine of their words' vectors; those without vectors are like none.

    Returns:
        ids and cosines, nearest first; none if the words of the entity have no vector.
    """
    if not words.known[entity]:
        return []
    cosines: NDArray[np.float32] = words.unit_vectors @ words.unit_vectors[entity]
    others = np.flatnonzero(words.known)
    order = others[np.argsort(-cosines[others], kind="stable")]
    return [(other, float(cosines[other])) for other in order[: limit + 1].tolist() if other != entity][:limit]


def _alike(labels: tuple[str, ...], found: list[tuple[int, float]]) -> tuple[AlikeEntity, ...]:
    return tuple(AlikeEntity(labels[other], cosine) for other, cosine in found)
