import re
from collections import Counter
from itertools import combinations_with_replacement
from operator import attrgetter

import graph_oracles as oracles
import numpy as np
import pytest
from graph_strategies import ANY_GRAPHS, graphs, rows
from hypothesis import given, strategies as st

from wordcraft_kg.base.errors import GraphError, UnknownEntityError
from wordcraft_kg.graphs import (
    Recipe,
    RecipeBook,
    RecipeGraph,
    SplitConfig,
    layers,
    make_split,
    read_book,
    recipe_triples,
    rounds,
)
from wordcraft_kg.graphs.export import to_networkx, triples_frame
from wordcraft_kg.graphs.graph_folder import entities_frame
from wordcraft_kg.graphs.triples import is_in, triple_keys


@given(ANY_GRAPHS)
def test_results_of_ingredients_in_any_order_equal_a_search_through_all_recipes(graph):
    recipes = graph.recipe_labels()
    sets = {recipe.ingredients for recipe in recipes}
    for parts in (*combinations_with_replacement(graph.entities, 2), *sets, graph.entities[:1] * 9):
        expected = oracles.results(recipes, *parts)
        assert list(graph.labels(graph.results(*parts))) == expected
        assert list(graph.labels(graph.results(*reversed(parts)))) == expected


@given(rows())
def test_a_graph_keeps_each_distinct_recipe_once_and_no_other(recipes):
    assert set(RecipeGraph.from_recipes(recipes).recipe_labels()) == {
        Recipe.of(*row) for row in recipes
    }
    assert RecipeGraph.from_recipes(recipes).num_recipes == len(
        {Recipe.of(*row) for row in recipes}
    )


@given(ANY_GRAPHS)
def test_recipes_and_uses_equal_a_search_through_all_recipes(graph):
    """Recipes and uses of every entity equal a search through all recipes."""
    recipes = graph.recipe_labels()
    for entity in graph.entities:
        making = [i for i, recipe in enumerate(recipes) if recipe.result == entity]
        using = [i for i, recipe in enumerate(recipes) if entity in recipe.ingredients]
        assert graph.recipes_of(entity).tolist() == making
        assert graph.uses_of(entity).tolist() == using
        assert graph.recipe_counts[graph.id_of(entity)] == len(making)
        assert graph.use_counts[graph.id_of(entity)] == len(using)
    assert graph.rows_of(graph.sets[::-1]).tolist() == list(range(graph.num_recipes))[::-1]


@given(ANY_GRAPHS)
def test_pairs_group_the_recipes_that_share_their_ingredients(graph):
    pairs = [recipe.ingredients for recipe in graph.recipe_labels()]
    assert graph.num_pairs == len(set(pairs))
    assert recipe_triples(np.empty((0, 3), dtype=np.int64)).shape == (0, 3)
    numbers = graph.pair_of_recipe.tolist()
    for i in range(1, len(pairs)):
        assert (numbers[i] == numbers[i - 1]) == (pairs[i] == pairs[i - 1])


@given(ANY_GRAPHS)
def test_triples_are_those_of_each_recipe_with_duplicates_merged_and_sorted(graph):
    triples = oracles.labelled(graph, graph.triples)
    assert set(triples) == oracles.triples(graph.recipe_labels())
    assert triples == sorted(set(triples), key=lambda triple: (triple[1], triple[0], triple[2]))


@given(graphs(), st.data())
def test_membership_and_keys_of_triples_equal_sets_of_tuples(graph, data):
    triples = graph.triples
    some = triples[[i for i in range(len(triples)) if data.draw(st.booleans())]]
    chosen = set(map(tuple, some.tolist()))
    assert is_in(triples, some, graph.num_entities).tolist() == [
        tuple(row) in chosen for row in triples.tolist()
    ]
    assert np.all(np.diff(triple_keys(triples, graph.num_entities)) > 0)


