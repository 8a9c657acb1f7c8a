"""JSON: recipes by paths of documented keys, or by the paths that the option `columns` gives.

Each way to read a document is a list of paths: those of ingredients and, last, that of the result.
Documented keys give some (``words``), the shapes ``{result: [[a, b]]}``, ``{a: {b: result}}`` and
``[[a, b, result]]`` others; the rule takes one of them. ``layouts`` has formats of their own.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import chain, compress, count, islice
from operator import itemgetter
from pathlib import Path as FilePath
from typing import Any

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.graphs.book_files.cells import JOINERS, is_number, listed_value
from wordcraft_kg.graphs.book_files.entries import Document, Names, Raw, fill, names_by_id
from wordcraft_kg.graphs.book_files.paths import (
    EACH,
    GRAMMAR,
    KEY,
    LOOPS,
    MOST_STEPS,
    VALUES,
    Located,
    Path,
    fitted,
    leaves,
    parse_path,
    path_text,
    rows_of_paths,
)
from wordcraft_kg.graphs.book_files.rows import (
    INFINITE_CRAFT_BASE,
    Entry,
    FileRows,
    Place,
    refusal,
    without_nothing,
)
from wordcraft_kg.graphs.book_files.rule import BookReading, choose, result_place
from wordcraft_kg.graphs.book_files.words import (
    COUNT,
    ID,
    IGNORED,
    INGREDIENT,
    KIND,
    NAME,
    ORDINAL,
    RESULT,
    SUMS,
    ColumnRoles,
    is_documented,
    is_id,
    is_name,
    is_plain,
    name_rank,
    readings,
    words_of,
)
from wordcraft_kg.graphs.recipes import check_label

_NAME_WORDS = frozenset(NAME)
_MOST_KEYS = 40  # of an object that is no map of labels
_DENSE = 0.5  # share of an object's keys that its siblings have as well
_MOST_PATHS = 12  # in a refusal
_MOST_READINGS = 60  # that are tried
_MOST_LABELS = 1_000  # paths of a document; more are no keys


class _Labels(dict[Path, list[Any]]):
    """The texts, numbers and keys of a document by path.

    Attributes:
        lengths: lengths of the lists at a path.
        counted: paths of keys with numbers of pieces.
    """

    def __init__(self) -> None:
        super().__init__()
        self.lengths: dict[Path, set[int]] = {}
        self.counted: set[Path] = set()


def rows_of_document(
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
        fold: see :func:`~wordcraft_kg.graphs.book_files.rule.choose`.
        allows_single: see there.

    Raises:
        RecipeFileError: if the document has no reading that the rule takes, with all readings as
            commands.
        ConfigError: if ``columns`` lead nowhere.
    """
    value = document.value
    base = value.get("base") if isinstance(value, dict) else None
    if isinstance(base, list) and all(isinstance(label, str) for label in base):
        source.base = {check_label(label, f"{path}: base"): "base" for label in base}
        document.value = {key: each for key, each in value.items() if key != "base"}
    labels = _Labels()
    if not value or not isinstance(value, list | dict):
        source.entries = document.others
        return source
    if document.is_table:
        for key in value[0]:
            labels[(EACH, f".{key}")] = [row[key] for row in value]
    else:
        _collect(labels, (), [document.value])
    if len(labels) > _MOST_LABELS:
        seen = f"{len(labels):,} different keys, more than {_MOST_LABELS:,}"
        raise refusal(path, seen, "json")
    names = _names(document.value, labels)
    reader = partial(_candidate, document, labels, names, is_exact=source.is_exact)
    if columns is not None:
        best = _given(document, columns, labels, reader)
    elif source.is_exact:
        parts = tuple((EACH, f".{name}") for name in ("ingredient_a", "ingredient_b"))
        best = reader(ColumnRoles(parts, ((EACH, ".result"),)))
    else:
        _check_choices(path, labels)
        ways = list(islice(_readings(labels), _MOST_READINGS))
        found = [reader(way) for way in ways if way.is_documented]
        guesses: Iterable[BookReading] = (reader(way) for way in ways if not way.is_documented)
        orders: list[BookReading] = []
        has_numbers = all(path[-1][1:].isdecimal() for path in labels)
        if has_numbers or any(way.by_place and way.parts[0][-1:] == ("[0]",) for way in ways):
            guesses = list(guesses)
            orders = [each for each in (*found, *guesses) if len(each.columns) == 3]
            orders = [each for each in orders if each.by_place or not each.is_documented]
        place = result_place(orders)
        anchor = "table" if document.is_table else "json"
        taken = orders[place] if place is not None else None
        taken = taken or choose(
            path, found, guesses, anchor, fold=fold, allows_single=allows_single
        )
        if taken is None:
            seen = f"no documented words name ingredients and a result; {_shown_paths(labels)}"
            raise refusal(path, seen, anchor, "Name them with --columns.")
        best = taken
    _note_craft(source, labels, best)
    source.columns = best.columns
    source.num_results = best.num_results
    source.ignored = best.ignored
    source.several_outputs = best.several_outputs
    source.counts_dropped += best.counts_dropped
    return source


