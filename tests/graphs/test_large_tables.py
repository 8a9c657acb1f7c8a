"""Tables of millions of rows: read and written by columns, with the results of a row at a time."""

from unittest.mock import patch

import numpy as np
import pytest
from graph_strategies import labels
from hypothesis import given
from hypothesis import strategies as st

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.arrays import absent, json_recipes, row_text
from wordcraft_kg.graphs.book_files import read_book
from wordcraft_kg.graphs.book_files.reader import BookRows
from wordcraft_kg.graphs.recipes import Recipe, RecipeBook, RecipeRows

HEADER = "ingredient_a,ingredient_b,result\n"
PLAIN = HEADER + "water,earth,mud\nearth,earth,land\nearth,water,mud\nmud,sun,mud\n"
ODD = {
    "quotes": '"water",earth,mud\n',
    "a quote within": 'wa"ter,earth,mud\n',
    "blanks": "water , earth,mud\n",
    "a blank at the start": " water,earth,mud\n",
    "a blank at the end": "water,earth,mud \n",
    "other line ends": "water,earth,mud\r\n",
    "old line ends": "water,earth,mud\rfire,earth,lava\n",
    "a blank line": "water,earth,mud\n\nfire,earth,lava\n",
    "a row of delimiters": "water,earth,mud\n,,\n",
    "two cells": "water,mud\n",
    "four cells": "water,earth,mud,clay\n",
    "two cells, then four": "water,mud\nwater,earth,mud,clay\n",
    "an empty ingredient": "water,,ice\n",
    "an empty result": "water,earth,\n",
    "the header again": HEADER,
    "a column's name as label": "result,earth,mud\n",
    "a byte order mark": "\ufeffwater,earth,mud\n",
    "a control character": "wa\ater,earth,mud\n",
    "a line separator": "wa\u2028ter,earth,mud\n",
    "a formula": "=SUM(A1),earth,mud\n",
    "an unseen blank": "\u00a0water,earth,mud\n",
    "a sum": "water,earth,earth + water\n",
    "a long label": f"{'w' * 1001},earth,mud\n",
    "a long line": f"{'w' * 100_001},earth,mud\n",
    "no end of the last line": "water,earth,steam",
    "a comment's sign": "#water,earth,mud\n",
    "missing values": "NA,earth,Nothing\n",
    "signs of templates": "100 %,%s,{mud}\n",
}


def outcome(path, **options):
    """Return a book with all that was counted, or the message of its fault."""
    try:
        book = read_book(path, **options)
    except RecipeFileError as error:
        return str(error)
    counts = book.dropped_self_results, book.merged_duplicates, book.sha256
    return tuple(book.recipes), book.base, book.idle, book.entities, counts, book.reading


def outcome_by_rows(path, **options):
    with patch.object(BookRows, "all_at_once", return_value=None):
        return outcome(path, **options)


@pytest.fixture
def put(tmp_path):
    def write(text, name="book.csv"):
        path = tmp_path / name
        path.write_bytes(text.encode())
        return path

    return write


def is_read_at_once(path):
    with patch.object(BookRows, "__iter__", side_effect=AssertionError("read row by row")):
        try:
            read_book(path)
        except AssertionError:
            return False
    return True


@pytest.mark.parametrize("keep_self_results", [False, True])
def test_a_plain_table_is_read_at_once_like_row_by_row(put, keep_self_results):
    path = put("# base: water, earth, moon\n# entities: sun, moon, star\n" + PLAIN)
    assert is_read_at_once(path)
    options = {"keep_self_results": keep_self_results}
    found = outcome(path, **options)
    assert found == outcome_by_rows(path, **options)
    assert found[4][:2] == ((0, 1) if keep_self_results else (1, 1))


@pytest.mark.parametrize("end", ["\n", ""])
def test_the_last_line_needs_no_end(put, end):
    path = put(PLAIN.removesuffix("\n") + end)
    assert is_read_at_once(path)
    assert outcome(path) == outcome_by_rows(path)


