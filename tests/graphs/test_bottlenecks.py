"""Entities that others need, and the size of what can be made."""

import sys
from importlib import import_module
from pathlib import Path

from graph_strategies import graphs
from hypothesis import given

from wordcraft_kg.base.records import as_values
from wordcraft_kg.graphs import RecipeGraph, layers

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
script = import_module("bottlenecks")
bottlenecks = script.bottlenecks
world_statistics = script.world_statistics


def made_from(recipes, known, without=None):
    """All that can be made, by trying all recipes again and again."""
    known = set(known) - {without}
    while True:
        new = {c for a, b, c in recipes if a in known and b in known and c != without} - known
        if not new:
            return known
        known |= new


@given(graphs())
def test_bottlenecks_are_what_closures_without_each_entity_lose(graph):
    recipes = graph.recipes.tolist()
    base = graph.base_ids.tolist()
    reachable = made_from(recipes, base)
    expected = {}
    for entity in reachable - set(base):
        lost = len(reachable) - len(made_from(recipes, base, entity)) - 1
        if lost:
            expected[entity] = lost
    found = bottlenecks(graph)
    assert dict(found) == expected
    assert found == sorted(found, key=lambda pair: (-pair[1], pair[0]))


def test_the_statistics_of_a_chain_are_known():
    rows = [("a", "b", "c"), ("a", "c", "d"), ("c", "d", "e"), ("b", "d", "e"), ("x", "a", "y")]
    graph = RecipeGraph.from_recipes(rows, ["a", "b"])
    found = world_statistics(graph)
    assert [tuple(as_values(each).values()) for each in found.bottlenecks] == [
        ("c", 2, 1),
        ("d", 1, 2),
    ]
    assert found.main.entity == "c"
    assert found.width == (2, 1, 1, 1)
    assert (found.reachable, found.pairs) == (5, 15)
    assert found.success_rate == 4 / 15
    assert world_statistics(graph, ["a", "b", "x"]).reachable == 7
    assert (layers(graph)[[graph.id_of("x"), graph.id_of("y")]] == -1).all()


def test_the_main_bottleneck_is_the_last_one_before_half_of_the_world():
    """``gate`` and ``door`` are on the way to all, ``lamp`` to a few; ``door`` is made last."""
    rows = [
        ("a", "b", "gate"),
        ("a", "gate", "door"),
        ("b", "gate", "lamp"),
        ("a", "lamp", "light"),
    ]
    rows += [("a", "door", "one"), ("b", "door", "two"), ("door", "door", "three")]
    found = world_statistics(RecipeGraph.from_recipes(rows, ["a", "b"]))
    assert [each.entity for each in found.bottlenecks] == ["gate", "door", "lamp"]
    # 3 of 9 entities need the door: less than half, so the one needed by most counts.
    assert found.main.entity == "gate"
    rows += [("a", "one", "four"), ("a", "two", "five"), ("a", "three", "six")]
    assert world_statistics(RecipeGraph.from_recipes(rows, ["a", "b"])).main.entity == "door"
    plain = world_statistics(RecipeGraph.from_recipes([("a", "b", "c")], ["a", "b"]))
    assert (plain.main, plain.bottlenecks) == (None, ())


def test_the_main_bottleneck_of_little_alchemy_2_is_life(alchemy):
    found = world_statistics(alchemy)
    assert found.main.entity == "life"
    assert found.main.needed_by == 574
