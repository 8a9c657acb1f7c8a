"""Recipes of one to eight ingredients: files, graphs, triples, splits, folders."""

import json
import pickle
from dataclasses import replace

import graph_oracles as oracles
import numpy as np
import pytest
from graph_strategies import graphs_of_sets
from hypothesis import given

from wordcraft_kg.base.errors import GraphError, RecipeFileError, SplitError
from wordcraft_kg.graphs import (
    Recipe,
    RecipeBook,
    RecipeGraph,
    SplitConfig,
    audit,
    make_split,
    open_graph,
    read_book,
    write_book,
    write_graph_folder,
)
from wordcraft_kg.graphs.book_check import check_book
from wordcraft_kg.graphs.export import export_graph, to_networkx

ROWS = [
    ("water", "earth", "mud"),
    ("mud", "straw", "fire", "brick"),
    ("brick", "brick", "mud", "wall"),
    ("wall", "wall", "wall", "wall", "straw", "house"),
    ("ore", "iron"),
    ("ice", "water"),
]
RECIPES = sorted(Recipe.of(*row) for row in ROWS)


def test_a_recipe_is_a_multiset_and_a_result():
    recipe = Recipe(["egg", "flour", "egg"], "dough")
    assert recipe == ("egg", "egg", "flour", "dough")
    assert (recipe.ingredients, recipe.result) == (("egg", "egg", "flour"), "dough")
    assert recipe != Recipe.of("egg", "flour", "dough")
    assert str(recipe) == "egg + egg + flour -> dough"
    assert pickle.loads(pickle.dumps(recipe)) == recipe
    assert isinstance(pickle.loads(pickle.dumps(recipe)), Recipe)
    with pytest.raises(TypeError, match="no ingredient"):
        Recipe([], "dough")


SHAPES = {
    "a.csv": "ingredient_a,ingredient_b,ingredient_c,ingredient_d,ingredient_e,result\n"
    + "".join(",".join([*row[:-1], *[""] * (6 - len(row)), row[-1]]) + "\n" for row in ROWS),
    "columns.csv": "result;item 1;item 2;item 3;item 4;item 5\n"
    + "".join(";".join([row[-1], *row[:-1], *[""] * (6 - len(row))]) + "\n" for row in ROWS),
    "cells.csv": "ingredients,result\n"
    + "".join(f"{' + '.join(row[:-1])},{row[-1]}\n" for row in ROWS[:4]),
    "lines.txt": "".join(f"{' + '.join(row[:-1])} -> {row[-1]}\n" for row in ROWS[:4]),
    "by-result.json": json.dumps({row[-1]: [row[:-1]] for row in ROWS}),
    "records.json": json.dumps([{"ingredients": row[:-1], "result": row[-1]} for row in ROWS]),
    "objects.json": json.dumps(
        {
            "recipes": [
                {"ingredients": [{"item": x} for x in row[:-1]], "output": {"item": row[-1]}}
                for row in ROWS
            ]
        }
    ),
    "parts.json": json.dumps(
        {
            "train": {row[-1]: [row[:-1]] for row in ROWS[:4]},
            "test": {row[-1]: [row[:-1]] for row in ROWS[4:]},
        }
    ),
}


@pytest.mark.parametrize("name", SHAPES)
def test_sets_are_read_from_files_of_each_shape(put, name):
    path = put(SHAPES[name], name)
    book = read_book(path)
    num_rows = book.reading.rows
    assert list(book.recipes) == sorted(Recipe.of(*row) for row in ROWS[:num_rows])
    assert num_rows >= 4
    assert "1 of 2, 2 of 3, 1 of 5" in book.reading.line().replace("2 of 1, ", "")


