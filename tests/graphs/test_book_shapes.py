"""Files as people have them: read as downloaded, or refused with what is missing."""

import gzip
import io
import json
import re
import stat
import zipfile
from pathlib import Path

import pytest
from book_shapes import ROWS, SHAPES, table, zipped

from wordcraft_kg.base.errors import ConfigError, RecipeFileError
from wordcraft_kg.graphs import RecipeGraph, read_book
from wordcraft_kg.graphs.book_check import check_book
from wordcraft_kg.graphs.book_files import rows as words

ROOT = Path(__file__).parents[2]

READ = [shape for shape in SHAPES if not shape.says]

REFUSED_SHAPES = [shape for shape in SHAPES if shape.says]


def put_shape(shape, folder):
    """Write a shape's files, and return the path of the book."""
    for name, data in shape.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return folder if len(shape.files) > 1 else folder / next(iter(shape.files))


def expected(rows):
    return {(tuple(sorted(set(parts))), result) for *parts, result in rows}


@pytest.mark.parametrize("shape", READ, ids=lambda shape: shape.name)
def test_a_shape_is_read_as_it_is_downloaded(tmp_path, shape):
    path = put_shape(shape, tmp_path)
    book = read_book(path, **shape.options)
    assert expected(book.recipes) == expected(shape.rows)
    reading = book.reading
    assert reading.rows == reading.kept + sum(reading.left_out.values())
    assert reading.kept == len(shape.rows)
    assert reading.line().startswith(f"read as {reading.shape}")
    checked = check_book(path, **shape.options)
    assert checked.book.recipes == book.recipes
    assert checked.reading == reading


@pytest.mark.parametrize("shape", REFUSED_SHAPES, ids=lambda shape: shape.name)
def test_a_refusal_names_what_is_missing_and_the_guide(tmp_path, shape):
    path = put_shape(shape, tmp_path)
    with pytest.raises(RecipeFileError, match=shape.says) as caught:
        read_book(path, **shape.options)
    assert "docs/your-file.md#" in str(caught.value)
    assert not check_book(path, **shape.options).passed


def test_at_least_42_shapes_are_read():
    assert len(READ) >= 42


def test_each_refusal_leads_to_a_section_of_the_guide():
    text = (Path(__file__).parents[2] / words.GUIDE).read_text()
    headings = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert set(words.SHAPES) <= {heading.lower().replace(" ", "-") for heading in headings}


def examples_of_the_guide():
    """Yield the files that the guide shows: a block each, and a line each of JSON."""
    text = (ROOT / "docs" / "your-file.md").read_text(encoding="utf-8")
    for section in text.split("\n## ")[1:]:
        title = section.splitlines()[0]
        files = []
        for language, block in re.findall(r"```(\w*)\n(.*?)```", section, re.DOTALL):
            if language == "json":
                files += block.splitlines()
            elif title in ("Table", "Lines"):
                files.append(block)
        yield from ((f"{title} {number}", file) for number, file in enumerate(files, 1))


EXAMPLES = dict(examples_of_the_guide())


@pytest.mark.parametrize("title", EXAMPLES)
def test_the_guides_examples_are_read(put, title):
    path = put(EXAMPLES[title], "book.txt")
    labels = {label.lower() for label in read_book(path).entities}
    assert labels & {"mud", "lake"}


def test_the_guide_shows_an_example_of_each_shape():
    assert {title.rstrip(" 0123456789") for title in EXAMPLES} == {
        "Table",
        "Lines",
        "JSON",
        "Infinite Craft",
    }
    assert len(EXAMPLES) >= 6


TORCH = {"ingredients": ["stick", "coal"], "result": {"id": "torch"}}

ONE = {("coal", "stick", "torch")}

CHOICE = {("birch", "birch", "x"), ("birch", "oak", "x"), ("oak", "oak", "x")}

UNKNOWN = [{"type": "neoforge:compound", "children": []}]

