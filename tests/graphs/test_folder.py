import json
import random
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import write_graph

from wordcraft_kg import graphs
from wordcraft_kg.base import ArtefactError, GraphMismatchError, RecipeFileError, as_values
from wordcraft_kg.graphs import (
    RELATIONS,
    Recipe,
    RecipeBook,
    RecipeGraph,
    SplitConfig,
    audit,
    graph_folder as folder_module,
    make_split,
    open_book,
    open_graph,
    read_book,
    write_graph_folder,
)
from wordcraft_kg.graphs.export import EXPORTERS, export_graph


@pytest.fixture(scope="module")
def pristine(tmp_path_factory, kitchen):
    folder = tmp_path_factory.mktemp("graphs") / "kitchen"
    write_graph_folder(
        folder, open_book("kitchen"), make_split(kitchen, SplitConfig(valid_ratio=0.1, seed=4))
    )
    return folder


@pytest.fixture
def folder(pristine, tmp_path):
    """Copy of a graph folder that a test may damage."""
    return shutil.copytree(pristine, tmp_path / "kitchen")


def test_a_graph_folder_has_its_files_and_no_others(pristine):
    files = sorted(
        str(path.relative_to(pristine)) for path in pristine.rglob("*") if path.is_file()
    )
    assert files == [
        *("audit.json", "entities.tsv", "graph.json", "recipes.csv", "split.json"),
        *("triples/full.tsv", "triples/partial.tsv", "triples/unseen.tsv"),
    ]


def test_a_graph_folder_opens_to_the_graph_and_split_that_were_written(pristine, kitchen):
    opened = open_graph(pristine)
    split = make_split(kitchen, SplitConfig(valid_ratio=0.1, seed=4))
    assert opened.graph == kitchen
    assert opened.graph.name == "kitchen"
    assert opened.split.hash == split.hash
    assert opened.split.config == split.config
    assert opened.source == str(pristine)