def test_nine_ingredients_are_left_out_and_counted(tmp_path):
    path = tmp_path / "book.json"
    rows = [(["iron"] * 9, "block"), (["iron"] * 8, "block"), (["ore", "coal"], "iron")]
    path.write_text(json.dumps([{"ingredients": parts, "result": made} for parts, made in rows]))
    book = read_book(path)
    assert Recipe(["iron"] * 8, "block") in book.recipes
    assert book.reading.left_out == {"with more than 8 ingredients": 1}
    assert (book.reading.rows, book.reading.kept, len(book.recipes)) == (3, 2, 2)
    assert any("more than 8" in finding.message for finding in check_book(path).findings)
    with pytest.raises(GraphError, match="9 ingredients; the most are 8"):
        RecipeGraph.from_recipes([("a",) * 9 + ("b",)])


def test_bad_sets_are_counted_and_nothing_is_lost(put):
    path = put(
        json.dumps(
            [
                {"ingredients": ["a", "b", "c"], "result": "d"},
                {"ingredients": ["c", "b", "a"], "result": "e"},  # one set with two results
                {"ingredients": ["b", "c", "a"], "result": "d"},  # a repetition
                {"ingredients": ["d", "b", "c"], "result": "d"},  # a set that contains its result
                {"ingredients": [], "result": "f"},
                {"ingredients": ["e", "d"], "result": "g"},
            ]
        ),
        "book.json",
    )
    book = read_book(path)
    assert list(book.recipes) == [("a", "b", "c", "d"), ("a", "b", "c", "e"), ("d", "e", "g")]
    assert book.reading.left_out == {
        "without ingredients or result": 1,
        "that repeat a recipe": 1,
        "with an ingredient as the result": 1,
    }
    graph = RecipeGraph.from_book(book)
    ambiguity = audit(graph, make_split(graph, SplitConfig("none"))).ambiguity
    assert ambiguity.examples[0].pair == ("a", "b", "c")
    assert ambiguity.examples[0].results == ("d", "e")


def test_a_single_ingredient_is_refused_in_a_book_of_pairs_unless_its_meaning_is_told(put):
    path = put(
        json.dumps({"iron": [["ore"]], "axe": [["iron", "wood"]], "wood": [["axe", "tree"]]}),
        "book.json",
    )
    with pytest.raises(RecipeFileError, match="only ingredient, in a book of pairs"):
        read_book(path)
    alone = read_book(path, single_ingredient="alone")
    assert Recipe.of("ore", "iron") in alone.recipes
    assert Recipe.of("ore", "ore", "iron") in read_book(path, single_ingredient="self").recipes
    graph = RecipeGraph.from_book(alone)
    assert graph.labels(graph.results("ore")) == ("iron",)
    assert ("ore", "combinesWith") not in {
        triple[:2] for triple in oracles.labelled(graph, graph.triples)
    }


@pytest.mark.parametrize("kind", ["by-recipe-plain", "by-goal", "by-slot", "by-kind"])
@given(graph=graphs_of_sets(min_size=3))
def test_splits_keep_sets_goals_slots_and_kinds_together(graph, kind):
    try:
        split = make_split(graph, SplitConfig(kind, 0.5))
    except SplitError:  # too few groups
        return
    part_of = {}
    parts = split.parts.tolist()
    for recipe, row_kind, part in zip(graph.recipe_labels(), graph.kinds, parts, strict=True):
        keys = {
            "by-recipe-plain": [recipe.ingredients],
            "by-goal": [recipe.result],
            "by-slot": [(one, recipe.result) for one in recipe.ingredients],
            "by-kind": [row_kind],
        }
        for key in keys[kind]:
            assert part_of.setdefault(key, part) == part
    evaluated = {tuple(row) for row in split.held_out("test").tolist()}
    assert evaluated.isdisjoint(map(tuple, split.partial.tolist()))
    assert evaluated <= set(map(tuple, split.triples_of("test").tolist()))


@given(graphs_of_sets(min_size=3))
def test_every_entity_of_a_split_by_recipe_has_a_train_recipe(graph):
    try:
        split = make_split(graph, SplitConfig("by-recipe", 0.5))
    except SplitError:  # too few recipes
        return
    assert not len(split.uncovered)