KINDS = {
    "unknown ingredients": (
        {"ingredients": UNKNOWN * 2, "result": "x"},
        set(),
        "with an ingredient of an unknown kind",
        0,
    ),
    "one unknown choice": (
        {"ingredients": [["a", None], "b"], "result": "x"},
        set(),
        "with an ingredient of an unknown kind",
        0,
    ),
    "letter without a key": (
        {"pattern": ["ABC"], "key": {"A": "a", "B": "b"}, "result": "x"},
        set(),
        "with a damaged pattern",
        0,
    ),
    "key of the blank": (
        {"pattern": ["A B"], "key": {"A": "a", "B": "b", " ": "c"}, "result": "x"},
        set(),
        "with a damaged pattern",
        0,
    ),
    "several results": (
        {"ingredients": ["a", "b"], "results": [{"item": "x"}, {"item": "y"}]},
        set(),
        "with several results",
        0,
    ),
    "no result": (
        {"ingredients": ["a", "b"], "result": {"count": 2}},
        set(),
        "without ingredients or result",
        0,
    ),
    "one of several results": (
        {"ingredients": ["a", "b"], "results": [{"item": "x"}]},
        {("a", "b", "x")},
        "",
        0,
    ),
    "two cells, two choices": (
        {"pattern": ["PP"], "key": {"P": ["oak", "birch"]}, "result": "x"},
        CHOICE,
        "",
        0,
    ),
    "the choices in another order": (
        {"ingredients": [["oak", "birch"], ["birch", "oak"]], "result": "x"},
        CHOICE,
        "",
        0,
    ),
    "a part twice": (
        {"ingredients": ["plank", "plank", "stick"], "result": "x"},
        {("plank", "stick", "x")},
        "",
        1,
    ),
    "a number of a part": (
        {"ingredients": [{"item": "a", "count": 3}, {"item": "b"}], "result": "x"},
        {("a", "b", "x")},
        "",
        1,
    ),
    "a number next to the result": (
        {"ingredients": ["a", "b"], "result": "x", "count": 4},
        {("a", "b", "x")},
        "",
        1,
    ),
}


def pack(folder, recipe):
    path = folder / "pack" / "recipe"
    path.mkdir(parents=True)
    (path / "torch.json").write_text(json.dumps(TORCH))
    (path / "other.json").write_text(recipe if isinstance(recipe, str) else json.dumps(recipe))
    return folder / "pack"


@pytest.mark.parametrize("case", KINDS)
def test_each_file_is_read_or_counted(tmp_path, case):
    recipe, expected, reason, counts = KINDS[case]
    book = read_book(pack(tmp_path, recipe))
    assert {tuple(each) for each in book.recipes} == ONE | expected
    reading = book.reading
    assert reading.left_out == ({reason: 1} if reason else {})
    assert reading.counts_dropped == counts
    assert reading.rows == reading.kept + sum(reading.left_out.values())


def test_a_key_twice_is_refused(tmp_path):
    path = pack(tmp_path, '{"ingredients": ["a", "b"], "result": "x", "result": "y"}')
    with pytest.raises(RecipeFileError, match="the key 'result' occurs twice"):
        read_book(path)


def test_an_ordinary_book_in_a_folder_called_recipes_is_read(put):
    path = put(zipped({"recipes/book.json": '{"mud": [["water", "earth"]]}'}), "book.zip")
    assert read_book(path).recipes == (("earth", "water", "mud"),)


def test_tags_of_the_pack_are_choices_and_no_entities(put):
    data = {
        "data/demo/tags/items/planks.json": {"values": ["#demo:oaks", "demo:birch"]},
        "data/demo/tags/items/oaks.json": {"values": ["demo:oak", {"id": "demo:dark_oak"}]},
        "data/demo/tags/items/circle.json": {"values": ["#demo:circle"]},
        "data/demo/recipes/lamp.json": {
            "ingredients": [{"tag": "demo:planks"}, "demo:coal"],
            "result": "demo:lamp",
        },
        "data/demo/recipes/door.json": {
            "ingredients": [{"tag": "minecraft:logs"}, "demo:coal"],
            "result": "demo:door",
        },
    }
    path = put(zipped({name: json.dumps(value) for name, value in data.items()}), "pack.zip")
    book = read_book(path)
    made_of = {label for recipe in book.recipes for label in recipe[:2]}
    assert made_of == {"demo:coal", "demo:oak", "demo:dark_oak", "demo:birch", "#minecraft:logs"}
    assert "3 tags of the pack are choices" in book.reading.line()


