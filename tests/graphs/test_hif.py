"""The Hypergraph Interchange Format: its rules are kept, and nothing of a graph is lost."""

import json
from dataclasses import replace

import pytest
from graph_strategies import books, graphs_of_sets
from hypothesis import given

from wordcraft_kg import RecipeGraph, SplitConfig, make_split, open_graph
from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs import Recipe, RecipeBook
from wordcraft_kg.graphs.export import export_graph
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.hif import hif_lines, is_hif, recipes_of_hif

FIELDS = {
    "nodes": ({"node"}, {"weight", "attrs"}),
    "edges": ({"edge"}, {"weight", "attrs"}),
    "incidences": ({"edge", "node"}, {"weight", "attrs", "direction"}),
}
"""Needed and allowed names in the objects of each list, by the published schema."""


def assert_conforms(document):
    """Check the rules of the published JSON schema that concern a document, without its text."""
    assert {"incidences"} <= set(document) <= {"network-type", "metadata", *FIELDS}
    assert document.get("network-type") in ("directed", "undirected", "asc")
    assert isinstance(document.get("metadata", {}), dict)
    for name, (needed, more) in FIELDS.items():
        assert isinstance(document.get(name, []), list)
        for one in document.get(name, []):
            assert needed <= set(one) <= needed | more
            assert all(type(one[key]) in (str, int) for key in needed)
            assert type(one.get("weight", 1)) in (int, float)
            assert isinstance(one.get("attrs", {}), dict)
            assert one.get("direction", "head") in ("head", "tail")


def book_of(found, name):
    """Make a book of the read recipes."""
    book = RecipeBook.of(
        name, found.rows, base=found.base, listed=found.listed, keep_self_results=True
    )
    kinds = zip(found.rows, found.kinds, strict=True)
    return replace(book, kinds={Recipe.of(*row): kind for row, kind in kinds if kind})


def back(graph):
    document = json.loads("".join(hif_lines(graph)))
    assert_conforms(document)
    assert is_hif(document)
    found = recipes_of_hif(document)
    assert found.dropped_counts == 0
    return RecipeGraph.from_book(book_of(found, found.name))


@given(book=books())
def test_any_graph_comes_back_whole(book):
    graph = RecipeGraph.from_book(book)
    again = back(graph)
    assert (again.hash, again.name, again.base) == (graph.hash, graph.name, graph.base)
    assert again.recipe_labels() == graph.recipe_labels()


@given(graph=graphs_of_sets())
def test_sets_come_back_with_their_numbers_of_pieces(graph):
    assert (back(graph).hash, back(graph).kinds) == (graph.hash, graph.kinds)


def test_a_recipe_is_a_directed_edge_and_a_self_pair_has_the_weight_2(tmp_path):
    rows = [("water", "water", "lake"), ("lake", "fire", "mist")]
    graph = RecipeGraph.from_recipes(rows, base=["fire", "water"], name="small")
    opened = OpenedGraph(graph, make_split(graph, SplitConfig("none")), "small")
    export_graph(opened, "hif", tmp_path / "small.json")
    document = json.loads((tmp_path / "small.json").read_text(encoding="utf-8"))
    assert document["network-type"] == "directed"
    assert document["metadata"] == {"name": "small", "hash": graph.hash}
    assert {node["node"] for node in document["nodes"] if node["attrs"]["base"]} == {
        "fire",
        "water",
    }
    lake = [row for row in document["incidences"] if row["edge"] == 1]
    assert lake == [
        {"edge": 1, "node": "water", "direction": "tail", "weight": 2},
        {"edge": 1, "node": "lake", "direction": "head"},
    ]


def test_a_part_of_a_graph_keeps_all_entities_and_the_base(tmp_path):
    opened = open_graph("kitchen")
    export_graph(opened, "hif", tmp_path / "part.json", part="partial")
    found = recipes_of_hif(json.loads((tmp_path / "part.json").read_text(encoding="utf-8")))
    assert found.listed == opened.graph.entities
    assert found.base == opened.graph.base
    assert len(found.rows) == len(opened.split.recipes("train"))


def incidences(*rows):
    names = ("edge", "node", "direction", "weight")
    return {"incidences": [dict(zip(names, row, strict=False)) for row in rows]}


def test_recipes_of_other_arities_and_tools_are_read_as_they_are():
    document = incidences(
        ("r1", "iron", "tail", 3),
        ("r1", 7, "tail"),
        ("r1", "gear", "head", 2),
        ("r1", "scrap", "head"),
        (2, "ore", "tail"),
        (2, "iron", "head"),
        (2, "ore", "tail", 1.0),
    )
    found = recipes_of_hif(document)
    assert found.rows == (
        ("iron", "iron", "iron", "7", "gear"),
        ("iron", "iron", "iron", "7", "scrap"),
        ("ore", "ore", "iron"),
    )
    assert (found.name, found.base, found.kinds) == ("", None, ("", "", ""))
    assert found.listed == ("iron", "7", "gear", "scrap", "ore")
    assert found.dropped_counts == 1


GOOD = [("e", "a", "tail"), ("e", "b", "head")]
BAD = {
    "undirected": ({"network-type": "undirected", **incidences(*GOOD)}, "without directions"),
    "no direction": (
        incidences(("e", "a"), ("e", "b")),
        r"without directions \(HIF: incidences\[0",
    ),
    "no head": (incidences(("e", "a", "tail")), "edge 'e' has no head, the result"),
    "no tail": (incidences(("e", "a", "head")), "edge 'e' has no tail, the ingredients"),
    "part of a count": (incidences(("e", "a", "tail", 0.5), *GOOD), "weight .* is 0.5; expected"),
    "huge count": (incidences(("e", "a", "tail", 1e300), *GOOD), "weight .* expected how often"),
    "many": (incidences(*[("e", "a", "tail", 900)] * 2, *GOOD), "has 1,801 ingredients"),
    "weight of text": (incidences(("e", "a", "tail", "2"), *GOOD), "weight .* is '2'"),
    "no node": (incidences(("e",), *GOOD), "without directions"),
    "true": (incidences(("e", True, "tail"), *GOOD), r"incidences\[0\]: the node is True"),
    "list": (incidences((["e"], "a", "tail"), *GOOD), "the edge is .*expected a text"),
    "blank": (incidences(("e", " ", "tail"), *GOOD), "is blank"),
    "twins": (incidences(("e", 1, "tail"), ("e", "1", "head")), "would be one entity"),
    "no object": ({"incidences": [3]}, r"incidences\[0\] is 3; expected an object"),
    "nodes": ({"nodes": 3, **incidences(*GOOD)}, "'nodes' is 3; expected a list"),
    "attrs": ({"nodes": [{"node": "a", "attrs": 1}], **incidences(*GOOD)}, "'attrs' is 1"),
    "kind": ({"edges": [{"edge": "e", "attrs": {"kind": 1}}], **incidences(*GOOD)}, "kind: 1 is"),
    "metadata": ({"metadata": [], **incidences(*GOOD)}, "'metadata' is .*expected an object"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_hypergraph_that_is_no_recipe_book_is_refused_with_the_place(name):
    document, says = BAD[name]
    with pytest.raises(RecipeFileError, match=says):
        recipes_of_hif(document)


@pytest.mark.parametrize("value", [[], {}, {"incidences": 3}, {"incidences": None}, None, "hif"])
def test_other_json_is_not_hif(value):
    assert not is_hif(value)
