"""Documents, JSON or the rows of a table: recipes by paths of ingredients and of the result.

A column of a document has a path, and its cells are texts, numbers, or lists and objects that hold
labels. Documented words name the columns of ingredients and results (``words``); the shapes
``{result: [[a, b]]}`` and ``{a: {b: result}}`` need no words, and the option `columns` names any
path. The rule takes one of these ways.

A path has keys after points, ``[]`` for each element of a list, ``[0]`` for its first one, ``{}``
for each value of an object, and ``{key}`` at its end for the keys of an object. A backslash takes a
sign in a key as it is. Paths that begin alike go through the same lists together.
"""

import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, count, islice, product
from operator import itemgetter
from pathlib import Path as FilePath
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace

from wordcraft_kg.base import ConfigError, listed, nearest
from wordcraft_kg.graphs.book_files.cells import (
    NUMBER,
    cell_fault,
    exact_fault,
    find_joiner,
    is_number,
    labels_in,
    read_labels,
    rows_of_raw,
    trim_unseen,
)
from wordcraft_kg.graphs.book_files.rows import (
    INFINITE_CRAFT_BASE,
    WITHOUT,
    Entry,
    Fault,
    FileRows,
    LeftOut,
    Place,
    Raw,
    Row,
    fault_at,
    is_infinite_craft,
    refusal,
    without_nothing,
)
from wordcraft_kg.graphs.book_files.rule import ReadingCandidate, choose
from wordcraft_kg.graphs.book_files.words import (
    COUNT,
    CSV_HEADER,
    EACH,
    INGREDIENT,
    KEY,
    KIND,
    LOOPS,
    QUANTITIES,
    VALUES,
    Path,
    Way,
    has_role,
    is_documented,
    is_plain,
    ways_by_words,
    words_of,
)
from wordcraft_kg.graphs.recipes import RecipeRows, check_label, label_fault

GRAMMAR = (
    "a path of keys, with [] for each element of a list, [0] for the first, {} for each value of "
    "an object and {key} for its keys, such as 'recipes[].parts[],recipes[].out.name'"
)
_STEP = re.compile(r"\[\d*\]|\{(?:key)?\}|\.?((?:\\.|[^.\[\]{}\\])+)")
MOST_STEPS = 50
"""Steps of the longest path."""
_MOST_ROWS = 1_000_000  # of lists that are combined with each other
_FEW_BELOW = 2  # recipes below a key
_DENSE = 0.5  # share of an object's keys that its siblings have as well
_MOST_PATHS = 12  # in a refusal
_MOST_WAYS = 60  # that are tried
_MOST_COLUMNS = 1_000  # more are no keys


class Located(NamedTuple):
    """A value with its place, and the key at which an object has it."""

    place: str
    value: Any
    key: str = ""


Columns = dict[Path, list[Any]]
"""Cells of a document by the path of their column."""


@dataclass
class Document:
    """A value of JSON, or the rows of a table as such a value.

    Attributes:
        value: the value.
        places: line of each row of a table.
        others: faults and rows left out.
        is_table: whether it is a table.
        fault: returns why a text is no label, or None.
    """

    value: Any
    places: list[int] = field(default_factory=list)
    others: list[Entry] = field(default_factory=list)
    is_table: bool = False
    fault: Callable[[str], str | None] = cell_fault


