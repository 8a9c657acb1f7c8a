"""The pages of the map and of paths: states, links and labels."""

import pytest

from tests.apps.explorer.shown import HOSTILE, client_of, explored_graph, look, view_of
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.apps.explorer.pages.entity import Entity
from wordcraft_kg.apps.explorer.pages.map import Map
from wordcraft_kg.apps.explorer.pages.path import Path
from wordcraft_kg.apps.explorer.rendering import Site
from wordcraft_kg.base.errors import ConfigError, UnknownEntityError
from wordcraft_kg.base.records import checked_values
from wordcraft_kg.graphs import Planner


@pytest.mark.parametrize("label", HOSTILE)
@pytest.mark.parametrize(("kind", "scripts"), [(Map, 3), (Path, 1)])  # of the map: two files, and the data of its links
def test_labels_stay_text_and_their_links_lead_to_them(hostile: Explored, label: str, kind: type, scripts: int):
    page = look(hostile, kind(entity=label))
    assert label in page.text
    tags = [tag for tag, _ in page.tags]
    assert tags.count("script") == scripts
    assert "img" not in tags
    linked = {state.entity for _, state in page.own if isinstance(state, kind)} - {""}
    assert linked <= set(hostile.opened.graph.entities)
    if kind is Map:
        assert linked == set(hostile.opened.graph.entities)


def test_no_page_has_styles_or_handlers_that_the_policy_forbids(explored: Explored):
    for state in (Map(entity="bread"), Path(entity="bread")):
        for _, values in look(explored, state).tags:
            assert not [name for name in values if name == "style" or name.startswith("on")]


def test_the_map_keeps_its_colours_when_another_entity_is_chosen(explored: Explored):
    page = look(explored, Map(entity="bread", colour="layer"))
    kept = [state for _, state in page.own if isinstance(state, Map) and state != Map()]  # but for the menu's link
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
    view = view_of(explored, Path())
    assert view == view_of(explored, Path(entity=view.entity))
    assert view.layers > 5


def test_an_unknown_entity_is_an_error_with_the_nearest_names(explored: Explored):
    for state in (Map(entity="braed"), Path(entity="braed")):
        with pytest.raises(UnknownEntityError, match="bread"):
            view_of(explored, state)


def test_paths_that_cannot_be_gone_say_why():
    explored = explored_graph([("a", "b", "c"), ("gone", "b", "d"), ("x", "b", "y"), ("y", "b", "x")], ["a", "b"])

    def text(goal: str) -> str:
        return look(explored, Path(entity=goal)).text

    assert "a is a base entity" in text("a")
    assert "1 craft in 1 layer" in text("c")
    assert "d cannot be made from the base (a, b)" in text("d")
    assert "what no recipe makes and is not in the base: gone." in text("d")
    assert "No recipe makes it." in text("gone")
    assert "need each other's results" in text("x")


def test_a_graph_without_entities_has_neither_page_in_the_menu():
    explored = explored_graph([])
    site = Site(explored, lambda page, state: page.address(state), str)
    assert {page.name for page, _ in site.menu}.isdisjoint({"map", "path"})
    with pytest.raises(ConfigError, match="no entities"):
        view_of(explored, Path())


def test_pages_of_an_entity_whose_cost_has_thousands_of_digits_can_be_read():
    explored = explored_graph([(f"{i:05}", f"{i:05}", f"{i + 1:05}") for i in range(15_000)])
    for state, text in ((Entity("15000"), "15,000 crafts"), (Path("15000"), "about 2.8 × 10^4515")):
        assert text in look(explored, state).text
        checked_values(view_of(explored, state))
    assert "about 2.8 × 10^4515" in repr(Planner(explored.opened.graph).derivation("15000"))


def test_a_graph_without_entities_is_no_error_of_the_program():
    explored = explored_graph([])
    client = client_of(explored)
    answers = {name: client.get(f"/{name}") for name in PAGES}
    assert {name: answer.status_code for name, answer in answers.items() if answer.status_code >= 500} == {}
    assert "The graph has no entities" in answers["path"].text
