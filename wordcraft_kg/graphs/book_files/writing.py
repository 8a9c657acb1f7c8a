"""Write recipe books: tables with our own header, or our own JSON."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from wordcraft_kg.base import RecipeFileError, output_target, write_atomically
from wordcraft_kg.graphs.arrays import json_recipes, row_text
from wordcraft_kg.graphs.book_files.cells import trim_unseen
from wordcraft_kg.graphs.book_files.words import KIND, QUANTITIES, own_header
from wordcraft_kg.graphs.recipes import Recipe, RecipeBook, RecipeRows

_JSON_FORMAT = "wordcraft-kg recipe book 1"
FurtherCells = tuple[Sequence[str], Mapping[Recipe, tuple[Sequence[str], Sequence[str]]]]
"""Names of further columns; by recipe, its ingredients in the order of a file and its cells."""


def write_book(book: RecipeBook, path: Path, further: FurtherCells | None = None) -> None:
    """Write a recipe book as ``.csv``, ``.tsv`` or ``.json``; reading restores an equal book.

    Args:
        book: the book.
        path: file to write; its ending chooses the format. A link is followed.
        further: further columns of a table. Labels that need a table of our own columns alone, such
            as numbers, are not read beside them.

    Raises:
        RecipeFileError: if the ending is another; nothing is written.
        OutputExistsError: if the path is a device, a pipe or a socket, or leads nowhere.
        OSError: if the file cannot be written.
    """
    ending = path.suffix.lower()
    target = output_target(path)
    if ending == ".json":
        write_atomically(target, book_json(book))
    elif ending in (".csv", ".tsv"):
        lines = recipe_table(book, "," if ending == ".csv" else "\t", further)
        write_atomically(target, chain(_directives(book), lines))
    else:
        raise RecipeFileError(
            f"{path}: unknown ending '{ending}'; a recipe book is written as .csv, .tsv or .json."
        )


def _directives(book: RecipeBook) -> Iterator[str]:
    """Yield comments that declare the base, also an empty one, and entities without a recipe."""
    # Between commas also above a table with tabs, as the reader of comments expects.
    if book.base is not None:
        yield f"# base: {csv_line(book.base, ',')}"
    if book.idle:
        yield f"# entities: {csv_line(book.idle, ',')}"


def recipe_table(
    book: RecipeBook, delimiter: str = ",", further: FurtherCells | None = None
) -> Iterator[str]:
    """Yield table lines: a header, then ingredients and result, kinds and quantities if any.

    Args:
        book: the book, whose recipes are in the order of the lines.
        delimiter: one character between cells.
        further: further columns.
    """
    rows = RecipeRows.of(book.recipes)
    num_ingredients = rows.ids.shape[1] - 1
    facts = {KIND: book.kinds, QUANTITIES: book.quantities}
    facts = {name: texts for name, texts in facts.items() if texts}
    if facts or further:
        names, row_of = further or ((), {})
        yield csv_line((*own_header(num_ingredients), *facts, *names), delimiter)
        for recipe in book.recipes:
            ingredients, cells = row_of.get(recipe, (recipe.ingredients, ()))
            if book.quantities:
                # Quantities are in the order of the recipe's ingredients.
                ingredients = recipe.ingredients
            blanks = [""] * (num_ingredients - len(ingredients))
            fact_cells = (texts.get(recipe, "") for texts in facts.values())
            yield csv_line((*ingredients, *blanks, recipe.result, *fact_cells, *cells), delimiter)
        return
    yield csv_line(own_header(num_ingredients), delimiter)
    # A label is looked at once, not in each of its recipes; the padding is a blank cell.
    texts = [*(_cell(label, delimiter) for label in rows.labels), ""]
    cells = [text + delimiter for text in texts]
    last_cells = [text + "\n" for text in texts]
    yield from row_text(rows.ids, (*[cells] * num_ingredients, last_cells))


def book_json(book: RecipeBook, **extra: Any) -> Iterator[str]:
    """Yield a book in our JSON layout, one recipe per line.

    Args:
        book: the book.
        extra: further top-level keys, with values of JSON.

    Raises:
        TypeError: if a value of ``extra`` is none of JSON.
        ValueError: if a number of ``extra`` is infinite or not a number.
    """
    dump = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode
    yield "{\n"
    yield f'"format": {dump(_JSON_FORMAT)},\n'
    yield f'"name": {dump(book.name)},\n'
    for name, values_by_recipe in (("kinds", book.kinds), (QUANTITIES, book.quantities)):
        if values_by_recipe:
            extra[name] = [values_by_recipe.get(recipe, "") for recipe in book.recipes]
    for key, value in extra.items():
        yield f"{dump(key)}: {dump(value)},\n"
    yield f'"base": {dump(book.base)},\n'
    yield f'"entities": {dump(book.entities)},\n'
    yield '"recipes": [\n'
    rows = RecipeRows.of(book.recipes)
    # Each label is encoded once, not in each of its recipes.
    yield from json_recipes(rows.ids, list(map(dump, rows.labels)))
    yield "]\n}\n"


def csv_line(labels: Iterable[str], delimiter: str) -> str:
    """Return a row, with quotes only around the cells that need them.

    Args:
        labels: the cells.
        delimiter: one character between them.
    """
    return delimiter.join(_cell(label, delimiter) for label in labels) + "\n"


def _cell(label: str, delimiter: str) -> str:
    """Return a label, in quotes if the reader would take it for something else without them."""
    # The reader strips blanks around a cell that has no quotes.
    is_stripped = label == label.strip() == trim_unseen(label)
    # A comment, or the mark at the start of a file.
    is_comment = label.startswith(("#", "//", "\ufeff"))
    if is_stripped and not is_comment and delimiter not in label and '"' not in label:
        return label
    doubled = label.replace('"', '""')
    return f'"{doubled}"'
