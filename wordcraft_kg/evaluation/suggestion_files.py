"""Suggestions as a table that a person ticks, and a book with the ticked recipes.

The table is a recipe file, so every command that takes a book reads it without options.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from wordcraft_kg.base import (
    OutputExistsError,
    RecipeFileError,
    check_output_file,
    nearest,
    output_target,
    write_atomically,
)
from wordcraft_kg.evaluation.suggestions import Suggestion
from wordcraft_kg.graphs import Recipe, RecipeBook, RecipeGraph, write_book
from wordcraft_kg.graphs.book_check import BookCheck, check_book
from wordcraft_kg.graphs.book_files.reader import SELF_RESULT
from wordcraft_kg.graphs.book_files.rows import Place
from wordcraft_kg.graphs.book_files.words import own_header
from wordcraft_kg.graphs.book_files.writing import csv_line

ACCEPT = "accept"
"""Column for the ticks."""
COLUMNS = ("probability", "because", ACCEPT)
"""Columns behind ingredients and result."""
TICKS = ("x", "yes", "y", "1", "true")
"""Cells that accept a recipe, in any case; all others leave it out."""


def because_cell(suggestion: Suggestion) -> str:
    """Return the nearest known recipe as the text of a cell, or an empty one."""
    for near in suggestion.because[:1]:
        return f"{' + '.join(near.ingredients)} -> {near.result}"
    return ""


def check_new_table(out: Path) -> None:
    """Check, before any work, that a table can be written.

    Raises:
        RecipeFileError: if the ending is no table's, or the file's folder is not there.
        OutputExistsError: if the file exists.
    """
    _check_new(out)
    if out.suffix.lower() not in (".csv", ".tsv"):
        raise RecipeFileError(f"{out}: suggestions are written as .csv or .tsv. Change the ending.")


def _check_new(out: Path) -> None:
    check_output_file(out, force=True)
    if not out.parent.is_dir():
        raise RecipeFileError(f"no folder '{out.parent}' for `out`; expected one. Make it first.")
    if out.exists():
        raise OutputExistsError(f"'{out}' exists, and is not replaced. Choose another `out`.")


def write_suggestions(suggestions: Sequence[Suggestion], out: Path) -> None:
    """Write suggestions as a table with an empty column for ticks.

    Args:
        suggestions: recipes, in the order of the rows.
        out: a .csv or .tsv file.

    Raises:
        RecipeFileError: if the ending is another, or there is no suggestion.
        OutputExistsError: if the file exists.
    """
    check_new_table(out)
    if not suggestions:
        raise RecipeFileError(f"{out} was not written: there is no suggestion to write.")
    delimiter = "," if out.suffix.lower() == ".csv" else "\t"
    write_atomically(output_target(out), table_lines(suggestions, delimiter))


def table_lines(suggestions: Sequence[Suggestion], delimiter: str = ",") -> Iterator[str]:
    """Yield the lines of a table of suggestions: a header, and a line for each.

    Args:
        suggestions: recipes, in the order of the lines.
        delimiter: one character between cells.
    """
    width = max((len(suggestion.ingredients) for suggestion in suggestions), default=2)
    yield csv_line((*own_header(width), *COLUMNS), delimiter)
    for suggestion in suggestions:
        empty = [""] * (width - len(suggestion.ingredients))
        probability = f"{suggestion.probability:.3f}"
        further_cells = (probability, because_cell(suggestion), "")
        cells = (*suggestion.ingredients, *empty, suggestion.result, *further_cells)
        yield csv_line(cells, delimiter)


def ticked(path: Path, graph: RecipeGraph) -> list[Recipe]:
    """Return the ticked recipes of a table of suggestions, in its order.

    A result may be an entity that the book lacks: the person who ticks may name a new thing.

    Raises:
        RecipeFileError: if the table cannot be read, has no column of ticks or no tick, or a ticked
            row is no recipe, has an ingredient that the book lacks, or is in the book.
    """
    # A page of suggestions may have no set of three, without which readers refuse sets of one.
    check = check_book(path, single_ingredient="alone")
    reading = check.reading
    if reading is None:
        raise RecipeFileError(str(check.findings[0].message))
    columns = {name.strip().lower(): name for name in reading.ignored}
    if ACCEPT not in columns:
        columns_shown = ", ".join((*reading.columns, *reading.ignored))
        raise RecipeFileError(
            f"{path} has the columns {columns_shown}; expected a column '{ACCEPT}' with x in the "
            "rows to take, as in a table of `wordcraft-kg suggest --out`."
        )
    ticked_places = {
        place
        for place, cells in check.records.items()
        if cells.get(columns[ACCEPT], "").strip().lower() in TICKS
    }
    _check_none_is_lost(path, check, ticked_places, keeps_self_results=graph.has_self_results)
    book_recipes = set(graph.recipe_labels())
    recipes = []
    for recipe, place in check.places.items():
        if place not in ticked_places:
            continue
        for label in recipe.ingredients:
            if label not in graph:
                raise RecipeFileError(
                    f"{path}, line {place}: '{label}' is no entity of {graph.name}; expected "
                    "suggestions for this book. Nothing was written."
                    f"{nearest(label, graph.entities)}"
                )
        if recipe in book_recipes:
            raise RecipeFileError(
                f"{path}, line {place}: {recipe} is in {graph.name} already. Remove the tick. "
                "Nothing was written."
            )
        recipes.append(recipe)
    if not recipes:
        raise RecipeFileError(
            f"{path} has no tick; expected {', '.join(TICKS)} in the column '{ACCEPT}' of the rows "
            "to take. Nothing was written."
        )
    return recipes


def _check_none_is_lost(
    path: Path, check: BookCheck, ticked_places: Collection[Place], *, keeps_self_results: bool
) -> None:
    for reason, places in check.lost.items():
        lost_places = [place for place in places if place in ticked_places]
        is_lost = reason != SELF_RESULT or not keeps_self_results
        if lost_places and is_lost:
            raise RecipeFileError(
                f"{path}, line {lost_places[0]}: this row has a tick, but is among the rows "
                f"{reason}. Correct the row, or remove its tick. Nothing was written."
            )


def write_accepted(graph: RecipeGraph, recipes: Sequence[Recipe], out: Path) -> None:
    """Write a copy of a graph's book with further recipes.

    Args:
        graph: the graph; its own file stays as it is.
        recipes: the further recipes.
        out: a .csv, .tsv or .json file.

    Raises:
        RecipeFileError: if the ending is another.
        OutputExistsError: if the file exists.
    """
    _check_new(out)
    book = graph.to_book()
    longer = RecipeBook.of(
        book.name,
        [*book.recipes, *recipes],
        base=book.base,
        listed=book.idle,
        keep_self_results=True,
    )
    write_book(replace(longer, kinds=book.kinds, quantities=book.quantities), out)
