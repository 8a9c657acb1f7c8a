"""Splits from files, and the split of a table whose results have one recipe each."""

import gzip
import json
import logging

import numpy as np
import pytest

from wordcraft_kg.base.errors import ArtefactError, SplitError
from wordcraft_kg.graphs import RecipeBook, RecipeGraph, SplitConfig, audit, make_split, open_graph
from wordcraft_kg.graphs.folder import default_split, write_graph_folder
from wordcraft_kg.graphs.published_splits import read_published_split
from wordcraft_kg.graphs.splits import Draw, Split

ROWS = [
    ("water", "earth", "mud"),
    ("rain", "earth", "mud"),
    ("mud", "straw", "fire", "brick"),
    ("brick", "brick", "wall"),
]
GRAPH = RecipeGraph.from_recipes(ROWS)
GOALS = {"mud": "train", "brick": "train", "wall": "test"}
FILES = {
    "results.csv": "part,result\n" + "".join(f"{part},{goal}\n" for goal, part in GOALS.items()),
    "recipes.csv": "part,ingredient_a,ingredient_b,ingredient_c,result\n"
    "Train,earth,water,,mud\ntrain,rain,earth,,mud\ntrain,straw,mud,fire,brick\ntest,brick,brick,,wall\n",
    "results.json": json.dumps({"train": ["mud", "brick"], "test": ["wall"]}),
    "recipes.json": json.dumps({"train": ROWS[:3], "test": ROWS[3:]}),
    "sets.json": json.dumps(
        {
            "train": {"mud": [["earth", "water"], ["earth", "rain"]], "brick": [ROWS[2][:-1]]},
            "test": {"wall": [["brick", "brick"]], "gold": [["lead", "stone"]]},
        }
    ),
}


def read(tmp_path, text, graph=GRAPH, name="split.json"):
    path = tmp_path / name
    path.write_text(text)
    return read_published_split(path, graph)


@pytest.mark.parametrize("name", FILES)
def test_a_published_split_is_read_from_tables_and_json(tmp_path, name):
    split = read(tmp_path, FILES[name], name=name)
    parts = {recipe: split.parts[row] for row, recipe in enumerate(GRAPH.recipe_labels())}
    assert {recipe for recipe, part in parts.items() if part == 2} == {("brick", "brick", "wall")}
    assert (split.config.kind, split.config.train_ratio) == ("by-goal", 0.75)
    assert (split.published.file, split.published.unknown) == (name, int(name == "sets.json"))


def test_a_published_split_by_recipe_has_three_parts(tmp_path):
    content = {"train": [ROWS[0], ROWS[3]], "val": [ROWS[2]], "test": [ROWS[1]]}
    split = read(tmp_path, json.dumps(content))
    assert (split.config.kind, np.bincount(split.parts).tolist()) == ("by-recipe-plain", [2, 1, 1])


def test_a_published_split_survives_a_folder_and_is_named_in_the_audit(tmp_path):
    split = read(tmp_path, FILES["results.json"])
    same_parts = read(tmp_path, FILES["recipes.json"])
    assert split.hash != same_parts.hash  # two files
    book = RecipeBook.of("published", ROWS)
    write_graph_folder(tmp_path / "graph", book, split)
    opened = open_graph(tmp_path / "graph")
    assert (opened.split.hash, opened.split.published) == (split.hash, split.published)
    assert audit(GRAPH, opened.split).split.published == split.published
    path = tmp_path / "graph" / "split.json"
    path.write_text(path.read_text().replace(split.published.sha256, "0" * 64))
    with pytest.raises(ArtefactError, match="does not match its hash"):
        open_graph(tmp_path / "graph")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"train": ["mud", "brick"], "test": ["mud", "wall"]}', r"-> mud is in train and test"),
        ('{"train": ["mud"], "test": ["wall"]}', r"1 recipe of 4 without a part, such as fire \+"),
        ('{"train": ["mud", "wall", "brick"], "test": []}', "test part has no recipe"),
        ('{"a": ["mud"]}', "no split .*expected a table"),
        ('{"train": [1]}', "no split"),
        ("part,goal\ntrain,mud\n", "no split .*result"),
        ("part,result\nlearn,mud\n", "no split .*learn"),
        ("part,result\ntrain,mud\nlearn,wall\n", "line 3: the part 'learn'"),
        ("part,result\ntrain,mud,brick\n", "line 2 has more cells"),
        ("part,ingredient,ingredient,result\ntrain,a,b,mud\n", "two columns"),
        ('part,result\ntrain,"mud\n' + 200_000 * "x", "no split .*field larger"),
        ('{"train": [[["water"], "mud"]], "test": ["wall"]}', "in place of a list of labels"),
        ('{"train": [{"mud": 1}], "test": ["wall"]}', "in place of a list"),
        ('{"train": [[]], "test": ["wall"]}', "in place of a list of labels"),
        ('{"train": {"mud": [[]]}, "test": ["wall"]}', "in place of a list of labels"),
        ('{"train": {"mud": ["water", "earth"]}, "test": ["wall"]}', "'water' in place of a list"),
        ('{"train": ["mud"], "train": ["brick"], "test": ["wall"]}', "'train' occurs twice"),
        ('{"train": ' + 10_000 * "[" + 10_000 * "]" + "}", "nested too deeply"),
        ("", "no columns part and result"),
    ],
)
def test_a_wrong_split_file_is_refused(tmp_path, text, says):
    with pytest.raises(SplitError, match=says):
        read(tmp_path, text)