def read_document(
    path: FilePath,
    document: Document,
    source: FileRows,
    columns: Sequence[str] | None = None,
    *,
    fold: bool = False,
    allows_single: bool = False,
) -> FileRows:
    """Find the recipes in a document.

    Args:
        path: the file, for errors.
        document: its value.
        source: what is known of its rows, which gets the recipes.
        columns: paths of ingredients and, last, of the result; None for documented words.
        fold: whether labels are in lower case.
        allows_single: see :func:`~wordcraft_kg.graphs.book_files.rule.choose`.

    Raises:
        RecipeFileError: if the document has no reading that the rule takes.
        ConfigError: if ``columns`` lead nowhere.
    """
    _take_base(path, document, source)
    value = document.value
    source.entries = document.others
    if not value or not isinstance(value, list | dict):
        return source
    if source.is_exact:
        return _read_exact(document, source)
    cells: Columns = {}
    if document.is_table:
        cells = {(EACH, f".{name}"): [row[name] for row in value] for name in value[0]}
    else:
        _collect(cells, (), [value])
    anchor = "table" if document.is_table else "json"
    if len(cells) > _MOST_COLUMNS:
        raise refusal(path, f"{len(cells):,} different keys, more than {_MOST_COLUMNS:,}", anchor)
    read_candidate = partial(_candidate, document, source, cells, fold=fold)
    if columns is not None:
        best = read_candidate(_given(document, columns, cells), is_given=True)
    else:
        candidates = list(map(read_candidate, islice(_ways(cells), _MOST_WAYS)))
        shown = _shown_paths(cells, is_table=document.is_table)
        best = choose(path, candidates, anchor, shown, allows_single=allows_single)
    source.entries = best.entries
    source.reading = best.reading
    if is_infinite_craft(best.entries):
        source.entries = without_nothing(best.entries)
        # Saves list items with emoji; another table or list may have these labels by chance.
        if not source.base and any(path[-1:] in ((".text",), (".emoji",)) for path in cells):
            source.base = dict.fromkeys(INFINITE_CRAFT_BASE, "items")
    return source


def _read_exact(document: Document, source: FileRows) -> FileRows:
    """Take the recipes of our own table, whose cells are labels as they stand."""
    source.numbered = _numbered(document)
    # Row by row only if somebody asks.
    rows = _exact_rows(document)
    is_at_once = source.numbered is not None
    source.entries = rows if is_at_once else sorted(rows, key=itemgetter(0))
    columns = [name for name in document.value[0] if name not in (KIND, QUANTITIES)]
    source.reading = replace(source.reading, columns=tuple(columns))
    return source


def _numbered(document: Document) -> RecipeRows | None:
    """Return the recipes of our own table at once; None unless each row is a plain pair.

    Each label is judged once, and no row becomes an object: many times faster for a large book.
    """
    if document.others or len(document.value[0]) != len(CSV_HEADER):
        return None
    number_of: defaultdict[str, int] = defaultdict(count().__next__)
    cells = chain.from_iterable(map(dict.values, document.value))
    ids = np.fromiter(map(number_of.__getitem__, cells), np.int64)
    if any(map(exact_fault, number_of)):
        return None
    return RecipeRows(number_of, ids.reshape(-1, len(CSV_HEADER)))


def _take_base(path: FilePath, document: Document, source: FileRows) -> None:
    """Take a list of labels under the key ``base`` out of a document, as the base."""
    value = document.value
    base = value.get("base") if isinstance(value, dict) else None
    if isinstance(base, list) and all(isinstance(label, str) for label in base):
        source.base = {check_label(trim_unseen(label), f"{path}: base"): "base" for label in base}
        document.value = {key: member for key, member in value.items() if key != "base"}


def _given(document: Document, columns: Sequence[str], cells: Columns) -> Way:
    """Return the way that the option `columns` gives: names and numbers of columns, or paths."""
    names = list(document.value[0]) if document.is_table else []
    paths: list[Path] = []
    for text in map(str.strip, columns):
        if text in names:
            paths.append((EACH, f".{text}"))
        elif text.isdecimal() and 0 < int(text) <= len(names):
            paths.append((EACH, f".{names[int(text) - 1]}"))
        else:
            paths.append(parse_path(text))
    if len(paths) < 2 or len(set(paths)) < len(paths):
        raise ConfigError(
            f"`columns` {','.join(columns)}: expected different columns, of the ingredients and, "
            "last, of the result."
        )
    for text, steps in zip(columns, paths, strict=True):
        if not any(True for _ in leaves(Located("", document.value), steps)):
            hint = nearest(text, [path_text(path, document.is_table) for path in cells])
            grammar = "" if document.is_table else f" A path is {GRAMMAR}."
            shown = _shown_paths(cells, is_table=document.is_table)
            raise ConfigError(f"`columns` {text!r}: no such column; {shown}.{hint}{grammar}")
    return Way(tuple(paths[:-1]), (paths[-1],))


