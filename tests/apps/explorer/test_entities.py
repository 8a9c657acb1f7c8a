"""The overview, lists of entities and the search; an entity's recipes, cost, predictions, similar
entities and paths."""

from collections import Counter

import pytest
from helpers import refuses

from tests.apps.explorer.shown import client_of, explored_graph, look, view_by, view_of
from wordcraft_kg import ComplExConfig, LinksConfig, RecipeGraph, train_links
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import paging
from wordcraft_kg.apps.explorer.pages import PAGES, entities, entity
from wordcraft_kg.apps.explorer.pages.entities import list_entities, search_entities
from wordcraft_kg.apps.explorer.pages.entity import EntityState, RecipesState
from wordcraft_kg.apps.explorer.pages.home import HomeState
from wordcraft_kg.apps.explorer.pages.pair import PairState
from wordcraft_kg.apps.explorer.pages.path import PathState
from wordcraft_kg.apps.explorer.predictor import recipes_giving
from wordcraft_kg.apps.explorer.site import Site, export_site
from wordcraft_kg.base import ConfigError, checked_values
from wordcraft_kg.graphs import COMBINES_WITH, PARTS, Planner, SplitConfig, layers, make_split

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


@pytest.mark.parametrize(
    ("settings", "train_sample"),
    [
        ({}, ""),
        (
            {"train_fraction": 0.5, "label_noise": 0.25},
            "50 % of the train recipes, 25 % of them with a wrong result",
        ),
    ],
)
def test_a_model_that_was_taught_a_dose_says_of_what(settings, train_sample, tmp_path):
    config = LinksConfig("kitchen", ComplExConfig(dim=2, epochs=1, n3=0.1, folds=0, **settings))  # type: ignore[arg-type]
    explored = Explored.open("kitchen", [train_links(config, tmp_path / "model").folder])
    assert [line.train_sample for line in view_of(explored, HomeState()).models] == [train_sample]
    assert f">{train_sample or 'train recipes'}<" in look(explored, HomeState()).page


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


def test_the_list_has_every_entity_in_the_order_asked_for(kitchen, monkeypatch):
    monkeypatch.setattr(entities, "ENTITIES_A_PAGE", 7)
    layer = layers(kitchen).tolist()
    made = [
        sum(row[2] == i for row in kitchen.recipes.tolist()) for i in range(kitchen.num_entities)
    ]
    used = [
        sum(i in row[:2] for row in kitchen.recipes.tolist()) for i in range(kitchen.num_entities)
    ]
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
        rows = [
            row
            for page in range(1, pages + 1)
            for row in list_entities(kitchen, "", order, page).entities
        ]
        assert [(row.entity, row.layer, row.recipes, row.uses) for row in rows] == expected


def test_an_entity_that_cannot_be_made_has_no_layer():
    graph = RecipeGraph.from_recipes([("a", "b", "c"), ("d", "d", "d2")], base=["a", "b"])
    assert [row.layer for row in list_entities(graph).entities] == [0, 0, 1, None, None]
    assert [row.entity for row in list_entities(graph, order="layer").entities] == [
        "a",
        "b",
        "c",
        "d",
        "d2",
    ]


