"""Pages of a graph whose recipes have one, three or more ingredients."""

from tests.apps.explorer.shown import explored_graph, look, view_of
from wordcraft_kg.apps.explorer.export import export_site
from wordcraft_kg.apps.explorer.pages.entity import EntityState, RecipesState
from wordcraft_kg.apps.explorer.pages.pair import PairState
from wordcraft_kg.apps.explorer.pages.path import PathState
from wordcraft_kg.apps.explorer.predictor import recipes_giving
from wordcraft_kg.graphs.triples import COMBINES_WITH

ROWS = [
    ("flour", "salt", "water", "dough"),
    ("flour", "water", "paste"),
    ("egg", "egg", "flour", "pasta"),
    ("dough", "bread"),
    ("bread", "salt", "yeast", "roll"),
]
"""Yeast is outside the base, so that no roll can be made."""
BASE = ["egg", "flour", "salt", "water"]


def test_a_site_of_sets_has_all_pages(tmp_path):
    exported = export_site(explored_graph(ROWS, BASE), tmp_path / "site")
    assert not exported.skipped


def test_recipes_of_an_entity_name_all_other_ingredients():
    explored = explored_graph(ROWS, BASE)
    partners = {
        row.recipe.result: row.partners("flour")
        for row in view_of(explored, RecipesState("flour")).recipes
    }
    expected = {"dough": ("salt", "water"), "paste": ("water",), "pasta": ("egg", "egg")}
    assert partners == expected
    assert "nothing else" in look(explored, EntityState("dough")).text


def test_a_pair_has_the_recipes_with_both_ingredients():
    explored = explored_graph(ROWS, BASE)
    makes = view_of(explored, PairState("water", "flour")).makes
    assert {row.recipe.result for row in makes} == {"dough", "paste"}
    graph = explored.opened.graph
    egg, flour = graph.id_of("egg"), graph.id_of("flour")
    assert len(recipes_giving(graph, egg, COMBINES_WITH, egg)) == 1
    assert not len(recipes_giving(graph, flour, COMBINES_WITH, flour))


def test_paths_lead_through_sets_and_name_what_is_missing():
    explored = explored_graph(ROWS, BASE)
    steps = view_of(explored, PathState("bread")).listed
    assert [str(step.recipe) for step in steps] == [
        "flour + salt + water -> dough",
        "dough -> bread",
    ]
    lacking = view_of(explored, PathState("roll"))
    assert [blocked.missing for blocked in lacking.blocked] == [("yeast",)]
    assert lacking.sources == ("yeast",)
    chain = view_of(explored, PathState("bread", start="salt")).chain
    assert [step.recipe.result for step in chain.steps] == ["dough", "bread"]
