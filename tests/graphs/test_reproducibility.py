import random
from pathlib import Path

import numpy as np
import pytest
from graph_folders import write_graph

from wordcraft_kg import graphs
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_book, open_graph, write_graph_folder
from wordcraft_kg.graphs.export import EXPORTERS, export_graph


def global_states():
    return random.getstate(), np.random.get_state()[1].tolist(), np.random.get_state()[2]  # noqa: NPY002


@pytest.mark.parametrize("kind", [kind for kind in graphs.SPLITS if kind != "by-kind"])  # the kitchen has none
def test_nothing_touches_the_global_generators(tmp_path, kind):
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    before = global_states()
    book = open_book("kitchen")
    graph = RecipeGraph.from_book(book)
    split = make_split(graph, SplitConfig(kind))
    write_graph_folder(tmp_path / "graph", book, split)
    graphs.write_book(book, tmp_path / "book.csv")
    opened = open_graph(tmp_path / "graph")
    for format in EXPORTERS:
        export_graph(opened, format, tmp_path / format)
    graphs.audit(graph, split)
    graphs.layers(graph)
    graphs.Planner(graph).derivation("bread")
    assert global_states() == before


@pytest.mark.parametrize("split", ["by-recipe", "by-goal"])
def test_a_graph_folder_holds_no_trace_of_where_it_was_made(tmp_path, split):
    for path in filter(Path.is_file, write_graph(tmp_path / "graph", kind=split).rglob("*")):
        assert str(tmp_path).encode() not in path.read_bytes(), path
        assert str(Path.home()).encode() + b"/" not in path.read_bytes(), path