@pytest.mark.parametrize(
    ("rows", "wanted", "expected"),
    [
        (
            [(a, "tree", b) for a in PIES for b in PIES if a != b],
            "pie",
            ("pie", "piece", "apple pie", "magpie"),
        ),
        ([("pie", "tree", "piece")], "  ", ()),
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
    assert search_entities(graph, wanted) == expected
    assert search_entities(graph, wanted, limit=2) == expected[:2]
    assert list_entities(graph, wanted).paging.total == len(expected) or not wanted.strip()


def test_recipes_that_make_and_use_an_entity_have_their_parts(neighbours, monkeypatch):
    monkeypatch.setattr(entity, "LISTED", 1_000)
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
    for learned in (False, True):
        found = view_by(neighbours, EntityState("bread", learned=learned))
        queries = [(slot.head, slot.relation, slot.tail) for slot in found.slots]
        assert queries[:2] == [("bread", "combinesWith", None), (None, "componentOf", "bread")]
        assert queries[2:] == [("bread", "componentOf", None)]
        assert ("learned" in {row.status for slot in found.slots for row in slot.best}) == learned
        assert found.model == neighbours.name


def test_the_nearest_in_the_model_are_not_the_entity_itself(neighbours):
    found = view_by(neighbours, EntityState("bread")).nearest
    assert len({row.entity for row in found} - {"bread"}) == len(found) == 8
    cosines = [row.cosine for row in found]
    assert cosines == sorted(cosines, reverse=True)
    assert cosines[0] > 0.3


def test_the_partner_of_an_entity_may_be_itself():
    explored = explored_graph([("a", "a", "b"), ("a", "z", "b"), ("Z", "a", "b")])
    rows = view_of(explored, RecipesState("a")).recipes
    assert [row.partners("a") for row in rows] == [("Z",), ("a",), ("z",)]


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
    for goal in kitchen.entities:
        view = view_of(explored, PathState(goal))
        found = planner.derivation(goal)
        assert tuple(step.recipe for step in view.listed) == found.steps
        assert [step.number for step in view.listed] == list(range(1, len(found.steps) + 1))
        assert [step.part for step in view.listed] == [part_of[recipe] for recipe in found.steps]
        assert sum(view.parts.values()) == view.steps == len(found.steps)
        assert view.outcome == ("made" if found.steps else "base")
        assert view.cost == f"{found.cost:,}"
        seen |= set(view.parts)
        checked_values(view)
    assert seen == {"train", "test"}


LOST = [("gone", "b", "d")]


@pytest.mark.parametrize(
    ("goal", "rows", "outcome", "blocked", "sources", "text"),
    [
        ("a", [("b", "b", "a")], "base", [], (), "a is a base entity"),
        ("c", [("a", "b", "c")], "made", [], (), "1 craft; 1 with train recipes"),
        ("d", LOST, "impossible", [("gone",)], ("gone",), "d cannot be made from the base (a, b)"),
        (
            "d",
            LOST,
            "impossible",
            [("gone",)],
            ("gone",),
            "entities without recipes outside the base: gone.",
        ),
        ("gone", LOST, "impossible", [], ("gone",), "No recipe makes it."),
        ("x", [("x", "b", "y"), ("y", "b", "x")], "impossible", [("y",)], (), "form a cycle"),
    ],
)
def test_a_path_says_whether_it_can_be_gone_and_why_not(
    goal, rows, outcome, blocked, sources, text
):
    explored = explored_graph([*rows, ("a", "b", "other")], ["a", "b"])
    view = view_of(explored, PathState(goal))
    assert (view.outcome, [row.missing for row in view.blocked], view.sources) == (
        outcome,
        blocked,
        sources,
    )
    assert view.steps == (1 if outcome == "made" else 0)
    assert text in look(explored, PathState(goal)).text


def test_the_view_says_what_unmakeable_entities_lack():
    """Of what cannot be made the view says what its recipes lack and where that ends."""
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
    assert (view.sources, view.num_sources, view.recipes) == (("gone", "lost"), 2, 2)


CHAIN = [
    ("a", "b", "c"),
    ("c", "a", "d"),
    ("c", "x", "e"),
    ("e", "e", "d"),
    ("d", "d", "f"),
    ("lone", "lone", "two"),
]


@pytest.mark.parametrize(
    ("start", "goal", "ends", "recipes", "text"),
    [
        (
            "a",
            "f",
            "af",
            ["a + c -> d", "d + d -> f"],
            "The shortest chain from a to f has 2 recipes",
        ),
        ("x", "f", "xf", ["c + x -> e", "e + e -> d", "d + d -> f"], "from x to f has 3 recipes"),
        (
            "f",
            "x",
            "xf",
            ["c + x -> e", "e + e -> d", "d + d -> f"],
            "No chain of recipes leads from f to x. The shortest",
        ),
        (
            "lone",
            "f",
            ("lone", "f"),
            [],
            "No chain of recipes leads from lone to f, and none leads back.",
        ),
        ("a", "a", "aa", [], "a is the start and the goal"),
    ],
)
def test_a_chain_leads_between_two_entities_or_is_missing(start, goal, ends, recipes, text):
    """A chain of recipes leads between any two entities or back or is said to be missing."""
    explored = explored_graph(CHAIN, ["a", "b", "x"])
    chain = view_of(explored, PathState(goal, start=start)).chain
    assert (chain.start, chain.end) == tuple(ends)
    assert ["{} + {} -> {}".format(*step.recipe) for step in chain.steps] == recipes
    page = look(explored, PathState(goal, start=start))
    assert text in page.text
    assert all(recipe.replace("->", "→") in page.text for recipe in recipes)


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
