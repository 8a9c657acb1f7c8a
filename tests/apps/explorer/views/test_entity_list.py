"""Lists of entities, page by page, and the search for one."""

import pytest

from wordcraft_kg.apps.explorer.views import entity_list
from wordcraft_kg.apps.explorer.views.entity_list import list_entities, search_entities
from wordcraft_kg.apps.explorer.views.paging import paging
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs import RecipeGraph
from wordcraft_kg.graphs.planner import layers


@pytest.mark.parametrize("total", [0, 1, 19, 20, 21, 40, 41])
def test_pages_together_hold_every_row_once(total: int):
    rows = list(range(total))
    first = paging(total, 1, 20)
    shown = [row for page in range(1, first.pages + 1) for row in rows[paging(total, page, 20).rows]]
    assert shown == rows
    assert first.pages == max((total + 19) // 20, 1)
    for page in (0, -1, first.pages + 1):
        with pytest.raises(ConfigError, match="`page`"):
            paging(total, page, 20)


def test_the_list_has_every_entity_in_the_order_asked_for(kitchen: RecipeGraph, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(entity_list, "ENTITIES_A_PAGE", 7)
    layer = layers(kitchen).tolist()
    made = [sum(row[2] == i for row in kitchen.recipes.tolist()) for i in range(kitchen.num_entities)]
    used = [sum(i in row[:2] for row in kitchen.recipes.tolist()) for i in range(kitchen.num_entities)]
    keys = {
        "label": lambda i: 0,
        "layer": lambda i: layer[i] if layer[i] >= 0 else 10**6,
        "recipes": lambda i: -made[i],
        "uses": lambda i: -used[i],
    }
    for order, key in keys.items():
        expected = [
            (kitchen.entities[i], layer[i] if layer[i] >= 0 else None, made[i], used[i])
            for i in sorted(range(kitchen.num_entities), key=lambda i: (key(i), i))
        ]
        pages = list_entities(kitchen, "", order).paging.pages
        rows = [row for page in range(1, pages + 1) for row in list_entities(kitchen, "", order, page).entities]
        assert [(row.entity, row.layer, row.recipes, row.uses) for row in rows] == expected


def test_an_entity_that_cannot_be_made_has_no_layer():
    graph = RecipeGraph.from_recipes([("a", "b", "c"), ("d", "d", "d2")], base=["a", "b"])
    assert [row.layer for row in list_entities(graph).entities] == [0, 0, 1, None, None]
    assert [row.entity for row in list_entities(graph, order="layer").entities] == ["a", "b", "c", "d", "d2"]


def test_a_search_takes_the_label_itself_then_beginnings_then_words_then_parts():
    labels = ["pie", "piece", "apple pie", "magpie", "tree"]
    rows = [(one, "tree", other) for one in labels for other in labels if one != other]
    graph = RecipeGraph.from_recipes(rows)
    assert search_entities(graph, "pie") == ("pie", "piece", "apple pie", "magpie")
    assert search_entities(graph, "pie", limit=2) == ("pie", "piece")
    assert search_entities(graph, "  ") == ()


def test_a_search_knows_neither_case_nor_accents():
    graph = RecipeGraph.from_recipes([("Crème brûlée", "ICE", "Straße")])
    assert search_entities(graph, "creme BRU") == ("Crème brûlée",)
    assert search_entities(graph, "strasse") == ("Straße",)
    assert list_entities(graph, "ice").paging.total == 1


def test_of_equal_matches_the_most_used_comes_first():
    graph = RecipeGraph.from_recipes([("ax", "water", "m1"), ("ay", "water", "m2"), ("ay", "fire", "m3")])
    assert search_entities(graph, "a")[:2] == ("ay", "ax")