def test_sets_survive_files_and_folders(tmp_path):
    book = RecipeBook.of("sets", RECIPES, base=["water", "ore"], listed=["idle"])
    book = replace(book, kinds={book.recipes[0]: "making", book.recipes[1]: "changing"})
    for name in ("sets.csv", "sets.tsv", "sets.json"):
        write_book(book, tmp_path / name)
        again = read_book(tmp_path / name)
        assert (again.recipes, again.base, again.kinds) == (book.recipes, book.base, book.kinds)
    graph = RecipeGraph.from_book(book)
    for given_book in (book, replace(book, kinds={})):
        split = make_split(graph, SplitConfig("by-goal", 0.5))
        write_graph_folder(tmp_path / "graph", given_book, split, force=True)
        opened = open_graph(tmp_path / "graph")
        assert (opened.graph, opened.split.hash) == (graph, split.hash)
    assert graph.hash != RecipeGraph.from_recipes(ROWS[:3]).hash


def test_code_for_pairs_refuses_sets_with_one_message():
    graph = RecipeGraph.from_recipes(ROWS)
    message = r"straw \+ wall \+ wall \+ wall \+ wall -> house has 5 ingredients; .* 2 so far"
    for use in (
        lambda: graph.recipes,
        lambda: make_split(graph, SplitConfig("none")).recipes("train"),
    ):
        with pytest.raises(GraphError, match=message):
            use()


def test_a_graph_of_pairs_has_the_same_array_as_recipes_and_as_sets(kitchen):
    assert kitchen.recipes is kitchen.sets
    assert np.array_equal(kitchen.sizes, np.full(kitchen.num_recipes, 2))
    # The width of a table with sets does not matter.
    wide = np.column_stack(
        [
            kitchen.sets[:, :2],
            np.full(kitchen.num_recipes, kitchen.num_entities),
            kitchen.sets[:, 2],
        ]
    )
    assert RecipeGraph(kitchen.entities, wide, kitchen.base_ids) == kitchen


def test_quantities_are_kept_in_the_order_of_the_ingredients_and_exported(put, tmp_path):
    path = put(
        "ingredient_a,ingredient_b,ingredient_c,result,kind,quantities\n"
        "water,flour,salt,dough,mixing,300 500 10\n"
        "dough,oven,,bread,baking,\n"
        "bread,bread,,crumbs,,0.5 2\n"
    )
    book = read_book(path)
    expected = {
        Recipe.of("water", "flour", "salt", "dough"): "500 10 300",
        Recipe.of("bread", "bread", "crumbs"): "0.5 2",
    }
    assert (book.quantities, len(book.kinds)) == (expected, 2)
    # A column that is not read changes nothing.
    lines = path.read_text().splitlines()
    noted = put("\n".join([f"{lines[0]},note", *(f"{line},x" for line in lines[1:])]))
    assert read_book(noted).quantities == expected
    graph = RecipeGraph.from_book(book)
    assert graph.hash == RecipeGraph.from_book(replace(book, quantities={})).hash
    split = make_split(graph, SplitConfig("none"))
    write_graph_folder(tmp_path / "graph", book, split)
    opened = open_graph(tmp_path / "graph")
    assert (opened.graph.quantities, opened.graph.kinds) == (graph.quantities, graph.kinds)
    for format in ("csv", "json"):
        export_graph(opened, format, tmp_path / f"again.{format}")
        again = read_book(tmp_path / f"again.{format}")
        assert (again.quantities, again.kinds) == (expected, book.kinds)
    assert "500 10 300" in str(list(to_networkx(graph).nodes(data="quantities")))
    rows = "water,flour,dough,1 2\nwater,flour,dough,1 2\nwater,flour,dough,3 2\n"
    path.write_text("ingredient_a,ingredient_b,result,quantities\n" + rows)
    repeated = read_book(path)
    assert repeated.quantities == {Recipe.of("water", "flour", "dough"): "2 1"}
    assert "1 repeated recipe with other quantities" in repeated.reading.line()
    path.write_text("ingredient_a,ingredient_b,result,quantities\nwater,flour,dough,3\n")
    with pytest.raises(RecipeFileError, match="quantities '3' of 2 ingredients; expected a number"):
        read_book(path)
