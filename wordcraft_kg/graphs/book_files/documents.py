"""Documents, JSON or the rows of a table: recipes by paths of ingredients and of the result.

Documented keys give some ways to read a document (``words``), the shapes ``{result: [[a, b]]}``,
``{a: {b: result}}`` and ``[[a, b, result]]`` others, and the option `columns` one of the user; the
rule takes one. A path has keys after points, ``[]`` for each element of a list, ``[0]`` for its
first one, ``{}`` for each value of an object, and ``{key}`` at its end for the keys of an object. A
backslash takes a sign in a key as it is. Paths that begin alike go through the same lists together.
``layouts`` has formats of their own.
"""

import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
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
    JOINERS,
    Names,
    cell_fault,
    exact_fault,
    find_joiner,
    is_number,
    listed_value,
    names_by_id,
    read_labels,
    rows_of_raw,
)
from wordcraft_kg.graphs.book_files.rows import (
    INFINITE_CRAFT_BASE,
    WITHOUT,
    Entry,
    FileRows,
    LeftOut,
    Place,
    Raw,
    Row,
    fault_at,
    refusal,
    without_nothing,
)
from wordcraft_kg.graphs.book_files.rule import ReadingCandidate, choose
from wordcraft_kg.graphs.book_files.words import (
    COUNT,
    CSV_HEADER,
    EACH,
    ID,
    IGNORED,
    INGREDIENT,
    KEY,
    KIND,
    LOOPS,
    NAME,
    ORDINAL,
    QUANTITIES,
    RESULT,
    VALUES,
    Path,
    Way,
    is_documented,
    is_id,
    is_name,
    is_plain,
    name_rank,
    ways_by_words,
    words_of,
)
from wordcraft_kg.graphs.recipes import RecipeRows, check_label

GRAMMAR = (
    "a path of keys, with [] for each element of a list, [0] for the first, {} for each value of "
    "an object and {key} for its keys, such as 'recipes[].parts[],recipes[].out.name'"
)
_STEP = re.compile(r"\[\d*\]|\{(?:key)?\}|\.?((?:\\.|[^.\[\]{}\\])+)")
MOST_STEPS = 50
"""Steps of the longest path."""
_MOST_ROWS = 1_000_000  # of lists that are combined with each other


class Located(NamedTuple):
    """A value with its place, and the key at which an object has it."""

    place: str
    value: Any
    key: str = ""


_MOST_KEYS = 40  # of an object that is no map of labels
_DENSE = 0.5  # share of an object's keys that its siblings have as well
_MOST_PATHS = 12  # in a refusal
_MOST_WAYS = 60  # that are tried
_MOST_TEXTS = 1_000  # paths of a document; more are no keys


@dataclass
class Document:
    """A value of JSON, or the rows of a table as such a value.

    Attributes:
        value: the value.
        places: line of each row of a table.
        others: faults and rows left out.
        is_table: whether it is a table.
    """

    value: Any
    places: list[int] = field(default_factory=list)
    others: list[Entry] = field(default_factory=list)
    is_table: bool = False


