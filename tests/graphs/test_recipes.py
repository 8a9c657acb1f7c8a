import json
import re
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch
from xml.etree import ElementTree
from xml.sax.saxutils import escape

import pytest
from graph_strategies import books
from helpers import refuses
from hypothesis import example, given, strategies as st

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs import Recipe, RecipeBook, RecipeGraph, read_book, write_book
from wordcraft_kg.graphs.book_files import book_name
from wordcraft_kg.graphs.book_files.reader import BookRows
from wordcraft_kg.graphs.book_files.texts import cells_of
from wordcraft_kg.graphs.recipes import alike_labels, check_label

TABLE = "ingredient_a,ingredient_b,result\n"


@pytest.fixture
def read(put):
    """Write a text to a file and read it as a book."""

    def read(text, name="book.csv", **options):
        return read_book(put(text, name), **options)

    return read


@pytest.fixture(scope="module")
def shelf(tmp_path_factory):
    return tmp_path_factory.mktemp("shelf")


@pytest.mark.parametrize("ending", ["csv", "tsv", "json"])
@given(book=books())
@example(
    book=RecipeBook.of("book", [("# a", ' "b, c" ', " lead")], base=None, listed=["ä, ö", "'"])
)
@example(book=RecipeBook.of("book", [("a", "b", "c")], base=[], listed=["idle"]))
@example(book=RecipeBook.of("book", [("Crafting", "Recipe", "Result")], base=None))
@example(book=RecipeBook.of("book", [("a", "b", "c")], base=[" lead"], listed=["trail "]))
@example(book=RecipeBook.of("book", [("a", "b", "c")], base=["# hash", "a,b", '"', " é "]))
def test_a_book_written_and_read_back_is_equal(shelf, ending, book):
    path = shelf / f"book.{ending}"
    write_book(book, path)
    again = read_book(path, keep_self_results=True)
    assert replace(again, sha256=None) == book
    assert RecipeGraph.from_book(again) == RecipeGraph.from_book(book)


@pytest.mark.parametrize("label", ["#a", "// a"])
@pytest.mark.parametrize(("ending", "delimiter"), [("csv", ","), ("tsv", "\t")])
def test_a_row_that_starts_like_a_comment_is_quoted(tmp_path, ending, delimiter, label):
    path = tmp_path / f"book.{ending}"
    write_book(RecipeBook.of("book", [(label, "b", "c")]), path)
    row = path.read_text(encoding="utf-8").splitlines()[1]
    assert row == delimiter.join([f'"{label}"', "b", "c"])
    assert read_book(path).entities == tuple(sorted((label, "b", "c")))


def test_a_book_is_not_written_under_another_ending(tmp_path):
    with pytest.raises(
        RecipeFileError, match=r"unknown ending '\.xml'; a recipe book is written as"
    ):
        write_book(RecipeBook.of("book", [("a", "b", "c")]), tmp_path / "book.xml")
    assert not list(tmp_path.iterdir())


SAVED = {
    "plain": TABLE + "a,b,c\n",
    "byte order mark": "\ufeff" + TABLE + "a,b,c\n",
    "CRLF": (TABLE + "a,b,c\n").replace("\n", "\r\n"),
    "no last line end": TABLE + "a,b,c",
    "blank lines": TABLE + "\na,b,c\n\n",
    "comments": "# a comment\n#\n" + TABLE + "a,b,c\n",
    "blanks in header": "ingredient_a, ingredient_b, result\na,b,c\n",
    "quotes": TABLE + '"a","b","c"\n',
}


@pytest.mark.parametrize("text", SAVED.values(), ids=SAVED)
def test_tables_are_read_however_they_were_saved(read, text):
    assert read(text).recipes == (Recipe.of("a", "b", "c"),)


def test_comments_may_declare_base_and_idle_entities(read):
    head = '# base: b, "a, or not" , a\n# entities: idle, "a, or not"\n'
    book = read(head + TABLE + "a,b,c\n")
    assert (book.base, book.idle) == (("a", "a, or not", "b"), ("a, or not", "idle"))


def test_labels_are_kept_verbatim_and_matched_exactly(read):
    book = read(TABLE + 'Tea," tea","tea "\ngreen  tea,"\u00a0tea",tea\n')
    assert book.entities == (" tea", "Tea", "green  tea", "tea", "tea ", "\u00a0tea")