def _check_choices(path: FilePath, labels: _Labels) -> None:
    """Refuse a document in which an ingredient is a text in some places, and a list in others.

    Raises:
        RecipeFileError: if there is such a key: its lists may be choices, or several ingredients.
    """
    for lists in labels:
        texts = lists[:-1]
        if lists[-1:] != (EACH,) or texts not in labels:
            continue
        # Within one loop, a key holds what belongs to a thing, such as its result or results.
        num_loops = sum(step in LOOPS for step in texts)
        # A map's values have no key: {"water": {"earth": ["mud", "clay"]}} has several results.
        if num_loops > 1 and texts[-1].startswith("."):
            seen = f"the lists of {path_text(texts)!r} may be choices of an ingredient or several"
            remedy = "Write each choice as a recipe of its own, or name columns with --columns."
            raise refusal(path, seen, "json", remedy)


def _note_craft(source: FileRows, labels: _Labels, best: BookReading) -> None:
    """Take the base of Infinite Craft where labels tell the game; Nothing is no result there."""
    source.entries = best.entries
    texts = set(chain.from_iterable(each for each in labels.values() if type(each[0]) is str))
    texts.update(*(row.ingredients for row in best.rows))
    if not source.is_exact and texts.issuperset(INFINITE_CRAFT_BASE):
        source.entries = without_nothing(best.entries)
        # Saves list items with emoji; another table or list may have these labels by chance.
        if not source.base and any(path[-1:] in ((".text",), (".emoji",)) for path in labels):
            source.base = dict.fromkeys(INFINITE_CRAFT_BASE, "items")


def _given(
    document: Document,
    columns: Sequence[str],
    labels: _Labels,
    reader: Callable[..., BookReading],
) -> BookReading:
    """Return the reading that the option `columns` gives."""
    value = document.value
    first = value[0] if isinstance(value, list) and value else None
    first = first if isinstance(first, list | dict) else None
    keys = {key.strip().casefold(): key for key in first} if isinstance(first, dict) else {}
    paths: list[Path] = []
    for text in map(str.strip, columns):
        steps: Path
        if text.casefold() in keys:
            steps = (EACH, f".{keys[text.casefold()]}")
        elif text.isdecimal() and first and 1 <= int(text) <= len(first):
            # Numbers count columns, or the labels of lists, from 1.
            at = int(text) - 1
            steps = (EACH, f".{list(first)[at]}" if isinstance(first, dict) else f"[{at}]")
        else:
            # A key that is at one place only needs no path.
            ends = [path for path in labels if path[-1].casefold() == f".{text}".casefold()]
            steps = ends[0] if len(ends) == 1 else parse_path(text)
        paths.append(fitted(steps, value))
    option = f"`columns` {','.join(columns)}"
    if len(paths) < 2 or len(set(paths)) < len(paths):
        raise ConfigError(
            f"{option}: expected different columns, of the ingredients and, last, of the result."
        )
    for text, steps in zip(columns, paths, strict=True):
        if not any(True for _ in leaves(Located("", value), steps)):
            hint = nearest(text, [path_text(path, document.is_table) for path in labels])
            grammar = "" if document.is_table else f" A path is {GRAMMAR}."
            raise ConfigError(
                f"`columns` {text!r}: no such column; {_shown_paths(labels)}.{hint}{grammar}"
            )
    return reader(ColumnRoles(tuple(paths[:-1]), (paths[-1],)), is_given=True)


