"""The overview of what there is to look at."""

import pytest

from wordcraft_kg.graphs.folder import OpenedGraph, default_split
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.views.overview import view_overview


@pytest.mark.parametrize(
    ("rows", "furthest", "most_used"),
    [
        ([("a", "b", "c"), ("c", "b", "d"), ("x", "y", "z")], ("d", "c", "z"), ("b", "a", "c", "x", "y")),
        ([("a", "b", "c"), ("b", "c", "a"), ("c", "a", "b")], (), ("a", "b", "c")),
        ([], (), ()),
    ],
)
def test_what_needs_no_craft_or_cannot_be_made_is_not_far_from_the_base(
    rows: list[tuple[str, str, str]], furthest: tuple[str, ...], most_used: tuple[str, ...]
):
    graph = RecipeGraph.from_recipes(rows)
    found = view_overview(OpenedGraph(graph, default_split(graph), "small"), {}, {})
    assert (found.furthest, found.most_used) == (furthest, most_used)