@given(rows(min_size=1), st.randoms(use_true_random=False))
def test_graphs_do_not_depend_on_row_order_or_name(recipes, shuffler):
    """Graphs are equal whatever the order of rows and ingredients and the name."""
    shuffled = [
        (b, a, result) if shuffler.random() < 0.5 else (a, b, result) for a, b, result in recipes
    ]
    shuffler.shuffle(shuffled)
    one, other = (
        RecipeGraph.from_recipes(recipes, name="one"),
        RecipeGraph.from_recipes(shuffled, name="other"),
    )
    assert one == other
    assert hash(one) == hash(other)
    assert one.hash == other.hash
    assert np.array_equal(one.recipes, other.recipes)


OTHERS = {
    **{"recipe less": (["abc"], "ab", ""), "other ingredient": (["abd", "acd"], "ab", "")},
    **{"other base": (["abc", "acd"], "a", ""), "other label": (["abc", "ace"], "ab", "")},
    **{
        "recipe more": (["abc", "acd", "acb"], "ab", ""),
        "idle entity more": (["abc", "acd"], "ab", "i"),
    },
}


@pytest.mark.parametrize(("rows", "base", "listed"), OTHERS.values(), ids=OTHERS)
def test_graphs_with_another_content_are_unequal(rows, base, listed):
    graph = RecipeGraph.from_recipes(["abc", "acd"], base="ab")
    other = RecipeGraph.from_book(RecipeBook.of("other", rows, base=base, listed=listed))
    assert graph != other
    assert graph.hash != other.hash
    assert graph != graph.hash


ARRAYS = {
    **{
        name: attrgetter(name)
        for name in ("recipes", "base_ids", "triples", "pair_starts", "pair_of_recipe")
    },
    "results": lambda graph: graph.results("seed", "water"),
    "recipes_of": lambda graph: graph.recipes_of("tree"),
    "uses_of": lambda graph: graph.uses_of("water"),
    "parts": lambda graph: make_split(graph, SplitConfig()).parts,
    "partial": lambda graph: make_split(graph, SplitConfig()).partial,
    "unseen": lambda graph: make_split(graph, SplitConfig()).unseen,
    "uncovered": lambda graph: make_split(graph, SplitConfig("by-goal")).uncovered,
}


@pytest.mark.parametrize("array_of", ARRAYS.values(), ids=ARRAYS)
def test_arrays_of_a_graph_and_its_split_cannot_be_written(kitchen, array_of):
    array = array_of(kitchen)
    assert array.size
    assert not array.flags.writeable


def test_a_graph_does_not_change_with_the_arrays_it_was_made_from():
    recipes, base = np.array([[0, 1, 2]]), np.array([0, 1])
    graph = RecipeGraph("abc", recipes, base)
    before = graph.recipe_labels(), graph.base
    recipes[:], base[:] = 0, 2
    assert (graph.recipe_labels(), graph.base) == before


@pytest.mark.parametrize(
    ("call", "error", "says"),
    [
        (
            lambda kitchen: kitchen.results("bred", "water"),
            UnknownEntityError,
            "in kitchen. Did you mean 'bread",
        ),
        (
            lambda kitchen: kitchen.recipes_of(-1),
            UnknownEntityError,
            "no entity id -1 in kitchen; ids are 0 .. 79",
        ),
        (
            lambda kitchen: kitchen.recipes_of(80),
            UnknownEntityError,
            "no entity id 80 in kitchen; ids are 0 .. 79",
        ),
        (lambda _: RecipeGraph(["b", "a"], np.empty((0, 3)), []), GraphError, "sorted and unique"),
        (lambda _: RecipeGraph(["a", "a"], np.empty((0, 3)), []), GraphError, "sorted and unique"),
        (lambda _: RecipeGraph("ab", [[0, 1, 2]], []), GraphError, "a recipe id is outside 0 .. 1"),
        (lambda _: RecipeGraph("ab", [[0, 1, 1]], [-1]), GraphError, "a base id is outside 0 .. 1"),
        (
            lambda _: RecipeGraph.from_recipes([("water", "earth", "mud")], base=["watr"]),
            UnknownEntityError,
            "base entity 'watr' is not in graph. Did you mean 'water'",
        ),
    ],
)
def test_unknown_entities_and_ids_out_of_range_are_refused(kitchen, call, error, says):
    with pytest.raises(error, match=re.escape(says)):
        call(kitchen)