# --- paths ---------------------------------------------------------------------------------------


def parse_path(text: str) -> Path:
    """Return the steps of a path.

    Raises:
        ConfigError: if the text is no path; the message has the grammar.
    """
    steps: list[str] = []
    at = 0
    while at < len(text):
        step = _STEP.match(text, at)
        if step is None or len(steps) > MOST_STEPS:
            raise ConfigError(f"`columns` {text[:80]!r}: expected {GRAMMAR}.")
        if step[1] is not None:
            steps.append("." + re.sub(r"\\(.)", r"\1", step[1]))
        else:
            steps += [VALUES, KEY] if step[0] == KEY else [step[0]]
        at = step.end()
    return tuple(steps)


def path_text(path: Path, is_table: bool = False) -> str:
    """Return a path as the option has it: of a table, the name of a column."""
    if is_table:
        return path[-1].removeprefix(".")
    keys = ("." + re.sub(r"([.\[\]{}\\])", r"\\\1", step[1:]) for step in path)
    steps = (key if step.startswith(".") else step for key, step in zip(keys, path, strict=True))
    return "".join(steps).replace("{}{key}", KEY).removeprefix(".")


def _step(located: Located, step: str) -> Iterator[Located]:
    """Yield what a step leads to, with places."""
    place, value, _ = located
    if step == KEY:
        yield Located(place, located.key)
    elif step == EACH and isinstance(value, list):
        yield from (Located(f"{place}[{index}]", element) for index, element in enumerate(value))
    elif step == VALUES and isinstance(value, dict):
        for key, element in value.items():
            yield Located(f"{place}.{key}".removeprefix("."), element, key)
    elif step.startswith("[") and step != EACH and isinstance(value, list):
        index = int(step[1:-1])
        yield from (Located(f"{place}{step}", element) for element in value[index : index + 1])
    elif step.startswith(".") and isinstance(value, dict) and step[1:] in value:
        yield Located(f"{place}{step}".removeprefix("."), value[step[1:]])


def leaves(found: Located, path: Path) -> Iterator[Located]:
    """Yield all values at the end of a path.

    Args:
        found: the value at its begin.
        path: its steps.
    """
    if not path:
        yield found
    else:
        for inner in _step(found, path[0]):
            yield from leaves(inner, path[1:])


_Bound = dict[int, list[Located]]
"""The values of each column in a row."""


def _rows(located: Located, paths: dict[int, Path], num_parts: int) -> Iterator[_Bound]:
    """Yield the values of columns, whose paths go through the same lists together.

    Args:
        located: where the paths begin.
        paths: the rest of each column's path.
        num_parts: number of columns of ingredients, which are the first ones. A single one has a
            row for each list at its end.
    """
    groups: dict[Path, dict[int, Path]] = {}
    for column, path in paths.items():
        groups.setdefault(path[:1], {})[column] = path[1:]
    bound: _Bound = {}
    several: list[list[_Bound]] = []
    for step, inner in groups.items():
        first = next(iter(inner))
        full_path = (*step, *inner[first])
        if not any(inner.values()):
            bound |= {column: list(leaves(located, step)) for column in inner}
        elif len(inner) > 1:
            inner_rows = (_rows(element, inner, num_parts) for element in _step(located, step[0]))
            several.append(list(chain.from_iterable(inner_rows)))
        elif num_parts == 1 and first == 0:
            loops = [i for i, step in enumerate(full_path) if step in LOOPS]
            last = loops[-1] if loops else len(full_path)
            lists = leaves(located, full_path[:last])
            several.append([{0: list(leaves(element, full_path[last:]))} for element in lists])
        else:
            bound[first] = list(leaves(located, full_path))
    if len(several) > 1 and math.prod(map(len, several)) > _MOST_ROWS:
        raise ConfigError("`columns`: these paths go through different lists; name one list.")
    for combined in product(*several):
        row = dict(bound)
        for columns in combined:
            row |= columns
        yield row


