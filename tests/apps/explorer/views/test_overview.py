"""The overview of what there is to look at."""

from pathlib import Path

import pytest
from starlette.testclient import TestClient

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.server import make_app
from wordcraft_kg.apps.explorer.views.overview import view_overview
from wordcraft_kg.graphs.folder import OpenedGraph, default_split
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig
from wordcraft_kg.models.links.training import train_links


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


@pytest.mark.parametrize(
    ("settings", "said"),
    [({}, ""), ({"share": 0.5, "noise": 0.25}, "50 % of the train recipes, 25 % of them with a wrong result")],
)
def test_a_model_that_was_taught_a_dose_says_of_what(settings: dict[str, float], said: str, tmp_path: Path):
    config = LinksConfig("kitchen", ComplExConfig(dim=2, epochs=1, folds=0, **settings))  # type: ignore[arg-type]
    explored = Explored.open("kitchen", [train_links(config, tmp_path / "model").folder])
    (line,) = view_overview(explored.opened, {name: one.model for name, one in explored.models.items()}, {}).models
    assert line.dose == said
    page = TestClient(make_app(explored), base_url="http://localhost").get("/home").text
    assert f">{said or 'train recipes'}<" in page