def test_base_entities_are_those_without_a_recipe_unless_given():
    recipes = [("a", "b", "c"), ("a", "c", "d"), ("d", "d", "a")]
    assert RecipeGraph.from_recipes(recipes).base == ("b",)
    assert RecipeGraph.from_recipes(recipes, base=["d", "b", "d"]).base == ("b", "d")
    assert RecipeGraph.from_recipes(recipes, base=[]).base == ()
    book = RecipeBook.of("book", [("a", "b", "c")], base=["c"])
    assert RecipeGraph.from_book(book).base == ("c",)
    assert RecipeGraph.from_book(book, base=["a"]).base == ("a",)


@given(graphs())
def test_the_networkx_view_with_recipe_nodes_keeps_which_pair_makes_what(graph):
    view = to_networkx(graph)
    nodes = [node for node, kind in view.nodes(data="kind") if kind == "recipe"]
    found = [
        Recipe.of(
            *(a for a, _, role in view.in_edges(node, data="role") if role == "ingredient"), result
        )
        for node in nodes
        for _, result in view.out_edges(node)
    ]
    assert sorted(found) == graph.recipe_labels()
    assert {label for label, base in view.nodes(data="base") if base} == set(graph.base)
    assert len(view) == graph.num_entities + graph.num_recipes


def test_an_entity_named_like_a_recipe_node_stays_an_entity():
    graph = RecipeGraph.from_recipes(
        [("recipe 0", "recipe 1", "recipe 2"), ("recipe 0", "recipe 2", "meal")]
    )
    view = to_networkx(graph)
    assert len(view) == graph.num_entities + graph.num_recipes
    assert {node for node, kind in view.nodes(data="kind") if kind == "entity"} == set(
        graph.entities
    )


def test_frames_have_a_row_per_entity_and_triple():
    book = RecipeBook.of(
        "book", [("a", "b", "c"), ("c", "c", "d")], base=["a", "b"], listed=["idle"]
    )
    graph = RecipeGraph.from_book(book)
    entities = entities_frame(graph).set_index("entity")
    assert entities["layer"].fillna(-1).to_dict() == {"a": 0, "b": 0, "c": 1, "d": 2, "idle": -1}
    assert entities["base"].to_dict() == {
        "a": True,
        "b": True,
        "c": False,
        "d": False,
        "idle": False,
    }
    assert entities["recipes"].to_dict() == {"a": 0, "b": 0, "c": 1, "d": 1, "idle": 0}
    assert entities["uses"].to_dict() == {"a": 1, "b": 1, "c": 1, "d": 0, "idle": 0}
    triples = triples_frame(graph, graph.triples).itertuples(index=False, name=None)
    assert set(triples) == oracles.triples(graph.recipe_labels())


def test_a_graph_has_a_length_and_contains_its_labels(kitchen):
    assert len(kitchen) == kitchen.num_entities == 80
    assert list(kitchen.entities) == sorted(kitchen.entities)
    assert [kitchen.id_of(label) for label in kitchen.entities] == list(range(kitchen.num_entities))
    assert kitchen.id_of(3) == 3
    assert "dough" in kitchen
    assert "tractor" not in kitchen
    assert 3 not in kitchen
    assert RecipeGraph((), np.empty((0, 3), dtype=np.int64), [])


MUD = [
    *(("water", "earth", "mud"), ("earth", "water", "plant"), ("mud", "fire", "brick")),
    *(("brick", "brick", "wall"), ("fire", "water", "steam")),
]


