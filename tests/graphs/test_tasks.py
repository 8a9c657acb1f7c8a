import itertools

import numpy as np
import pytest
from graph_strategies import graphs, graphs_of_sets
from hypothesis import given, strategies as st

from wordcraft_kg.base.errors import ConfigError, TaskError
from wordcraft_kg.graphs import (
    RecipeGraph,
    Split,
    SplitConfig,
    make_split,
    tasks,
)
from wordcraft_kg.graphs.splits import PARTS
from wordcraft_kg.graphs.tasks import (
    MAX_DEPTH,
    TWICE_SHARE,
    SolutionSearch,
    make_tasks,
)


def outcomes(graph):
    """Results of each set of ingredients."""
    found = {}
    for recipe in graph.recipe_labels():
        found.setdefault(recipe.ingredients, set()).add(recipe.result)
    return found


def plans_by_trying(book, start, attempts):
    """Try every pair at hand, again and again; return what first comes up after 1, 2, ... attempts,
    with the pairs.

    No attempt in these sets is idle: without it the entity would have come up before.
    """
    tried = {frozenset(): frozenset(start)}
    seen = set(start)
    rounds = []
    for _ in range(attempts):
        tried = {
            used | {pair}: at_hand | results
            for used, at_hand in tried.items()
            for pair, results in book.items()
            if at_hand.issuperset(pair) and pair not in used
        }
        new = {}
        for used, at_hand in tried.items():
            for entity in at_hand - seen:
                new.setdefault(entity, set()).add(used)
        rounds.append(new)
        seen |= new.keys()
    return rounds


def tasks_by_trying(graph, depth):
    """Try every set of starting ingredients: the goals that come up in the last round, if some plan
    uses the set up."""
    book = outcomes(graph)
    tasks = {}
    for size in range(1, graph.most_leaves(depth) + 1):
        for start in itertools.combinations(graph.entities, size):
            for goal, plans in plans_by_trying(book, set(start), depth)[-1].items():
                if any(set(start) <= set().union(*plan) for plan in plans):
                    tasks[goal, start] = plans
    return tasks


def replay(graph, start, plan):
    """Carry out a plan; return the labels at hand."""
    at_hand = {*start}
    for recipe in plan:
        assert at_hand.issuperset(recipe.ingredients)
        results = graph.labels(graph.results(*recipe.ingredients))
        assert recipe.result in results
        at_hand.update(results)
    return at_hand


def pairs(plan):
    return frozenset(recipe.ingredients for recipe in plan)


def tasks_made(graph, depth, *arguments, **options):
    try:
        return list(make_tasks(graph, depth, *arguments, twice_share=None, **options))
    except TaskError:
        return []


@given(graphs(min_size=8) | graphs_of_sets(min_size=8), st.data())
def test_plans_are_all_that_trying_every_pair_finds(graph, data):
    start = data.draw(st.sets(st.sampled_from(graph.entities), min_size=1, max_size=4))
    rounds = plans_by_trying(outcomes(graph), start, 3)
    search = SolutionSearch(graph)
    have = frozenset(map(graph.id_of, start))
    for goal in graph.entities:
        ways = search.shortest_ways(graph.id_of(goal), have, 3)
        expected = next((plans[goal] for plans in rounds if goal in plans), set())
        found = [
            tuple(graph.recipe_labels(graph.sets[list(rows)]))
            for rows in search.ordered(ways, graph.id_of(goal), have)
        ]
        if goal in start:
            assert found == [()]
        else:
            assert {pairs(plan) for plan in found} == expected
            assert len(found) == len(expected)
        for plan in found:
            assert goal in replay(graph, start, plan)
            made = [recipe.result for recipe in plan]
            assert len(set(made)) == len(made)
            assert not start & set(made)
            assert not plan or made[-1] == goal


def test_ways_are_the_same_if_too_much_is_within_reach_to_look_up(kitchen, monkeypatch):
    start = frozenset(kitchen.base_ids.tolist())
    goals = range(kitchen.num_entities)
    search = SolutionSearch(kitchen)
    expected = [search.shortest_ways(goal, start, 4) for goal in goals]
    assert any(len(way) == 4 for ways in expected for way in ways)
    for most in (0, len(start)):
        monkeypatch.setattr(tasks, "_MOST_NEAR", most)
        assert [search.shortest_ways(goal, start, 4) for goal in goals] == expected


def test_ways_are_also_longer_than_the_shortest_but_never_go_in_circles():
    graph = RecipeGraph.from_recipes(["aab", "abc", "acb", "bbg", "ccg"])
    pair = {(a, b): number for number, (a, b, _) in enumerate(graph.recipe_labels())}
    short, long = {pair["a", "a"], pair["b", "b"]}, {pair["a", "a"], pair["a", "b"], pair["c", "c"]}
    search, goal, start = SolutionSearch(graph), graph.id_of("g"), frozenset([graph.id_of("a")])
    assert search.shortest_ways(goal, start, 5) == {frozenset(short)}
    every_way = search._ways(goal, [start, *[None] * 5], 5, frozenset())
    assert every_way == {frozenset(short), frozenset(long)}