@pytest.mark.parametrize(
    "row", ["a b, c,d", " a b , c , d ", ' "a b" ,c,  "d"  ', "a b,c ,d", '"a b", c ,d']
)
@pytest.mark.parametrize(("ending", "delimiter"), [("csv", ","), ("tsv", "\t")])
def test_spaces_around_a_cell_do_not_belong_to_it(read, row, ending, delimiter):
    book = read((TABLE + row + "\n" + row).replace(",", delimiter), f"book.{ending}")
    assert (book.recipes, book.merged_duplicates) == ((Recipe.of("a b", "c", "d"),), 1)


@given(
    cells=st.lists(st.text(' ,\t"ab', max_size=5), min_size=3, max_size=3),
    around=st.lists(st.text(" ", max_size=2), min_size=6, max_size=6),
    delimiter=st.sampled_from(",\t"),
)
def test_trimming_takes_only_spaces_outside_of_quotes(cells, around, delimiter):
    """The spaces outside of quotes are no part of cells, and nothing else is."""
    quoted = ['"' + cell.replace('"', '""') + '"' for cell in cells]
    padded = zip(around[::2], quoted, around[1::2], strict=True)
    loose = delimiter.join("".join(parts) for parts in padded)
    assert cells_of(loose + "\r\n", delimiter) == cells
    long = '"a"' + " " * 99_000 + ",b"  # in linear time
    assert cells_of(long, ",") == ["a", "b"]


KINDS = TABLE.replace("result", "result,kind")


def test_a_fourth_column_names_kinds(read):
    book = read(KINDS + "b,a,c,making\na,b,d,\n", "book.csv")
    assert book.kinds == {Recipe.of("a", "b", "c"): "making"}
    single = read(KINDS + "sand,,glass,matter\n", "book.csv", single_ingredient="fire")
    assert single.kinds == {Recipe.of("fire", "sand", "glass"): "matter"}


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("book.csv", KINDS + "a,b,c,\x01\n", "line 2: the label '\\\\x01' holds a tab"),
        (
            "book.csv",
            KINDS + "a,b,c,d\nb,a,c,e\n",
            "line 3: a . b -> c has the kind 'e' here, and 'd' above",
        ),
        ("book.csv", TABLE + "a,b,c,d\n", "line 2: 'a,b,c,d' has 4 cells; the table has 3"),
        (
            "book.json",
            '{"entities": ["a"], "recipes": [["a", "a", "a"]], "kinds": ["x", "y"]}',
            "expected a list with a kind",
        ),
        (
            "book.json",
            '{"entities": ["a"], "recipes": [["a", "a", "a"]], "kinds": 3}',
            "kinds is 3; expected a list",
        ),
        (
            "book.json",
            '{"entities": ["a"], "recipes": [["a", "a", "a"]], "kinds": [3]}',
            "3 is not a label",
        ),
    ],
)
def test_bad_kinds_are_refused(read, name, text, says):
    with pytest.raises(RecipeFileError, match=says):
        read(text, name)


UNKNOWN_BASE = {
    "book.csv, line 2": "# a book\n# base: water, fier\n" + TABLE + "water,fire,steam\n",
    "book.tsv, line 1": ("# base: fier\n" + TABLE + "water,fire,steam\n").replace(",", "\t"),
    "book.json: base[1]": '{"base": ["fire", "fier"], "entities": ["fire", "s"], '
    '"recipes": [["fire", "fire", "s"]]}',
}


@pytest.mark.parametrize("where", UNKNOWN_BASE)
def test_an_unknown_base_entity_is_refused_with_a_hint(read, where):
    """A base entity that is no entity is refused with its place and the nearest one."""
    with pytest.raises(RecipeFileError, match=f"{re.escape(where)}.*'fier'.*Did you mean 'fire'"):
        read(UNKNOWN_BASE[where], re.split("[,:]", where)[0])


ENTITIES = {
    **{label: {"recipes": []} for label in ("coal", "sand", "ore")},
    "glass": {"recipes": [["sand"]]},
    "iron": {"recipes": [["ore"]]},
    "steel": {"recipes": [["iron", "coal"]]},
}

ROWS = "sand glass", "ore iron", "iron coal steel"