def test_names_of_a_part_in_json_add_up_and_other_keys_are_ignored(tmp_path):
    content = {"Train": ["mud"], "training": ["brick"], "test": ["wall"], "licence": "CC0"}
    split = read(tmp_path, json.dumps(content))
    assert split.parts.tolist() == read(tmp_path, FILES["results.json"]).parts.tolist()


def test_entries_of_too_many_ingredients_are_unknown_recipes(tmp_path):
    content = {"train": ["mud", "brick", [*9 * ["water"], "mud"]], "test": ["wall"]}
    assert read(tmp_path, json.dumps(content)).published.unknown == 1


def test_labels_of_a_split_are_folded_with_those_of_the_book(tmp_path):
    path = tmp_path / "split.csv"
    path.write_text(FILES["results.csv"].replace("mud", "Mud"))
    assert read_published_split(path, GRAPH, fold=True).published.unknown == 0
    with pytest.raises(SplitError, match="without a part"):
        read_published_split(path, GRAPH)


def test_a_split_file_may_have_blank_columns_and_rows(tmp_path):
    text = FILES["results.csv"].replace("\n", ",,\n") + ",,,\n"
    assert read(tmp_path, text, name="split.csv").published.unknown == 0


def test_a_split_file_may_have_the_line_ends_of_old_systems(tmp_path):
    text = FILES["results.csv"].replace("\n", "\r")
    (tmp_path / "split.csv").write_bytes(text.encode())
    assert read_published_split(tmp_path / "split.csv", GRAPH).published.unknown == 0


def test_a_table_of_results_with_one_recipe_each_is_split_by_goal(caplog):
    rows = [(f"a{i}", f"b{i % 7}", f"c{i % 5}", f"made {i}") for i in range(100)]
    with caplog.at_level(logging.WARNING):
        split = default_split(RecipeGraph.from_recipes(rows))
    assert split.config == SplitConfig("by-goal")
    assert "100 of 100 recipes are the only one of their result" in caplog.text
    few = default_split(RecipeGraph.from_recipes(rows[:99]))
    repeated = default_split(
        RecipeGraph.from_recipes([*rows, *((*row[:2], row[3]) for row in rows)])
    )
    assert few.config.kind == "none"  # by-recipe keeps all of them in train
    assert repeated.config.kind == "by-recipe"


def test_the_audit_counts_sets_inside_others_and_pairs_that_train_knows():
    rows = [
        ("a", "b", "c", "r"),
        ("a", "b", "r"),
        ("a", "a", "b", "c", "d", "r"),
        ("a", "c", "s"),
        ("b", "c", "t"),
        ("x", "r"),
    ]
    graph = RecipeGraph.from_recipes(rows)
    split = make_split(graph, SplitConfig("none"))
    parts = np.array(
        [2 if len(recipe) > 3 else 0 for recipe in graph.recipe_labels()], dtype=np.int8
    )
    sets = audit(graph, Split(graph, split.config, Draw(parts))).sets
    assert sets.recipes_by_number_of_ingredients == {"1": 1, "2": 3, "3": 1, "5": 1}
    # {a, b} in {a, b, c}, and both in {a, a, b, c, d}.
    assert sets.inside_another_set == 2
    # Train combines a + b, a + c and b + c: all pairs of one set, and none with d or a + a.
    assert (sets.test_sets, sets.with_a_train_pair, sets.of_train_pairs) == (2, 2, 1)


def test_a_graph_of_pairs_has_no_statistics_of_sets(kitchen):
    assert audit(kitchen, make_split(kitchen, SplitConfig())).sets is None


def test_a_split_in_gzip_is_read(tmp_path):
    path = tmp_path / "split.csv.gz"
    path.write_bytes(gzip.compress(FILES["results.csv"].encode()))
    plain = tmp_path / "split.csv"
    plain.write_text(FILES["results.csv"])
    splits = [read_published_split(each, GRAPH) for each in (path, plain)]
    assert splits[0].parts.tolist() == splits[1].parts.tolist()
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(SplitError):
        read_published_split(path, GRAPH)
