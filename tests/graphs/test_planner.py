import graph_oracles as oracles
import pytest
from graph_strategies import ANY_GRAPHS
from hypothesis import given, strategies as st

from wordcraft_kg.base.errors import GraphError, UnknownEntityError
from wordcraft_kg.graphs import Derivation, Planner, Recipe, RecipeGraph, layers, rounds
from wordcraft_kg.graphs.planner import derivation_tree

STARTS = st.none() | st.sets(st.integers(0, 99))


def from_start(graph, numbers):
    """Return a start for the planner, None for the base, and the labels of its entities."""
    if numbers is None or not graph.entities:
        return None, set(graph.base)
    start = {graph.entities[number % graph.num_entities] for number in numbers}
    return start, start


@given(ANY_GRAPHS, STARTS)
def test_layers_and_rounds_equal_a_closure_round_by_round(graph, numbers):
    start, labels = from_start(graph, numbers)
    rows = graph.recipe_labels()
    assert layers(graph, start).tolist() == [
        oracles.layer(rows, label, labels) for label in graph.entities
    ]
    known = [len(after) for after in oracles.known_after_rounds(rows, labels)]
    assert rounds(layers(graph, start)) == (known if labels else [])


def test_a_start_may_be_given_by_ids_and_labels_more_than_once():
    graph = RecipeGraph.from_recipes([("a", "b", "c")])
    assert layers(graph, [0, "b", "a"]).tolist() == [0, 0, 1]
    assert Planner(graph, [0, "b", "a"]).costs == [0, 0, 1]


@given(ANY_GRAPHS, STARTS)
def test_costs_equal_lowering_them_until_nothing_changes(graph, numbers):
    start, labels = from_start(graph, numbers)
    expected = oracles.costs(graph.recipe_labels(), graph.entities, labels)
    assert dict(zip(graph.entities, Planner(graph, start).costs, strict=True)) == expected


def replay(graph, derivation, start):
    recipes, known, tree = set(graph.recipe_labels()), set(start), dict.fromkeys(start, 0)
    for step in derivation.steps:
        assert step in recipes
        assert set(step.ingredients) <= known
        assert step.result not in known
        known.add(step.result)
        tree[step.result] = 1 + sum(map(tree.__getitem__, step.ingredients))
    assert derivation.goal in known
    assert tree[derivation.goal] == derivation.cost
    assert len(derivation.steps) <= derivation.cost
    assert not derivation.steps or derivation.steps[-1].result == derivation.goal


@given(ANY_GRAPHS, STARTS)
def test_the_steps_of_a_derivation_can_be_carried_out_from_the_start(graph, numbers):
    start, labels = from_start(graph, numbers)
    planner = Planner(graph, start)
    for entity, depth in zip(graph.entities, layers(graph, start), strict=True):
        if depth < 0:
            with pytest.raises(GraphError, match="cannot be made"):
                planner.derivation(entity)
        else:
            derivation = planner.derivation(entity)
            assert derivation.goal == entity
            replay(graph, derivation, labels)


DERIVATIONS = {
    "a base entity costs nothing": (["aab", "bba"], "a", "a", [], 0),
    "a shared step counts each time": (["aab", "bbc"], "a", "c", ["aab", "bbc"], 3),
    "the earlier of equal recipes": (["bbg", "abg", "acg"], "abc", "g", ["abg"], 1),
    "cheaper, but made later": (
        ["bbc", "ccg", *(chain := ["aab", "abd", "ade", "aef", "afg"])],
        "a",
        "g",
        chain,
        5,
    ),
}


@pytest.mark.parametrize(
    ("rows", "base", "goal", "steps", "cost"), DERIVATIONS.values(), ids=DERIVATIONS
)
def test_the_cheapest_derivation_is_found(rows, base, goal, steps, cost):
    derivation = Planner(RecipeGraph.from_recipes(rows, base=base)).derivation(goal)
    assert derivation == Derivation(goal, tuple(Recipe.of(*row) for row in steps), cost)


def test_long_derivations_have_exact_costs_and_do_not_exhaust_the_stack():
    doubling = [(f"{i:04}", f"{i:04}", f"{i + 1:04}") for i in range(1100)]
    assert (
        Planner(RecipeGraph.from_recipes(doubling, base=["0000"])).derivation("1100").cost
        == 2**1100 - 1
    )
    chain = [("0000", f"{i:04}", f"{i + 1:04}") for i in range(3000)]
    assert (
        len(Planner(RecipeGraph.from_recipes(chain, base=["0000"])).derivation("3000").steps)
        == 3000
    )
    steps = [Recipe.of(f"x{i}", f"x{i}", f"x{i + 1}") for i in range(3_000)]
    assert sum(1 for _ in derivation_tree("x3000", steps)) == 3_000


def test_an_unreachable_goal_and_an_unknown_goal_or_start_are_refused(kitchen):
    graph = RecipeGraph.from_recipes([("a", "b", "c")], base=["a", "b"])
    with pytest.raises(GraphError, match="'c' cannot be made from b"):
        Planner(graph, ["b"]).derivation("c")
    for call in (Planner(kitchen).derivation, lambda label: layers(kitchen, [label])):
        with pytest.raises(UnknownEntityError, match="no entity 'bred'"):
            call("bred")


def test_a_derivation_is_shown_as_a_tree_in_which_nothing_is_made_twice():
    rows = [("a", "b", "c"), ("c", "a", "d"), ("d", "c", "e"), ("e", "e", "f")]
    derivation = Planner(RecipeGraph.from_recipes(rows)).derivation("f")
    lines = (
        "f = e + e",
        "└─ e = c + d",
        "   ├─ c = a + b",
        "   └─ d = a + c",
        "      └─ c (see above)",
    )
    assert tuple(str(derivation).splitlines()) == lines
    assert repr(derivation) == "Derivation('f', 4 steps, cost 9)"
    assert str(Planner(RecipeGraph.from_recipes(rows)).derivation("a")) == "a"