SINGLE = {
    "book.csv": TABLE + "sand,,glass\n,ore,iron\niron,coal,steel\n",
    "loose.csv": TABLE + 'sand, ,glass\n"",ore,iron\niron,coal,steel\n',
    "book.tsv": TABLE.replace(",", "\t") + "sand\t\tglass\n\tore\tiron\niron\tcoal\tsteel\n",
    "own.json": json.dumps({"entities": [*ENTITIES], "recipes": [row.split() for row in ROWS]}),
    "official.json": json.dumps({"entities": ENTITIES}),
}


@pytest.mark.parametrize("name", SINGLE)
def test_recipes_of_one_ingredient_are_read_as_asked(read, name):
    for options in ({}, {"single_ingredient": " "}):
        with refuses("single_ingredient", RecipeFileError):
            read(SINGLE[name], name, **options)
    for setting, sand, ore in (("self", "sand", "ore"), ("furnace", "furnace", "furnace")):
        expected = {("sand", sand, "glass"), ("ore", ore, "iron"), ("coal", "iron", "steel")}
        assert set(read(SINGLE[name], name, single_ingredient=setting).recipes) == {
            Recipe.of(*row) for row in expected
        }


def test_labels_that_xml_cannot_hold_are_refused():
    """A label that xml cannot hold is refused and any other can be written as xml."""
    planes = [*range(0x3000), *range(0xD000, 0x10100), *range(0x1F000, 0x1F100), 0x10FFFF]
    for char in map(chr, planes):
        label = f"a{char}b"
        if char in "\ufffe\uffff\u2028\u2029\x7f\x85" or char < " " or "\ud800" <= char <= "\udfff":
            with pytest.raises(RecipeFileError, match="here: the label 'a"):
                check_label(label, "here")
        else:
            assert check_label(label, "here") == label
            ElementTree.fromstring(f"<label>{escape(label)}</label>")


@pytest.mark.parametrize("stem", ["a\x01b", "a\udce9b", "a\ufffeb"])
def test_a_bad_file_name_is_replaced_in_the_books_name(stem):
    """A files name that no label may have is replaced in the name of the book."""
    assert book_name(Path(f"{stem}.csv")) == "a_b"


def test_self_results_are_dropped_and_counted_unless_kept(read):
    text = (
        "# base: fire, a, x\n# entities: x\n"
        + TABLE
        + "rabbit,rabbit,rabbit\nfire,coal,fire\na,b,c\n"
    )
    dropped, kept = read(text), read(text, keep_self_results=True)
    assert (dropped.recipes, dropped.dropped_self_results) == ((Recipe.of("a", "b", "c"),), 2)
    assert (len(kept.recipes), kept.dropped_self_results) == (3, 0)
    assert dropped.base == ("a", "fire", "x")  # entities of a dropped row and listed entities count


def test_entities_of_the_official_layout_that_no_recipe_mentions_are_idle(read):
    entry = {"a": {"recipes": []}, "b": {"recipes": [["a", "a"]]}, "lone": {"recipes": []}}
    book = read(json.dumps({"entities": entry}), "book.json")
    assert (book.idle, book.entities) == (("lone",), ("a", "b", "lone"))


def test_labels_in_several_spellings_are_grouped():
    labels = ("LAVA", "Lava", "ice cream", "ice-cream", "lava", "\u2764", "\u2764\ufe0f", "C", "C-")
    assert alike_labels(labels) == [
        ("LAVA", "Lava", "lava"),
        ("ice cream", "ice-cream"),
        ("\u2764", "\u2764\ufe0f"),
    ]


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


@pytest.mark.parametrize("odd", ODD.values(), ids=ODD)
@pytest.mark.parametrize("after", ["", "fire,water,steam\n"], ids=["last", "inside"])
def test_an_odd_row_has_the_result_or_the_fault_of_its_line(put, odd, after):
    path = put(PLAIN + odd + after)
    assert outcome(path) == outcome_by_rows(path)


def test_an_option_that_changes_labels_reads_row_by_row(put):
    path = put(PLAIN + "Water,earth,clay\n")
    assert outcome(path, case="fold") == outcome_by_rows(path, case="fold")


def test_a_table_of_a_header_alone_has_no_recipe(put):
    assert outcome(put(HEADER)) == outcome_by_rows(put(HEADER))
