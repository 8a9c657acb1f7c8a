"""The dataset folder data/everyday belongs to the book of the package, and its metadata are valid
Croissant."""

import csv
import runpy
from pathlib import Path

import mlcroissant
import pytest

from wordcraft_kg.graphs import Recipe, RecipeGraph, open_book

ROOT = Path(__file__).parents[1]
DATA = ROOT / "data/everyday"
MAKER = runpy.run_path(str(ROOT / "data/make_everyday.py"))


def rows_of(name):
    with (DATA / name).open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_generated_files_are_those_of_the_book(monkeypatch):
    monkeypatch.setattr("sys.argv", ["make_everyday.py", "--check"])
    assert MAKER["main"]() == 0
    kinds = open_book("everyday").kinds
    recipes = {
        Recipe.of(row["ingredient_a"], row["ingredient_b"], row["result"]): row
        for row in rows_of("recipes.csv")
    }
    assert {recipe: row["kind"] for recipe, row in recipes.items()} == kinds


def test_votes_ranks_are_those_of_counting():
    graph = RecipeGraph.from_book(open_book("kitchen"))
    rows, ranks = graph.recipes.tolist(), MAKER["votes_ranks"](graph)
    for index in range(0, len(rows), 30):
        a, b, result = rows[index]
        votes = [
            sum(
                x in other[:2] and other[2] == entity
                for x in {a, b}
                for i, other in enumerate(rows)
                if i != index
            )
            for entity in range(graph.num_entities)
        ]
        own = votes[result]
        expected = (
            sum(count > own for count in votes) + (sum(count == own for count in votes) + 1) / 2
        )
        assert ranks[index] == expected


@pytest.mark.slow
def test_croissant_metadata_are_valid_and_their_records_can_be_read():
    dataset = mlcroissant.Dataset(str(DATA / "croissant.json"))
    assert not dataset.metadata.issues.errors
    records = list(dataset.records("recipes"))
    assert len(records) == len(open_book("everyday").recipes)
    assert {key.split("/")[-1] for key in records[0]} == set(rows_of("recipes.csv")[0])


def test_every_thing_has_a_category_and_nearly_every_one_a_sense():
    rows = rows_of("entities.csv")
    assert tuple(row["entity"] for row in rows) == open_book("everyday").entities
    assert sum(not row["wordnet"] for row in rows) == 5


def test_judged_answers_are_not_in_the_book():
    graph = RecipeGraph.from_book(open_book("everyday"))
    rows = rows_of("judged.csv")
    for row in rows:
        pair = row["ingredient_a"], row["ingredient_b"]
        assert len(graph.results(*pair))
        assert row["answer"] not in graph.labels(graph.results(*pair))
    assert len({(row["ingredient_a"], row["ingredient_b"]) for row in rows}) <= 300


def test_the_canary_stands_in_the_book_and_its_datasheet():
    book = (ROOT / "wordcraft_kg/graphs/books/everyday.csv").read_text()
    canary = next(line for line in book.splitlines() if "canary" in line).split()[2]
    assert canary in (DATA / "README.md").read_text()