def as_records(document: Any) -> Any:
    """Return columns, or a list below a header, as records; any other value as it is."""
    if isinstance(document, dict):
        data = document.get("data")
        if isinstance(document.get("columns"), list) and isinstance(data, list):
            document = [document["columns"], *data]
        else:
            columns = [
                [*each.values()] if isinstance(each, dict) else each for each in document.values()
            ]
            names = [(EACH, f".{name}") for name in document]
            is_table = any(
                reading.is_named and reading.is_documented for reading in readings(names)
            )
            if is_table and all(isinstance(column, list) for column in columns):
                rows = list(zip(*columns, strict=False))
                is_flat = all(
                    isinstance(cell, str | int | float) for cell in chain.from_iterable(rows)
                )
                if is_flat and len(set(map(len, columns))) == 1:
                    return [dict(zip(document, row, strict=True)) for row in rows]
    if isinstance(document, list) and document and isinstance(document[0], list):
        head = document[0]
        names = [(EACH, f".{name}") for name in head]
        is_header = all(isinstance(name, str) for name in head)
        if is_header and any(
            reading.is_named and reading.is_documented for reading in readings(names)
        ):
            rows_below = [row for row in document[1:] if isinstance(row, list)]
            return [dict(zip(head, row, strict=False)) for row in rows_below]
    return document


# --- paths of a document -------------------------------------------------------------------------


def _collect(labels: _Labels, path: Path, values: list[Any]) -> None:
    """Collect the texts, numbers and keys below all values at a path.

    Args:
        labels: gets them.
        path: the path.
        values: all values there.
    """
    if len(path) > MOST_STEPS:
        return  # no recipe book is nested so deeply
    plain = [value for value in values if isinstance(value, str | int | float)]
    lists = [value for value in values if isinstance(value, list)]
    objects = [value for value in values if isinstance(value, dict) and value]
    if plain:
        labels.setdefault(path, []).extend(plain)
    if lists:
        _collect_lists(labels, path, lists)
    if objects and _are_records(objects, path):
        for key in dict.fromkeys(chain.from_iterable(objects)):
            _wrap_pairs([(each, key) for each in objects if key in each])
            inner = [each[key] for each in objects if key in each]
            _collect(labels, (*path, f".{key}"), inner)
    elif objects:
        keys = (*path, VALUES, KEY)
        labels.setdefault(keys, []).extend(chain.from_iterable(objects))
        _wrap_pairs([(each, key) for each in objects for key in each])
        inner = list(chain.from_iterable(each.values() for each in objects))
        # Numbers beside labels are numbers of pieces; those beside sums are ids.
        if all(map(is_number, inner)) and not _are_sums(labels[keys]):
            labels.counted.add(keys)
        else:
            _collect(labels, (*path, VALUES), inner)


def _wrap_pairs(places: Sequence[tuple[dict[str, Any], str]]) -> None:
    """Make a single pair a list of one pair, in place, where values beside it are lists of pairs.

    Args:
        places: objects and their keys with values of one meaning.
    """
    if any(_is_list(each[key], list) for each, key in places):
        for each, key in places:
            if _is_list(each[key], str):
                each[key] = [each[key]]


def _is_list(value: Any, kind: type) -> bool:
    is_filled = isinstance(value, list) and bool(value)
    return is_filled and all(isinstance(element, kind) for element in value)


def _collect_lists(labels: _Labels, path: Path, lists: list[list[Any]]) -> None:
    """Collect what is in lists; a label with a number of pieces, as in ["egg", 2], is one label."""
    if all(map(_is_counted, lists)):
        labels[(*path, "[0]")] = [value[0] for value in lists]
        return
    labels.lengths.setdefault(path, set()).update(map(len, lists))
    elements = [element for element in chain.from_iterable(lists) if element is not None]
    num_lists = sum(isinstance(element, list) for element in elements)
    # Choices beside ingredients, as in Minecraft: no reading accounts for both.
    if num_lists in (0, len(elements)):
        _collect(labels, (*path, EACH), elements)
    elif path[-1:] == (EACH,) and set(map(len, lists)) == {2}:
        # Ingredients in a list, and a result: [["water", "earth"], "mud"].
        for place in range(2):
            _collect(labels, (*path, f"[{place}]"), [each[place] for each in lists])


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
    known = [key for key in counts if is_documented(key)]
    values = [value for each in objects for value in each.values() if value is not None]
    properties = [key for key in counts if words_of(key) & (COUNT | IGNORED)]
    if all(map(str.isdecimal, counts)) or (
        len(counts) > _MOST_KEYS and 2 * len(known) < len(counts)
    ):
        return False
    role = words_of(path[-1][1:]) if path and path[-1].startswith(".") else frozenset()
    if role & (INGREDIENT | RESULT | {"in"}):
        return bool(known or properties) or not all(map(is_number, values))
    if len(objects) > 1:
        if any(counts[key] * 2 > len(objects) for key in known):
            return True
        texts = {value for value in values if isinstance(value, str)}
        # Labels of a map are values of it as well; properties are not.
        is_dense = len(values) > _DENSE * len(objects) * len(counts)
        return is_dense and texts.isdisjoint(counts)
    if not known:
        return False
    if len(values) > 1 and all(isinstance(value, dict) and value for value in values):
        return not _are_records(values)
    kinds = {isinstance(value, dict | list) for value in values}
    others = [key for key in counts if words_of(key) & ORDINAL]
    return len(kinds) > 1 or bool(others or properties) or len(known) * 2 >= len(counts)