HEADER = "ingredient_a,ingredient_b,result\n"


def linked_zip():
    """A zip archive with a symbolic link to a file outside."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("book.csv", table())
        link = zipfile.ZipInfo("other.csv")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(link, "/etc/hostname")
    return buffer.getvalue()


BOMB = b"a" * 50_000_000
# Large contents are functions: each worker collects this file, and few run it.
REFUSED = {
    "total at the end": (
        table() + "Total,,7\n",
        "b.csv",
        "line 9: 'Total' alone is rather a total",
    ),
    "merged cells": (table() + ",earth,pot\n", "b.csv", "line 9: 'earth' is the only"),
    "formula": (table().replace("mud", '"=CONCAT(A2;B2)"').replace("_a", "1"), "b.csv", "formula"),
    "error of a formula": (
        table(header=("in1", "in2", "out")).replace("steam", "#REF!"),
        "b.csv",
        "'#REF!' is a spreadsheet's formula or its error",
    ),
    "mark in the middle": (
        table() + "\ufeff" + table(),
        "b.csv",
        "line 9: a byte order mark in the middle",
    ),
    "header in the middle": (table() + table(), "b.csv", "line 9: .* names the columns again"),
    "ten million characters": (
        lambda: table() + f"a,b,{'x' * 10_000_000}\n",
        "b.csv",
        "a line of 10,000,005 characters",
    ),
    "bomb, gzip": (lambda: gzip.compress(BOMB), "b.csv.gz", "at most 200 from a compressed byte"),
    "bomb, zip": (lambda: zipped({"b.csv": BOMB}), "b.zip", "expands more than 200 times"),
    "bomb in a zip": (
        lambda: zipped({"b.csv.gz": gzip.compress(BOMB)}),
        "b.zip",
        "at most 200 from a compressed byte",
    ),
    "link in a zip": (linked_zip(), "b.zip", "holds a link, 'other.csv'"),
    "path out of a zip": (zipped({"../b.csv": table()}), "b.zip", r"leads out of it, '\.\./b.csv'"),
    "two marks": (b"\xef\xbb\xbf" * 2 + table().encode(), "b.csv", "two byte order marks"),
    "row like a comment": (
        "#a:b,coal,torch\nstick,coal,torch\n",
        "b.csv",
        "no documented words name ingredients",
    ),
    "no table": ("water + earth > mud\n", "b.txt", "no table, because commas give 1 column"),
    "damaged zip": (zipped({"b.csv": table()})[:60], "b.zip", "is damaged"),
    "cut gzip": (gzip.compress(table().encode())[:-20], "b.gz", "is damaged"),
    "more after gzip": (gzip.compress(table().encode()) + b"more", "b.gz", "is damaged"),
    "zip in a zip": (zipped({"b.csv": zipped({"c.csv": table()})}), "b.zip", "within an archive"),
    "empty zip": (zipped({}), "b.zip", "0 files that may be recipe books"),
    "deep JSON": ('{"a":' * 10_000 + "1" + "}" * 10_000, "b.json", "nested too deeply"),
    "a key twice, the last of many": (
        lambda: "{" + "".join(f'"k{i}": null, ' for i in range(50_000)) + '"k49999": null}',
        "b.json",
        "the key 'k49999' occurs twice",
    ),
    "deep lists": ("[" * 10_000 + "]" * 10_000, "b.json", "nested too deeply"),
    "bzip2": (b"BZh91AY&SY", "b.csv", "compressed with bzip2"),
    "binary": (b"\x00\x01\x02a,b,c\n", "b.csv", "a binary file"),
    "UTF-16 without a mark": (table().encode("utf-16-le"), "b.csv", "--encoding utf-16-le"),
    "text behind JSON": ('{\n"mud": null}\nmore', "b.json", "line 3, column 1: not JSON"),
    "a damaged line of JSON": ('{"a": 1}\n{"b": \n', "b.jsonl", "line 2, column 7: not JSON"),
    "two delimiters": (
        "a;b,c;d,e;f\na;b,x;d,y;f\n",
        "b.csv",
        "the file has 'a;b', 'c;d', 'e;f'",
    ),
    "sums on both sides": ("a + b = c\nd = e + f\n", "b.txt", "line 2 has a sum behind its sign"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_files_are_refused_with_what_is_wrong(put, case):
    content, name, says = REFUSED[case]
    path = put(content() if callable(content) else content, name)
    with pytest.raises(RecipeFileError, match=says) as caught:
        read_book(path)
    assert len(str(caught.value)) < 1_500
    assert not check_book(path).passed


def test_html_entities_and_text_from_right_to_left_are_kept_and_named(put):
    text = HEADER + "salt &amp; pepper,water,brine\nמים,אש,אדים\n"
    book = read_book(put(text))
    assert "salt &amp; pepper" in book.entities
    notes = [f.message for f in check_book(put(text)).findings if f.kind == "html"]
    assert notes == [
        "the label 'salt &amp; pepper' holds an HTML entity; write the character itself"
    ]
    assert ("אש", "מים", "אדים") in book.recipes


def test_options_name_what_a_guess_cannot_know(put):
    path = put("x,y,z\n" + table(header=None))
    with pytest.raises(RecipeFileError, match="the file has 'x', 'y', 'z'"):
        read_book(path)
    expected = RecipeGraph.from_recipes(ROWS).hash
    named = read_book(path, columns=["x", "y", "z"])
    assert RecipeGraph.from_book(named).hash == expected
    turned = read_book(put(table(header=None)), columns=["1", "2", "3"])
    assert RecipeGraph.from_book(turned).hash == expected
    spaced = read_book(put(table(delimiter="^")), delimiter="^")
    assert RecipeGraph.from_book(spaced).hash == expected
    mac = put("in1,in2,out\nthé,eau,crème\n".encode("mac_roman"))
    assert read_book(mac, encoding="mac_roman").recipes == (("eau", "thé", "crème"),)
    upper = read_book(put(table().upper().replace("BRICK", "brick")), case="fold")
    assert RecipeGraph.from_book(upper).hash == expected


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"columns": ["nope", "b"]}, "`columns` 'nope': no such column"),
        ({"columns": ["1"]}, "expected different columns"),
        ({"columns": ["1", "1", "2"]}, "expected different columns"),
        ({"delimiter": "::"}, "`delimiter` '::'"),
        ({"encoding": "klingon"}, "`encoding` 'klingon'"),
        ({"encoding": "hex"}, "`encoding` 'hex'"),
        *[
            ({"encoding": name}, f"`encoding` '{name}'")
            for name in ("punycode", "idna", "unicode_escape", "undefined")
        ],
        ({"case": "lower"}, "`case` 'lower'"),
    ],
)
def test_wrong_options_are_refused(put, options, says):
    with pytest.raises(ConfigError, match=says):
        read_book(put(table()), **options)


def test_a_total_and_blank_rows_are_named(put):
    book = read_book(put(table(header=("in1", "in2", "out")) + ",,\n"))
    assert book.reading.left_out == {"blank": 1}
    assert "(1 blank)" in book.reading.line()


def test_another_encoding_than_that_of_the_mark_is_refused(put):
    path = put(b"\xef\xbb\xbf" + table().encode())
    with pytest.raises(RecipeFileError, match="begins with the byte order mark of utf-8"):
        read_book(path, encoding="cp1252")
    assert read_book(path, encoding="UTF8").recipes == read_book(path).recipes
