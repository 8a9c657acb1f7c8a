import msgspec
import pytest

from tests.apps.explorer.shown import explored_graph, view_of
from wordcraft_kg.apps.explorer.pages import path as paths
from wordcraft_kg.apps.explorer.pages.path import Path, PathView
from wordcraft_kg.base.errors import ConfigError, UnknownEntityError
from wordcraft_kg.base.records import checked_values
from wordcraft_kg.graphs import Planner, SplitConfig, make_split


def path_to(goal: str, *rows: tuple[str, str, str], base: list[str] | None = None, page: int = 1) -> PathView:
    return view_of(explored_graph(rows, base), Path(goal, page))


def chain(length: int) -> list[tuple[str, str, str]]:
    """Each entity is made of the one before, twice: the tree doubles with each layer."""
    return [(f"{i:05}", f"{i:05}", f"{i + 1:05}") for i in range(length)]


def test_the_steps_are_those_of_the_cheapest_derivation_with_the_parts_of_their_recipes(kitchen):
    planner, split = Planner(kitchen), make_split(kitchen, SplitConfig())
    explored = explored_graph(kitchen, split=split)
    part_of = {
        recipe: part for part in ("train", "valid", "test") for recipe in kitchen.recipe_labels(split.recipes(part))
    }
    seen = set()
    for entity in kitchen.entities:
        view = view_of(explored, Path(entity))
        found = planner.derivation(entity)
        assert tuple(step.recipe for step in view.listed) == found.steps
        assert [step.number for step in view.listed] == list(range(1, len(found.steps) + 1))
        assert [step.part for step in view.listed] == [part_of[recipe] for recipe in found.steps]
        assert sum(view.parts.values()) == view.steps == len(found.steps)
        assert view.outcome == ("made" if found.steps else "base")
        assert view.cost == f"{found.cost:,}"
        seen |= set(view.parts)
        checked_values(view)
    assert seen == {"train", "test"}


def test_each_craft_is_a_layer_after_all_that_it_needs_and_a_layer_before_something_that_needs_it(kitchen):
    explored = explored_graph(kitchen)
    for entity in kitchen.entities:
        view = view_of(explored, Path(entity))
        layer = {step.recipe.result: step.layer for step in view.listed}
        needed_in: dict[str, set[int]] = {}
        for step in view.listed:
            for part in step.recipe[:2]:
                assert layer.get(part, 0) < step.layer
                needed_in.setdefault(part, set()).add(step.layer)
        for label, number in layer.items():
            assert label == entity or min(needed_in[label]) == number + 1
        assert set(layer.values()) == set(range(1, view.layers + 1))


def test_what_is_needed_late_is_crafted_late():
    view = path_to("e", ("a", "a", "b"), ("b", "b", "c"), ("x", "x", "y"), ("c", "y", "e"), base=["a", "x"])
    assert {step.recipe.result: step.layer for step in view.listed} == {"b": 1, "c": 2, "y": 2, "e": 3}


def test_a_base_entity_needs_no_craft_even_if_a_recipe_makes_it():
    view = path_to("a", ("b", "b", "a"), base=["a", "b"])
    assert (view.outcome, view.steps, view.layers, view.drawn) == ("base", 0, 0, ())


def test_of_what_cannot_be_made_the_view_says_what_its_recipes_lack_and_where_that_ends():
    rows = [("lost", "a", "one"), ("one", "one", "goal"), ("a", "two", "goal"), ("gone", "lost", "two")]
    view = path_to("goal", *rows, base=["a"])
    assert view.outcome == "impossible"
    assert [(row.recipe.ingredient_a, row.missing) for row in view.blocked] == [("a", ("two",)), ("one", ("one",))]
    assert view.sources == ("gone", "lost")
    assert (view.num_sources, view.recipes, view.steps) == (2, 2, 0)


def test_recipes_that_need_each_others_results_end_nowhere():
    view = path_to("x", ("x", "a", "y"), ("y", "a", "x"), base=["a"])
    assert (view.outcome, view.sources) == ("impossible", ())
    assert [row.missing for row in view.blocked] == [("y",)]


def test_what_no_recipe_makes_is_its_own_source():
    view = path_to("b", ("a", "b", "c"), base=["a"])
    assert (view.outcome, view.blocked, view.sources) == ("impossible", (), ("b",))


def test_a_long_path_is_listed_page_by_page_and_its_last_layers_are_drawn(monkeypatch):
    monkeypatch.setattr(paths, "STEPS_A_PAGE", 4)
    monkeypatch.setattr(paths, "DRAWN", 3)
    view = path_to("00009", *chain(9), page=3)
    assert [step.number for step in view.listed] == [9]
    assert (view.paging.pages, view.steps) == (3, 9)
    assert [step.layer for step in view.drawn] == [7, 8, 9]
    with pytest.raises(ConfigError, match="there are 3 pages"):
        path_to("00009", *chain(9), page=4)


def test_a_cost_of_thousands_of_digits_is_a_power_of_ten():
    view = path_to("20000", *chain(20_000))
    assert view.cost == "about 4 × 10^6020"
    assert view.steps == view.layers == 20_000
    assert len(view.drawn) == paths.DRAWN
    msgspec.json.encode(view)


def test_a_goal_that_is_not_there_is_an_error():
    with pytest.raises(UnknownEntityError, match="no entity 'z'"):
        path_to("z", ("a", "b", "c"))
