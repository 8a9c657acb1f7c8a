"""Evidence from outside the train recipes: which pieces are found, in which order, and where they are printed."""

import json
import logging
import shutil
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from short_fits import short_fits

from tests.apps.explorer.shown import look
from wordcraft_kg import RecipesConfig, RecipeScorerConfig, open_graph, train_recipes
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.pages.link import LinkState
from wordcraft_kg.apps.explorer.pages.pair import PairState
from wordcraft_kg.models.knowledge.folder import (
    FACTS,
    KnowledgeRecord,
    KnowledgeTables,
    TableInfo,
    write_knowledge,
)
from wordcraft_kg.models.knowledge.outside import open_outside
from wordcraft_kg.models.recipes.outside_evidence import OutsideEvidenceFinder

NEEDS = TableInfo(name="need", role="part", phrase="{result} needs {ingredient}")
AND = TableInfo(name="and", role="pair", phrase="{a} goes with {b}")
SILENT = TableInfo(name="silent", role="part", phrase="")
BREAD = [
    "language model: bread needs dough (+3.1)",
    "WordNet: dough is part of bread",
    "other: dough + stove -> bread",
]
WORDNET = """head\trelation\ttail
dough\tis part of\tbread
dough\tis a\tfood
bread\tis a\tfood
"""
OTHER = """ingredient_a,ingredient_b,result
stove,dough,bread
The Baker,dough,bread
dough,fire,bread
oven,dough,crust
"""


@cache
def opened():
    return open_graph("kitchen")


def write_tables(folder, source, tables, facts=None):
    """Write tables of the kitchen's entities: an array, or values by pairs of labels, for each description."""
    graph, arrays = opened().graph, []
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
    files = {} if facts is None else {FACTS: facts}
    return str(
        write_knowledge(
            folder,
            "test",
            KnowledgeTables(record, tuple(arrays)),
            inputs={},
            files=files,
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
    things = "".join(f"{label}\tis a\tthing\n" for label in opened().graph.entities)
    return (
        write_tables(folder / "language", "language model", words),
        write_tables(folder / "wn", "WordNet", {SILENT: {("oven", "bread"): 1}}, WORDNET + things),
        str(folder / "other.csv"),
    )


def finder(*sources, kg="partial"):
    """Return a finder as of a model that was trained with these sources."""
    hashes = frozenset(
        source.sha256 for source in open_outside(sources, opened(), "one-hot").sources
    )
    return OutsideEvidenceFinder(RecipeScorerConfig(kg=kg, with_=sources), hashes, opened())


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
    first, *_ = json.loads(run("score", model, "dough + oven = bread", "--json").out)["outside"]
    assert first == {
        "source": "language model",
        "text": "bread needs dough",
        "value": pytest.approx(3.1, abs=0.01),
    }
    lines = run("score", model, "dough", "componentOf", "bread").out.splitlines()
    assert lines[2:5] == [f"           {text}" for text in BREAD]
    lines = run("score", model, "dough", "combinesWith").out.splitlines()
    shown = [number for number, line in enumerate(lines) if ": dough is a thing, like " in line]
    assert shown
    assert all(lines[number].rsplit(" like ", 1)[1] in lines[number - 1] for number in shown)


def test_the_sources_take_turns(model):
    evidence = OutsideEvidenceFinder.open(model, opened())
    assert texts(evidence.of_recipe("oven", "dough", "bread")) == BREAD
    assert texts(evidence.of_link("oven", "combinesWith", "dough")) == [
        "language model: oven goes with dough (+1.2)", "WordNet: oven is a thing, like dough",
        "other: dough + oven -> crust",
    ]  # fmt: skip
    only = finder(str(model.parent / "wn"))
    # A link of two entities, then shared classes, the rarer first.
    assert texts(only.of_recipe("dough", "water", "bread")) == [
        "WordNet: dough is part of bread", "WordNet: dough is a food, like bread",
        "WordNet: dough is a thing, like water",
    ]  # fmt: skip
    assert finder(str(model.parent / "language")).of_recipe("mill", "mill", "flour") == ()


def test_shared_recipes_are_no_evidence_unless_they_were_learned(model):
    recipe = ("dough", "cold", "bread")
    other = str(model.parent / "other.csv")
    assert texts(finder(other).of_recipe(*recipe)) == ["other: dough + stove -> bread"]
    # Of the shared recipes one is a train recipe and one a test recipe, which no scorer learns.
    parts = {o: opened().split.parts[row] for row, o in enumerate(opened().graph.recipe_labels())}
    assert (parts["dough", "fire", "bread"], parts["baker", "dough", "bread"]) == (0, 2)
    learned = texts(finder(other, kg="none").of_recipe(*recipe))
    assert learned == ["other: dough + fire -> bread", "other: dough + stove -> bread"]


def test_cells_that_stand_out_are_found_strongest_first(tmp_path):
    graph, size = opened().graph, opened().graph.num_entities
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
    assert lines[3:6] == [
        f"           {text}" for text in (*BREAD[1:], "WordNet: dough is a food, like bread")
    ]
    (warning,) = caplog.messages
    says = {
        "missing": "expected a knowledge folder",
        "changed": "changed since the model",
        "damaged": "damaged",
    }
    assert "language'" in warning
    assert says[damage] in warning


def test_facts_without_three_columns_are_no_evidence(tmp_path, caplog):
    evidence = finder(
        write_tables(
            tmp_path / "k", "oracle", {NEEDS: {("dough", "bread"): 1}}, "head\nbread\tis a\n"
        )
    )
    assert evidence.of_recipe("dough", "oven", "bread") == ()
    assert "facts.tsv, line 2: expected 3 columns" in caplog.text


@pytest.mark.slow
def test_explain_and_the_explorer_name_sources(run, moved, tmp_path, caplog):
    agent, evidence = tmp_path / "agent", OutsideEvidenceFinder.open(moved, opened())
    settings = ("--use", "w", "--steps", 512, "--features", "random", "--distractors", 3)
    assert run("train-agent", "kitchen", "--scorer", moved, *settings, "--out", agent).code == 0
    lines = run("explain", agent, "--goal", "bread").out.splitlines()
    heads = [number for number, line in enumerate(lines) if line.startswith("  w: ")]
    assert heads
    named = 0
    for number in heads:
        slot, partner = lines[number].removeprefix("  w: ").split(" because ")[0].split(" + ")
        expected = [f"     {text}" for text in texts(evidence.of_recipe(slot, partner, "bread"))]
        assert lines[number + 1 : number + 1 + len(expected)] == expected
        assert not lines[number + 1 + len(expected)].startswith("     ")
        named += len(expected)
    assert named
    page = (agent / "report" / "index.html").read_text()
    assert "WordNet: " in page
    explored = Explored.open("kitchen", [moved], [agent])
    assert "; ".join(BREAD) in look(explored, PairState("dough", "oven")).text
    assert " ".join(BREAD) in look(explored, LinkState("dough", "componentOf", "bread")).text
    # Another scorer in the same place is not the scorer of the agent.
    settings = replace(RecipesConfig.read(moved).settings, seed=1, with_=())
    with short_fits():
        train_recipes(RecipesConfig("kitchen", settings), moved, force=True)
    assert "language model" not in run("explain", agent, "--goal", "bread").out
    assert "has changed since the agent was trained" in caplog.text
