"""An entity's recipes with their parts, its cost, what is predicted for it and what is like it."""

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from wordcraft_kg.apps.explorer.views.entities import (
    EntityProfile,
    near_by_words,
    view_entity_profile,
    view_entity_recipes,
)
from wordcraft_kg.apps.explorer.views.predictor import LinkPredictor
from wordcraft_kg.base.errors import ConfigError, UnknownEntityError
from wordcraft_kg.base.records import checked_values
from wordcraft_kg.graphs.planner import Planner, layers
from wordcraft_kg.graphs.splits import PARTS
from wordcraft_kg.models.scorers.features import glove_features


def profile(predictor: LinkPredictor, label: str, *, asked: bool = True, **options: object) -> EntityProfile:
    graph = predictor.graph
    return view_entity_profile(
        predictor.split,
        label,
        planner=Planner(graph),
        words=glove_features(graph.entities),
        predictor=predictor if asked else None,
        **options,
    )


def test_recipes_that_make_and_use_an_entity_have_their_parts(neighbours: LinkPredictor):
    graph, split = neighbours.graph, neighbours.split
    part_of = {tuple(row): PARTS[part] for row, part in zip(graph.recipe_labels(), split.parts.tolist(), strict=True)}
    parts = set()
    for label in ("water", "bread", "flour"):
        found = profile(neighbours, label, listed=1_000)
        makes = {(row.ingredient_a, row.ingredient_b, row.result): row.part for row in found.made_by.recipes}
        uses = {(row.ingredient_a, row.ingredient_b, row.result): row.part for row in found.used_in.recipes}
        assert makes == {recipe: part for recipe, part in part_of.items() if recipe[2] == label}
        assert uses == {recipe: part for recipe, part in part_of.items() if label in recipe[:2]}
        assert found.used_in.parts == Counter(uses.values())
        assert found.used_in.total == len(uses)
        parts |= set(uses.values())
    assert parts == set(PARTS)


def test_layer_and_crafts_are_those_of_the_planner(neighbours: LinkPredictor):
    graph = neighbours.graph
    planner, layer = Planner(graph), layers(graph)
    for label in graph.entities[::9]:
        found = profile(neighbours, label, asked=False)
        entity = graph.id_of(label)
        assert found.layer == layer[entity]
        assert found.crafts == len(planner.derivation(entity).steps)
        assert found.base == (label in graph.base)


def test_what_cannot_be_made_has_neither_layer_nor_crafts(of_recipes: Callable[..., LinkPredictor]):
    predictor = of_recipes([("a", "b", "c"), ("x", "y", "x"), ("x", "c", "y")], kind="none")
    found = profile(predictor, "y")
    assert (found.layer, found.crafts, found.base) == (None, None, False)
    assert found.made_by.total == 1


def test_a_model_answers_for_partners_ingredients_and_products(neighbours: LinkPredictor):
    found = profile(neighbours, "bread")
    assert [(slot.head, slot.relation, slot.tail) for slot in found.slots] == [
        ("bread", "combinesWith", None),
        (None, "componentOf", "bread"),
        ("bread", "componentOf", None),
    ]
    assert "learned" not in {row.status for slot in found.slots for row in slot.best}
    with_learned = profile(neighbours, "bread", with_learned=True)
    assert "learned" in {row.status for slot in with_learned.slots for row in slot.best}
    assert found.model == neighbours.name
    checked_values(found)


def test_without_a_model_the_recipes_and_words_are_left(neighbours: LinkPredictor):
    found = profile(neighbours, "bread", asked=False)
    assert (found.model, found.slots, found.nearest) == ("", (), ())
    assert found.made_by.total
    assert found.by_words


def test_the_nearest_in_the_model_are_not_the_entity_itself(neighbours: LinkPredictor):
    found = profile(neighbours, "bread")
    assert len(found.nearest) == 8
    assert "bread" not in {row.entity for row in found.nearest}
    cosines = [row.cosine for row in found.nearest]
    assert cosines == sorted(cosines, reverse=True)
    assert cosines[0] > 0.3


def test_near_by_words_are_only_entities_whose_words_have_a_vector():
    labels = ("bread", "cake", "qqxzzq", "xqqzzqx", "water")
    words = glove_features(labels)
    assert words.known.tolist() == [True, True, False, False, True]
    unit = words.vectors / np.maximum(np.linalg.norm(words.vectors, axis=1, keepdims=True), 1e-9)
    found = near_by_words(words, 0)
    assert [labels[other] for other, _ in found] == ["cake", "water"]
    assert [cosine for _, cosine in found] == pytest.approx([unit[0] @ unit[1], unit[0] @ unit[4]], abs=1e-6)
    assert near_by_words(words, 2) == []


def test_an_entity_whose_words_have_no_vector_is_like_none_by_words(of_recipes: Callable[..., LinkPredictor]):
    predictor = of_recipes([("bread", "water", "qqxzzq"), ("qqxzzq", "water", "cake")], kind="none")
    assert profile(predictor, "qqxzzq").by_words is None
    by_words = profile(predictor, "bread").by_words
    assert by_words is not None
    assert {row.entity for row in by_words} == {"water", "cake"}


def test_many_recipes_come_page_by_page(of_recipes: Callable[..., LinkPredictor]):
    predictor = of_recipes([("hub", f"part {i:03}", f"thing {i:03}") for i in range(250)], kind="by-recipe-plain")
    split = predictor.split
    pages = [view_entity_recipes(split, "hub", "uses", page) for page in (1, 2, 3)]
    assert [len(page.recipes) for page in pages] == [100, 100, 50]
    assert len({row.result for page in pages for row in page.recipes}) == 250
    assert pages[0].paging.pages == 3
    assert len(profile(predictor, "hub").used_in.recipes) == 12
    with pytest.raises(ConfigError, match="there are 3 pages"):
        view_entity_recipes(split, "hub", "uses", 4)
    assert view_entity_recipes(split, "hub", "makes").recipes == ()
    of_test = view_entity_recipes(split, "hub", "uses", part="test")
    assert {row.part for row in of_test.recipes} == {"test"}
    assert of_test.total == pages[0].parts["test"] < 250


def test_the_partner_of_an_entity_may_be_itself(of_recipes: Callable[..., LinkPredictor]):
    predictor = of_recipes([("a", "a", "b"), ("a", "z", "b"), ("Z", "a", "b")], kind="none")
    found = view_entity_recipes(predictor.split, "a", "uses").recipes
    assert [row.partner("a") for row in found] == ["Z", "a", "z"]


def test_an_unknown_entity_is_refused_with_the_nearest_labels(neighbours: LinkPredictor):
    with pytest.raises(UnknownEntityError, match="Did you mean 'bread'"):
        profile(neighbours, "braed")


def test_hostile_labels_stay_what_they_are(hostile: LinkPredictor):
    for label in hostile.graph.entities:
        found = profile(hostile, label, with_learned=True)
        assert found.entity == label
        checked_values(found)
