"""Outside knowledge: what enters a recipe scorer from other books, tables and words, and what must not."""

import json
import logging
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from link_helpers import random_graph, same_files
from short_fits import short_fits

from wordcraft_kg import (
    RecipeGraph,
    RecipesConfig,
    RecipeScorerConfig,
    load_scorer,
    open_graph,
    train_recipes,
)
from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.graphs.splits import Split, SplitConfig
from wordcraft_kg.graphs.triples import is_in
from wordcraft_kg.models.knowledge.books import open_other_book, with_words_of
from wordcraft_kg.models.knowledge.knowledge_folder import (
    KnowledgeRecord,
    KnowledgeTables,
    TableInfo,
    write_knowledge,
)
from wordcraft_kg.models.knowledge.outside import join_books, open_outside
from wordcraft_kg.models.recipes.outside_evidence import OutsideEvidenceFinder
from wordcraft_kg.models.scorers.neighbours.links import OF_COMPONENTS

SMALL = RecipeScorerConfig(folds=3, features="one-hot")


def write_book(path, recipes):
    path.write_text("\n".join(["ingredient_a,ingredient_b,result", *map(",".join, recipes)]))
    return str(path)


def labelled(graph, rows):
    return [tuple(graph.entities[entity] for entity in row) for row in rows.tolist()]


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    graph = random_graph(1, 12, 60)
    book = write_book(tmp_path_factory.mktemp("book") / "mine.csv", labelled(graph, graph.recipes))
    return open_graph(book, SplitConfig(seed=3))


@pytest.fixture
def knowledge(opened, tmp_path):
    """A folder with a part table and a pair table, with labels in reverse order and one label missing."""
    generator = torch.Generator().manual_seed(0)
    part, pair = torch.randn(2, 11, 11, generator=generator).half()
    infos = [TableInfo(name=role, role=role, phrase="") for role in ("part", "pair")]
    record = KnowledgeRecord(
        source="oracle", entities=opened.graph.entities[:0:-1], tables=tuple(infos)
    )
    return write_knowledge(
        tmp_path / "tables",
        "test",
        KnowledgeTables(record, (part, pair + pair.T)),
        inputs={},
        files={},
    )


def test_recipes_of_both_books_stay_out_of_the_other_book(opened, tmp_path):
    graph, held_out = (
        opened.graph,
        labelled(opened.graph, opened.graph.recipes[~opened.split.is_in("train")]),
    )
    new = [
        ("sand", graph.entities[0], "sandcastle"),
        (graph.entities[1], "sand", graph.entities[2]),
    ]
    without = open_outside([write_book(tmp_path / "other.csv", new)], opened, "one-hot")
    # Shared recipes: in the other order, in other spelling, and train recipes, too.
    shared = [(b.upper(), f"the {a}", result.title()) for a, b, result in held_out]
    train = labelled(graph, opened.split.recipes("train"))[:5]
    leaking = open_outside(
        [write_book(tmp_path / "leak.csv", new + shared + train)], opened, "one-hot"
    )
    (source,) = leaking.sources
    assert source.coverage == 1  # several spellings are one entity
    assert (source.recipes, source.left_out, source.left_out_test) == (
        2,
        len(held_out) + 5,
        len(held_out),
    )
    for tables, expected in zip(leaking.tables[:2], without.tables[:2], strict=True):
        assert all(torch.equal(table, other) for table, other in zip(tables, expected, strict=True))
    assert leaking.tables.parts[0].shape == (12, 12)


def test_the_other_book_alone_decides_the_tables(opened, tmp_path):
    graph = opened.graph
    # Entities 3 and 4 make 5 in the other book only.
    other = write_book(tmp_path / "other.csv", [(graph.entities[3], "sand", graph.entities[5])])
    outside = open_outside([other], opened, "one-hot")
    observed = outside.tables.parts[OF_COMPONENTS.index("link")]
    assert observed[3, 5] > observed[3, 6]