class _Texts(dict[Path, list[Any]]):
    """The texts, numbers and keys of a document by path.

    Attributes:
        lengths: lengths of the lists at a path.
        counted: paths of keys with numbers of pieces.
    """

    def __init__(self) -> None:
        super().__init__()
        self.lengths: dict[Path, set[int]] = {}
        self.counted: set[Path] = set()


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
        RecipeFileError: if the document has no reading that the rule takes, with all readings as
            commands.
        ConfigError: if ``columns`` lead nowhere.
    """
    _take_base(path, document, source)
    value = document.value
    source.entries = document.others
    if not value or not isinstance(value, list | dict):
        return source
    texts = _texts_of(document)
    anchor = "table" if document.is_table else "json"
    if len(texts) > _MOST_TEXTS:
        raise refusal(path, f"{len(texts):,} different keys, more than {_MOST_TEXTS:,}", anchor)
    read_candidate = partial(_candidate, document, source, texts, _names(value, texts), fold=fold)
    if columns is not None:
        best = read_candidate(_given(document, columns, texts), is_given=True)
    elif source.is_exact:
        names_of_columns = [name for name in document.value[0] if name not in (KIND, QUANTITIES)]
        *parts, result_path = ((EACH, f".{name}") for name in names_of_columns)
        way = Way(tuple(parts), (result_path,))
        source.numbered = _numbered(document)
        if source.numbered is not None:
            # Row by row only if somebody asks.
            source.entries = chain.from_iterable(
                read_candidate(only_way).entries for only_way in [way]
            )
            source.reading = replace(source.reading, columns=tuple(names_of_columns))
            return source
        best = read_candidate(way)
    else:
        _check_choices(path, texts)
        ways = list(islice(_ways(texts), _MOST_WAYS))
        documented = [read_candidate(way) for way in ways if way.is_documented]
        unsure = (way for way in ways if not way.is_documented)
        guesses = map(read_candidate, chain(unsure, _by_column(texts)))
        choice = choose(path, documented, guesses, anchor, allows_single=allows_single)
        if choice is None:
            raise refusal(
                path,
                f"no documented words name ingredients and a result; {_shown_paths(texts)}",
                anchor,
                "Name them with --columns.",
            )
        best = choice
    source.entries = best.entries
    source.reading = best.reading
    if not source.is_exact:
        best.labels.finish(source)
    # Nothing is no result where labels tell that the game is Infinite Craft.
    every_text = set(
        chain.from_iterable(
            column_texts for column_texts in texts.values() if type(column_texts[0]) is str
        )
    )
    every_text.update(*(row.ingredients for row in best.rows))
    craft = {label.lower() if fold else label for label in INFINITE_CRAFT_BASE}
    if not source.is_exact and every_text.issuperset(craft):
        source.entries = without_nothing(best.entries, fold=fold)
        # Saves list items with emoji; another table or list may have these labels by chance.
        if not source.base and any(path[-1:] in ((".text",), (".emoji",)) for path in texts):
            source.base = dict.fromkeys(INFINITE_CRAFT_BASE, "items")
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
        source.base = {check_label(label, f"{path}: base"): "base" for label in base}
        document.value = {key: member for key, member in value.items() if key != "base"}


def _texts_of(document: Document) -> "_Texts":
    texts = _Texts()
    if document.is_table:
        for key in document.value[0]:
            texts[(EACH, f".{key}")] = [row[key] for row in document.value]
    else:
        _collect(texts, (), [document.value])
    return texts


def _check_choices(path: FilePath, texts: _Texts) -> None:
    """Refuse lists that may be choices of an ingredient, or several ingredients or recipes.

    Raises:
        RecipeFileError: if an ingredient is a text in some places and a list in others, or if
            ingredients beside a result are lists of lists.
    """
    for lists in texts:
        # Within one loop, a key holds what belongs to a thing, such as its result or results. A
        # map's values have no key: {"water": {"earth": ["mud", "clay"]}} has several results.
        single = lists[:-1]
        num_loops = sum(step in LOOPS for step in single)
        are_odd = lists[-1:] == (EACH,) and single in texts and num_loops > 1
        are_odd = are_odd and single[-1].startswith(".")
        holder, key = lists[:-3], lists[-3:-2]
        if lists[-2:] == (EACH, EACH) and key and words_of(key[0][1:]) & INGREDIENT:
            beside = (sibling[-1] for sibling in texts if sibling[:-1] == holder)
            are_odd = any(words_of(sibling[1:]) & RESULT for sibling in beside)
        if are_odd:
            problem = (
                f"the lists of {path_text(single)!r} may be choices of an ingredient or several"
            )
            raise refusal(
                path,
                problem,
                "json",
                "Write each choice as a recipe of its own, or name columns with --columns.",
            )


def _given(document: Document, columns: Sequence[str], texts: _Texts) -> Way:
    """Return the way that the option `columns` gives."""
    first = document.value[0] if isinstance(document.value, list) else None
    members = first if isinstance(first, list | dict) else []
    keys = [f".{key}" if isinstance(first, dict) else f"[{at}]" for at, key in enumerate(members)]
    paths: list[Path] = []
    for text in map(str.strip, columns):
        # A key that is at one place only needs no path; numbers count columns, or labels of lists.
        ends = [path for path in texts if _last_key(path) == text.casefold()]
        at = int(text) if text.isdecimal() else 0
        if (EACH, f".{text}") in texts or len(ends) == 1:
            paths.append((EACH, f".{text}") if (EACH, f".{text}") in texts else ends[0])
        else:
            paths.append((EACH, keys[at - 1]) if 0 < at <= len(keys) else parse_path(text))
    if len(paths) < 2 or len(set(paths)) < len(paths):
        raise ConfigError(
            f"`columns` {','.join(columns)}: expected different columns, of the ingredients and, "
            "last, of the result."
        )
    for text, steps in zip(columns, paths, strict=True):
        if not any(True for _ in leaves(Located("", document.value), steps)):
            hint = nearest(text, [path_text(path, document.is_table) for path in texts])
            grammar = "" if document.is_table else f" A path is {GRAMMAR}."
            raise ConfigError(
                f"`columns` {text!r}: no such column; {_shown_paths(texts)}.{hint}{grammar}"
            )
    return Way(tuple(paths[:-1]), (paths[-1],))


def _last_key(path: Path) -> str:
    """Return the key, in lower case, at which a path ends, or whose list it ends in."""
    *_, last = ("", *(step for step in path if step != EACH))
    return last.removeprefix(".").casefold()


def as_records(document: Any) -> Any:
    """Return columns, or a list below a header, as records; any other value as it is."""
    head: Any = None
    rows: Any = []
    if isinstance(document, list) and document and isinstance(document[0], list):
        head, *rows = document
    elif isinstance(document, dict) and isinstance(document.get("data"), list):
        head, rows = document.get("columns"), document["data"]
    elif isinstance(document, dict):
        columns = [
            [*value.values()] if isinstance(value, dict) else value for value in document.values()
        ]
        if all(isinstance(column, list) for column in columns):
            rows = list(zip(*columns, strict=False))
            is_flat = all(isinstance(cell, str | int | float) for cell in chain.from_iterable(rows))
            is_even = len(set(map(len, columns))) == 1
            head = list(document) if is_flat and is_even else None
    if not isinstance(head, list) or not head or not all(isinstance(name, str) for name in head):
        return document
    ways = ways_by_words((EACH, f".{name}") for name in head)
    if not any(way.is_named and way.is_documented for way in ways):
        return document
    return [dict(zip(head, row, strict=False)) for row in rows if isinstance(row, list | tuple)]


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
    """Return a path as the option has it: of a table, the name or number of a column."""
    if is_table:
        name = path[-1]
        return name[1:] if name.startswith(".") else str(int(name[1:-1]) + 1)
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


Columns = dict[int, list[Located]]
"""The values of each column in a row."""


def _rows(located: Located, paths: dict[int, Path], num_parts: int) -> Iterator[Columns]:
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
    bound: Columns = {}
    several: list[list[Columns]] = []
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


# --- paths of a document -------------------------------------------------------------------------


def _collect(texts: _Texts, path: Path, values: list[Any]) -> None:
    """Collect the texts, numbers and keys below all values at a path.

    Args:
        texts: gets them.
        path: the path.
        values: all values there.
    """
    if len(path) > MOST_STEPS:
        return  # no recipe book is nested so deeply
    plain = [value for value in values if isinstance(value, str | int | float)]
    lists = [value for value in values if isinstance(value, list)]
    objects = [value for value in values if isinstance(value, dict) and value]
    if plain:
        texts.setdefault(path, []).extend(plain)
    if lists:
        _collect_lists(texts, path, lists)
    if objects and _are_records(objects, path):
        for key in dict.fromkeys(chain.from_iterable(objects)):
            holders = [record for record in objects if key in record]
            _wrap_pairs([(record, key) for record in holders])
            _collect(texts, (*path, f".{key}"), [record[key] for record in holders])
    elif objects:
        keys = (*path, VALUES, KEY)
        texts.setdefault(keys, []).extend(chain.from_iterable(objects))
        _wrap_pairs([(record, key) for record in objects for key in record])
        inner = list(chain.from_iterable(record.values() for record in objects))
        # Numbers beside labels are numbers of pieces; those beside sums are ids.
        if all(map(is_number, inner)) and not _are_sums(texts[keys]):
            texts.counted.add(keys)
        else:
            _collect(texts, (*path, VALUES), inner)


def _wrap_pairs(places: Sequence[tuple[dict[str, Any], str]]) -> None:
    """Make a single pair a list of one pair, in place, where values beside it are lists of pairs.

    Args:
        places: objects and their keys with values of one meaning.
    """
    if any(_is_list(record[key], list) for record, key in places):
        for record, key in places:
            if _is_list(record[key], str):
                record[key] = [record[key]]


def _is_list(value: Any, kind: type) -> bool:
    is_filled = isinstance(value, list) and bool(value)
    return is_filled and all(isinstance(element, kind) for element in value)


def _collect_lists(texts: _Texts, path: Path, lists: list[list[Any]]) -> None:
    """Collect what is in lists; a label with a number of pieces, as in ["egg", 2], is one label."""
    if all(map(_is_counted, lists)):
        texts[(*path, "[0]")] = [value[0] for value in lists]
        return
    texts.lengths.setdefault(path, set()).update(map(len, lists))
    elements = [element for element in chain.from_iterable(lists) if element is not None]
    num_lists = sum(isinstance(element, list) for element in elements)
    # Choices beside ingredients, as in Minecraft: no reading accounts for both.
    if num_lists in (0, len(elements)):
        _collect(texts, (*path, EACH), elements)
    elif path[-1:] == (EACH,) and set(map(len, lists)) == {2}:
        # Ingredients in a list, and a result: [["water", "earth"], "mud"].
        for place in range(2):
            _collect(texts, (*path, f"[{place}]"), [pair[place] for pair in lists])


def _is_counted(value: list[Any]) -> bool:
    if len(value) != 2 or not isinstance(value[0], str) or not value[0]:
        return False
    label, beside = value
    if isinstance(beside, str):
        # An emoji beside its name, as in ["Water", "💧"].
        return label[0].isalpha() and bool(beside) and not any(map(str.isalnum, beside))
    return isinstance(beside, int | float)


def _are_records(objects: Sequence[dict[str, Any]], path: Path = ()) -> bool:
    """Return whether the keys of objects are properties, not labels.

    Args:
        objects: objects that are not empty.
        path: where they are; below a key such as ``inputs`` numbers are numbers of pieces.
    """
    counts = Counter(chain.from_iterable(objects))
    documented_keys = [key for key in counts if is_documented(key)]
    values = [value for record in objects for value in record.values() if value is not None]
    properties = [key for key in counts if words_of(key) & (COUNT | IGNORED)]
    is_large = len(counts) > _MOST_KEYS and 2 * len(documented_keys) < len(counts)
    if is_large or all(map(str.isdecimal, counts)):
        return False
    role = words_of(path[-1][1:]) if path and path[-1].startswith(".") else frozenset()
    if role & (INGREDIENT | RESULT | {"in"}):
        return bool(documented_keys or properties) or not all(map(is_number, values))
    if len(objects) > 1:
        if any(counts[key] * 2 > len(objects) for key in documented_keys):
            return True
        texts = {value for value in values if isinstance(value, str)}
        # Labels of a map are values of it as well; properties are not.
        is_dense = len(values) > _DENSE * len(objects) * len(counts)
        return is_dense and texts.isdisjoint(counts)
    if not documented_keys:
        return False
    if len(values) > 1 and all(isinstance(value, dict) and value for value in values):
        return not _are_records(values)
    kinds = {isinstance(value, dict | list) for value in values}
    ordinal_keys = [key for key in counts if words_of(key) & ORDINAL]
    return (
        len(kinds) > 1
        or bool(ordinal_keys or properties)
        or len(documented_keys) * 2 >= len(counts)
    )


def _names(value: Any, texts: _Texts) -> list[Names]:
    """Return names by id, slug or emoji, for each kind of ids beside names in a document."""
    tables = []
    for path in texts:
        parent = path[:-1]
        name_paths = [
            sibling for sibling in texts if sibling[:-1] == parent and is_name(sibling[-1][1:])
        ]
        if path[-1:] == (KEY,):
            is_list = parent in texts and all(map(str.isdecimal, texts[path]))
            name_paths += [parent] if is_list else []
        elif path and path[-1].startswith(".") and is_id(path[-1][1:]):
            # The name and the id of one thing, such as Parent 1 ID and Parent 1 Name.
            thing = words_of(path[-1][1:]) - ID - _NAME_WORDS
            name_paths = [
                sibling
                for sibling in name_paths
                if words_of(sibling[-1][1:]) - _NAME_WORDS == thing
            ]
        else:
            continue
        if name_paths:
            name = min(name_paths, key=lambda name_path: name_rank(name_path[-1][1:]))
            rows = rows_of_paths(value, [path], [name])
            tables.append(
                names_by_id(
                    (ids[0], names_in_row[0])
                    for _, ids, names_in_row in rows
                    if ids and names_in_row
                )
            )
    lists = [path for path in texts if path[-1:] == (EACH,) and not set(path[:-1]) & set(LOOPS)]
    # Ids may be places in a list of names, if nothing else is.
    for path in lists if not tables else ():
        if all(isinstance(value, str) for value in texts[path]):
            tables.append(names_by_id(enumerate(texts[path])))
    return tables


_NAME_WORDS = frozenset(NAME)


def _shown_paths(texts: _Texts) -> str:
    names = [path_text(path)[:40].removeprefix("[].") for path in texts][:_MOST_PATHS]
    if all(map(str.isdecimal, names)):
        names = [str(texts[path][0])[:40] for path in texts][:_MOST_PATHS]  # no header
    shown = listed(list(map(repr, names)), _MOST_PATHS, len(texts))
    return f"the file has {shown or 'no labels'}"


# --- ways to read a document ---------------------------------------------------------------------


def _ways(texts: _Texts) -> Iterator[Way]:
    """Yield the ways to read a document, the more certain ones first."""
    # Flat records have nothing but keys.
    nested = [path for path in texts if len(path) != 2 or path[0] != EACH or path[1][0] != "."]
    by_place = [way for path in nested for way in (*_by_keys(texts, path), *_by_list(texts, path))]
    documented_ways = [way for way in by_place if way.is_documented]
    result_paths = {path for way in documented_ways for path in way.results if path[-1] != KEY}
    yield from ways_by_words(path for path in texts if path not in result_paths)
    yield from by_place


def _by_keys(texts: _Texts, path: Path) -> Iterator[Way]:
    """Yield ways to read what is at a path below keys that are labels, or sums of them."""
    maps = [at for at, step in enumerate(path) if step == VALUES]
    keys = tuple((*path[: at + 1], KEY) for at in maps)
    if path in texts.counted and path[-3:] == (VALUES, VALUES, KEY):
        # Numbers of pieces by label: {"torch": {"plank": 2, "stick": 1}}.
        yield Way((path,), (keys[-2],), is_named=False, by_place=True)
    if not maps or path[-1] == KEY:
        return
    below = path[maps[-1] + 1 :]
    name = below[0][1:] if len(below) == 1 and below[0].startswith(".") else ""
    is_result = bool(words_of(name) & RESULT) and is_plain(name)
    has_texts = any(isinstance(value, str) for value in texts[path])
    is_sum = _are_sums(texts[path])
    # Commas in keys may be parts of labels of things that are made of lists.
    are_sums = _are_sums(texts[keys[-1]], has_commas=EACH not in below)
    if below == (EACH, EACH) and has_texts:
        yield Way((path,), (keys[-1],), by_place=True)
        if texts.lengths[path[:-1]] == {2}:
            # Or a partner and what it makes.
            partner, second_items = (*path[:-1], "[0]"), (*path[:-1], "[1]")
            yield Way((keys[-1], partner), (second_items,), is_documented=False)
    elif not (is_result or is_name(name) or below in ((), (EACH,))):
        return
    elif are_sums and not is_sum:
        yield Way(keys[-1:], (path,), by_place=True)
    elif is_sum and not name:
        yield Way((path,), keys[-1:], by_place=True)
    elif has_texts and maps[-2:] == [maps[-1] - 1, maps[-1]] and (is_result or not name):
        yield Way(keys[-2:], (path,), by_place=True)
    elif has_texts and below == (EACH,):
        # Two labels below a key may be anything about it.
        yield Way((path,), keys[-1:], is_documented=False)


def _by_list(texts: _Texts, path: Path) -> Iterator[Way]:
    """Yield ways to read lists of three labels, and of ingredients in a list before the result."""
    beside = path[-1:] if path[-1] == "[0]" else ()  # a label and something beside it
    outer = path[: len(path) - len(beside)]
    if outer[-2:] == (EACH, EACH) and texts.lengths.get(outer[:-1]) == {3}:
        a, b, c = ((*outer[:-1], f"[{place}]", *beside) for place in range(3))
        yield Way((a, b), (c,), by_place=True, is_order=True)
        yield Way((b, c), (a,), is_documented=False, is_order=True)
        yield Way((a, c), (b,), is_documented=False, is_order=True)
    elif path[-2:] == ("[0]", EACH) and (*path[:-2], "[1]") in texts:
        yield Way((path,), ((*path[:-2], "[1]"),), by_place=True)


def _by_column(texts: _Texts) -> Iterator[Way]:
    """Yield guesses for three columns or keys whose names say nothing."""
    columns = [path for path in texts if path[:1] == (EACH,) and path[1:] == path[-1:]]
    columns = [path for path in columns if is_plain(path[-1][1:])]
    columns = [path for path in columns if not all(map(is_number, texts[path]))]
    is_unnamed = all(path[-1][1:].isdecimal() for path in texts)
    for word in set(chain.from_iterable(words_of(path[-1][1:]) for path in columns)):
        # Such as draggedItem, targetItem and resultItem.
        like = [path for path in columns if word in words_of(path[-1][1:])]
        if len(like) == 3 and words_of(like[-1][-1][1:]) & RESULT:
            yield Way((like[0], like[1]), (like[2],), is_documented=False)
    if len(columns) == 3 and not any(is_name(path[-1][1:]) for path in columns):
        a, b, c = columns
        for first_part, second_part, result_path in ((a, b, c), (b, c, a), (a, c, b)):
            yield Way((first_part, second_part), (result_path,), False, False, is_order=is_unnamed)


def _are_sums(keys: Sequence[Any], *, has_commas: bool = True) -> bool:
    """Return whether all keys are sums, or lists as text."""
    signs = [sign for sign in JOINERS if has_commas or sign != ","]
    if not keys or not all(isinstance(key, str) for key in keys):
        return False
    plain = [key for key in keys if not listed_value(key)]
    return not plain or any(all(sign in key for key in plain) for sign in signs)


# --- the recipes of a way ------------------------------------------------------------------------


def _candidate(
    document: Document,
    source: FileRows,
    texts: _Texts,
    names: Sequence[Names],
    way: Way,
    *,
    is_given: bool = False,
    fold: bool = False,
) -> ReadingCandidate:
    """Return the recipes of a way to read a document."""
    way_paths = (*way.parts, *way.results)
    facts = [(*way.parts[0][:-1], f".{name}") for name in (KIND, QUANTITIES)]
    facts = [path for path in facts if path in texts and path not in way_paths]
    read_paths = {*way_paths, *facts}
    ignored_paths = [path for path in texts if path not in read_paths and path[-1:] != (KEY,)]
    raws = list(_raws(document, way, facts))
    is_sole = len(way.parts) == 1
    has_several = any(len(raw.parts) != 1 for raw in raws)
    in_lists = is_sole and way.parts[0][-1] in LOOPS and has_several
    joiner: str | None = ""
    cells = [part for raw in raws for part in raw.parts if isinstance(part, str) and part]
    if not source.is_exact and is_sole:
        cells = [cell for cell in cells if listed_value(cell) is None]
        joiner = find_joiner(cells, in_all=in_lists, allows_weak=not way.by_place)
    elif not source.is_exact and all("+" in cell for cell in cells):
        joiner = find_joiner(cells)
    if joiner and (in_lists or not is_sole):
        # Several columns or texts of a list hold a whole recipe each.
        raws = [raw._replace(parts=[part]) for raw in raws for part in filter(None, raw.parts)]
    # A grid has blanks, and as many slots in each row; in lists of labels they are slips.
    is_uneven = in_lists and not joiner and len({len(raw.parts) for raw in raws if raw.parts}) > 1
    entries = list(document.others)
    several_outputs = 0
    for raw in raws:
        if is_uneven and "" in raw.parts[1:]:
            message = "a blank ingredient; fill it, or leave it out of the list."
            entries.append(fault_at(raw.place, "label", message, "blank"))
        else:
            row_entries = _exact_rows(raw) if source.is_exact else list(rows_of_raw(raw, joiner))
            several_outputs += len(row_entries) > 1
            entries += row_entries
    if document.is_table:
        entries.sort(key=itemgetter(0))
    rows = [entry for entry in entries if isinstance(entry, Row)]
    # Numbers are no results, unless they are names or ids.
    numbers = {row.result for row in rows if is_number(row.result)}
    numbers.difference_update(*names)
    if rows and not is_given and not source.is_exact and all(row.result in numbers for row in rows):
        message = "is a number; a result is a name. If it is one, name the columns with --columns."
        entries = []
        if way.is_named and not way.by_place:
            entries += (fault_at(row.place, "label", f"{row.result!r} {message}") for row in rows)
        rows = []
    labels = read_labels(
        rows,
        exact_fault if source.is_exact else cell_fault,
        names,
        is_exact=source.is_exact,
        is_given=is_given,
        fold=fold,
    )
    counts = (path for path in ignored_paths if words_of(path[-1][1:]) & COUNT)
    return ReadingCandidate(
        way,
        replace(
            source.reading,
            columns=tuple(path_text(path, document.is_table) for path in way_paths),
            num_results=len(way.results),
            ignored=tuple(path_text(path, document.is_table) for path in ignored_paths),
            counts_dropped=sum(n not in ("", "1", 1) for path in counts for n in texts[path]),
            several_outputs=several_outputs,
        ),
        entries=[labels.row(entry) if isinstance(entry, Row) else entry for entry in entries],
        labels=labels,
        num_unmade=sum(any(raw.parts) and not any(raw.results) for raw in raws),
        needs_reuse=not texts.counted.isdisjoint(way_paths),
    )


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


def _exact_rows(raw: Raw) -> list[Entry]:
    """Return the recipe of a row of our own table."""
    parts = [part for part in raw.parts if part]
    if not parts or not raw.results[0]:
        return [LeftOut(raw.place, WITHOUT)]
    return [Row(raw.place, parts, raw.results[0], raw.kind, raw.quantities)]
