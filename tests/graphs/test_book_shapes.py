"""Files as people have them: read as downloaded, or refused with what is missing."""

import bz2
import gzip
import json
import random
import re
from itertools import islice, product
from pathlib import Path

import pytest
from book_shapes import SHAPES, zipped

from wordcraft_kg.base.errors import RecipeFileError, WordCraftKGError
from wordcraft_kg.graphs import RecipeGraph, open_book, read_book
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


DELIMITERS = ",;\t|"

QUOTES = ("none", "all", "needed", "single")  # the last one is refused

HEADERS = {
    "own": ("ingredient_a", "ingredient_b", "result"),
    "capitals": ("Ingredient A", "Ingredient B", "Result"),
    "renamed": ("react1", "react2", "products"),
    "names": ("first", "second", "Product name"),
    "foreign": ("Zutat1", "Zutat2", "Ergebnis"),
    "none": None,
}

ORDERS = ((0, 1, 2), (2, 0, 1), (1, 2, 0))

CASES = ("keep", "upper", "results")

ENDS = ("\n", "\r\n", "\r")

ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252", "mac_roman")

PACKINGS = ("plain", "gzip", "zip", "bzip2")

EXTRAS = ("", "emoji", "index", "trailing")


def variants():
    """Yield all combinations in an order in which few of them differ in everything."""
    every = list(
        product(DELIMITERS, QUOTES, HEADERS, ORDERS, CASES, ENDS, ENCODINGS, PACKINGS, EXTRAS)
    )
    random.Random(49).shuffle(every)
    yield from every


def cells_of(row, quotes, delimiter):
    if quotes == "all":
        return [f'"{cell}"' for cell in row]
    if quotes == "single":
        return [f"'{cell}'" for cell in row]
    if quotes == "needed":
        return [f'"{cell}"' if delimiter in cell or " " in cell else cell for cell in row]
    return list(row)


def written(rows, variant):
    """Return a book's bytes in a variant."""
    delimiter, quotes, header, order, case, end, encoding, packing, extra = variant
    rows = [list(row) for row in rows]
    if case == "upper":
        rows = [[cell.upper() for cell in row] for row in rows]
    elif case == "results":
        rows = [[a, b, c.capitalize()] for a, b, c in rows]
    names = HEADERS[header]
    table = [[row[i] for i in order] for row in ([list(names)] if names else []) + rows]
    for number, row in enumerate(table):
        if extra == "emoji":
            row.append("emoji" if names and not number else "🔥" if "utf" in encoding else "x")
        elif extra == "index":
            row.insert(0, "" if names and not number else str(number))
    lines = [delimiter.join(cells_of(row, quotes, delimiter)) for row in table]
    if extra == "trailing":
        lines = [line + delimiter for line in lines]
    data = (end.join(lines) + end).encode(encoding)
    pack = {
        "plain": bytes,
        "gzip": gzip.compress,
        "bzip2": bz2.compress,
        "zip": lambda data: zipped({"recipes.csv": data}),
    }
    return pack[packing](data)


def outcome(folder, data, **options):
    """Return the hash of a file's graph, or the refusal."""
    path = folder / "book.csv"
    path.write_bytes(data)
    try:
        return RecipeGraph.from_book(read_book(path, **options)).hash
    except WordCraftKGError as error:
        return str(error)


@pytest.mark.parametrize(
    "number", [24, pytest.param(500, marks=pytest.mark.slow)], ids=["few", "all"]
)
def test_variants_of_one_book_give_its_graph_or_a_refusal(tmp_path, number):
    accents = {"bread": "crème brûlée", "water": "eau", "cheese": "gruyère"}
    rows = [[accents.get(cell, cell) for cell in row] for row in open_book("kitchen").recipes]
    graph = RecipeGraph.from_recipes(rows).hash
    read = 0
    for variant in islice(variants(), number):
        found = outcome(tmp_path, written(rows, variant), case="fold")
        is_refused = found.startswith(str(tmp_path)) and "See docs/your-file.md#" in found
        assert found == graph or is_refused, (variant, found)
        read += found == graph
    # Three quarters have a packing and quotes that are read, half an encoding, five sixths a header.
    assert read > 0.2 * number


SPOILT = ('"', ";", ",", "\t", "|", "\n", "\r", "\x00", "\ufeff", "+", "=", "{", "}", " ", "#", "é")


def spoilt(rows, rng):
    """Return a table with some characters added, removed or repeated, and how many rows it has."""
    lines = ["ingredient_a,ingredient_b,result", *(",".join(row) for row in rows)]
    for _ in range(rng.choice((0, 1, 2, 5))):
        at = rng.randrange(len(lines))
        line = lines[at]
        place = rng.randrange(len(line) + 1)
        kind = rng.randrange(5)
        if kind == 0:
            line = line[:place] + rng.choice(SPOILT) + line[place:]
        elif kind == 1:
            line = line[:place] + line[place + rng.choice((1, 3)) :]
        elif kind == 2:
            line = line + "," + line
        elif kind == 3:
            line = line.replace(",", rng.choice(",;\t|"))
        else:
            line = line[:place]
        lines[at] = line
    return "\n".join(lines) + "\n"


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
