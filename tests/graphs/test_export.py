import csv
import json
from pathlib import Path
from typing import get_args

import networkx as nx
import pandas as pd
import pytest
from helpers import refuses

from wordcraft_kg import RecipeGraph, SplitConfig, make_split, open_graph
from wordcraft_kg.base.errors import OutputExistsError
from wordcraft_kg.cli.graphs import Format
from wordcraft_kg.graphs import RELATIONS, OpenedGraph, Recipe, RecipeBook, read_book
from wordcraft_kg.graphs.export import EXPORTERS, export_graph, triples_frame
from wordcraft_kg.graphs.graph_folder import entities_frame

AWKWARD = [
    *("#hash", " lead", "a, b", 'say "x"', "<&>", "crème brûlée"),
    *("火", "it's", "null", "100%", "a/b?c#d", "\ufeffBOM"),
]


def opened(graph, config=None):
    return OpenedGraph(graph, make_split(graph, config or SplitConfig()), graph.name)


KITCHEN_OF_SETS = Path(__file__).parents[2] / "examples" / "kitchen-sets.csv"


@pytest.fixture(params=["kitchen", "awkward labels", "sets"])
def source(request, kitchen):
    if request.param == "kitchen":
        return opened(kitchen, SplitConfig(train_ratio=0.7, valid_ratio=0.1))
    if request.param == "sets":
        return open_graph(KITCHEN_OF_SETS, SplitConfig("by-recipe-plain"))
    rows = [
        (one, other, AWKWARD[(i * j) % 11])
        for i, one in enumerate(AWKWARD)
        for j, other in enumerate(AWKWARD[:i])
    ]
    rows += [(one, one, AWKWARD[0]) for one in AWKWARD]
    book = RecipeBook.of("awkward", rows, base=AWKWARD[:3], listed=["idle"], keep_self_results=True)
    return opened(RecipeGraph.from_book(book))


def exported(source, format, folder):
    path = folder / f"export.{format}"
    export_graph(source, format, path)
    assert list(folder.iterdir()) == [path]
    return path


@pytest.mark.parametrize("format", ["tsv", "parquet"])
def test_tables_hold_the_triples(source, tmp_path, format):
    assert list(get_args(Format)) == list(EXPORTERS)
    path = exported(source, format, tmp_path)
    if format == "tsv":
        options = {"sep": "\t", "quoting": csv.QUOTE_NONE, "keep_default_na": False}
        frame = pd.read_csv(path, names=["head", "relation", "tail"], **options)
    else:
        pytest.importorskip("pyarrow")
        frame = pd.read_parquet(path)
    pd.testing.assert_frame_equal(
        frame, triples_frame(source.graph, source.graph.triples), check_dtype=False
    )


@pytest.mark.parametrize("format", ["csv", "json"])
def test_exported_books_read_back_to_an_equal_graph(source, tmp_path, format):
    book = read_book(exported(source, format, tmp_path), keep_self_results=True)
    assert RecipeGraph.from_book(book) == source.graph


def recipes_in(view):
    recipes = []
    for node, kind in view.nodes(data="kind"):
        if kind == "recipe":
            ingredients = [ingredient for ingredient, _ in view.in_edges(node)]
            [(_, result)] = view.out_edges(node)
            recipes.append(Recipe.of(*ingredients, result))
    return sorted(recipes)


def test_graphml_holds_each_recipe_as_a_node(source, tmp_path):
    view = nx.read_graphml(exported(source, "graphml", tmp_path))
    kinds = [kind for _, kind in view.nodes(data="kind")]
    assert kinds.count("recipe") == source.graph.num_recipes
    assert kinds.count("entity") == source.graph.num_entities
    assert view.number_of_edges() == source.graph.num_recipes + source.graph.sizes.sum()
    assert recipes_in(view) == sorted(source.graph.recipe_labels())
    assert {node for node, base in view.nodes(data="base") if base} == set(source.graph.base)
    frame = entities_frame(source.graph).set_index("entity")
    for label, node in view.nodes(data=True):
        if node["kind"] == "entity":
            assert (node["recipes"], node["uses"]) == tuple(frame.loc[label, ["recipes", "uses"]])
            assert node.get("layer") == (
                None if pd.isna(frame.loc[label, "layer"]) else frame.loc[label, "layer"]
            )


