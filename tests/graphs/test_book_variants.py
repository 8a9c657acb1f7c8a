"""One book in many dialects gives one graph or a refusal; spoilt files lose no row in silence."""

import bz2
import gzip
import random
from itertools import islice, product

import pytest
from book_shapes import zipped

from wordcraft_kg.base.errors import WordCraftKGError
from wordcraft_kg.graphs import RecipeGraph, open_book, read_book

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
