"""The overview, lists of entities and the search; an entity's recipes, cost, predictions and
similar entities."""

from collections import Counter

import pytest
from helpers import refuses

from tests.apps.explorer.shown import (
    explored_graph,
    view_by,
    view_of,
)
from wordcraft_kg import RecipeGraph
from wordcraft_kg.apps.explorer.page import paging
from wordcraft_kg.apps.explorer.pages import entities
from wordcraft_kg.apps.explorer.pages.entities import (
    EntitiesState,
    EntityState,
)
from wordcraft_kg.apps.explorer.pages.home import HomeState
from wordcraft_kg.graphs import PARTS, layers

PIES = ["pie", "piece", "apple pie", "magpie", "tree"]


@pytest.mark.parametrize(
    ("rows", "furthest", "most_used"),
    [
        (
            [("a", "b", "c"), ("c", "b", "d"), ("x", "y", "z")],
            ("d", "c", "z"),
            ("b", "a", "c", "x", "y"),
        ),
        ([("a", "b", "c"), ("b", "c", "a"), ("c", "a", "b")], (), ("a", "b", "c")),
        ([], (), ()),
    ],
)
def test_what_needs_no_craft_or_cannot_be_made_is_not_far_from_the_base(rows, furthest, most_used):
    overview = view_of(explored_graph(rows), HomeState())
    assert (overview.furthest, overview.most_used) == (furthest, most_used)


@pytest.mark.parametrize("total", [0, 1, 19, 20, 21, 40, 41])
def test_pages_together_hold_every_row_once(total):
    rows = list(range(total))
    first = paging(total, 1, 20)
    shown = [
        row for page in range(1, first.pages + 1) for row in rows[paging(total, page, 20).rows]
    ]
    assert shown == rows
    assert first.pages == max((total + 19) // 20, 1)
    for page in (0, -1, first.pages + 1):
        with refuses("page"):
            paging(total, page, 20)


def test_the_list_has_every_entity_by_label(kitchen, monkeypatch):
    monkeypatch.setattr(entities, "ENTITIES_A_PAGE", 7)
    layer = layers(kitchen).tolist()
    made = [
        sum(row[2] == i for row in kitchen.recipes.tolist()) for i in range(kitchen.num_entities)
    ]
    used = [
        sum(i in row[:2] for row in kitchen.recipes.tolist()) for i in range(kitchen.num_entities)
    ]
    explored = explored_graph(kitchen)
    pages = view_of(explored, EntitiesState()).paging.pages
    rows = [
        (row.entity, row.layer, row.recipes, row.uses)
        for page in range(1, pages + 1)
        for row in view_of(explored, EntitiesState(page=page)).entities
    ]
    assert rows == list(zip(kitchen.entities, layer, made, used, strict=True))


def test_an_entity_that_cannot_be_made_has_no_layer():
    explored = explored_graph([("a", "b", "c"), ("d", "d", "d2")], ["a", "b"])
    shown = [row.layer for row in view_of(explored, EntitiesState()).entities]
    assert shown == [0, 0, 1, None, None]


@pytest.mark.parametrize(
    ("rows", "wanted", "expected"),
    [
        (
            [(a, "tree", b) for a in PIES for b in PIES if a != b],
            "pie",
            ("pie", "piece", "apple pie", "magpie"),
        ),
        ([("pie", "tree", "piece")], "  ", ("pie", "piece", "tree")),
        ([("Crème brûlée", "ICE", "Straße")], "creme BRU", ("Crème brûlée",)),
        ([("Crème brûlée", "ICE", "Straße")], "strasse", ("Straße",)),
        (
            [("ax", "water", "m1"), ("ay", "water", "m2"), ("ay", "fire", "m3")],
            "a",
            ("ay", "ax", "water"),
        ),
    ],
)
def test_a_search_takes_labels_then_beginnings_words_and_parts(rows, wanted, expected):
    """A search takes the label itself then beginnings words and parts without case and accents."""
    graph = RecipeGraph.from_recipes(rows)
    rows = view_of(explored_graph(graph), EntitiesState(wanted)).entities
    assert tuple(row.entity for row in rows) == expected


def test_recipes_that_make_and_use_an_entity_have_their_parts(neighbours, monkeypatch):
    monkeypatch.setattr(entities, "LISTED", 1_000)
    graph, split = neighbours.graph, neighbours.split
    part_of = {
        tuple(row): PARTS[part]
        for row, part in zip(graph.recipe_labels(), split.parts.tolist(), strict=True)
    }
    parts = set()
    for label in ("water", "bread", "flour"):
        found = view_by(neighbours, EntityState(label))
        makes, uses = (
            {tuple(row.recipe): row.part for row in kind.recipes}
            for kind in (found.made_by, found.used_in)
        )
        assert makes == {recipe: part for recipe, part in part_of.items() if recipe[2] == label}
        assert uses == {recipe: part for recipe, part in part_of.items() if label in recipe[:2]}
        assert found.used_in.parts == Counter(uses.values())
        assert found.used_in.paging.total == len(uses)
        parts |= set(uses.values())
    assert parts == set(PARTS)


def test_a_model_answers_for_partners_ingredients_and_products(neighbours):
    found = view_by(neighbours, EntityState("bread"))
    queries = [(slot.head, slot.relation, slot.tail) for slot in found.slots]
    assert queries[:2] == [("bread", "combinesWith", None), (None, "componentOf", "bread")]
    assert queries[2:] == [("bread", "componentOf", None)]
    assert found.model == neighbours.name


def test_the_nearest_in_the_model_are_not_the_entity_itself(neighbours):
    found = view_by(neighbours, EntityState("bread")).nearest
    assert len({row.entity for row in found} - {"bread"}) == len(found) == 8
    cosines = [row.cosine for row in found]
    assert cosines == sorted(cosines, reverse=True)
    assert cosines[0] > 0.3