@pytest.mark.parametrize("missing", [8, 20])
def test_labels_of_other_books_may_lack_words_but_not_most_of_them(opened, tmp_path, missing):
    """12 labels of the graph have vectors."""
    labels = opened.graph.entities
    path = tmp_path / "words.txt"
    rows = np.eye(12)
    lines = [f"{label} {' '.join(map(str, rows[row]))}" for row, label in enumerate(labels)]
    path.write_text("\n".join(lines), encoding="utf-8")
    unknown = [f"nameless{'x' * row}" for row in range(missing)]
    other = write_book(tmp_path / "other.csv", [(labels[0], labels[1], word) for word in unknown])
    if missing == 8:
        outside = open_outside([other], opened, str(path))
        assert outside.sources[0].recipes == missing
        return
    with pytest.raises(ConfigError, match="20 of 32 entities have no vector"):
        open_outside([other], opened, str(path))
    assert open_outside([other], opened, str(path), allow_missing=True).sources[0].recipes == 20


def test_a_zero_shot_scorer_needs_words_of_its_own_labels(opened, put, tmp_path):
    """However many labels of the other book have some."""
    labels = [f"known{'x' * row}" for row in range(40)]
    path = put("\n".join(f"{label} 1 {row}" for row, label in enumerate(labels)), "words.txt")
    recipes = list(zip(labels, labels[1:], labels[2:], strict=False))
    settings = RecipeScorerConfig(
        kg="none", features=str(path), with_=(write_book(tmp_path / "other.csv", recipes),)
    )
    with pytest.raises(ConfigError, match="12 of 12 entities have no vector"):
        train_recipes(RecipesConfig(opened.source, settings), tmp_path / "model")


def test_reworded_test_recipes_are_counted(opened, tmp_path):
    graph = opened.graph
    a, b, result = labelled(graph, opened.split.recipes("test"))[0]
    vectors = {label: np.eye(15)[row] for row, label in enumerate(graph.entities)}
    vectors["synonym"] = vectors[result]
    lines = [f"{label} {' '.join(map(str, vector))}" for label, vector in vectors.items()]
    (tmp_path / "words.txt").write_text("\n".join(lines))
    other = write_book(tmp_path / "other.csv", [(b, a, "synonym"), (a, a, "synonym")])
    book, _ = with_words_of(open_other_book(other, opened), opened, str(tmp_path / "words.txt"))
    assert book.source.reworded == 1 + (a == b)


def test_tables_are_found_by_label(opened, knowledge):
    outside = open_outside([str(knowledge)], opened, "one-hot")
    (part,), (pair,) = outside.tables.parts, outside.tables.pairs
    assert not part[0].any()
    assert not part[:, 0].any()
    assert part[1, 2] != 0
    assert torch.equal(pair, pair.T)
    reversed_part = torch.flip(part[1:, 1:], (0, 1))
    stored = torch.randn(2, 11, 11, generator=torch.Generator().manual_seed(0)).half()[0]
    assert torch.equal(reversed_part.half(), stored)
    assert outside.sources[0].coverage == pytest.approx(11 / 12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda opened, folder: opened.source, "is the graph itself"),
        (
            lambda opened, folder: str(folder / "nothing"),
            "expected a knowledge folder, a graph folder or a book",
        ),
        (
            lambda opened, folder: write_book(
                folder / "same.csv", labelled(opened.graph, opened.graph.recipes[:9])
            ),
            "all 9",
        ),
    ],
)
def test_a_source_that_adds_nothing_is_an_error(opened, tmp_path, make, message):
    with pytest.raises(ConfigError, match=message):
        open_outside([make(opened, tmp_path)], opened, "one-hot")


def test_tables_of_other_labels_are_an_error(opened, tmp_path):
    record = KnowledgeRecord(
        source="WordNet", entities=("x", "y"), tables=(TableInfo(name="t", role="part", phrase=""),)
    )
    folder = write_knowledge(
        tmp_path / "k",
        "test",
        KnowledgeTables(record, (torch.ones(2, 2).half(),)),
        inputs={},
        files={},
    )
    with pytest.raises(ConfigError, match="WordNet describes none of the 12 entities"):
        open_outside([str(folder)], opened, "one-hot")


def test_tables_of_one_source_merge_and_of_two_models_do_not(opened, tmp_path):
    """Tables of one source complete each other and those of two models stay apart."""
    info = TableInfo(name="need", role="part", phrase="")

    def folder(name: str, weights: str, entities: tuple[str, ...], graph: str = "") -> str:
        record = KnowledgeRecord(source="language model", entities=entities, tables=(info,))
        made = KnowledgeTables(record, (torch.full((len(entities),) * 2, len(name)).half(),))
        inputs = {"model.gguf": weights * 64, "graph": graph or opened.graph.hash}
        return str(write_knowledge(tmp_path / name, "test", made, inputs=inputs, files={}))

    labels = opened.graph.entities
    specs = (
        folder("a", "1", labels[:6]),
        folder("bb", "1", labels[6:], "0" * 64),
        folder("ccc", "2", labels),
    )
    both, other = open_outside(specs, opened, "one-hot").tables.parts
    assert [both[0, 1].item(), both[6, 7].item(), both[0, 7].item()] == [1, 2, 0]
    assert (other == 3).all()