def rows_of_paths(
    document: Any, parts: Sequence[Path], results: Sequence[Path]
) -> Iterator[tuple[str, list[Any], list[Any]]]:
    """Yield place, ingredients and results of each row, all of them values of JSON.

    Args:
        document: the document.
        parts: paths of ingredients.
        results: paths of the results.
    """
    columns = dict(enumerate([*parts, *results]))
    for row in _rows(Located("", document), columns, len(parts)):
        values = list(chain.from_iterable(row.get(i, []) for i in range(len(parts))))
        result_values = list(
            chain.from_iterable(row.get(i, []) for i in range(len(parts), len(columns)))
        )
        place = (*values, *result_values, Located("", None))[0].place
        yield (
            place,
            [located.value for located in values],
            [located.value for located in result_values],
        )


# --- columns of a document -----------------------------------------------------------------------


def _collect(cells: Columns, path: Path, values: Sequence[Any]) -> None:
    """Collect the cells of all columns below the values at a path.

    Args:
        cells: gets them.
        path: the path.
        values: all values there.
    """
    values = [value for value in values if value not in (None, [], {})]
    elements = chain.from_iterable(value for value in values if isinstance(value, list))
    # The labels of ingredients and results may be names in objects, and these in lists.
    parts = chain.from_iterable(each if isinstance(each, list) else [each] for each in values)
    is_column = has_role(_key(path)) and all(labels_in(part, {}) is not None for part in parts)
    if is_column or not values or len(path) > MOST_STEPS:
        cells.setdefault(path, []).extend(values)
    elif all(isinstance(value, list) for value in values) and _are_objects(elements):
        _collect(cells, (*path, EACH), list(chain.from_iterable(values)))
    elif not _are_objects(values):
        cells.setdefault(path, []).extend(values)
    elif _are_records(values):
        for key in dict.fromkeys(chain.from_iterable(values)):
            _collect(cells, (*path, f".{key}"), [each[key] for each in values if key in each])
    else:
        cells.setdefault((*path, VALUES, KEY), []).extend(chain.from_iterable(values))
        inner = chain.from_iterable(record.values() for record in values)
        _collect(cells, (*path, VALUES), list(inner))


def _key(path: Path) -> str:
    """Return the key at the end of a path; empty without one."""
    return path[-1][1:] if path and path[-1].startswith(".") else ""


def _are_objects(values: Iterable[Any]) -> bool:
    return all(isinstance(value, dict) for value in values)


def _are_records(objects: Sequence[dict[str, Any]]) -> bool:
    """Return whether the keys of objects are properties, not labels.

    Args:
        objects: objects that are not empty.
    """
    counts = Counter(chain.from_iterable(objects))
    documented_keys = [key for key in counts if is_documented(key)]
    values = list(chain.from_iterable(record.values() for record in objects))
    if all(map(str.isdecimal, counts)):
        return False
    if len(objects) > 1:
        if any(counts[key] * 2 > len(objects) for key in documented_keys):
            return True
        texts = {value for value in values if isinstance(value, str)}
        # Labels of a map are values of it as well; properties are not.
        is_dense = len(values) > _DENSE * len(objects) * len(counts)
        return is_dense and texts.isdisjoint(counts)
    if len(values) > 1 and all(values) and _are_objects(values):
        return bool(documented_keys) and not _are_records(values)
    words = [key for key in counts if is_documented(key) or has_role(key) or not is_plain(key)]
    return bool(documented_keys) and 2 * len(words) >= len(counts)


def _shown_paths(cells: Columns, *, is_table: bool) -> str:
    names = [path_text(path, is_table)[:80] or EACH for path in cells][:_MOST_PATHS]
    if all(map(str.isdecimal, names)):
        names = [str(cells[path][0])[:40] for path in cells][:_MOST_PATHS]  # no header
    return f"the file has {listed(list(map(repr, names)), _MOST_PATHS, len(cells))}"


