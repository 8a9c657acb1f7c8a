"""Published splits: each recipe's part from a file, checked against a recipe graph.

A table names results or recipes, with the columns ``part``, ``result`` and perhaps the ingredient
columns of our own table. JSON has a list for each part, or an object of results with their sets as
in a recipe book: ``{"train": {"mud": [["water", "earth"]]}, "test": ["brick"]}``. A result stands
for all its recipes. Other keys and columns, such as a licence, are ignored.
"""

import csv
import io
import json
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base import SplitError, check_file, counted
from wordcraft_kg.base.artefacts import gunzip, is_gzip
from wordcraft_kg.graphs.arrays import Ids, stacked
from wordcraft_kg.graphs.book_files.files import MAX_BOOK_SIZE, without_repeated_keys
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import MOST_INGREDIENTS, shown
from wordcraft_kg.graphs.splits import (
    PARTS,
    TEST,
    TRAIN,
    VALID,
    Draw,
    Published,
    Split,
    SplitConfig,
    groups_of,
)

_PART_OF_NAME = {
    **dict.fromkeys(("train", "training"), TRAIN),
    **dict.fromkeys(("valid", "validation", "val", "dev"), VALID),
    "test": TEST,
}
_EXPECTED = (
    "expected a table with the columns part, result and, for single recipes, ingredient_a, "
    'ingredient_b, ..., or JSON such as {"train": ["mud"], "test": [["mud", "fire", "brick"]]}'
)
_NO_PART = -1
_Entry = tuple[tuple[str, ...], int]
"""Labels (*ingredients, result) or (result,) and the part."""


def read_published_split(path: Path, graph: RecipeGraph, *, fold: bool = False) -> Split:
    """Read a split from a file.

    The split is by-goal if the file holds out whole results, else by-recipe-plain; its ratios are
    the shares of the recipes.

    Args:
        path: a CSV or JSON file, also in gzip.
        graph: the graph whose recipes it divides.
        fold: whether labels are folded to lower case, as those of the graph were.

    Raises:
        ArtefactError: if the file is missing, or larger than a recipe book may be.
        SplitError: if the file has another shape, a recipe has two parts or none, or the train or
            test part is empty.
    """
    check_file(path, MAX_BOOK_SIZE)
    packed = path.read_bytes()
    data = gunzip(path, packed, MAX_BOOK_SIZE, SplitError) if is_gzip(packed) else packed
    entries = _entries(path, data)
    if fold:
        entries = [(tuple(map(str.lower, labels)), part) for labels, part in entries]
    parts = np.full(graph.num_recipes, _NO_PART, dtype=np.int8)
    unknown = 0
    for part in (TRAIN, VALID, TEST):
        entries_of_part = [labels for labels, entry_part in entries if entry_part == part]
        rows, num_unknown = _rows(graph, entries_of_part)
        unknown += num_unknown
        conflicts = rows[(parts[rows] != _NO_PART) & (parts[rows] != part)]
        if len(conflicts):
            names = f"{PARTS[parts[conflicts[0]]]} and {PARTS[part]}"
            raise SplitError(
                f"{path}: the recipe {_recipe(graph, conflicts)} is in {names}; expected one."
            )
        parts[rows] = part
    unassigned = np.flatnonzero(parts == _NO_PART)
    if len(unassigned):
        raise SplitError(
            f"{path}: {counted(len(unassigned), 'recipe')} of {graph.num_recipes:,} without a "
            f"part, such as {_recipe(graph, unassigned)}; a published split names all recipes of "
            "the graph."
        )
    for part in (TRAIN, TEST):
        if not (parts == part).any():
            raise SplitError(f"{path}: the {PARTS[part]} part has no recipe of this graph.")
    train, valid = (float(np.mean(parts == part)) for part in (TRAIN, VALID))
    kind = "by-goal" if _is_whole(groups_of(graph, "by-goal"), parts) else "by-recipe-plain"
    published = Published(file=path.name, sha256=sha256(packed).hexdigest(), unknown=unknown)
    return Split(graph, SplitConfig(kind, train, valid), Draw(parts, published=published))