def test_the_files_of_a_graph_folder_agree_with_the_graph(pristine, kitchen):
    split = make_split(kitchen, SplitConfig(valid_ratio=0.1, seed=4))
    for name, triples in (
        ("full", kitchen.triples),
        ("partial", split.partial),
        ("unseen", split.unseen),
    ):
        text = (pristine / "triples" / f"{name}.tsv").read_text(encoding="utf-8")
        assert text == "".join(
            f"{kitchen.entities[head]}\t{RELATIONS[relation]}\t{kitchen.entities[tail]}\n"
            for head, relation, tail in triples.tolist()
        )
    assert read_book(pristine / "recipes.csv").recipes == tuple(kitchen.recipe_labels())
    lines = (pristine / "entities.tsv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "id\tentity\tbase\tlayer\trecipes\tuses"
    assert [line.split("\t")[:2] for line in lines[1:]] == [
        [str(i), label] for i, label in enumerate(kitchen.entities)
    ]
    recorded = json.loads((pristine / "audit.json").read_text(encoding="utf-8"))
    assert recorded == {"dropped_self_results": 0, "merged_duplicates": 0} | as_values(
        audit(kitchen, split)
    )


def test_a_book_opens_with_the_split_asked_for(kitchen):
    opened = open_graph("kitchen", SplitConfig("by-goal", seed=7))
    assert opened.split.hash == make_split(kitchen, SplitConfig("by-goal", seed=7)).hash
    assert open_graph("kitchen").split.config == SplitConfig()


@pytest.mark.parametrize(
    ("name", "error", "says"),
    [
        (
            "",
            ArtefactError,
            r"is an empty folder; expected a graph folder.*wordcraft-kg build-graph",
        ),
        ("nowhere", RecipeFileError, "is neither a file nor a known book"),
    ],
)
def test_a_folder_that_is_empty_or_not_there_is_refused(tmp_path, name, error, says):
    with pytest.raises(error, match=says):
        open_graph(tmp_path / name)


CHANGED = "is damaged or was edited: its content does not match its hash"
EDITS = {
    "label": ("graph.json", '"bread"', '"bread2"', rf"graph\.json {CHANGED}"),
    "label in one recipe": (
        "graph.json",
        '"earth", "pig"]',
        '"earth", "pug"]',
        "'pug' is none of its entities",
    ),
    "base": ("graph.json", '"base": ["animal", ', '"base": [', CHANGED),
    "name": (
        "graph.json",
        '"name": "kitchen"',
        '"name": {"a": 1}',
        r"graph\.json is damaged: Expected 'str', got 'object' - at '\$\.name'",
    ),
    **{
        f"name {name}": (
            "graph.json",
            '"name": "kitchen"',
            f'"name": "{name}"',
            "expected a name without folders and control characters",
        )
        for name in (
            "../../x",
            "/etc/x",
            "a/b",
            r"..\\..\\x",
            "C:x",
            "..",
            "",
            r"a\u001b[2Jb",
            r"a\nb",
        )
    },
    "ratio": ("split.json", '"train_ratio": 0.8', '"train_ratio": 0.7', CHANGED),
}


def test_a_book_whose_name_is_no_folder_is_not_written(tmp_path):
    book = RecipeBook.of("<b>kitchen</b>", [("water", "earth", "mud")])
    split = make_split(RecipeGraph.from_book(book), SplitConfig("none"))
    with pytest.raises(RecipeFileError, match="expected a name without folders"):
        write_graph_folder(tmp_path / "graph", book, split)
    assert not (tmp_path / "graph").exists()


@pytest.mark.parametrize(("name", "old", "new", "says"), EDITS.values(), ids=EDITS)
def test_an_edited_file_is_noticed(folder, name, old, new, says):
    text = (folder / name).read_text(encoding="utf-8")
    assert old in text
    (folder / name).write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises((ArtefactError, RecipeFileError), match=says):
        open_graph(folder)


DAMAGED = {
    **{"empty": (b"", ""), "list": (b"[]", ""), "number": (b"7", ""), "no keys": (b"{}", "")},
    **{
        "nested too deeply": (b"[" * 200_000, ""),
        "truncated": (b'{"format": "wordcraft', "Unterminated string|was truncated"),
    },
    **{
        "not UTF-8": (b"\xff\x80", "0xff|byte 0"),
        "huge number": (b'{"format": ' + b"1" * 5000 + b"}", "4300 digits|out of range"),
    },
}


@pytest.mark.parametrize("name", ["graph.json", "split.json"])
@pytest.mark.parametrize(("data", "detail"), DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_file_of_a_graph_folder_is_refused_by_name(folder, name, data, detail):
    (folder / name).write_bytes(data)
    with pytest.raises((ArtefactError, RecipeFileError)) as caught:
        open_graph(folder)
    message = str(caught.value)
    assert str(folder / name) in message
    assert "damaged" in message
    assert re.search(detail, message)


def test_a_missing_split_and_the_split_of_another_graph_are_refused(folder):
    (folder / "split.json").unlink()
    with pytest.raises(ArtefactError, match=r"split\.json is missing; the folder is incomplete"):
        open_graph(folder)
    other = RecipeGraph.from_recipes([("a", "b", "c"), ("a", "c", "d")])
    text = "".join(make_split(other, SplitConfig("none")).to_json())
    (folder / "split.json").write_text(text, encoding="utf-8")
    with pytest.raises(
        GraphMismatchError, match=rf"belongs to graph {other.hash[:12]} but the folder's graph is"
    ):
        open_graph(folder)


KINDS = ["making", ""]
OWN = {
    "format": "wordcraft-kg recipe book 1",
    "name": "mine",
    "base": ["a"],
    "kinds": KINDS,
    "entities": ["a", "b", "c", "idle"],
    "recipes": [["a", "b", "c"], ["c", "c", "c"]],
}


def test_a_graph_folder_keeps_idle_entities_self_results_and_kinds(tmp_path):
    book = RecipeBook.of(
        "mine", OWN["recipes"], base=["a"], listed=["idle"], keep_self_results=True
    )
    book = replace(book, kinds={Recipe.of("a", "b", "c"): "making"})
    graph = RecipeGraph.from_book(book)
    write_graph_folder(tmp_path / "mine", book, make_split(graph, SplitConfig("none")))
    opened = open_graph(tmp_path / "mine")
    assert opened.graph == graph
    assert opened.graph.kinds == graph.kinds == tuple(KINDS)
    content = json.loads((tmp_path / "mine" / "graph.json").read_text("utf-8"))
    assert OWN.items() <= content.items()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"entities": ["b", "a", "c", "idle"]}, "entity labels must be sorted and unique"),
        ({"entities": ["a", "b", "c", "c", "idle"]}, "entity labels must be sorted and unique"),
        ({"entities": ["a", "b\n", "c", "idle"]}, "holds a tab, line break or control character"),
        ({"kinds": ["\x1b[2J", ""]}, "holds a tab, line break or control character"),
        ({"kinds": ["making"]}, "does not match"),
        ({"recipes": OWN["recipes"][::-1]}, "does not match"),
        ({"recipes": [*OWN["recipes"], ["a", "b", "c"]]}, "does not match"),
        ({"recipes": [["a", "b", "x"]]}, "'x' is none of its entities"),
        ({"recipes": [["a"]]}, "Expected 'array' of length"),
        ({"recipes": [["a", "b", 3]]}, "Expected 'str', got 'int'"),
        ({"base": None}, "Expected 'array', got 'null'"),
        ({"base": ["x"]}, "'x' is none of its entities"),
        ({"source": {"reading": {"shape": 1}}}, "Expected 'str', got 'int'"),
        ({"format": "wordcraft-kg recipe book 2"}, "Invalid enum value"),
    ],
    ids=str,
)
def test_a_graph_that_was_not_written_so_is_refused(tmp_path, change, says):
    graph = RecipeGraph.from_recipes(OWN["recipes"])
    graph = RecipeGraph(OWN["entities"], graph.sets, [0])
    (tmp_path / "graph.json").write_text(json.dumps(OWN | {"hash": graph.hash}), "utf-8")
    assert folder_module._read_graph(tmp_path).kinds == tuple(KINDS)
    text = json.dumps(OWN | {"hash": graph.hash} | change)
    (tmp_path / "graph.json").write_text(text, "utf-8")
    with pytest.raises(ArtefactError, match=rf"graph\.json is damaged.*{says}"):
        open_graph(tmp_path)


def global_states():
    return random.getstate(), np.random.get_state()[1].tolist(), np.random.get_state()[2]  # noqa: NPY002


@pytest.mark.parametrize(
    "kind", [kind for kind in graphs.SPLITS if kind != "by-kind"]
)  # the kitchen has none
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