@pytest.mark.slow
def test_a_model_with_outside_knowledge_is_trained_and_found_again(opened, knowledge, tmp_path):
    other = write_book(tmp_path / "other.csv", [("sand", opened.graph.entities[0], "sandcastle")])
    settings = replace(SMALL, with_=(str(knowledge), other))
    trained = train_recipes(RecipesConfig(opened.source, settings), tmp_path / "model")
    assert [source.kind for source in trained.metrics.outside] == ["tables", "book"]
    written = RecipesConfig.read(trained.folder).settings.with_
    assert [Path(path).resolve() for path in written[:2]] == [
        knowledge.resolve(),
        Path(other).resolve(),
    ]
    assert same_files(
        trained.folder, train_recipes(RecipesConfig.read(trained.folder), tmp_path / "again").folder
    )
    plain = train_recipes(RecipesConfig(opened.source, SMALL), tmp_path / "plain").folder
    assert not same_files(trained.folder, plain)


def test_damaged_tables_are_refused(opened, knowledge):
    path = knowledge / "tables.safetensors"
    path.write_bytes(path.read_bytes()[:-1] + b"\x01")
    with pytest.raises(ArtefactError, match="damaged or was changed"):
        open_outside([str(knowledge)], opened, "one-hot")


@pytest.fixture
def teacher(opened, tmp_path):
    """Another book with half of the entities, and 6 of its own."""
    graph = random_graph(2, 12, 60)
    labels = {
        label: opened.graph.entities[row] if row < 6 else f"other {row}"
        for row, label in enumerate(graph.entities)
    }
    rows = [tuple(labels[label] for label in recipe) for recipe in labelled(graph, graph.recipes)]
    return write_book(tmp_path / "teacher.csv", rows)


def test_a_zero_shot_scorer_has_seen_no_recipe_of_the_book(opened, teacher, tmp_path):
    settings = replace(SMALL, kg="none", with_=(teacher,), features="random")
    trained = train_recipes(RecipesConfig(opened.source, settings), tmp_path / "model")
    source = trained.metrics.outside[0]
    assert (trained.metrics.folds, trained.metrics.recipes) == (0, source.recipes)
    scorer = load_scorer(trained.folder, graph=opened.graph)
    assert not len(scorer.recipes)
    # A book whose train recipes are others teaches the same.
    held_out = opened.graph.recipes[~opened.split.is_in("train")]
    rest = random_graph(5, 12, 60).recipes[:30]
    graph = RecipeGraph(
        opened.graph.entities, np.unique(np.concatenate([held_out, rest]), axis=0), []
    )
    parts = np.where(is_in(graph.recipes, held_out, 12), 2, 0).astype(np.int8)
    other = replace(opened, graph=graph, split=Split(graph, opened.split.config, parts))
    folds = [join_books([teacher], each, "random", folds=3)[2].hash for each in (opened, other)]
    assert folds[0] == folds[1]


def test_a_scorer_without_recipes_needs_a_source(opened, tmp_path):
    with pytest.raises(ConfigError, match="learns from outside knowledge only"):
        train_recipes(RecipesConfig(opened.source, replace(SMALL, kg="none")), tmp_path / "model")
    assert not (tmp_path / "model").exists()