def _entries(path: Path, data: bytes) -> list[_Entry]:
    """Return the entries of a JSON or CSV file; SplitError for a file of another shape."""
    try:
        text = data.decode("utf-8-sig")
        if text.lstrip()[:1] in ("{", "["):
            return list(_json_entries(json.loads(text, object_pairs_hook=without_repeated_keys)))
        return list(_table_entries(text))
    except RecursionError:
        raise SplitError(f"{path}: no split (nested too deeply); {_EXPECTED}.") from None
    except (ValueError, csv.Error) as error:
        raise SplitError(f"{path}: no split ({error}); {_EXPECTED}.") from None


def _json_entries(document: Any) -> Iterator[_Entry]:
    """Yield the entries of the lists or objects below the names of parts."""
    keys = document if isinstance(document, dict) else {}
    values = [(_PART_OF_NAME.get(key.strip().lower()), value) for key, value in keys.items()]
    named = [(part, value) for part, value in values if part is not None]
    if not named:
        raise ValueError("no key is the name of a part")
    for part, value in named:
        if isinstance(value, dict):
            for result, sets in value.items():
                # An empty set is no result: it would stand for all recipes of the result.
                yield from (((*_labels(each), result), part) for each in _list(sets))
        else:
            for row in _list(value):
                yield ((row,) if isinstance(row, str) else _labels(row)), part


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise ValueError(f"{shown(value)} in place of a list")
    return value


def _labels(value: Any) -> tuple[str, ...]:
    labels = _list(value)
    if not labels or not all(isinstance(label, str) for label in labels):
        raise ValueError(f"{shown(value)} in place of a list of labels")
    return tuple(labels)


def _table_entries(text: str) -> Iterator[_Entry]:
    """Yield the entries of a table with a header; blank cells are no ingredients."""
    # Line ends of any system; a label holds none.
    reader = csv.DictReader(io.StringIO(text, newline=None))
    columns = [name.strip() for name in reader.fieldnames or ()]
    if not {"part", "result"}.issubset(columns):
        raise ValueError("no columns part and result")
    # Spreadsheets leave columns and rows of blanks.
    named = [name for name in columns if name]
    if len(set(named)) < len(named):
        raise ValueError("two columns have the same name")
    reader.fieldnames = columns
    for row in reader:
        if None in row:
            raise ValueError(f"line {reader.line_num} has more cells than the header")
        cells = {name: (cell or "").strip() for name, cell in row.items()}
        if not any(cells.values()):
            continue
        part = _PART_OF_NAME.get(cells["part"].lower())
        if part is None:
            cell = f"the part {shown(cells['part'])}"
            raise ValueError(f"line {reader.line_num}: {cell} is not train, valid or test")
        ingredients = (cell for name, cell in cells.items() if name.startswith("ingredient"))
        yield (*filter(None, ingredients), cells["result"]), part


def _rows(graph: RecipeGraph, entries: list[tuple[str, ...]]) -> tuple[Ids, int]:
    """Return the rows of results and recipes in the graph, and the number of unknown entries."""
    # Longer rows are no recipes, and one of a million labels would widen the table for all.
    short = (labels for labels in entries if len(labels) <= MOST_INGREDIENTS + 1)
    known_entries = [labels for labels in short if all(label in graph for label in labels)]
    results = [labels[0] for labels in known_entries if len(labels) == 1]
    recipes = [labels for labels in known_entries if len(labels) > 1]
    ids = graph.ids_of(label for labels in recipes for label in labels)
    table = stacked(ids, list(map(len, recipes)), graph.num_entities)
    table[:, :-1].sort(axis=1)
    rows_of_recipes = graph.rows_of(table)
    rows_of_results = [graph.recipes_of(result) for result in results]
    unknown = len(entries) - len(known_entries) + int(np.sum(rows_of_recipes < 0))
    unknown += sum(not len(rows) for rows in rows_of_results)
    rows = np.concatenate([rows_of_recipes[rows_of_recipes >= 0], *rows_of_results])
    return rows.astype(np.int64), unknown


def _recipe(graph: RecipeGraph, rows: Ids) -> str:
    return str(graph.recipe_labels(graph.sets[rows[:1]])[0])


def _is_whole(groups: Ids, parts: NDArray[np.int8]) -> bool:
    """Return whether each group is in one part.

    Args:
        groups: group of each recipe, shape (num_recipes,).
        parts: part of each recipe, same shape.
    """
    group_parts = np.unique(np.column_stack([groups, parts]), axis=0)
    return len(group_parts) == len(np.unique(groups))
