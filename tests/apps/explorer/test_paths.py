"""Paths: the cheapest derivation, its layers, and goals that cannot be made."""

import pytest

from tests.apps.explorer.shown import client_of, explored_graph, look, view_of
from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.apps.explorer.pages.link import PairState
from wordcraft_kg.apps.explorer.pages.path import PathState
from wordcraft_kg.apps.explorer.predictor import recipes_giving
from wordcraft_kg.apps.explorer.site import Site, export_site
from wordcraft_kg.base import ConfigError, checked_values
from wordcraft_kg.graphs import COMBINES_WITH, PARTS, Planner, SplitConfig, make_split


def path_to(goal, *rows, base=None, page=1):
    return view_of(explored_graph(rows, base), PathState(goal, page))


def chain(length):
    """Each entity is made of the one before, twice: the tree doubles with each layer."""
    return [(f"{i:05}", f"{i:05}", f"{i + 1:05}") for i in range(length)]


def test_the_steps_are_the_cheapest_derivation(kitchen):
    """The steps are those of the cheapest derivation with the parts of their recipes."""
    planner, split = Planner(kitchen), make_split(kitchen, SplitConfig())
    explored = explored_graph(kitchen, split=split)
    part_of = {
        recipe: part for part in PARTS for recipe in kitchen.recipe_labels(split.recipes(part))
    }
    seen = set()
    for entity in kitchen.entities:
        view = view_of(explored, PathState(entity))
        found = planner.derivation(entity)
        assert tuple(step.recipe for step in view.listed) == found.steps
        assert [step.part for step in view.listed] == [part_of[recipe] for recipe in found.steps]
        assert sum(view.parts.values()) == view.paging.total == len(found.steps)
        assert view.outcome == ("made" if found.steps else "base")
        seen |= set(view.parts)
        checked_values(view)
    assert seen == {"train", "test"}


LOST = [("gone", "b", "d")]


@pytest.mark.parametrize(
    ("goal", "rows", "outcome", "blocked", "text"),
    [
        ("a", [("b", "b", "a")], "base", [], "a is a base entity"),
        ("c", [("a", "b", "c")], "made", [], "1 craft; 1 with train recipes"),
        ("d", LOST, "impossible", [("gone",)], "d cannot be made from the base (a, b)"),
        ("gone", LOST, "impossible", [], "No recipe makes it."),
        ("x", [("x", "b", "y"), ("y", "b", "x")], "impossible", [("y",)], "Missing ingredients"),
    ],
)
def test_a_path_says_whether_it_can_be_gone_and_why_not(goal, rows, outcome, blocked, text):
    explored = explored_graph([*rows, ("a", "b", "other")], ["a", "b"])
    view = view_of(explored, PathState(goal))
    assert (view.outcome, [row.missing for row in view.blocked]) == (outcome, blocked)
    assert view.paging.total == (1 if outcome == "made" else 0)
    assert text in look(explored, PathState(goal)).text


def test_the_view_says_what_unmakeable_entities_lack():
    rows = [
        ("lost", "a", "one"),
        ("one", "one", "goal"),
        ("a", "two", "goal"),
        ("gone", "lost", "two"),
    ]
    view = path_to("goal", *rows, base=["a"])
    assert [(row.recipe.ingredients[0], row.missing) for row in view.blocked] == [
        ("a", ("two",)),
        ("one", ("one",)),
    ]


def test_a_path_without_a_goal_leads_to_an_entity_of_the_last_layer(explored):
    view = view_of(explored, PathState())
    assert view == view_of(explored, PathState(entity=view.entity))


def test_a_graph_without_entities_has_no_path():
    """A graph without entities has no path in the menu and is no error of the program."""
    explored = explored_graph([])
    site = Site(explored, lambda page, state: page.address(state), str)
    assert {page.name for page, _ in site.menu}.isdisjoint({"path"})
    with pytest.raises(ConfigError, match="no entities"):
        view_of(explored, PathState())
    client = client_of(explored)
    answers = {name: client.get(f"/{name}") for name in PAGES}
    assert not [name for name, answer in answers.items() if answer.status_code >= 500]
    assert "The graph has no entities" in answers["path"].text


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