def _names(document: Any, labels: _Labels) -> list[Names]:
    """Return names by id, slug or emoji, for each kind of ids beside names in a document."""
    tables = []
    for path in labels:
        parent = path[:-1]
        inside = [other for other in labels if other[:-1] == parent and is_name(other[-1][1:])]
        named: list[Path] = []
        if path[-1:] == (KEY,):
            texts = [parent] if parent in labels and all(map(str.isdecimal, labels[path])) else []
            named = [*inside, *texts]
        elif path and path[-1].startswith(".") and is_id(path[-1][1:]):
            # The name and the id of one thing, such as Parent 1 ID and Parent 1 Name.
            thing = words_of(path[-1][1:]) - ID
            same = [
                words_of(other[-1][1:]) - _NAME_WORDS == thing - _NAME_WORDS for other in inside
            ]
            named = list(compress(inside, same))
        if named:
            rows = rows_of_paths(
                document, [path], [min(named, key=lambda each: name_rank(each[-1][1:]))]
            )
            tables.append(names_by_id((ids[0], made[0]) for _, ids, made in rows if ids and made))
    lists = [path for path in labels if path[-1:] == (EACH,) and not set(path[:-1]) & set(LOOPS)]
    # Ids may be places in a list of names, if nothing else is.
    for path in lists if not tables else ():
        if all(isinstance(value, str) for value in labels[path]):
            tables.append(names_by_id(enumerate(labels[path])))
    return tables


def _shown_paths(labels: _Labels) -> str:
    names = [path_text(path)[:40].removeprefix("[].") for path in labels][:_MOST_PATHS]
    if all(map(str.isdecimal, names)):
        names = [str(labels[path][0])[:40] for path in labels][:_MOST_PATHS]  # no header
    shown = list(map(repr, names))
    more = f" and {len(labels) - _MOST_PATHS:,} more" if len(labels) > _MOST_PATHS else ""
    return f"the file has {', '.join(shown) or 'no labels'}{more}"


# --- ways to read a document ---------------------------------------------------------------------


def _readings(labels: _Labels) -> Iterator[ColumnRoles]:
    """Yield the ways to read a document, the more certain ones first."""
    by_place = list(
        chain(_by_keys(labels), _by_place(labels), _by_list(labels), _by_column(labels))
    )
    sure = [reading for reading in by_place if reading.is_documented]
    taken = {path for reading in sure for path in reading.results if path[-1] != KEY}
    for reading in readings(path for path in labels if path not in taken):
        yield reading
        (part, *others), (made, *_) = reading.parts, reading.results
        # A pair under a key such as combinations may be a partner and a result.
        named = {word for step in part if step.startswith(".") for word in words_of(step[1:])}
        is_pair = not others and labels.lengths.get(part[:-1]) == {2}
        if is_pair and not reading.is_named and named.isdisjoint(INGREDIENT):
            first, second = (*part[:-1], "[0]"), (*part[:-1], "[1]")
            yield ColumnRoles((made, first), (second,), is_documented=False)
    yield from by_place


