"""Files as people have them: read as downloaded, or refused with what is missing."""

import json
import re
from pathlib import Path

import pytest
from book_shapes import SHAPES, zipped

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs import read_book
from wordcraft_kg.graphs.book_check import check_book
from wordcraft_kg.graphs.book_files import rows as words

ROOT = Path(__file__).parents[2]

READ = [shape for shape in SHAPES if not shape.says]

REFUSED = [shape for shape in SHAPES if shape.says]


def put(shape, folder):
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
    path = put(shape, tmp_path)
    book = read_book(path, **shape.options)
    assert expected(book.recipes) == expected(shape.rows)
    reading = book.reading
    assert reading.rows == reading.kept + sum(reading.left_out.values())
    assert reading.kept == len(shape.rows)
    assert reading.line().startswith(f"read as {reading.shape}")
    checked = check_book(path, **shape.options)
    assert checked.book.recipes == book.recipes
    assert checked.reading == reading


@pytest.mark.parametrize("shape", REFUSED, ids=lambda shape: shape.name)
def test_a_refusal_names_what_is_missing_and_the_guide(tmp_path, shape):
    path = put(shape, tmp_path)
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
def test_the_guides_examples_are_read(tmp_path, title):
    path = tmp_path / "book.txt"
    path.write_text(EXAMPLES[title], encoding="utf-8")
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


def test_an_ordinary_book_in_a_folder_called_recipes_is_read(tmp_path):
    path = tmp_path / "book.zip"
    path.write_bytes(zipped({"recipes/book.json": '{"mud": [["water", "earth"]]}'}))
    assert read_book(path).recipes == (("earth", "water", "mud"),)


def test_tags_of_the_pack_are_choices_and_no_entities(tmp_path):
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
    path = tmp_path / "pack.zip"
    path.write_bytes(zipped({name: json.dumps(value) for name, value in data.items()}))
    book = read_book(path)
    made_of = {label for recipe in book.recipes for label in recipe[:2]}
    assert made_of == {"demo:coal", "demo:oak", "demo:dark_oak", "demo:birch", "#minecraft:logs"}
    assert "3 tags of the pack are choices" in book.reading.line()