@pytest.mark.parametrize("depth", [1, 2])
@given(graph=graphs(tuple("abcdef"), min_size=4) | graphs_of_sets(min_size=4))
def test_tasks_are_all_that_trying_every_start_finds(depth, graph):
    expected = tasks_by_trying(graph, depth)
    found = tasks_made(graph, depth)
    assert {
        (task.goal, task.start): {pairs(plan) for plan in task.plans} for task in found
    } == expected
    assert len(found) == len(expected)


@pytest.fixture(
    params=[1, 2, 3, pytest.param(4, marks=pytest.mark.slow)],
    ids=["depth 1", "depth 2", "depth 3", "depth 4"],
)
def kitchen_tasks(kitchen, request):
    return make_tasks(kitchen, request.param, limit=300, twice_share=None)


def test_every_plan_makes_the_goal_and_none_is_shorter(kitchen, kitchen_tasks):
    """Every plan of every task makes the goal and one attempt fewer never does."""
    book = outcomes(kitchen)
    assert len({(task.goal, task.start) for task in kitchen_tasks}) == len(kitchen_tasks)
    assert kitchen_tasks.is_complete == (kitchen_tasks.depth <= 2)
    for task in kitchen_tasks:
        assert task.goal not in task.start
        for plan in task.plans:
            assert task.goal in replay(kitchen, task.start, plan)
            assert len(pairs(plan)) == task.depth
            assert plan[-1].result == task.goal
        assert any(set(task.start) <= set().union(*pairs(plan)) for plan in task.plans)
        rounds = plans_by_trying(book, set(task.start), task.depth - 1)
        assert not any(task.goal in plans for plans in rounds)


def test_arrays_and_labels_of_tasks_agree(kitchen, kitchen_tasks):
    made = kitchen_tasks
    assert made.goals.shape == (len(made),)
    assert made.starts.shape == (len(made), made.depth + 1)
    for index, task in enumerate(made):
        assert kitchen.entities[made.goals[index]] == task.goal
        padded = [
            *map(kitchen.id_of, task.start),
            *[kitchen.num_entities] * (made.depth + 1 - len(task.start)),
        ]
        assert made.starts[index].tolist() == padded
        between = {recipe.result for plan in task.plans for recipe in plan} - {task.goal}
        assert set(made.intermediates[index].tolist()) - {kitchen.num_entities} == {
            *map(kitchen.id_of, between)
        }
        last = {tuple(map(kitchen.id_of, plan[-1][:2])) for plan in task.plans}
        firsts = kitchen.recipes[kitchen.pair_starts[:-1], :2].tolist()
        assert {
            tuple(firsts[pair]) for pair in made.final_pairs[index].tolist() if pair >= 0
        } == last


def test_drawing_ends_when_no_new_task_comes_up():
    graph = RecipeGraph.from_recipes([("a", "b", "c"), ("a", "c", "d"), ("a", "d", "e")])
    made = make_tasks(graph, 3, limit=50)
    assert [(task.goal, task.start) for task in made] == [("e", ("a", "b"))]
    assert not made.is_complete


def part_of(task, split):
    """The part that a task with plans by all recipes belongs to, or "mixed"."""
    parts = dict(
        zip(split.graph.recipe_labels(), (PARTS[part] for part in split.parts), strict=True)
    )
    uses = [{parts[recipe] for recipe in plan} for plan in task.plans]
    if all(used == {"train"} for used in uses):
        return "train"
    if all("test" in used for used in uses):
        return "test"
    return "valid" if all("valid" in used and "test" not in used for used in uses) else "mixed"


@pytest.mark.parametrize(
    ("kind", "valid_ratio", "depth"),
    [
        pytest.param("by-recipe", 0, 1, marks=pytest.mark.slow),
        pytest.param("by-goal", 0, 1, marks=pytest.mark.slow),
        ("by-goal", 0.1, 1),
        pytest.param("by-recipe", 0.1, 2, marks=pytest.mark.slow),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ("by-recipe", 0.1, 1),
                ("by-goal", 0.1, 2),
                ("by-recipe", 0, 2),
                ("by-goal", 0, 2),
            )
        ),
    ],
)
def test_each_task_belongs_to_the_part_of_its_plans_or_to_none(kitchen, kind, valid_ratio, depth):
    split = make_split(kitchen, SplitConfig(kind, 0.7, valid_ratio, seed=1))
    every = make_tasks(kitchen, depth, split, "all", twice_share=None)
    expected = {
        part: [task for task in every if part_of(task, split) == part] for part in (*PARTS, "mixed")
    }
    # Train tasks are those of a book of the train recipes: more, and other ones at depth 2.
    of_train_book = [*make_tasks(train_book(split), depth, twice_share=None)]
    assert (expected["train"] != of_train_book) == bool(expected["mixed"])
    expected["train"] = of_train_book
    assert expected["test"]
    assert bool(expected["valid"]) == bool(valid_ratio)
    for part in PARTS:
        if expected[part]:
            made = make_tasks(kitchen, depth, split, part, twice_share=None)
            assert list(made) == expected[part]
            mixed = 0 if part == "train" else len(expected["mixed"])
            assert (made.part, made.mixed) == (part, mixed)
        else:
            assert not tasks_made(kitchen, depth, split, part)
    # Depth 1, by goal: all plans end, and begin, with a recipe of the one goal.
    assert bool(expected["mixed"]) == (depth == 2 or kind == "by-recipe")