@pytest.mark.parametrize("odd", ODD.values(), ids=ODD)
@pytest.mark.parametrize("after", ["", "fire,water,steam\n"], ids=["last", "inside"])
def test_an_odd_row_has_the_result_or_the_fault_of_its_line(put, odd, after):
    path = put(PLAIN + odd + after)
    assert outcome(path) == outcome_by_rows(path)


@pytest.mark.parametrize("name", ["the header again", "a control character"])
def test_a_fault_behind_the_first_piece_has_its_line(put, monkeypatch, name):
    monkeypatch.setattr("wordcraft_kg.graphs.book_files.texts._PIECE", 20)
    assert ", line 6: " in outcome(put(PLAIN + ODD[name]))


def test_pieces_end_at_lines(put, monkeypatch):
    path = put(PLAIN)
    whole = outcome(path)
    for size in range(1, len(PLAIN)):
        monkeypatch.setattr("wordcraft_kg.graphs.book_files.texts._PIECE", size)
        assert outcome(path) == whole


def test_an_option_that_changes_labels_reads_row_by_row(put):
    path = put(PLAIN + "Water,earth,clay\n")
    assert outcome(path, case="fold") == outcome_by_rows(path, case="fold")


def test_a_table_of_a_header_alone_has_no_recipe(put):
    assert outcome(put(HEADER)) == outcome_by_rows(put(HEADER))


@given(st.lists(st.tuples(labels(), labels(), labels()), min_size=1))
def test_rows_with_ids_equal_their_tuple(rows):
    recipes = [Recipe.of(*row) for row in rows]
    numbered = RecipeRows.of(recipes)
    assert numbered == tuple(recipes)
    assert tuple(recipes) == numbered
    assert hash(numbered) == hash(tuple(recipes))
    assert numbered[1:] == tuple(recipes[1:])
    assert numbered[-1] == recipes[-1]
    assert (repr(numbered), len(numbered)) == (repr(tuple(recipes)), len(recipes))
    assert numbered != tuple(recipes[1:])
    assert numbered != recipes


@given(st.lists(st.tuples(labels(), labels(), labels())))
def test_a_book_of_rows_with_ids_equals_a_book_of_labels(rows):
    numbered = RecipeRows.of([Recipe.of(*row) for row in rows])
    for keep in (False, True):
        book = RecipeBook.of("book", rows, keep_self_results=keep)
        assert RecipeBook.of("book", numbered, keep_self_results=keep) == book
        kept = {Recipe.of(*row) for row in rows}
        assert list(book.recipes) == sorted(r for r in kept if keep or not r.is_self_result)


@given(st.lists(labels(), min_size=1, max_size=5, unique=True), st.data())
def test_text_of_rows_equals_that_of_single_rows(names, data):
    ids = st.integers(0, len(names) - 1)
    rows = data.draw(st.lists(st.tuples(ids, ids, ids)))
    columns = [[f"{name}, " for name in names], [f"{name}\t" for name in names], names]
    with patch("wordcraft_kg.graphs.arrays._PIECE", data.draw(st.integers(1, 4))):
        pieces = list(row_text(np.array(rows, dtype=np.int64).reshape(-1, 3), columns))
        lines = "".join(json_recipes(np.array(rows, dtype=np.int64).reshape(-1, 3), names))
    assert "".join(pieces) == "".join(f"{names[a]}, {names[b]}\t{names[c]}" for a, b, c in rows)
    single = ",\n".join(f"[{names[a]}, {names[b]}, {names[c]}]" for a, b, c in rows)
    assert lines == (single + "\n" if rows else "")


def test_absent_ids_are_those_without_a_row():
    assert absent(np.array([3, 0, 3]), 5).tolist() == [1, 2, 4]
    assert absent(np.array([], dtype=np.int64), 2).tolist() == [0, 1]