def test_a_recipe_is_a_directed_edge_of_hif_and_a_self_pair_has_the_weight_2(tmp_path):
    rows = [("water", "water", "lake"), ("lake", "fire", "mist")]
    graph = RecipeGraph.from_recipes(rows, base=["fire", "water"], name="small")
    document = json.loads(
        exported(opened(graph, SplitConfig("none")), "hif", tmp_path).read_text(encoding="utf-8")
    )
    assert document["network-type"] == "directed"
    assert document["metadata"] == {"name": "small", "hash": graph.hash}
    base = {node["node"] for node in document["nodes"] if node["attrs"]["base"]}
    assert base == {"fire", "water"}
    assert [row for row in document["incidences"] if row["edge"] == 1] == [
        {"edge": 1, "node": "water", "direction": "tail", "weight": 2},
        {"edge": 1, "node": "lake", "direction": "head"},
    ]


def test_sentences_name_each_recipe_of_the_part_once(source, tmp_path):
    export_graph(source, "sentences", tmp_path / "a.txt", part="partial")
    rows = source.split.is_in("train")
    expected = []
    for first, *others, result in source.graph.recipe_labels(source.graph.sets[rows]):
        with_others = {1: "{}", 2: "{} and {}", 3: "{}, {} and {}", 4: "{}, {}, {} and {}"}.get(
            len(others), "{}, {}, {}, {} and {}"
        )
        names = with_others.format(*others) if others != [first] else "itself"
        expected.append(f"Combining {first} with {names} makes {result}.")
    assert (tmp_path / "a.txt").read_text(encoding="utf-8").split("\n")[:-1] == expected
    assert any(" with itself makes " in each or each.count(",") == 3 for each in expected)


@pytest.mark.parametrize("format", EXPORTERS)
def test_an_export_that_exists_is_kept_unless_forced(kitchen, put, tmp_path, format):
    path = put("mine", "out")
    with pytest.raises(OutputExistsError):
        export_graph(opened(kitchen), format, path)
    assert path.read_text(encoding="utf-8") == "mine"
    export_graph(opened(kitchen), format, path, force=True)
    assert path.read_bytes() != b"mine"
    assert list(tmp_path.iterdir()) == [path]
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputExistsError):
        export_graph(opened(kitchen), format, tmp_path / "folder", force=True)
    assert (tmp_path / "folder").is_dir()


@pytest.mark.parametrize("part", ["full", "partial", "unseen"])
def test_an_export_holds_the_part_that_is_asked_for(source, tmp_path, part):
    split, graph = source.split, source.graph
    is_train = split.is_in("train")
    rows = {"full": is_train | True, "partial": is_train, "unseen": ~is_train}[part]
    triples = {"full": graph.triples, "partial": split.partial, "unseen": split.unseen}[part]
    export_graph(source, "tsv", tmp_path / "a.tsv", part=part)
    lines = (tmp_path / "a.tsv").read_text(encoding="utf-8").splitlines()
    assert lines == [
        f"{graph.entities[head]}\t{RELATIONS[relation]}\t{graph.entities[tail]}"
        for head, relation, tail in triples.tolist()
    ]
    export_graph(source, "csv", tmp_path / "a.csv", part=part)
    book = read_book(tmp_path / "a.csv", keep_self_results=True)
    assert (list(book.recipes), book.entities) == (
        graph.recipe_labels(graph.sets[rows]),
        graph.entities,
    )
    export_graph(source, "graphml", tmp_path / "a.graphml", part=part)
    assert recipes_in(nx.read_graphml(tmp_path / "a.graphml")) == sorted(book.recipes)


@pytest.mark.parametrize(
    ("setting", "format", "part"),
    [
        ("part", "tsv", "parts"),
        ("format", "graphm", "full"),
        ("format", "graphml", "full"),
    ],  # it needs too much memory
)
def test_an_export_that_cannot_be_is_refused(kitchen, tmp_path, monkeypatch, setting, format, part):
    monkeypatch.setattr("wordcraft_kg.graphs.export.MOST_BYTES", 2**20)
    with refuses(setting):
        export_graph(opened(kitchen), format, tmp_path / "out", part=part)
    assert not list(tmp_path.iterdir())
