import os
import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from wordcraft_kg.graphs import (
    SPLITS,
    Planner,
    RecipeGraph,
    SplitConfig,
    audit,
    layers,
    make_split,
    open_book,
    open_graph,
    write_book,
    write_graph_folder,
)
from wordcraft_kg.graphs.export import EXPORTERS, export_graph


def python(code: str, folder: Path, hash_seed: str = "random") -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONHASHSEED": hash_seed}
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("kind", SPLITS)
def test_nothing_touches_the_global_generators(tmp_path, kind):
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    before = random.getstate(), np.random.get_state()[1].tolist(), np.random.get_state()[2]  # noqa: NPY002
    book = open_book("kitchen")
    graph = RecipeGraph.from_book(book)
    split = make_split(graph, SplitConfig(kind))
    write_graph_folder(tmp_path / "graph", book, split)
    write_book(book, tmp_path / "book.csv")
    opened = open_graph(tmp_path / "graph")
    for format in EXPORTERS:
        export_graph(opened, format, tmp_path / format)
    audit(graph, split)
    layers(graph)
    Planner(graph).derivation("bread")
    after = random.getstate(), np.random.get_state()[1].tolist(), np.random.get_state()[2]  # noqa: NPY002
    assert after == before


@pytest.mark.parametrize(
    "code",
    [
        "import wordcraft_kg",
        "import wordcraft_kg.graphs",
        "from wordcraft_kg.cli import main; main(['--help'])",
        "from wordcraft_kg.cli import main; main(['build-graph', 'kitchen', '--out', 'kitchen'])",
        "from wordcraft_kg.cli import main; main(['describe', 'kitchen', '--entity', 'bread'])",
    ],
    ids=["package", "graphs", "help", "build-graph", "describe"],
)
def test_torch_and_pykeen_stay_unimported(tmp_path, code):
    done = python(f"{code}\nimport sys; print('heavy:', *({{'torch', 'pykeen'}} & set(sys.modules)))", tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "heavy:"


@pytest.mark.parametrize("split", ["by-recipe", "by-goal"])
def test_a_graph_folder_holds_no_trace_of_where_it_was_made(tmp_path, split):
    folder = tmp_path / "graph"
    book = open_book("kitchen")
    write_graph_folder(folder, book, make_split(RecipeGraph.from_book(book), SplitConfig(split)))
    for name, data in contents(folder).items():
        assert str(tmp_path).encode() not in data, name
        assert str(Path.home()).encode() + b"/" not in data, name