def _by_keys(labels: _Labels) -> Iterator[ColumnRoles]:
    """Yield readings in which keys are ingredients: sums, or two keys around a result."""
    for path in labels:
        keys = [(*path[:at], VALUES, KEY) for at, step in enumerate(path) if step == VALUES]
        keys = [key for key in keys if key in labels]
        named = path[-1][1:] if path[-1].startswith(".") else ""
        is_result = named and (words_of(named) & RESULT or is_name(named)) and is_plain(named)
        is_inside = path[-1] == EACH and path[-2:-1] == (VALUES,)
        if not keys or path[-1] == KEY or not (is_result or path[-1] == VALUES or is_inside):
            continue
        inner = keys[-1]
        steps = path[len(inner) - 1 :]
        has_lists = EACH in steps
        # Commas in keys may be parts of labels of things that are made of lists.
        sums = _are_sums(labels[inner], has_commas=not has_lists)
        if sums and not _are_sums(labels[path]) and (not named or steps == path[-1:]):
            yield ColumnRoles((inner,), (path,), by_place=True)
        elif len(keys) > 1 and not sums and path[: len(inner) - 1] == inner[:-1]:
            is_pair = len(keys[-1]) - len(keys[-2]) == 1
            is_text = any(isinstance(value, str) for value in labels[path])
            if is_pair and is_text and (not named or words_of(named) & RESULT):
                outer = keys[-2]
                yield ColumnRoles((outer, inner), (path,), by_place=True)
                yield ColumnRoles((inner, path), (outer,), is_documented=False)
        # Partners below a key of a thing: {"water": {"combinations": {"earth": "mud"}}}.
        step = inner[-3] if len(inner) > 2 else ""
        if step.startswith(".") and words_of(step[1:]) & SUMS and not sums and not named:
            parent = inner[:-3]
            things = [other for other in labels if other[:-1] == parent and is_name(other[-1][1:])]
            around = [*things, *(key for key in keys[:-1] if key[:-1] == parent)]
            for thing in around[:1]:
                yield ColumnRoles((thing, inner), (path,), by_place=True)


def _by_list(labels: _Labels) -> Iterator[ColumnRoles]:
    """Yield readings of lists of three labels, and of ingredients in a list before the result."""
    for path in labels:
        inner = path[-1:] if path[-1] == "[0]" else ()  # a label and something beside it
        outer = path[: len(path) - len(inner)]
        if outer[-2:] == (EACH, EACH) and labels.lengths.get(outer[:-1]) == {3}:
            a, b, c = ((*outer[:-1], f"[{place}]", *inner) for place in range(3))
            yield ColumnRoles((a, b), (c,), by_place=True)
            yield ColumnRoles((b, c), (a,), is_documented=False)
            yield ColumnRoles((a, c), (b,), is_documented=False)
        elif path[-2:] == ("[0]", EACH) and (*path[:-2], "[1]") in labels:
            yield ColumnRoles((path,), ((*path[:-2], "[1]"),), by_place=True)


def _by_column(labels: _Labels) -> Iterator[ColumnRoles]:
    """Yield readings of three columns or keys whose names say nothing, and of two without names."""
    columns = [path for path in labels if path[:1] == (EACH,) and path[1:] == path[-1:]]
    columns = [path for path in columns if is_plain(path[-1][1:])]
    columns = [path for path in columns if not all(map(is_number, labels[path]))]
    for word in set(chain.from_iterable(words_of(path[-1][1:]) for path in columns)):
        # Such as draggedItem, targetItem and resultItem.
        like = [path for path in columns if word in words_of(path[-1][1:])]
        if len(like) == 3 and words_of(like[-1][-1][1:]) & RESULT:
            yield ColumnRoles((like[0], like[1]), (like[2],), is_documented=False)
    if len(columns) == 3 and not any(map(is_name, (path[-1][1:] for path in columns))):
        a, b, c = columns
        for one, other, made in ((a, b, c), (b, c, a), (a, c, b)):
            yield ColumnRoles((one, other), (made,), is_named=False, is_documented=False)
    if len(columns) == 2 and all(path[-1][1:].isdecimal() for path in columns):
        sums = [path for path in columns if all("+" in cell for cell in labels[path])]
        if len(sums) == 1:
            yield ColumnRoles(tuple(sums), tuple(path for path in columns if path not in sums))


def _are_sums(keys: Sequence[str], *, has_commas: bool = True) -> bool:
    """Return whether all keys are sums, or lists as text."""
    signs = [sign for sign in JOINERS if has_commas or sign != ","]
    plain = [key for key in keys if isinstance(key, str) and not listed_value(key)]
    if len(plain) < len(keys) and not plain:
        return bool(keys) and all(isinstance(key, str) for key in keys)
    return bool(plain) and any(all(sign in key for key in plain) for sign in signs)


