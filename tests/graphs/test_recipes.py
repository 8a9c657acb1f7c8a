import json
from dataclasses import replace

import pytest
from graph_strategies import books
from hypothesis import example, given

from wordcraft_kg.errors import RecipeFileError
from wordcraft_kg.graphs import Recipe, RecipeBook, RecipeGraph, read_book, write_book

TABLE = "ingredient_a,ingredient_b,result\n"


@pytest.fixture(scope="module")
def shelf(tmp_path_factory):
    return tmp_path_factory.mktemp("shelf")


@pytest.mark.parametrize("ending", ["csv", "tsv", "json"])
@given(book=books())
@example(book=RecipeBook.of("book", [("# a", ' "b, c" ', " lead")], base=None, listed=["ä, ö", "'"]))
@example(book=RecipeBook.of("book", [("a", "b", "c")], base=[], listed=["idle"]))
@example(book=RecipeBook.of("book", [("a", "b", "c")], base=[" lead"], listed=["trail "]))
@example(book=RecipeBook.of("book", [("a", "b", "c")], base=["# hash", "a,b", '"', " é "]))
def test_a_book_written_and_read_back_is_equal(shelf, ending, book):
    path = shelf / f"book.{ending}"
    write_book(book, path)
    again = read_book(path, keep_self_results=True)
    assert replace(again, sha256=None) == book
    assert RecipeGraph.from_book(again) == RecipeGraph.from_book(book)


@pytest.mark.parametrize(("ending", "delimiter"), [("csv", ","), ("tsv", "\t")])
def test_a_row_that_starts_with_a_hash_is_quoted_so_that_no_reader_takes_it_for_a_comment(tmp_path, ending, delimiter):
    path = tmp_path / f"book.{ending}"
    write_book(RecipeBook.of("book", [("#a", "b", "c")]), path)
    assert path.read_text(encoding="utf-8").splitlines()[1] == delimiter.join(['"#a"', '"b"', '"c"'])


@pytest.mark.parametrize("ending", [".csv", ".tsv", ".json"])
def test_writing_a_book_twice_gives_the_same_bytes(tmp_path, ending):
    one = RecipeBook.of("book", [("a", "b", "c"), ("c", "a", "d")], base=["b", "a"])
    other = RecipeBook.of("book", [("a", "c", "d"), ("b", "a", "c")], base=["a", "b"])
    for name, book in (("one", one), ("other", other)):
        (tmp_path / name).mkdir()
        write_book(book, tmp_path / name / f"book{ending}")
    assert (tmp_path / "one" / f"book{ending}").read_bytes() == (tmp_path / "other" / f"book{ending}").read_bytes()


def test_a_book_is_not_written_under_another_ending(tmp_path):
    with pytest.raises(RecipeFileError, match=r"unknown ending '\.xml'; a recipe book is written as"):
        write_book(RecipeBook.of("book", [("a", "b", "c")]), tmp_path / "book.xml")
    assert not list(tmp_path.iterdir())


def test_the_layouts_of_one_book_give_equal_graphs(tmp_path):
    rows = [["b", "a", "c"], ["a", "a", "d"], ["a", "b", "d"]]
    official = {"entities": {label: {"id": 1, "recipes": []} for label in "abcd"}}
    for a, b, result in rows:
        official["entities"][result]["recipes"].append([a, b])
    texts = {
        "own.json": json.dumps({"entities": list("abcd"), "recipes": rows}),
        "official.json": json.dumps(official),
        "commas.csv": TABLE + "".join(",".join(row) + "\n" for row in rows),
        "tabs.tsv": TABLE.replace(",", "\t") + "".join("\t".join(row) + "\n" for row in rows),
        "tabs.tab": TABLE.replace(",", "\t") + "".join("\t".join(row) + "\n" for row in rows),
        "upper.CSV": TABLE + "".join(",".join(row) + "\n" for row in rows),
    }
    graphs = []
    for name, text in texts.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
        graphs.append(RecipeGraph.from_book(read_book(tmp_path / name)))
    assert len({graph.hash for graph in graphs}) == 1
    assert graphs[0].recipe_labels() == [("a", "a", "d"), ("a", "b", "c"), ("a", "b", "d")]


@pytest.mark.parametrize(
    "text",
    [
        TABLE + "a,b,c\n",
        "\ufeff" + TABLE + "a,b,c\n",
        (TABLE + "a,b,c\n").replace("\n", "\r\n"),
        TABLE + "a,b,c",
        TABLE + "\na,b,c\n\n",
        "# a comment\n#\n" + TABLE + "a,b,c\n",
        "ingredient_a, ingredient_b, result\na,b,c\n",
        TABLE + '"a","b","c"\n',
    ],
    ids=[
        "plain",
        "byte order mark",
        "CRLF",
        "no last line end",
        "blank lines",
        "comments",
        "blanks in header",
        "quotes",
    ],
)
def test_tables_are_read_however_they_were_saved(tmp_path, text):
    path = tmp_path / "book.csv"
    path.write_text(text, encoding="utf-8", newline="")
    assert read_book(path).recipes == (Recipe("a", "b", "c"),)


def test_comments_may_declare_base_and_idle_entities(tmp_path):
    path = tmp_path / "book.csv"
    path.write_text('# base: b, "a, or not", a\n# entities: idle\n' + TABLE + "a,b,c\n", encoding="utf-8")
    book = read_book(path)
    assert book.base == ("a", "a, or not", "b")
    assert book.idle == ("a, or not", "idle")


def test_labels_are_kept_verbatim_and_matched_exactly(tmp_path):
    path = tmp_path / "book.csv"
    path.write_text(TABLE + "Tea, tea,tea \n", encoding="utf-8")
    assert read_book(path).entities == (" tea", "Tea", "tea ")


def test_self_results_are_dropped_and_counted_unless_kept(tmp_path):
    path = tmp_path / "book.csv"
    path.write_text(TABLE + "rabbit,rabbit,rabbit\nfire,coal,fire\na,b,c\n", encoding="utf-8")
    assert read_book(path).recipes == (Recipe("a", "b", "c"),)
    assert read_book(path).dropped_self_results == 2
    kept = read_book(path, keep_self_results=True)
    assert len(kept.recipes) == 3
    assert kept.dropped_self_results == 0


def test_the_same_recipe_twice_is_merged_and_counted(tmp_path):
    path = tmp_path / "book.csv"
    path.write_text(TABLE + "a,b,c\nb,a,c\na,b,d\n", encoding="utf-8")
    book = read_book(path)
    assert book.recipes == (Recipe("a", "b", "c"), Recipe("a", "b", "d"))
    assert book.merged_duplicates == 1


def test_entities_of_the_official_layout_that_no_recipe_mentions_are_idle(tmp_path):
    path = tmp_path / "book.json"
    entry = {"a": {"recipes": []}, "b": {"recipes": [["a", "a"]]}, "lone": {"recipes": []}}
    path.write_text(json.dumps({"entities": entry}), encoding="utf-8")
    assert read_book(path).idle == ("lone",)
    assert read_book(path).entities == ("a", "b", "lone")
