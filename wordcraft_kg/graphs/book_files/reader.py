"""Read a recipe book from a file in any readable shape; one guess, which is announced.

``opening`` finds container, encoding and shape. ``book_rows`` turns entries into recipes of two
ingredients and counts what is left out. :func:`read_book` stops at the first fault; ``check_book``
takes the same rows and lists all faults.
"""

import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.graphs.book_files.book_rows import BookRows
from wordcraft_kg.graphs.book_files.guide import GUIDE, naming_the_guide
from wordcraft_kg.graphs.book_files.opening import open_source
from wordcraft_kg.graphs.book_files.options import BookOptions, ReadOptions
from wordcraft_kg.graphs.book_files.rows import Fault
from wordcraft_kg.graphs.chains import makes_nothing
from wordcraft_kg.graphs.recipes import Recipe, RecipeBook, label_fault


@stage("reading the book")
def read_book(
    path: str | Path,
    *,
    keep_self_results: bool = False,
    name: str | None = None,
    **options: Unpack[ReadOptions],
) -> RecipeBook:
    """Read and validate a recipe book from a file, or from a graph folder.

    Tables with any delimiter and order of columns, lines ``a + b = c``, JSON in the shapes of
    common games, saves of Infinite Craft and folders of Minecraft recipes are read, also in gzip or
    zip. The guess is in ``reading`` of the result. In tables, leading lines with ``#`` are
    comments; ``# base: a, b`` declares base entities (known at the start), and ``# entities: a, b``
    lists entities without a recipe. A column ``kind`` may name each recipe's kind of reasoning.

    Args:
        path: the file, or a graph folder.
        keep_self_results: keep recipes with the result among the ingredients.
        name: the book's name; None uses the file's or folder's name.
        options: what a user says about the file, see :class:`BookOptions`.

    Returns:
        The book, with the record of how it was read in ``reading``.

    Raises:
        RecipeFileError: naming the line or JSON key with the first error; also if the file cannot
            be read, its shape is not certain, or it has no recipe to keep.
        ConfigError: for an option outside its values, or `columns` that the file does not have.
    """
    path = Path(path)
    if (path / "graph.json").is_file():
        path = path / "graph.json"
    chosen = BookOptions(**options)
    with naming_the_guide(path):
        file = open_source(path, chosen)
    rows = BookRows(file, chosen)
    at_once = rows.all_at_once()
    book = RecipeBook.of(
        name or book_name(path),
        _without_faults(path, rows) if at_once is None else at_once,
        listed=rows.listed,
        keep_self_results=keep_self_results,
        sha256=file.sha256,
    )
    entities = book.entities
    reading = rows.reading(book.merged_duplicates, book.dropped_self_results, entities)
    if makes_nothing(book.recipes):
        left_out = [f"{number:,} {reason}" for reason, number in reading.left_out.items()]
        why = "half-products only" if book.recipes else "no rows"
        if left_out:
            why = ", ".join(left_out)
        raise RecipeFileError(
            f"{path} has no recipe to keep (read as {reading.shape}; {why}). See {GUIDE}."
        )
    base = rows.base
    declared = None
    if base is not None:
        # Places in JSON are no lines; JSON checks its base when it is opened.
        for label, line in base.items():
            if isinstance(line, int) and label not in entities:
                raise RecipeFileError(f"{path}, line {line}: {unknown_base(label, entities)}")
        declared = tuple(sorted(base))
    kinds = {}
    if rows.kinds:
        # Recipes that the book left out have no kind in it.
        kinds = {recipe: rows.kinds[recipe] for recipe in book.recipes if recipe in rows.kinds}
    logging.getLogger(__name__).info("%s: %s", path, reading.line())
    return replace(book, base=declared, kinds=kinds, reading=reading)


def _without_faults(path: Path, rows: BookRows) -> Iterator[Recipe]:
    for entry in rows:
        if isinstance(entry, Fault):
            raise RecipeFileError(place_of(path, entry))
        yield from entry[1]


def place_of(path: Path, fault: Fault) -> str:
    """Return a fault's message with its file and line; places in JSON are in the message.

    Args:
        path: the file.
        fault: an entry that is no recipe.
    """
    if isinstance(fault.place, int):
        return f"{path}, line {fault.place}: {fault.message}"
    return f"{path}: {fault.message}"


def book_name(path: Path) -> str:
    """Return a book's default name: the file or folder name, without control characters."""
    name = path.parent.name if path.name == "graph.json" else path.stem
    if label_fault(name) is None:
        return name
    return "".join(char if char.isprintable() else "_" for char in name) or "book"


def unknown_base(label: str, known: Any) -> str:
    """Return the error message for a base entity that is not among the known labels.

    Args:
        label: the base entity.
        known: labels of all entities, of which the most similar one is named.
    """
    return (
        f"the base entity '{label}' is in no recipe.{nearest(label, known)} "
        f"If it is meant, list it as well: # entities: {label}"
    )