def _by_place(labels: _Labels) -> Iterator[ColumnRoles]:
    """Yield readings of shapes without keys of their own, in which places tell the roles."""
    for path, values in labels.items():
        has_texts = any(isinstance(value, str) for value in values)
        parent, lengths = path[:-1], labels.lengths.get(path[:-1])
        if path[-3:] == (VALUES, EACH, EACH) and has_texts:
            key = (*path[:-2], KEY)
            yield ColumnRoles((path,), (key,), by_place=True)
            if lengths == {2}:
                reading = ColumnRoles((key, (*parent, "[0]")), ((*parent, "[1]"),))
                yield reading._replace(is_documented=False)
        elif path[-2:] == (VALUES, EACH) and has_texts and not _are_sums(labels[(*parent, KEY)]):
            # Two labels below a key may be anything about it; sums are recipes.
            is_sum = _are_sums(values)
            if is_sum or path[-3:-2] != (VALUES,):
                yield ColumnRoles((path,), ((*parent, KEY),), is_documented=is_sum, by_place=True)
        elif path[-1:] == (VALUES,) and _are_sums(values) and not _are_sums(labels[(*path, KEY)]):
            yield ColumnRoles((path,), ((*path, KEY),), by_place=True)
    # Numbers of pieces by label: {"torch": {"plank": 2, "stick": 1}}.
    for path in labels.counted:
        if path[-3:] == (VALUES, VALUES, KEY):
            yield ColumnRoles((path,), ((*path[:-2], KEY),), is_named=False, by_place=True)


def _candidate(
    document: Document,
    labels: _Labels,
    names: Sequence[Names],
    reading: ColumnRoles,
    *,
    is_given: bool = False,
    is_exact: bool = False,
) -> BookReading:
    """Return the recipes of a reading."""
    parts, results = reading.parts, reading.results
    used = {*parts, *results}
    others = [path for path in labels if path not in used and path[-1:] != (KEY,)]
    kind = (*parts[0][:-1], f".{KIND}")
    kinds = [kind] if kind in labels and kind not in used else []
    text = partial(path_text, is_table=document.is_table)
    candidate = BookReading(
        tuple(map(text, (*parts, *results))),
        [],
        reading.is_documented,
        reading.is_named,
        num_results=len(results),
        ignored=tuple(text(path) for path in others if path not in kinds),
        by_place=reading.by_place,
        needs_reuse=not labels.counted.isdisjoint((*results, *parts)),
    )
    counts = [path for path in others if words_of(path[-1][1:]) & COUNT]
    candidate.counts_dropped = sum(
        number not in ("", "1", 1) for path in counts for number in labels[path]
    )
    raws: list[Raw | Entry] = list(document.others)
    is_flat = all(path[:1] == (EACH,) and path[1:2] == path[1:] for path in (*parts, *results))
    if is_flat and all(path[-1].startswith(".") for path in (*parts, *results)):
        raws += _raws_of_records(document, parts, results, kinds)
    else:
        steps = chain.from_iterable(parts if len(parts) > 1 else ())
        has_places = any(step.startswith("[") and step != EACH for step in steps)
        for place, values, made in rows_of_paths(document.value, parts, results):
            if not has_places or len(values) == len(parts):
                raws.append(Raw(place, values, made))
    if document.is_table:
        raws.sort(key=itemgetter(0))
    is_sole = len(parts) == 1
    in_lists = (
        is_sole
        and parts[0][-1] in LOOPS
        and any(len(raw.parts) != 1 for raw in raws if isinstance(raw, Raw))
    )
    return fill(
        candidate,
        raws,
        is_sole=is_sole,
        in_lists=in_lists,
        is_given=is_given,
        is_exact=is_exact,
        tables=names,
    )


def _raws_of_records(
    document: Document, parts: Sequence[Path], results: Sequence[Path], kinds: Sequence[Path]
) -> Iterator[Raw]:
    """Yield the rows of flat records: as paths lead to them, but many times faster."""
    columns, made, kind = ([path[-1][1:] for path in paths] for paths in (parts, results, kinds))
    places: Iterable[Place] = document.places or map("[{}]".format, count())
    for place, row in zip(places, document.value, strict=False):
        if isinstance(row, dict):
            cells = [row[name] for name in columns if name in row]
            results_of_row = [row[name] for name in made if name in row]
            kind_of_row = str(row.get(kind[0]) or "") if kind else ""
            yield Raw(place, cells, results_of_row, kind_of_row)
