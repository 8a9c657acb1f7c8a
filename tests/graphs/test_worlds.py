"""Worlds that are cut out of books, wrong recipes, and the entities that others need."""

import numpy as np
import pytest
from graph_strategies import graphs
from hypothesis import given
from refusals import refuses

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.base.records import as_values
from wordcraft_kg.graphs import RecipeBook, RecipeGraph, layers, open_book, open_graph
from wordcraft_kg.graphs.library import locate_book, without_prefixes
from wordcraft_kg.graphs.worlds import (
    SIZES,
    WAYS,
    bottlenecks,
    cut_world,
    with_wrong_recipes,
    world_statistics,
)

SMALL = (20, 40)
GOLDEN = ["9515e6c95ace", "cfb5e820a644"]
"""Begin of the hashes of the worlds 0 and 7 of ``everyday``."""


@pytest.fixture(scope="module")
def everyday():
    return open_book("everyday")


def made_from(recipes, known, without=None):
    """All that can be made, by trying all recipes again and again."""
    known = set(known) - {without}
    while True:
        new = {c for a, b, c in recipes if a in known and b in known and c != without} - known
        if not new:
            return known
        known |= new


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    "seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)]
)
def test_a_world_has_all_recipes_among_its_entities_and_all_can_be_made(everyday, way, seed):
    world = cut_world(everyday, seed, way)
    entities = set(world.entities)
    assert SIZES[0] <= len(entities) <= SIZES[1]
    assert 4 <= len(world.base) <= 6
    inside = {recipe for recipe in everyday.recipes if entities.issuperset(recipe)}
    assert set(world.recipes) == inside
    assert made_from(world.recipes, world.base) == entities
    assert {world.kinds[recipe] for recipe in world.recipes} <= set(everyday.kinds.values())
    if way != "base":
        assert world.base == everyday.base


def test_worlds_differ_by_seed_and_way_and_depend_on_nothing_else(everyday):
    worlds = {(seed, way): cut_world(everyday, seed, way) for seed in range(2) for way in WAYS}
    assert len({world.recipes for world in worlds.values()}) == len(worlds)
    assert len({world.sha256 for world in worlds.values()}) == len(worlds)
    for (seed, way), world in worlds.items():
        assert cut_world(everyday, seed, way) == world
    # The ways take turns with the seed.
    assert cut_world(everyday, 1).recipes == worlds[1, "topic"].recipes
    graphs_of_two = [RecipeGraph.from_book(cut_world(everyday, seed)).hash[:12] for seed in (0, 7)]
    # Known figures refer to these worlds: the draws may never change.
    assert graphs_of_two == GOLDEN


@pytest.mark.slow
def test_entities_of_a_topic_are_closer_than_those_of_a_closure(everyday):
    """A world around a topic has more recipes for its size than a random one."""

    def density(way):
        worlds = [cut_world(everyday, seed, way) for seed in range(6)]
        return np.mean([len(world.recipes) / len(world.entities) for world in worlds])

    assert density("topic") > 1.05 * density("closure")


@pytest.mark.parametrize("way", WAYS)
def test_a_book_with_another_number_of_base_entities_gets_a_drawn_base(way):
    kitchen = open_book("kitchen")
    assert len(RecipeGraph.from_book(kitchen).base) == 8
    world = cut_world(kitchen, 4, way, sizes=SMALL)
    assert 4 <= len(world.base) <= 6
    assert SMALL[0] <= len(world.entities) <= SMALL[1]
    assert made_from(world.recipes, world.base) == set(world.entities)


@pytest.mark.slow
def test_a_name_makes_a_world_and_prefixes_follow_each_other(everyday):
    assert open_book("world-topic-3:everyday") == cut_world(everyday, 3, "topic")
    wrong = open_book("world-3:wrong-30-2:everyday")
    assert wrong == cut_world(with_wrong_recipes(everyday, 30, 2), 3)
    assert wrong.name == "world-3-wrong-30-2-everyday"
    made_up = open_graph("world-2:made-up:everyday").graph
    assert len(made_up.entities) == len(cut_world(everyday, 2).entities)
    assert without_prefixes("world-2:made-up-5:wrong-9:a:b.csv") == (
        "world-2:made-up-5:wrong-9:",
        "a:b.csv",
    )
    assert without_prefixes("world-x:everyday") == ("", "world-x:everyday")
    with pytest.raises(RecipeFileError, match="made from 'kitchen'; give that book"):
        locate_book("world-1:kitchen")


def test_books_that_are_too_small_and_odd_settings_are_refused(everyday):
    with pytest.raises(RecipeFileError, match=r"at least 200 entities in kitchen: .* of its 80"):
        open_book("world-0:kitchen")
    one = RecipeBook.of("one", [], base=["water"])
    with pytest.raises(RecipeFileError, match="1 of its 1 entities"):
        cut_world(one, 0)
    # Most of the book lies out of reach.
    rows = [("a", "b", "c"), *(("x", f"{n}", f"{n + 1}") for n in range(300))]
    apart = RecipeBook.of("apart", rows, base=["a", "b", "c", "x"])
    with pytest.raises(RecipeFileError, match="4 of its 305 entities"):
        cut_world(apart, 1)
    with refuses("way"):
        cut_world(everyday, 0, "luck")
    with refuses("seed"):
        cut_world(everyday, -1)
    with refuses("percent"):
        open_book("wrong-101:kitchen")
    with refuses("percent"):
        with_wrong_recipes(RecipeBook.of("one", [("a", "b", "c")]), 100)


def test_a_pair_with_thousands_of_results_fills_a_world_and_no_more():
    rows = [("a", "b", f"thing {n}") for n in range(5_000)]
    book = RecipeBook.of("many", rows, base=["a", "b", "c", "d"])
    for way in WAYS:
        try:
            world = cut_world(book, 0, way)
        except RecipeFileError:
            assert way == "topic"
            continue
        assert SIZES[0] <= len(world.entities) <= SIZES[1]


@pytest.mark.parametrize("percent", [1, 30, 100])
def test_wrong_recipes_exchange_results_and_keep_none_of_a_pair(percent):
    book = open_book("kitchen")
    wrong = with_wrong_recipes(book, percent)
    new = set(wrong.recipes) - set(book.recipes)
    assert len(wrong.recipes) == len(book.recipes)
    assert len(new) == pytest.approx(
        percent / 100 * len(book.recipes), abs=0.02 * len(book.recipes)
    )
    assert not any(recipe.is_self_result for recipe in new)
    assert wrong.entities == book.entities
    assert wrong.base == book.base
    # Each pair has as many recipes as before, and each entity is made as often.
    for column in (lambda recipe: recipe[:2], lambda recipe: recipe[2]):
        assert sorted(map(column, wrong.recipes)) == sorted(map(column, book.recipes))
    assert with_wrong_recipes(book, percent) == wrong != with_wrong_recipes(book, percent, 1)


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
