"""Entities that others need, and the size of what can be made."""

import sys
from importlib import import_module
from pathlib import Path

from graph_strategies import graphs
from hypothesis import given

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