def test_test_recipes_stay_out_of_training_in_any_spelling(opened, tmp_path):
    """Recipes of a book to be tested stay out of training in any order and spelling."""
    graph, rows = opened.graph, labelled(opened.graph, opened.graph.recipes)
    others = [("sand", rows[5][1], rows[5][2]), (*rows[6][:2], "sandcastle")]
    spelt = [(b.upper(), f"the {a}", f"{result}s") for a, b, result in rows[:4]]
    books = (
        write_book(tmp_path / "explored.csv", [*spelt, *others]),
        write_book(tmp_path / "second.csv", [rows[7]]),
    )
    config = RecipesConfig(opened.source, replace(SMALL, kg="full", without=books))
    trained = train_recipes(config, tmp_path / "model")
    kept = {
        (*sorted((a, b)), result)
        for a, b, result in labelled(graph, load_scorer(trained.folder).recipes.numpy())
    }
    assert kept == {(*sorted((a, b)), result) for a, b, result in (*rows[4:7], *rows[8:])}
    assert trained.metrics.recipes == len(rows) - 5
    everything = write_book(tmp_path / "all.csv", rows)
    with pytest.raises(ConfigError, match="leaves no recipe"):
        train_recipes(
            RecipesConfig(opened.source, replace(SMALL, kg="full", without=(everything,))),
            tmp_path / "none",
        )
    # Another book could bring them back.
    with pytest.raises(ConfigError, match="`with` is empty"):
        replace(config.settings, with_=books[:1])
    with pytest.raises(ConfigError, match="kg"):
        replace(SMALL, without=books)


NEEDS = TableInfo(name="need", role="part", phrase="{result} needs {ingredient}")

AND = TableInfo(name="and", role="pair", phrase="{a} goes with {b}")

PART = TableInfo(name="part", role="part", phrase="{ingredient} is part of {result}")

SILENT = TableInfo(name="silent", role="part", phrase="")

BREAD = [
    "language model: bread needs dough (+3.1)",
    "WordNet: dough is part of bread (+1.0)",
    "other: dough + stove -> bread",
]

OTHER = """ingredient_a,ingredient_b,result
stove,dough,bread
The Baker,dough,bread
dough,fire,bread
oven,dough,crust
"""


@cache
def opened_of_outside_evidence():
    return open_graph("kitchen")


def write_tables(folder, source, tables):
    """Write tables of the kitchen's entities: an array, or values by pairs of labels, for each description."""
    graph, arrays = opened_of_outside_evidence().graph, []
    for info, cells in tables.items():
        array = (
            cells
            if isinstance(cells, np.ndarray)
            else np.zeros((graph.num_entities,) * 2, dtype=np.float16)
        )
        for labels, value in cells.items() if isinstance(cells, dict) else ():
            one, other = map(graph.id_of, labels)
            array[one, other] = value
            array[(other, one) if info.role == "pair" else (one, other)] = value
        arrays.append(torch.tensor(array))
    record = KnowledgeRecord(source=source, entities=graph.entities, tables=tuple(tables))
    return str(
        write_knowledge(
            folder,
            "test",
            KnowledgeTables(record, tuple(arrays)),
            inputs={},
            files={},
            force=True,
        )
    )


def write_sources(folder):
    cells = {("dough", "bread"): 3.1, ("oven", "bread"): 2.5, ("mill", "flour"): -9}
    words = {
        NEEDS: cells,
        AND: {("dough", "oven"): 1.25, ("grass", "cow"): -9},
        SILENT: {("dough", "bread"): 50},
    }
    (folder / "other.csv").write_text(OTHER)
    return (
        write_tables(folder / "language", "language model", words),
        write_tables(folder / "wn", "WordNet", {PART: {("dough", "bread"): 1}}),
        str(folder / "other.csv"),
    )


def finder(*sources, kg="partial"):
    """Return a finder as of a model that was trained with these sources."""
    hashes = frozenset(
        source.sha256
        for source in open_outside(sources, opened_of_outside_evidence(), "one-hot").sources
    )
    return OutsideEvidenceFinder(
        RecipeScorerConfig(kg=kg, with_=sources), hashes, opened_of_outside_evidence()
    )


def texts(pieces):
    return [str(piece) for piece in pieces]


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    folder = tmp_path_factory.mktemp("evidence")
    settings = RecipeScorerConfig(folds=3, features="glove", with_=write_sources(folder))
    with short_fits():
        return train_recipes(RecipesConfig("kitchen", settings), folder / "model").folder


@pytest.fixture
def moved(model, tmp_path):
    """A copy of the sources and the model."""
    shutil.copytree(model.parent, tmp_path / "copy")
    return tmp_path / "copy" / "model"