def train_book(split):
    """A graph of the train recipes, with the same entities."""
    graph = split.graph
    return RecipeGraph(graph.entities, split.recipes("train"), graph.base_ids, graph.name)


BRANCHED = RecipeGraph.from_recipes(
    [
        *[("a", "b", "c"), ("a", "b", "d")],  # one attempt makes both
        *[("a", "c", "e"), ("c", "d", "e"), ("d", "d", "f"), ("a", "x", "f")],
        *[("e", "f", "g"), ("c", "f", "g"), ("e", "e", "h"), ("b", "g", "i")],
        *[("b", "h", "d"), ("g", "h", "g")],  # a circle, by way of e, and a self result
    ]
)
PART_OF_ROW = {
    ("a", "c", "e"): "test",
    ("e", "f", "g"): "test",
    ("a", "x", "f"): "valid",
    ("e", "e", "h"): "test",
}
BRANCHED_SPLIT = Split(
    BRANCHED,
    SplitConfig("by-recipe"),
    np.array(
        [PARTS.index(PART_OF_ROW.get(row, "train")) for row in BRANCHED.recipe_labels()],
        dtype=np.int8,
    ),
)


@pytest.mark.parametrize(
    ("arguments", "error", "says"),
    [
        ({"depth": 0}, ConfigError, "`depth` 0: expected a whole number, 1 to 5"),
        ({"depth": 7}, ConfigError, "`depth` 7: expected a whole number, 1 to 5"),
        ({"part": "tests"}, ConfigError, "`part` 'tests': expected one of all, train, valid, test"),
        ({"part": "test"}, TaskError, "`part` 'test' needs a split"),
        (
            {"part": "train", "split": BRANCHED_SPLIT},
            TaskError,
            "the split belongs to another graph",
        ),
    ],
)
def test_tasks_that_make_no_sense_are_refused(kitchen, arguments, error, says):
    with pytest.raises(error, match=says):
        make_tasks(kitchen, **arguments)


@pytest.mark.parametrize(
    "recipes", [[], [("a", "b", "a")], [("a", "a", "a")]], ids=["none", "self result", "one"]
)
@pytest.mark.parametrize("depth", range(1, MAX_DEPTH + 1))
def test_a_graph_without_tasks_is_refused(recipes, depth):
    with pytest.raises(TaskError, match=f"graph has no task of depth {depth}"):
        make_tasks(RecipeGraph.from_recipes(recipes), depth)


def test_a_part_without_tasks_is_refused_saying_how_many_belong_to_none():
    # d is made from a, b with c as the intermediate, or with e; one of the two plans is held out.
    graph = RecipeGraph.from_recipes(
        [("a", "b", "c"), ("a", "c", "d"), ("a", "a", "e"), ("b", "e", "d")]
    )
    parts = np.array([row == ("b", "e", "d") for row in graph.recipe_labels()], dtype=np.int8) * 2
    split = Split(graph, SplitConfig(), parts)
    with pytest.raises(
        TaskError, match=r"graph has no task of depth 2 in the test part \(1 belong to no part\)"
    ):
        make_tasks(graph, 2, split, "test")


def test_tasks_of_depth_two_are_drawn_where_too_many_plans_lead_to_them(kitchen, monkeypatch):
    every_task = make_tasks(kitchen, 2, twice_share=None)
    by_share = make_tasks(kitchen, 2)
    plans = sum(
        len(SolutionSearch(kitchen).recipes_of[part])
        for a, b, _ in kitchen.recipes
        for part in (a, b)
    )
    monkeypatch.setattr(tasks, "MAX_ENUMERATED", plans)
    assert make_tasks(kitchen, 2).hash == by_share.hash
    monkeypatch.setattr(tasks, "MAX_ENUMERATED", plans - 1)
    drawn = make_tasks(kitchen, 2, limit=30)
    assert (len(drawn), drawn.is_complete) == (30, False)
    assert set(drawn) < set(every_task)
    assert make_tasks(kitchen, 1).is_complete


@pytest.mark.parametrize("depth", [2, 3])
def test_a_stated_share_of_the_tasks_uses_an_entity_twice(kitchen, depth):
    tasks = make_tasks(kitchen, depth, limit=60)
    every_task = make_tasks(kitchen, depth, limit=60, twice_share=None)
    assert abs(tasks.uses_twice.mean() - TWICE_SHARE) < 1 / len(tasks)
    assert abs(every_task.uses_twice.mean() - TWICE_SHARE) > 2 / len(tasks)
    assert [len(set(task.start)) <= depth for task in tasks] == tasks.uses_twice.tolist()
    if depth == 2:
        assert set(tasks) < set(every_task)
