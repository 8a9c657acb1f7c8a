import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from wordcraft_kg import graphs
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_book, open_graph, write_graph_folder
from wordcraft_kg.graphs.export import EXPORTERS, export_graph


def global_states() -> tuple:
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


PLAY = (
    "import wordcraft_kg, gymnasium as gym\n"
    "gym.make('WordCraft-v0', graph='kitchen').reset(seed=0)\n"
    "gym.make_vec('WordCraft-v0', num_envs=2, vectorization_mode='vector_entry_point', graph='kitchen').reset()\n"
)


@pytest.mark.parametrize(
    "code",
    [
        PLAY,
        "import wordcraft_kg.graphs",
        "from wordcraft_kg.cli import main; main(['--help'])",
        "from wordcraft_kg.cli import main; main(['build-graph', 'kitchen', '--out', 'kitchen'])",
        "from wordcraft_kg.cli import main; main(['describe', 'kitchen', '--entity', 'bread'])",
    ],
    ids=["environments", "graphs", "help", "build-graph", "describe"],
)
def test_torch_and_pykeen_stay_unimported(tmp_path, code):
    code += "\nimport sys; print('heavy:', *({'torch', 'pykeen'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "heavy:"


@pytest.mark.parametrize("split", ["by-recipe", "by-goal"])
def test_a_graph_folder_holds_no_trace_of_where_it_was_made(tmp_path, split):
    folder = tmp_path / "graph"
    book = open_book("kitchen")
    write_graph_folder(folder, book, make_split(RecipeGraph.from_book(book), SplitConfig(split)))
    for path in filter(Path.is_file, folder.rglob("*")):
        assert str(tmp_path).encode() not in path.read_bytes(), path
        assert str(Path.home()).encode() + b"/" not in path.read_bytes(), path