# --- ways to read a document ---------------------------------------------------------------------


def _ways(cells: Columns) -> Iterator[Way]:
    """Yield the ways to read a document, the more certain ones first."""
    lists = {path for path, column in cells.items() if any(isinstance(c, list) for c in column)}
    yield from ways_by_words(cells, lists)
    for path in cells:
        if path[-1:] == (VALUES,) and (*path, KEY) in cells:
            yield from _ways_by_keys(cells, path)


def _ways_by_keys(cells: Columns, path: Path) -> Iterator[Way]:
    """Yield ways to read the values at a path, below keys that are labels."""
    key = (*path, KEY)
    are_lists = [isinstance(cell, list) for cell in cells[path]]
    pairs = list(chain.from_iterable(cell for cell in cells[path] if isinstance(cell, list)))
    texts = chain(chain.from_iterable(labels_in(pair, {}) or () for pair in pairs), cells[path])
    if all(are_lists) and all(isinstance(pair, list) for pair in pairs):
        if _are_labels(cells[key], len(pairs), texts):
            yield Way((path,), (key,), is_named=False)
        if set(map(len, pairs)) == {2}:
            # Or a partner and what it makes: a guess that refuses the other reading.
            partner, made = ((*path, EACH, f"[{place}]") for place in range(2))
            yield Way((key, partner), (made,), is_documented=False)
    elif (
        path[-2:] == (VALUES, VALUES)
        and not find_joiner(cells[key])
        and _are_labels(cells[(*path[:-1], KEY)], len(cells[path]), chain(cells[key], texts))
    ):
        yield Way(((*path[:-1], KEY), key), (path,), is_named=False)


def _are_labels(keys: Sequence[str], num_recipes: int, texts: Iterable[Any]) -> bool:
    """Return whether keys are things of the recipes below them, not only names of lists.

    Args:
        keys: the keys.
        num_recipes: number of recipes; a few for each key need no other sign.
        texts: what else is in the recipes.
    """
    if num_recipes <= _FEW_BELOW * len(keys):
        return True
    return not set(keys).isdisjoint(text for text in texts if isinstance(text, str))


# --- the recipes of a way ------------------------------------------------------------------------


def _candidate(
    document: Document,
    source: FileRows,
    cells: Columns,
    way: Way,
    *,
    is_given: bool = False,
    fold: bool = False,
) -> ReadingCandidate:
    """Return the recipes of a way to read a document."""
    way_paths = (*way.parts, *way.results)
    facts = [(*way.parts[0][:-1], f".{name}") for name in (KIND, QUANTITIES)]
    facts = [path for path in facts if path in cells and path not in way_paths]
    read_paths = {path[:end] for path in (*way_paths, *facts) for end in range(len(path) + 1)}
    ignored_paths = [path for path in cells if path not in read_paths and path[-1:] != (KEY,)]
    raws = list(_raws(document, way, facts))
    joiner: str | None = ""
    if len(way.parts) == 1:
        raws = list(chain.from_iterable(_without_lists(raw, way) for raw in raws))
        has_lists = any(len(raw.parts) > 1 for raw in raws)
        parts = chain.from_iterable(raw.parts for raw in raws)
        texts = [part for part in parts if isinstance(part, str) and part]
        joiner = find_joiner(texts, in_all=has_lists)
        if joiner and has_lists:
            # Each text of a list holds a whole recipe.
            raws = [raw._replace(parts=[part]) for raw in raws for part in filter(None, raw.parts)]
    beside: dict[str, list[Any]] = {}
    entries = list(document.others)
    for raw in raws:
        entries += rows_of_raw(raw, joiner, beside)
    if document.is_table:
        entries.sort(key=itemgetter(0))
    rows = [entry for entry in entries if isinstance(entry, Row)]
    # Numbers alone are ids or amounts.
    for texts in ([row.ingredients[0] for row in rows], [row.result for row in rows]):
        if rows and not is_given and all(map(is_number, texts)):
            number = texts[0].removeprefix(NUMBER)
            message = f"{number!r} is a number, no name. If it is one, name it with --columns."
            entries = [fault_at(rows[0].place, "label", message)] if way.is_named else []
    entries, trimmed = read_labels(entries, document.fault, is_given=is_given)
    beside |= {path_text(path, document.is_table): cells[path] for path in ignored_paths}
    ingredients = set(chain.from_iterable(row.ingredients for row in rows))
    texts_beside = (text for text in chain.from_iterable(beside.values()) if isinstance(text, str))
    counts = (values for name, values in beside.items() if words_of(name) & COUNT)
    return ReadingCandidate(
        way,
        replace(
            source.reading,
            columns=tuple(path_text(path, document.is_table) for path in way_paths),
            num_results=len(way.results),
            ignored=tuple(sorted(beside)),
            counts_dropped=sum(number not in ("", "1", 1) for number in chain(*counts)),
            trimmed=source.reading.trimmed + trimmed,
        ),
        entries,
        names_ingredients_elsewhere=not ingredients.isdisjoint(texts_beside),
        fold=fold,
    )