@pytest.fixture(scope="module")
def mud():
    return RecipeGraph.from_recipes(MUD)


def test_the_small_graph_has_its_ids_recipes_and_base(mud):
    assert mud.entities == ("brick", "earth", "fire", "mud", "plant", "steam", "wall", "water")
    assert mud.base == ("earth", "fire", "water")
    assert mud.hash == "1c95ed91bd75498735e3822d5b67038c625f86fa5ed8e84e856eb99ab9a74e58"
    assert mud.recipes.tolist() == [[0, 0, 6], [1, 7, 3], [1, 7, 4], [2, 3, 0], [2, 7, 5]]


def test_the_kitchen_is_the_book_that_was_published(kitchen):
    assert kitchen.hash == "43fe37e2e912f6b42e9b5f510cde548bc69cc02f72d403c5365572355e54e772"
    assert (kitchen.num_entities, kitchen.num_recipes, kitchen.num_pairs, len(kitchen.triples)) == (
        80,
        326,
        310,
        961,
    )


SPLIT_HASHES = {
    "by-recipe": "62faec6fe06217e84565be30e46c521126ff7701dc233ed1690aa14cad22d0b7",
    "by-recipe-plain": "66473333a27f415d10e124396a3bed46d9c5f17cba65e27ce5d982d634eb6716",
    "by-slot": "fc341139e3aa95fc859fa66cd33341aa833cd507e322e4e509aebf1cac6d506d",
    "by-goal": "566741cd3cbdc0033b8f348f8235d47b31a83120148c1427d230ea1ee9bffe77",
    "none": "d598958fe9302c32f980219c352839a17e8b2165f9b4677d49d19c98be8f992d",
}


@pytest.mark.parametrize("kind", SPLIT_HASHES)
def test_the_kitchen_is_split_as_ever(kitchen, kind):
    assert make_split(kitchen, SplitConfig(kind, seed=0)).hash == SPLIT_HASHES[kind]


def test_little_alchemy_2_has_its_known_hash_and_size(alchemy):
    assert alchemy.hash == "43e57b020d434e8c00300f92770656bf0f555c3dbaed47e41defc0f005626b1e"
    assert (alchemy.num_entities, alchemy.num_recipes, alchemy.num_pairs) == (700, 3417, 3277)
    assert alchemy.triples[:, 1].tolist().count(0) == 6420
    assert alchemy.triples[:, 1].tolist().count(1) == 3578
    assert len(alchemy.triples) == 9998
    assert not len(make_split(alchemy, SplitConfig()).uncovered)


def test_little_alchemy_2_as_read_has_nine_self_results(alchemy_path):
    """Little alchemy 2 as read has nine self results and hardly reaches anything."""
    book = read_book(alchemy_path)
    inferred = RecipeGraph.from_book(book)
    assert (book.dropped_self_results, inferred.base) == (9, ("earth", "fire", "time"))
    assert rounds(layers(inferred))[-1] == 30
    kept = RecipeGraph.from_book(read_book(alchemy_path, keep_self_results=True))
    assert (kept.num_recipes, kept.num_pairs) == (3426, 3285)
    assert Counter(np.diff(kept.pair_starts).tolist()) == {1: 3151, 2: 127, 3: 7}


def test_little_alchemy_2_takes_sixteen_rounds_with_time(alchemy):
    """Little alchemy 2 is reached in sixteen rounds with time and not without."""
    known = [5, 15, 27, 37, 53, 84, 109, 128, 178, 293, 396, 468, 560, 640, 687, 698, 700]
    assert rounds(layers(alchemy)) == known
    layer = layers(alchemy, ["air", "earth", "fire", "water"])
    assert (max(layer), rounds(layer)[-1]) == (16, 697)
    assert alchemy.labels(np.flatnonzero(layer < 0)) == ("archeologist", "ruins", "time")
