"""Cells that hold more than a label: numbers of pieces, marks, characters that cannot be seen."""

import json

import pytest

from wordcraft_kg.graphs import read_book
from wordcraft_kg.graphs.book_check import check_book

OWN = "ingredient_a,ingredient_b,result\n"
OTHER = "first,second,result\n"
MUD = ("earth", "water", "mud")
STEAM = ("fire", "water", "steam")


@pytest.fixture
def put(tmp_path):
    def put(content, name="book.csv"):
        path = tmp_path / name
        path.write_text(content, encoding="utf-8")
        return path

    return put


NUMBERS = {
    "before": (OTHER + "2 water,earth,mud\nwater,3x fire,steam\n", "book.csv"),
    "behind": (OTHER + "water x2,earth,mud\nwater,fire*3,steam\n", "book.csv"),
    "in brackets": (OTHER + "water (2),earth,mud\nwater,fire (x3),steam\n", "book.csv"),
    "in sums": ("2 water + earth = mud\nwater + 3 fire = steam\n", "book.txt"),
    "in a cell": ("Result,Recipe\nmud,2 water + earth\nsteam,water + x3 fire\n", "book.csv"),
    "in JSON": (json.dumps({"mud": "2 water + earth", "steam": "water + 3 fire"}), "book.json"),
}


@pytest.mark.parametrize("case", NUMBERS)
def test_numbers_in_many_cells_are_numbers_of_pieces(put, case):
    book = read_book(put(*NUMBERS[case]))
    assert {tuple(recipe) for recipe in book.recipes} == {MUD, STEAM}
    assert book.reading.counts_dropped == 2
    assert "2 numbers of pieces not kept, numbers read as pieces, such as" in book.reading.line()


def test_two_pieces_of_one_thing_are_a_pair(put):
    book = read_book(put("2 water = lake\n1 lake + 2 salt = sea\n", "book.txt"))
    assert {tuple(recipe) for recipe in book.recipes} == {
        ("water", "water", "lake"),
        ("lake", "salt", "sea"),
    }


KEPT = {
    "our own table": OWN + "2 water,earth,mud\nwater,3 fire,steam\n",
    "a game of merging": OTHER + "axe (1),axe (1),axe (2)\naxe (2),axe (2),axe (3)\n",
    "names with numbers": OTHER + "3 Musketeers,fire,ash\n7 Up,water,soda\n",
    "years": OTHER + "1990 car,fire,wreck\n2000 car,water,boat\n",
    "a few cells": OTHER + "2 water,earth,mud\n" + "".join(f"a,b{i},c{i}\n" for i in range(9)),
    "names": OTHER + "H2,O2,H2O\nR2 D2,C-3,2001\n",
}


@pytest.mark.parametrize("case", KEPT)
def test_other_numbers_are_parts_of_labels(put, case):
    book = read_book(put(KEPT[case]))
    rows = [tuple(line.split(",")) for line in KEPT[case].splitlines()[1:]]
    assert {tuple(recipe) for recipe in book.recipes} == {
        (*sorted(row[:2]), row[2]) for row in rows
    }
    assert book.reading.counts_dropped == 0


def test_a_number_beside_the_label_without_it_is_named(put):
    rows = "2 water,earth,mud\nwater,fire,steam\n" + "".join(f"a,b{i},c{i}\n" for i in range(9))
    for header in (OWN, OTHER):
        path = put(header + rows)
        says = "1 label with numbers, such as '2 water' beside the label without it"
        assert says in read_book(path).reading.line()
        assert any(says in f.message for f in check_book(path).findings if f.kind == "numbers")


@pytest.mark.parametrize("mark", ["mud*", "mud ✓", "mud[1]", "1. mud", "★ mud"])
def test_a_mark_in_a_single_cell_is_named(put, mark):
    rows = f"water,earth,{mark}\nmud,fire,brick\nwater,fire,steam\n"
    path = put(OWN + rows)
    says = f"1 label with a mark, such as '{mark}'"
    assert says in read_book(path).reading.line()
    assert any(says in f.message for f in check_book(path).findings if f.kind == "marks")


@pytest.mark.parametrize("label", ["Yahoo!", "C+", "mud (wet)", "+1", "*", "3.14"])
def test_signs_that_belong_to_labels_are_no_marks(put, label):
    line = read_book(put(OWN + f"water,earth,{label}\n")).reading.line()
    assert "mark" not in line


@pytest.mark.parametrize("header", [OWN, OTHER])
@pytest.mark.parametrize("blank", ["\u00a0", "\u200b", "\u3000", "\u200f"])
def test_blanks_that_cannot_be_seen_are_left_out_and_counted(put, header, blank):
    reading_of = {}
    for name, rows in (
        ("book.csv", f"{header}water{blank},{blank}earth,mud\n"),
        ("book.json", json.dumps([[["water" + blank, blank + "earth"], "mud"]])),
    ):
        book = read_book(put(rows, name))
        assert [tuple(recipe) for recipe in book.recipes] == [MUD]
        reading_of[name] = book.reading
    assert [reading.trimmed for reading in reading_of.values()] == [2, 2]
    assert "2 cells without blanks that cannot be seen" in reading_of["book.csv"].line()


def test_a_cell_of_blanks_that_cannot_be_seen_is_a_fault(put):
    path = put(OTHER + "water,earth,mud\nwater,\u200b,steam\n")
    found = [f for f in check_book(path).findings if f.kind == "label"]
    assert [f.lines for f in found] == [(3,)]


def test_labels_that_stand_for_nothing_are_named(put):
    line = read_book(put(OWN + "NA,earth,Nothing\n")).reading.line()
    assert "'NA', 'Nothing' kept as entities" in line