def _without_lists(raw: Raw, way: Way) -> Iterator[Raw]:
    """Yield a row for each recipe in its only cell of ingredients."""
    cells = [cell for cell in raw.parts if cell not in (None, [], {})]
    if not cells and not way.is_named:
        return  # a thing without a recipe
    if len(cells) == 1 and isinstance(cells[0], list):
        (cells,) = cells
    are_lists = bool(cells) and all(isinstance(cell, list) for cell in cells)
    # Lists in ingredients beside a result are rather choices of an ingredient.
    are_choices = way.is_named and not words_of(way.parts[0][-1][1:]).isdisjoint(INGREDIENT)
    if are_lists and not are_choices:
        yield from (raw._replace(parts=cell) for cell in cells)
    else:
        yield raw._replace(parts=cells)


def _raws(document: Document, way: Way, facts: Sequence[Path]) -> Iterator[Raw]:
    """Yield the rows at the paths of a way, those of records with kinds and quantities."""
    paths = (*way.parts, *way.results)
    if all(len(path) == 2 and path[0] == EACH and path[1].startswith(".") for path in paths):
        # Flat records, many times faster.
        parts, result_names, fact_names = (
            [p[-1][1:] for p in column_paths] for column_paths in (way.parts, way.results, facts)
        )
        places: Iterable[Place] = document.places or map("[{}]".format, count())
        for place, row in zip(places, document.value, strict=False):
            if isinstance(row, dict):
                cells = [row[name] for name in parts if name in row]
                results = [row[name] for name in result_names if name in row]
                yield Raw(
                    place, cells, results, **{name: str(row.get(name) or "") for name in fact_names}
                )
        return
    # Each of several places, such as [0] and [1], is filled.
    steps = set(chain.from_iterable(way.parts if len(way.parts) > 1 else ()))
    has_places = any(step.startswith("[") and step != EACH for step in steps)
    for place, values, results in rows_of_paths(document.value, way.parts, way.results):
        if not has_places or len(values) == len(way.parts):
            yield Raw(place, values, results)


def _exact_rows(document: Document) -> Iterator[Entry]:
    """Yield the recipes of our own table, whose cells are labels as they stand, and all faults."""
    yield from document.others
    for place, record in zip(document.places, document.value, strict=True):
        facts = {name: record[name] for name in (KIND, QUANTITIES) if name in record}
        *parts, result = (cell for name, cell in record.items() if name not in facts)
        labels = [*filter(None, parts), result]
        faults = list(filter(None, map(exact_fault, labels)))
        if record.get(KIND):
            faults += filter(None, [label_fault(record[KIND])])
        if len(labels) < 2 or not result:
            yield LeftOut(place, WITHOUT)
        elif faults:
            yield Fault(place, "label", " Also, ".join(dict.fromkeys(faults)))
        else:
            yield Row(place, labels[:-1], result, **facts)
