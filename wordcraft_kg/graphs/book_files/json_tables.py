"""Tables in JSON: lists of lists, and objects of columns."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

from wordcraft_kg.graphs.book_files.columns import (
    Roles,
    names_ingredient,
    names_property,
    readings,
    repeated_cells,
    roles_of_header,
    roles_of_option,
)
from wordcraft_kg.graphs.book_files.guide import refusal
from wordcraft_kg.graphs.book_files.json_found import FoundShape, JsonPart, RawRecipe
from wordcraft_kg.graphs.book_files.json_records import Records, recipes_of_records
from wordcraft_kg.graphs.book_files.places import result_place
from wordcraft_kg.graphs.book_files.rows import Fault

MOST_COLUMNS = 20
"""Most keys of an object that may be columns; a book has more results."""


# --- lists of lists ------------------------------------------------------------------------------


def rows_of_labels(part: JsonPart) -> FoundShape | None:
    """Return the recipes of a list of lists ``[a, b, result]``, a table perhaps with a header.

    Args:
        part: a value in the file.

    Returns:
        The recipes, made as they are read, with a fault for each row of another width; None for
        another shape.

    Raises:
        RecipeFileError: if neither a header nor the rows tell which column is the result.
        ConfigError: if the option `columns` names no column.
    """
    value = part.value
    if not isinstance(value, list) or not value:
        return None
    if not all(isinstance(row, list) for row in value):
        return None
    if all(map(_is_parted, value)):
        return _parted_rows(part)
    width = len(value[0])
    rows = _texts(value)
    if width < 2 or rows is None:
        return None
    roles, start = _roles_of_lists(part, rows)

    def raws() -> Iterator[RawRecipe | Fault]:
        for index, row in enumerate(rows[start:], start):
            here = f"{part.where}[{index}]"
            if len(row) != width:
                message = f"{here} has {len(row)} labels; the first row has {width}."
                yield Fault(here, "row", message, f"width {len(row)}")
                continue
            ingredients = [row[i] for i in roles.ingredients if row[i]]
            results = [row[i] for i in roles.results if row[i]]
            # A row without a result is a fault of its label, which names the place.
            for result in results or [""]:
                yield RawRecipe(here, row, ingredients, result)

    has_header = start > 0
    titles = rows[0] if has_header else [f"place {i + 1}" for i in range(width)]
    ignored = [title for i, title in enumerate(titles) if i not in roles.used]
    return FoundShape(
        "a list of lists",
        raws(),
        columns=tuple(titles[i] for i in (*roles.ingredients, *roles.results)),
        num_results=len(roles.results),
        ignored=tuple(ignored),
    )


def _is_parted(row: Sequence[Any]) -> bool:
    """Return whether a row is a list of ingredients and a result: ``[["water", "earth"], "mud"]``.

    A list within a row holds the ingredients, so that the columns are known.
    """
    return len(row) == 2 and isinstance(row[0], list) and isinstance(row[1], (str, int))


def _parted_rows(part: JsonPart) -> FoundShape | None:
    rows = _texts([[*ingredients, result] for ingredients, result in part.value])
    if rows is None:
        return None
    raws = []
    for index, row in enumerate(rows):
        here = f"{part.where}[{index}]"
        raws.append(RawRecipe(here, row, row[:-1], row[-1]))
    return FoundShape("a list of lists", raws)


def _texts(rows: Sequence[Sequence[Any]]) -> list[list[str]] | None:
    """Return rows of labels and numbers as texts; None if a cell is neither."""
    texts = []
    for row in rows:
        if not all(isinstance(cell, (str, int)) for cell in row):
            return None
        texts.append(list(map(str, row)))
    return texts


def _roles_of_lists(part: JsonPart, rows: Sequence[Sequence[str]]) -> tuple[Roles, int]:
    """Return the roles of a list of lists, and the index of its first recipe."""
    names, *others = rows
    width = len(names)
    header = roles_of_header(names)
    if header is not None and repeated_cells(names, header, others):
        header = None
    if part.columns is not None:
        by_number = all(column.strip().isdecimal() for column in part.columns)
        # Names in the option are those of a header, whatever it looks like.
        has_header = header is not None or not by_number
        return roles_of_option(part.columns, names, width), int(has_header)
    if header is not None:
        return header, 1
    result = None
    if width == 3:
        full = part.with_names([row for row in rows if len(row) == 3])
        result = result_place(full)
    if result is None:
        seen = f"a list of lists of {width} labels, and nothing tells which is the result"
        if width == 3:
            seen = f"{seen}: {readings(names)}"
        remedy = "Choose with `columns`, numbers with the result last."
        raise refusal(part.path, seen, "json", remedy)
    ingredients = tuple(place for place in range(3) if place != result)
    return Roles(ingredients, (result,)), 0


def split_table(part: JsonPart) -> FoundShape | None:
    """Return the recipes of a table as pandas writes it: ``{"columns": [], "data": [[]]}``.

    Args:
        part: a value in the file.

    Returns:
        The recipes, as those of a list of lists with a header; None for another layout.

    Raises:
        RecipeFileError: if neither the columns nor the rows tell which column is the result.
        ConfigError: if the option `columns` names no column.
    """
    value = part.value
    if not isinstance(value, dict):
        return None
    header = value.get("columns")
    rows = value.get("data")
    if not isinstance(header, list) or not isinstance(rows, list):
        return None
    return rows_of_labels(part._replace(value=[header, *rows], where="data"))


# --- objects of columns --------------------------------------------------------------------------


def columns_of_cells(part: JsonPart) -> FoundShape | None:
    """Return the recipes of an object of columns, each with a list of cells or cells by row.

    Args:
        part: a value in the file.

    Returns:
        The recipes, made as they are read; None for another shape.

    Raises:
        RecipeFileError: if the keys may be columns or results, or a single column of ingredients
            may hold labels or pairs.
        ConfigError: if the option `columns` names no column.
    """
    value = part.value
    if not isinstance(value, dict) or not 2 < len(value) <= MOST_COLUMNS:
        return None
    keys = list(value)
    cells = _cells_by_column(list(value.values()))
    if cells is None or not _are_columns(part, keys):
        return None
    strange = [key for key in keys if not names_property(key) and not names_ingredient(key)]
    if strange and part.columns is None:
        both = f"{keys[0][:40]!r} and {strange[0][:40]!r}"
        seen = f"{both} may be columns of a table, or results"
        remedy = "If they are columns, name them with `columns`."
        raise refusal(part.path, seen, "json", remedy)
    # From columns to rows: a record for the cells of one row.
    rows = []
    for row in zip(*cells, strict=True):
        record = dict(zip(keys, row, strict=True))
        rows.append(record)
    places = [f"{part.where}[{index}]" for index in range(len(rows))]
    found = recipes_of_records(Records(part, rows, places))
    if found is None:
        return None
    return replace(found, shape="columns")


def _are_columns(part: JsonPart, keys: Sequence[str]) -> bool:
    """Return whether the option `columns`, or else the keys' names, tell that keys are columns."""
    if part.columns is None:
        return roles_of_header(keys) is not None
    return part.columns[0] in keys


def _cells_by_column(values: Sequence[Any]) -> list[list[Any]] | None:
    """Return the cells of columns of one length; None if the values are no columns."""
    first = values[0]
    if not first:
        return None
    if all(isinstance(column, list) and len(column) == len(first) for column in values):
        cells = list(values)
    elif all(isinstance(column, dict) and column.keys() == first.keys() for column in values):
        cells = []
        for column in values:
            # Rows may stand in another order in each column.
            cells.append([column[row] for row in first])
    else:
        return None
    every_cell = chain.from_iterable(cells)
    if any(isinstance(cell, (list, dict)) for cell in every_cell):
        return None
    return cells
