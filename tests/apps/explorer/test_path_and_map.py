"""The pages of the map and of paths: states, links and labels."""

from html.parser import HTMLParser
from urllib.parse import parse_qsl, unquote, urlsplit

import pytest
from starlette.testclient import TestClient

from tests.apps.explorer.labels import HOSTILE
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page
from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.apps.explorer.pages.map import Map
from wordcraft_kg.apps.explorer.pages.path import Path
from wordcraft_kg.apps.explorer.rendering import Site
from wordcraft_kg.apps.explorer.server import make_app
from wordcraft_kg.base.errors import ConfigError, UnknownEntityError
from wordcraft_kg.base.records import checked_values
from wordcraft_kg.graphs import Planner, RecipeGraph
from wordcraft_kg.graphs.folder import OpenedGraph, default_split


class Found(HTMLParser):
    """The tags of a page, its links, and its text."""

    def __init__(self, page: str):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attributes)))

    def handle_data(self, data: str) -> None:
        self.text += data

    @property
    def links(self) -> list[str]:
        return [values["href"] or "" for tag, values in self.tags if tag == "a" and values.get("href")]


def found(explored: Explored, page: Page, state: object) -> Found:
    site = Site(explored, lambda page, state: page.address(state), lambda name: f"/files/{name}")
    return Found(site.page(page, state))


def state_of(address: str) -> tuple[str, object]:
    parts = urlsplit(address)
    name, _, subject = parts.path.removeprefix("/").partition("/")
    return name, PAGES[name].read(unquote(subject), parse_qsl(parts.query, keep_blank_values=True))


@pytest.mark.parametrize("label", HOSTILE)
@pytest.mark.parametrize(("name", "kind"), [("map", Map), ("path", Path)])
def test_labels_stay_text_and_their_links_lead_to_them(hostile: Explored, label: str, name: str, kind: type):
    page = found(hostile, PAGES[name], kind(entity=label))
    assert label in page.text
    tags = [tag for tag, _ in page.tags]
    allowed = {"map": 3, "path": 1}[name]  # the site's two scripts, and the data of the map's links
    assert tags.count("script") == allowed
    assert "img" not in tags
    linked = {state.entity for found_name, state in map(state_of, filter(_is_own, page.links)) if found_name == name}
    assert linked - {""} <= set(hostile.opened.graph.entities)
    if name == "map":
        assert linked - {""} == set(hostile.opened.graph.entities)


def _is_own(address: str) -> bool:
    return address.startswith(("/map", "/path"))


def test_no_page_has_styles_or_handlers_that_the_policy_forbids(explored: Explored):
    for page, state in ((PAGES["map"], Map(entity="bread")), (PAGES["path"], Path(entity="bread"))):
        for _, values in found(explored, page, state).tags:
            assert not [name for name in values if name == "style" or name.startswith("on")]


def test_the_map_keeps_its_colours_when_another_entity_is_chosen(explored: Explored):
    page = found(explored, PAGES["map"], Map(entity="bread", colour="layer"))
    states = [state for name, state in map(state_of, filter(_is_own, page.links)) if name == "map"]
    kept = [state for state in states if state != Map()]  # but for the link in the menu
    assert len(kept) > 80
    assert all(state.colour == "layer" for state in kept)
    assert "shade-0" in str(page.tags)


def test_each_colour_of_layers_is_in_the_legend_with_the_number_of_its_entities(explored: Explored):
    page = PAGES["map"]
    view = page.view(explored, Map(colour="layer"))
    legend = page.draw(view, Map(colour="layer"), lambda *_: "")["legend"]
    assert sum(number for _, _, number in legend) == 80
    assert legend[0] == ("shade-0", "base", len(explored.opened.graph.base))
    assert len(legend) == len({style for style, _, _ in legend}) == 5


def test_a_path_without_a_goal_leads_to_an_entity_of_the_last_layer(explored: Explored):
    view = PAGES["path"].view(explored, Path())
    assert view == PAGES["path"].view(explored, Path(entity=view.entity))
    assert view.layers > 5


def test_an_unknown_entity_is_an_error_with_the_nearest_names(explored: Explored):
    for name, state in (("map", Map(entity="braed")), ("path", Path(entity="braed"))):
        with pytest.raises(UnknownEntityError, match="bread"):
            PAGES[name].view(explored, state)


def test_paths_that_cannot_be_gone_say_why():
    rows = [("a", "b", "c"), ("gone", "b", "d"), ("x", "b", "y"), ("y", "b", "x")]
    graph = RecipeGraph.from_recipes(rows, ["a", "b"])
    explored = Explored(OpenedGraph(graph, default_split(graph), "here"))

    def text(goal: str) -> str:
        return " ".join(found(explored, PAGES["path"], Path(entity=goal)).text.split())

    assert "a is a base entity" in text("a")
    assert "1 craft in 1 layer" in text("c")
    assert "d cannot be made from the base (a, b)" in text("d")
    assert "what no recipe makes and is not in the base: gone." in text("d")
    assert "No recipe makes it." in text("gone")
    assert "need each other's results" in text("x")


def test_a_graph_without_entities_has_neither_page_in_the_menu():
    graph = RecipeGraph.from_recipes([])
    explored = Explored(OpenedGraph(graph, default_split(graph), "empty"))
    site = Site(explored, lambda page, state: page.address(state), str)
    assert {page.name for page, _ in site.menu}.isdisjoint({"map", "path"})
    with pytest.raises(ConfigError, match="no entities"):
        PAGES["path"].view(explored, Path())


def test_pages_of_an_entity_whose_cost_has_thousands_of_digits_can_be_read():
    graph = RecipeGraph.from_recipes([(f"{i:05}", f"{i:05}", f"{i + 1:05}") for i in range(15_000)])
    explored = Explored(OpenedGraph(graph, default_split(graph), "deep"))
    for name, shown in (("entity", "15,000 crafts"), ("path", "about 2.8 × 10^4515")):
        page = PAGES[name]
        state = page.state(entity="15000")
        assert shown in found(explored, page, state).text
        checked_values(page.view(explored, state))
    assert "about 2.8 × 10^4515" in repr(Planner(graph).derivation("15000"))


def test_a_graph_without_entities_is_no_error_of_the_program():
    graph = RecipeGraph.from_recipes([])
    explored = Explored(OpenedGraph(graph, default_split(graph), "empty"))
    client = TestClient(make_app(explored), base_url="http://localhost")
    answers = {name: client.get(f"/{name}") for name in PAGES}
    assert {name: answer.status_code for name, answer in answers.items() if answer.status_code >= 500} == {}
    assert "The graph has no entities" in answers["path"].text