def test_score_names_sources_below_a_recipe_and_a_link(run, model):
    lines = run("score", model, "dough + oven = bread").out.splitlines()
    assert lines[2].startswith("           because ")
    assert lines[3:6] == [f"           {text}" for text in BREAD]
    assert "Lines with the name of a source: knowledge from outside" in "".join(lines[7:])
    printed = json.loads(run("score", model, "dough + oven = bread", "--json").out)
    first, *_ = printed["answers"][0]["outside"]
    assert first == {
        "source": "language model",
        "text": "bread needs dough",
        "value": pytest.approx(3.1, abs=0.01),
    }
    lines = run("score", model, "dough", "componentOf", "bread").out.splitlines()
    assert lines[2:5] == [f"           {text}" for text in BREAD]


def test_the_sources_take_turns(model):
    evidence = OutsideEvidenceFinder.open(model, opened_of_outside_evidence())
    assert texts(evidence.of_recipe("oven", "dough", "bread")) == BREAD
    assert texts(evidence.of_link("oven", "combinesWith", "dough")) == [
        "language model: oven goes with dough (+1.2)", "other: dough + oven -> crust",
    ]  # fmt: skip
    assert finder(str(model.parent / "language")).of_recipe("mill", "mill", "flour") == ()


def test_shared_recipes_are_no_evidence_unless_they_were_learned(model):
    recipe = ("dough", "cold", "bread")
    other = str(model.parent / "other.csv")
    assert texts(finder(other).of_recipe(*recipe)) == ["other: dough + stove -> bread"]
    # Of the shared recipes one is a train recipe and one a test recipe, which no scorer learns.
    parts = {
        o: opened_of_outside_evidence().split.parts[row]
        for row, o in enumerate(opened_of_outside_evidence().graph.recipe_labels())
    }
    assert (parts["dough", "fire", "bread"], parts["baker", "dough", "bread"]) == (0, 2)
    learned = texts(finder(other, kg="none").of_recipe(*recipe))
    assert learned == ["other: dough + fire -> bread", "other: dough + stove -> bread"]


def test_cells_that_stand_out_are_found_strongest_first(tmp_path):
    graph, size = (
        opened_of_outside_evidence().graph,
        opened_of_outside_evidence().graph.num_entities,
    )
    rng = np.random.default_rng(0)
    part, pair = rng.normal(2, 1, (2, size, size)).astype(np.float16)
    pair = np.triu(pair * 10) + np.triu(pair * 10, 1).T
    for table in (part, pair):
        np.fill_diagonal(table, 500)
    evidence = finder(write_tables(tmp_path / "k", "oracle", {NEEDS: part, AND: pair}))
    off = ~np.eye(size, dtype=bool)
    part_z, pair_z = (
        (table - table[off].mean(dtype=float)) / table[off].std(dtype=float)
        for table in (part, pair)
    )
    sizes = set()
    for a, b, result in rng.integers(size, size=(3_000, 3)).tolist():
        one, other, made = graph.labels((a, b, result))
        cells = {
            f"oracle: {made} needs {one} ({part[a, result]:+.1f})": part_z[a, result],
            f"oracle: {made} needs {other} ({part[b, result]:+.1f})": part_z[b, result],
            f"oracle: {one} goes with {other} ({pair[a, b]:+.1f})": pair_z[a, b],
        }
        expected = sorted(
            (text for text, z in cells.items() if z >= 2), key=lambda text: -cells[text]
        )
        assert texts(evidence.of_recipe(a, b, result)) == expected
        sizes.add(len(expected))
    assert sizes >= {0, 1, 2}


@pytest.mark.parametrize("damage", ["missing", "changed", "damaged"])
def test_a_missing_source_gives_a_warning_and_the_same_scores(
    run, moved, caplog, monkeypatch, damage
):
    """A source that is missing or changed gives a warning and the same scores."""
    monkeypatch.chdir(moved)
    command = ("score", moved, "dough + oven = bread")
    before = run(*command).out.splitlines()
    tables = moved.parent / "language"
    if damage == "missing":
        shutil.rmtree(tables)
    elif damage == "changed":
        write_tables(tables, "language model", {NEEDS: {("dough", "bread"): 4}})
    else:
        (tables / "tables.safetensors").write_bytes(b"")
    with caplog.at_level(logging.WARNING):
        lines = run(*command).out.splitlines()
    assert lines[:3] == before[:3]
    assert lines[3:5] == [f"           {text}" for text in BREAD[1:]]
    (warning,) = caplog.messages
    says = {
        "missing": "expected a knowledge folder",
        "changed": "changed since the model",
        "damaged": "damaged",
    }
    assert "language'" in warning
    assert says[damage] in warning
