"""JSON in the shapes that games, clones and tools write.

Each shape is a function from the parsed value to entries, tried in the order of :data:`SHAPES`. A
shape yields ``_Raw`` recipes; :class:`JsonRecipes` checks their labels.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple

from wordcraft_kg.base.errors import ConfigError, RecipeFileError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.graphs.book_files.columns import (
    Roles,
    names_ingredient,
    names_property,
    readings,
    repeated_cells,
    result_by_rows,
    roles_of_header,
    roles_of_option,
    words_of,
)
from wordcraft_kg.graphs.book_files.guide import refusal
from wordcraft_kg.graphs.book_files.json_keys import (
    common_sign,
    listed_parts,
    pair_keys,
    property_keys,
)
from wordcraft_kg.graphs.book_files.rows import (
    INFINITE_CRAFT_BASE,
    NOTHING,
    Entry,
    Fault,
    LeftOut,
    RowSource,
)
from wordcraft_kg.graphs.hif import is_hif, recipes_of_hif
from wordcraft_kg.graphs.recipes import check_label, label_fault, shown

_NAMES = ("text", "name", "item", "id", "label", "title", "tag", "element", "displayName")
"""Keys of an object that stands for an entity, the usual ones first."""
_TEXTS = ("name", "text", "label", "title")
_COUNTS = ("count", "amount", "quantity", "qty", "number")
_RECIPE_KEYS = words_of(
    "recipe recipes combinations combination combos canbemadewith madewith madefrom makeswith "
    "ingredients ingredient inputs input components component parents parent reagents "
    "reactants from craftedfrom crafting materials material requires parts pairs"
)
_RESULT_KEYS = words_of("result results output outputs product products")
_ENTITY_LISTS = words_of("elements entities items nodes")
_WRAPPERS = _ENTITY_LISTS | words_of(
    "recipes data combinations combos results entries content payload book pairs"
)
_ABOUT = _WRAPPERS | words_of("base bases start starting initial starters basics kinds columns")
"""Keys that say something about a book, and are no result where labels follow."""
_KEY_JOINERS = (" + ", "+", ";", "|", "&", ",")
_MAX_DEPTH = 3  # objects around the recipes
_MOST_COLUMNS = 20  # keys of an object that may be columns; a book has more results
_MOST_PIECES = 10**12  # a larger number next to a label is no number of pieces
_LONG = 10  # labels in lists of one length that are columns rather than ingredients
_LOOKED_AT = 1_000  # entries by which a shape is judged


class _Raw(NamedTuple):
    """A recipe before its labels are checked.

    Attributes:
        where: place in the file.
        shown: the value, for errors.
        ingredients: values that stand for ingredients.
        result: value that stands for the result.
        kind: kind of reasoning, or empty.
        counts: numbers of pieces next to the values, which are not kept.
    """

    where: str
    shown: Any
    ingredients: Sequence[Any]
    result: Any
    kind: Any = ""
    counts: int = 0


@dataclass
class _Found:
    """A shape that fits a value.

    Attributes:
        shape: name for people.
        raws: recipes, faults and rows left out.
        listed: entities outside of recipes, as values.
        known: labels that recipes may name; None for any.
        base: declared base; None without one.
        columns: keys that were read.
        ignored: keys that were not read.
        names: labels by id, for values that are ids.
        indices: whether integers are indices into ``names``.
        nothing: whether Infinite Craft's Nothing is no entity.
        counts_dropped: numbers of results that are not kept.
    """

    shape: str
    raws: Iterable[_Raw | Fault | LeftOut]
    listed: Sequence[Any] = ()
    known: frozenset[str] | None = None
    base: Sequence[str] | None = None
    columns: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()
    names: Mapping[Any, str] = field(default_factory=dict)
    indices: bool = False
    nothing: bool = False
    counts_dropped: int = 0


class JsonRecipes(RowSource):
    """The recipes of a JSON file or of JSON lines."""

    def __init__(self, path: Path, text: str, columns: Sequence[str] | None = None):
        """Parse the text and find its shape.

        Raises:
            RecipeFileError: if it is not JSON or has no readable shape; the message says what was
                seen.
        """
        super().__init__()
        self._path = path
        content, self._is_lines = load_json(path, text)
        found = _shape_of(path, content, columns)
        self._found = found
        self.shape = f"{found.shape} (JSON lines)" if self._is_lines else found.shape
        self.columns, self.ignored = found.columns, found.ignored
        self.counts_dropped = found.counts_dropped
        self._read_listed()

    def _read_listed(self) -> None:
        found = self._found
        for index, value in enumerate(found.listed):
            label = self._label(value)
            if not (found.nothing and label == NOTHING):
                where = (
                    f"{self._path}: entities[{index}]"
                    if found.known is not None
                    else f"{self._path}"
                )
                self.listed[check_label(label, where)] = f"entities[{index}]"
        if found.base is not None:
            self.base = {}
            for index, label in enumerate(found.base):
                where = f"base[{index}]"
                fault = self._unknown(label, where)
                if fault:
                    raise RecipeFileError(f"{self._path}: {fault}")
                self.base[label] = where

    def __iter__(self) -> Iterator[Entry]:
        """Yield recipes, invalid entries and rows left out, in file order."""
        before: _Raw | None = None
        is_counted = False
        for raw in self._found.raws:
            if isinstance(raw, (Fault, LeftOut)):
                yield raw
                continue
            # Results of one entry follow each other; an entry counts once.
            is_same = (
                before is not None
                and before.where == raw.where
                and before.ingredients == raw.ingredients
            )
            self.several_outputs += is_same and not is_counted
            before, is_counted = raw, is_same
            if self._found.known is None:
                counted = raw.ingredients if not is_same else ()
                self.counts_dropped += sum(map(_has_count, (*counted, raw.result)))
                self.counts_dropped += raw.counts if not is_same else 0
            yield self._entry(raw)

    def _entry(self, raw: _Raw) -> Entry:
        found = self._found
        values = (*raw.ingredients, raw.result)
        # The frequent case in our own layouts: known labels need no further look.
        if found.known is not None and not raw.kind and len(values) > 1:
            try:
                is_known = found.known.issuperset(values)
            except TypeError:  # an object or a list, which is not hashable
                is_known = False
            if is_known:
                return raw.where, values
        labels = [self._label(value) for value in values]
        if found.nothing and NOTHING in labels:
            is_result = labels[-1] == NOTHING
            return LeftOut(
                raw.where, "with the result Nothing" if is_result else "with Nothing as ingredient"
            )
        for label in labels:
            fault = self._unknown(label, raw.where)
            if fault:
                return Fault(raw.where, "label", fault)
        if len(labels) < 2:
            return Fault(
                raw.where,
                "row",
                f"{raw.where} is {shown(raw.shown)}; a recipe needs two ingredients.",
            )
        conflict = self._note_kind(raw, labels) if raw.kind else None
        if conflict is not None:
            return conflict
        return raw.where, labels

    def _note_kind(self, raw: _Raw, labels: Sequence[str]) -> Fault | None:
        """Keep a recipe's kind, or return what is wrong with it."""
        fault = label_fault(raw.kind)
        if fault:
            return Fault(raw.where, "label", f"{raw.where}: {fault}")
        *ingredients, result = labels
        known = self.kind_of.setdefault((tuple(sorted(ingredients)), result), raw.kind)
        if known != raw.kind:
            recipe = f"{' + '.join(ingredients)} -> {result}"
            kinds = f"the kind '{raw.kind}' here, and '{known}' above"
            return Fault(raw.where, "row", f"{raw.where}: {recipe} has {kinds}.")
        return None

    def _unknown(self, label: Any, where: str) -> str | None:
        fault = label_fault(label)
        if fault:
            return f"{where}: {fault}"
        known = self._found.known
        if known is not None and label not in known:
            return f"{where}: '{label}' is not among the file's entities.{nearest(label, known)}"
        return None

    def _label(self, value: Any) -> Any:
        """Return the label that a value stands for, or a value that stands for none."""
        label = self._named(value)
        # Our own layouts keep blanks; elsewhere they are slips, as in tables.
        is_ours = self._found.known is not None or not isinstance(label, str)
        return label if is_ours else label.strip()

    def _named(self, value: Any) -> Any:
        found = self._found
        if isinstance(value, dict):
            value = next((value[key] for key in _NAMES if _is_name(value.get(key))), value)
        if found.indices and isinstance(value, int) and not isinstance(value, bool):
            return found.names.get(value, value)
        if isinstance(value, int) and not isinstance(value, bool) and found.known is None:
            return found.names.get(value, str(value))
        if isinstance(value, str):
            return found.names.get(value, value)
        return value


def load_json(path: Path, text: str) -> tuple[Any, bool]:
    """Parse JSON, or JSON lines as a list.

    Returns:
        The value, and whether it was JSON lines.

    Raises:
        RecipeFileError: with the line of the first fault.
    """
    try:
        return _loads(path, text), False
    except json.JSONDecodeError as error:
        # Other line separators, such as U+2028, may stand in a text.
        every = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
        lines = [line for line in every if line.strip()]
        is_lines = error.msg == "Extra data" and len(lines) > 1 and error.lineno > 1
        if is_lines and all(line.lstrip()[:1] in "{[" for line in lines[:_LOOKED_AT]):
            return [
                _loaded_line(path, number, line)
                for number, line in enumerate(every, 1)
                if line.strip()
            ], True
        raise RecipeFileError(
            f"{path}, line {error.lineno}, column {error.colno}: not JSON ({error.msg})."
        ) from None


def _loaded_line(path: Path, number: int, line: str) -> Any:
    try:
        return _loads(path, line)
    except json.JSONDecodeError as error:
        raise RecipeFileError(
            f"{path}, line {number}, column {error.colno}: not JSON ({error.msg})."
        ) from None


def parsed_json(path: Path | str, text: str) -> Any:
    """Parse JSON.

    Raises:
        RecipeFileError: if it is not JSON.
    """
    try:
        return _loads(path, text)
    except json.JSONDecodeError as error:
        raise RecipeFileError(
            f"{path}, line {error.lineno}, column {error.colno}: not JSON ({error.msg})."
        ) from None


def _loads(path: Path | str, text: str) -> Any:
    def without_duplicate_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        keys = dict(pairs)
        if len(keys) < len(pairs):
            names = [key for key, _ in pairs]
            twice = next(key for key in names if names.count(key) > 1)
            raise RecipeFileError(f"{path}: the key '{twice}' occurs twice in one object.")
        return keys

    try:
        return json.loads(text, object_pairs_hook=without_duplicate_keys)
    except (json.JSONDecodeError, RecipeFileError):
        raise
    except RecursionError:
        raise RecipeFileError(f"{path}: nested too deeply for a recipe book.") from None
    except ValueError as error:  # such as a number of thousands of digits
        raise RecipeFileError(f"{path}: not a recipe book ({error}).") from None


# --- shapes --------------------------------------------------------------------------------------


def _shape_of(path: Path, content: Any, columns: Sequence[str] | None) -> _Found:
    value, where = content, ""
    names: dict[Any, str] = {}
    for _ in range(_MAX_DEPTH):
        inner = _unwrapped(value)
        # A key such as "elements" around a list is no result of its own.
        is_wrapped = inner is not None and inner.lower() in _WRAPPERS
        for shape in LAYOUTS if is_wrapped else (*LAYOUTS, *SHAPES):
            found = shape(path, value, where, columns)
            if found is not None:
                return _resolved(path, _with_columns(path, found, columns), names)
        if inner is None:
            break
        names = names or _names_beside(path, value, inner)
        value, where = value[inner], f"{where}.{inner}".lstrip(".")
    raise refusal(path, f"{_seen(content)}; recipes in a known shape are missing", "json")


def _with_columns(path: Path, found: _Found, columns: Sequence[str] | None) -> _Found:
    """Return a shape that took the option `columns`, or refuse the option."""
    if columns is not None and not found.columns:
        raise ConfigError(
            f"`columns` {','.join(columns)}: {path} is read as {found.shape}, which has no "
            "columns; leave `columns` out."
        )
    return found


def _unwrapped(value: Any) -> str | None:
    """Return the key of the only list or object in an object that may hold the recipes."""
    if not isinstance(value, dict):
        return None
    inner = [key for key, each in value.items() if isinstance(each, (dict, list)) and each]
    # Among many keys, one such as book is a result like the others.
    if len(inner) > _MOST_COLUMNS:
        return None
    named = [key for key in inner if key.lower() in _WRAPPERS]
    # Elements may be listed next to their recipes.
    recipes = [key for key in named if key.lower() not in _ENTITY_LISTS]
    chosen = next((keys for keys in (named, recipes) if len(keys) == 1), inner)
    return chosen[0] if len(chosen) == 1 else None


def _names_beside(path: Path, value: Mapping[str, Any], inner: str) -> dict[Any, str]:
    """Return the names by id of elements that are listed next to the recipes."""
    lists = [each for key, each in value.items() if key != inner and key.lower() in _ENTITY_LISTS]
    objects = [each for each in lists if isinstance(each, list)]
    rows = [row for row in chain.from_iterable(objects) if isinstance(row, dict)]
    return _names_of_ids(path, ((row.get("id"), row) for row in rows))


def _names_of_ids(path: Path, rows: Iterable[tuple[Any, Mapping[str, Any]]]) -> dict[Any, str]:
    """Return names by id, for digits also by their number.

    Raises:
        RecipeFileError: if two names have one id.
    """
    names: dict[Any, str] = {}
    for identifier, row in rows:
        name = next((row[key] for key in _TEXTS if isinstance(row.get(key), str)), None)
        if name is None or isinstance(identifier, bool) or not isinstance(identifier, (int, str)):
            continue
        text = str(identifier)
        is_digits = isinstance(identifier, str) and _is_digits(text)
        for key in (text, int(text)) if is_digits else (identifier,):
            if names.setdefault(key, name) != name:
                both = f"{names[key][:60]!r} and {name[:60]!r}"
                raise RecipeFileError(f"{path}: the id {text[:60]} belongs to {both}.")
    return names


def _is_digits(text: str) -> bool:
    # Longer numbers are no ids, and int() refuses thousands of digits.
    return text.isascii() and text.isdigit() and len(text) < 20


def _resolved(path: Path, found: _Found, names: Mapping[Any, str]) -> _Found:
    """Return a shape with names for ids if recipes name entities by id.

    Raises:
        RecipeFileError: if only some of the values are ids.
    """
    if not names or found.names:
        return found
    raws = list(found.raws)
    rows = [raw for raw in raws if isinstance(raw, _Raw)]
    used = {part for raw in rows for part in raw.ingredients if _is_name(part)}
    results = {raw.result for raw in rows if _is_name(raw.result)}
    labels = set(names.values())
    strange = [part for part in used | results if part not in labels]
    unknown = [part for part in strange if part not in names]
    found = replace(found, raws=raws)
    if not strange or not any(part in names for part in strange):
        return found
    # A result may be the name of the object around it.
    if unknown and any(part in used for part in unknown):
        missing = min(map(str, unknown))[:60]
        raise refusal(path, f"recipes name elements by id, but none has the id {missing!r}", "json")
    if all(isinstance(part, int) for part in strange if part in names):
        # A label of digits, such as '7', is no id where ids are numbers.
        names = {key: name for key, name in names.items() if isinstance(key, int)}
    return replace(found, names=names)


def _own(path: Path, value: Any, where: str, columns: Sequence[str] | None) -> _Found | None:
    """Our own layout: lists of entities and of recipes by label."""
    if not isinstance(value, dict) or not isinstance(value.get("recipes"), list):
        return None
    entities, rows, base = value.get("entities"), value["recipes"], value.get("base")
    if not isinstance(entities, list):
        return None
    if base is not None and not isinstance(base, list):
        raise RecipeFileError(
            f"{path}: 'base' is {type(base).__name__}; expected a list of labels or null."
        )
    kinds = value.get("kinds")
    if kinds is not None and (not isinstance(kinds, list) or len(kinds) != len(rows)):
        raise RecipeFileError(
            f'{path}: kinds is {shown(kinds)}; expected a list with a kind, or "", for each recipe.'
        )

    def raws() -> Iterator[_Raw | Fault]:
        for index, row in enumerate(rows):
            place = f"recipes[{index}]"
            if not isinstance(row, list) or len(row) < 2:
                message = f"{place} is {shown(row)}; expected [ingredient, ingredient, result]."
                yield Fault(place, "row", message, "own row")
            else:
                kind = kinds[index] if kinds else ""
                yield _Raw(place, row, row[:-1], row[-1], kind)

    known = frozenset(label for label in entities if isinstance(label, str))
    return _Found("our own JSON", raws(), entities, known, base)


def _official(path: Path, value: Any, where: str, columns: Sequence[str] | None) -> _Found | None:
    """The layout released with the paper's code: an object of entities with lists of pairs."""
    entities = value.get("entities") if isinstance(value, dict) else None
    if not isinstance(entities, dict):
        return None

    def raws() -> Iterator[_Raw | Fault]:
        for result, entry in entities.items():
            place = f"entities['{result}']"
            if not isinstance(entry, dict) or not isinstance(entry.get("recipes"), list):
                yield Fault(place, "row", f"{place} has no list 'recipes'.")
                continue
            for index, pair in enumerate(entry["recipes"]):
                here = f"{place}.recipes[{index}]"
                if isinstance(pair, list) and pair:
                    yield _Raw(here, pair, pair, result)
                else:
                    message = f"{here} is {shown(pair)}; a recipe needs two ingredients."
                    yield Fault(here, "row", message)

    return _Found("the paper's JSON", raws(), list(entities), frozenset(entities))


def _craft_items(
    path: Path, value: Any, where: str, columns: Sequence[str] | None
) -> _Found | None:
    """A save of Infinite Craft (``.ic``), or a dump with recipes by index."""
    if not isinstance(value, dict) or not isinstance(value.get("items"), list):
        return None
    items = value["items"]
    recipes = value.get("recipes")
    if items and isinstance(recipes, list) and all(map(_is_index_row, recipes)):
        names = {i: _own_name(item) for i, item in enumerate(items)}
        raws = (_Raw(f"recipes[{i}]", row, row[:-1], row[-1]) for i, row in enumerate(recipes))
        return _infinite_craft("a dump of Infinite Craft", raws, names)
    if not items or not all(isinstance(item, dict) and "text" in item for item in items):
        return None
    if not all(isinstance(item["text"], str) for item in items):
        raise refusal(path, "an item whose 'text' is no text", "infinite-craft")
    names = _names_of_ids(path, ((item.get("id", i), item) for i, item in enumerate(items)))

    def saved() -> Iterator[_Raw | Fault]:
        for i, item in enumerate(items):
            pairs = item.get("recipes") or []
            if not isinstance(pairs, list):
                here = f"items[{i}].recipes"
                yield Fault(here, "row", f"{here} is {shown(pairs)}; expected a list of pairs.")
                continue
            for j, pair in enumerate(pairs):
                here = f"items[{i}].recipes[{j}]"
                if isinstance(pair, list) and pair:
                    yield _Raw(here, pair, pair, item["text"])
                else:
                    yield Fault(
                        here, "row", f"{here} is {shown(pair)}; a recipe needs two ingredients."
                    )

    return _infinite_craft("a save of Infinite Craft", saved(), names)


def _craft_elements(
    path: Path, value: Any, where: str, columns: Sequence[str] | None
) -> _Found | None:
    """An older save of Infinite Craft: elements, and recipes by result."""
    if not isinstance(value, dict) or not isinstance(value.get("elements"), list):
        return None
    recipes = value.get("recipes")
    if not isinstance(recipes, dict):
        return None
    names = {i: _own_name(item) for i, item in enumerate(value["elements"])}
    raws = _of_results(recipes.items(), "recipes")
    found = _infinite_craft("an older save of Infinite Craft", raws, names)
    found.indices = False
    return found


def _hif(path: Path, value: Any, where: str, columns: Sequence[str] | None) -> _Found | None:
    """A directed hypergraph in HIF, as `export --format hif` writes."""
    if not is_hif(value):
        return None
    found = recipes_of_hif(value, str(path))
    rows = zip(found.rows, found.kinds, strict=True)
    raws = (
        _Raw(f"edge {i}", row, row[:-1], row[-1], kind) for i, (row, kind) in enumerate(rows, 1)
    )
    return _Found(
        "a hypergraph (HIF)",
        raws,
        found.listed,
        frozenset(found.listed),
        found.base,
        counts_dropped=found.dropped_counts,
    )


def _infinite_craft(
    shape: str, raws: Iterable[_Raw | Fault | LeftOut], names: Mapping[Any, Any]
) -> _Found:
    labels = [label for label in names.values() if isinstance(label, str)]
    is_world = set(INFINITE_CRAFT_BASE) <= set(labels)
    base = INFINITE_CRAFT_BASE if is_world else None
    return _Found(shape, raws, labels, base=base, names=names, indices=True, nothing=True)


def _rows_of_three(
    path: Path, value: Any, where: str, columns: Sequence[str] | None
) -> _Found | None:
    """A list of lists ``[a, b, result]``, like a table without a header."""
    if not isinstance(value, list) or not value or not all(isinstance(row, list) for row in value):
        return None
    # A list within a row holds the ingredients: the columns are known.
    is_parted = all(map(_is_parted, value))
    if is_parted:
        value = [[*ingredients, result] for ingredients, result in value]
    width = len(value[0])
    if not all(isinstance(cell, (str, int)) for row in value for cell in row) or width < 2:
        return None
    rows = [[str(cell) for cell in row] for row in value]
    names = rows[0]
    if is_parted:
        parted = (_Raw(f"{where}[{i}]", row, row[:-1], row[-1]) for i, row in enumerate(rows))
        return _Found("a list of lists", parted)
    roles, start = _roles_of_lists(path, rows, columns)

    def raws() -> Iterator[_Raw | Fault]:
        for index, row in enumerate(rows[start:], start):
            here = f"{where}[{index}]"
            if len(row) != width:
                message = f"{here} has {len(row)} labels; the first row has {width}."
                yield Fault(here, "row", message, f"width {len(row)}")
                continue
            parts = [row[i] for i in roles.ingredients if row[i]]
            for result in [row[i] for i in roles.results if row[i]] or [""]:
                yield _Raw(here, row, parts, result)

    titles = tuple(
        names[i] if start else f"place {i + 1}" for i in (*roles.ingredients, *roles.results)
    )
    ignored = [names[i] if start else f"place {i + 1}" for i in range(width) if i not in roles.used]
    return _Found("a list of lists", raws(), columns=titles, ignored=tuple(ignored))


def _is_parted(row: Sequence[Any]) -> bool:
    """Whether a row is a list of ingredients and a result: ``[["water", "earth"], "mud"]``."""
    return len(row) == 2 and isinstance(row[0], list) and isinstance(row[1], (str, int))


def _roles_of_lists(
    path: Path, rows: Sequence[Sequence[str]], columns: Sequence[str] | None
) -> tuple[Roles, int]:
    """Return the roles of a list of lists, and the index of its first recipe."""
    names, *others = rows
    width = len(names)
    header = roles_of_header(names)
    has_header = header is not None and not repeated_cells(names, header, others)
    if columns is not None:
        by_number = all(column.strip().isdecimal() for column in columns)
        return roles_of_option(columns, names, width), int(has_header or not by_number)
    if header is not None and has_header:
        return header, 1
    full = [row for row in rows if len(row) == 3]
    result = result_by_rows(full)
    if width != 3 or result is None:
        seen = f"a list of lists of {width} labels, and nothing tells which is the result"
        two = f": {readings(names)}" if width == 3 else ""
        raise refusal(
            path, seen + two, "json", "Choose with `columns`, numbers with the result last."
        )
    return roles_of_option([str(1 + (result + i) % 3) for i in (1, 2, 3)], None, 3), 0


def _split(path: Path, value: Any, where: str, columns: Sequence[str] | None) -> _Found | None:
    """A table as pandas writes it with its columns apart: ``{"columns": [], "data": [[]]}``."""
    if not isinstance(value, dict) or not isinstance(value.get("columns"), list):
        return None
    rows = value.get("data")
    if not isinstance(rows, list):
        return None
    return _rows_of_three(path, [value["columns"], *rows], "data", columns)


def _columnar(path: Path, value: Any, where: str, columns: Sequence[str] | None) -> _Found | None:
    """An object of columns, each a list of cells, or an object of cells by row."""
    if not isinstance(value, dict) or not 2 < len(value) <= _MOST_COLUMNS:
        return None
    cells = _cells_by_column(list(value.values()))
    keys = list(value)
    if cells is None or (
        roles_of_header(keys) is None if columns is None else columns[0] not in keys
    ):
        return None
    strange = [key for key in keys if not names_property(key) and not names_ingredient(key)]
    if strange and columns is None:
        seen = f"{keys[0][:40]!r} and {strange[0][:40]!r} may be columns of a table, or results"
        raise refusal(path, seen, "json", "If they are columns, name them with `columns`.")
    records = [dict(zip(keys, row, strict=True)) for row in zip(*cells, strict=True)]
    places = [f"{where}[{index}]" for index in range(len(records))]
    found = _of_records(path, records, places, columns)
    return None if found is None else replace(found, shape="columns")


def _cells_by_column(values: Sequence[Any]) -> list[list[Any]] | None:
    """Return the cells of columns of one length; None if the values are no columns."""
    first = values[0]
    if isinstance(first, list) and first:
        is_table = all(isinstance(each, list) and len(each) == len(first) for each in values)
        cells = values
    elif isinstance(first, dict) and first:
        is_table = all(isinstance(each, dict) and each.keys() == first.keys() for each in values)
        cells = [[each[key] for key in first] for each in values] if is_table else []
    else:
        return None
    is_flat = is_table and not any(isinstance(cell, (list, dict)) for row in cells for cell in row)
    return list(cells) if is_flat else None


def _record(path: Path, value: Any, where: str, columns: Sequence[str] | None) -> _Found | None:
    """One recipe, an object with keys like columns, such as the only one of JSON lines."""
    if not isinstance(value, dict) or not all(
        isinstance(each, (str, int, type(None))) and "+" not in str(each) for each in value.values()
    ):
        return None
    return _of_records(path, [value], [where or "the object"], columns) if value else None


def _records(path: Path, value: Any, where: str, columns: Sequence[str] | None) -> _Found | None:
    """A list of objects: an entity with its recipes, or a recipe with keys like columns."""
    if not isinstance(value, list) or not value or not all(isinstance(row, dict) for row in value):
        return None
    places = [f"{where}[{index}]" for index in range(len(value))]
    return _of_records(path, value, places, columns)


def _named_records(
    path: Path, value: Any, where: str, columns: Sequence[str] | None
) -> _Found | None:
    """An object of objects: entities, or recipes, by name."""
    if not isinstance(value, dict) or not value:
        return None
    if not all(isinstance(row, dict) for row in value.values()):
        return None
    places = [f"{where}['{key}']" for key in value]
    # Objects that have names of their own are under their ids.
    own = [row for row in value.values() if any(isinstance(row.get(key), str) for key in _TEXTS)]
    key_name = "id" if len(own) == len(value) else "name"
    records = [{key_name: key, **row} for key, row in value.items()]
    # Without such a key the inner keys are ingredients, see _nested.
    if not _recipe_keys(records) and not _has_columns(value):
        return None
    return _of_records(path, records, places, columns)


def _has_columns(value: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether every object has the same keys of ingredients, and a result or its own key as one."""
    rows = list(value.values())
    keys = list(dict.fromkeys(key for row in islice(rows, _LOOKED_AT) for key in row))
    keys = [key for key in keys if key not in value]
    roles = roles_of_header(keys)
    if roles is not None:
        used = [keys[i] for i in (*roles.ingredients, *roles.results[:1])]
        return all(set(used) <= row.keys() for row in rows)
    pair = pair_keys(rows[0])
    return (
        bool(pair) and all(pair_keys(row) == pair for row in rows) and value.keys().isdisjoint(pair)
    )


def _recipe_keys(records: Sequence[Mapping[str, Any]]) -> list[str]:
    keys = dict.fromkeys(key for row in islice(records, _LOOKED_AT) for key in row)
    named = [key for key in keys if _plain(key) in _RECIPE_KEYS]
    return [key for key in named if any(_is_recipes(row.get(key)) for row in records)]


def _plain(key: str) -> str:
    """Return the letters of a key in lower case, such as canbemadewith."""
    return "".join(char for char in key.lower() if char.isalnum())


def _is_recipes(value: Any) -> bool:
    """Whether a value may hold recipes: a list, an object, or a sum."""
    return isinstance(value, (list, dict)) or (isinstance(value, str) and "+" in value)


def _of_records(
    path: Path,
    records: Sequence[Mapping[str, Any]],
    places: Sequence[str],
    columns: Sequence[str] | None,
) -> _Found | None:
    keys = list(dict.fromkeys(key for row in islice(records, _LOOKED_AT) for key in row))
    recipe_keys = _recipe_keys(records)
    outputs = [key for key in keys if _plain(key) in _RESULT_KEYS]
    names = [key for key in _NAMES if any(_is_name(row.get(key)) for row in records)]
    if not recipe_keys and outputs:
        recipe_keys = _only_recipe_key(records, [key for key in keys if key not in outputs])
    if columns is None and recipe_keys and (outputs or names):
        return _entities(path, records, places, recipe_keys, outputs, names, keys)
    roles = (
        roles_of_option(columns, keys, len(keys)) if columns is not None else roles_of_header(keys)
    )
    if roles is None:
        return None
    parts = [keys[i] for i in roles.ingredients]
    made = [keys[i] for i in roles.results]
    if len(parts) == 1:
        _refuse_joined(path, [row.get(parts[0]) for row in records])

    def raws() -> Iterator[_Raw | Fault]:
        for row, place in zip(records, places, strict=True):
            ingredients = [row[key] for key in parts if row.get(key) not in (None, "")]
            results = [each for key in made for each in _results_of(row.get(key), True)]
            dropped = sum(row.get(keys[i]) not in (None, "", 1, "1") for i in roles.counts)
            if not ingredients or not results:
                message = (
                    f"{place} is {shown(row)}; expected {', '.join(parts)} and {', '.join(made)}."
                )
                yield Fault(place, "row", message, "keys")
            flat = list(
                chain.from_iterable(
                    each if isinstance(each, list) else [each] for each in ingredients
                )
            )
            for result in results if flat else ():
                yield _Raw(place, row, flat, result, counts=dropped)

    ignored = tuple(key for key in keys if key not in (*parts, *made))
    return _Found("a list of objects", raws(), columns=(*parts, *made), ignored=ignored)


def _only_recipe_key(records: Sequence[Mapping[str, Any]], keys: Sequence[str]) -> list[str]:
    """Return the only key whose values are all lists of labels or sums, whatever its name."""
    fitting = [key for key in keys if all(_is_listed(row.get(key)) for row in records)]
    return fitting if len(fitting) == 1 else []


def _is_listed(value: Any) -> bool:
    """Whether a value is a list of labels or a sum."""
    if isinstance(value, list):
        return len(value) > 1 and all(isinstance(each, (str, int)) for each in value)
    return _is_sum(value)


def _entities(
    path: Path,
    records: Sequence[Mapping[str, Any]],
    places: Sequence[str],
    recipe_keys: Sequence[str],
    outputs: Sequence[str],
    name_keys: Sequence[str],
    keys: Sequence[str],
) -> _Found:
    """Objects with a key for recipes or ingredients, and one for the results or the name."""
    _refuse_joined(path, [row.get(key) for row in records for key in recipe_keys])
    made = _made_key(path, records, recipe_keys, outputs, name_keys)
    raws: list[_Raw | Fault | LeftOut] = []
    listed = []
    for row, place in zip(records, places, strict=True):
        results = _results_of(row.get(made), bool(outputs))
        if not results and outputs and name_keys:
            # Some tools leave out the product of a recipe that is called like it.
            results = _results_of(row.get(name_keys[0]), False)
        values = [row[key] for key in recipe_keys if row.get(key)]
        recipes = [pair for value in values for pair in _pairs(value)]
        if not results:
            message = f"{place} is {shown(row)}; {made!r} names no result."
            raws.append(Fault(place, "row", message, "result"))
        elif not all(map(_pairs, values)):
            message = f"{place} is {shown(row)}; expected pairs of ingredients."
            raws.append(Fault(place, "row", message, "pairs"))
        elif not recipes:
            raws.append(LeftOut(place, "without a recipe"))
            listed += results if not outputs else []
        raws += [
            _Raw(f"{place}.{recipe_keys[0]}", pair, pair, result)
            for pair in recipes
            for result in results
        ]
    ignored = tuple(key for key in keys if key not in (*recipe_keys, made))
    found = _Found("a list of objects", raws, listed, columns=(*recipe_keys, made), ignored=ignored)
    return _resolved(path, found, _names_of_ids(path, ((row.get("id"), row) for row in records)))


def _made_key(
    path: Path,
    records: Sequence[Mapping[str, Any]],
    recipe_keys: Sequence[str],
    outputs: Sequence[str],
    name_keys: Sequence[str],
) -> str:
    """Return the key of results: that of outputs, or of names if there is none.

    Raises:
        RecipeFileError: if both name entities, so that a recipe could make either.
    """
    if not outputs:
        return name_keys[0]
    if not name_keys:
        return outputs[0]
    name, output = name_keys[0], outputs[0]
    pairs = [pair for row in records for key in recipe_keys for pair in _pairs(row.get(key))]
    used = {part for pair in pairs for part in map(_own_name, pair) if _is_name(part)}
    alike = 0
    other: list[Mapping[str, Any]] = []
    for row in records:
        results = list(map(_own_name, _results_of(row.get(output), True)))
        if row.get(name) in results:
            alike += 1
        elif results and _is_name(row.get(name)) and row[name] in used:
            other.append(row)
    if len(other) > alike:
        row = other[0]
        seen = f"{name!r} {shown(row[name])} and {output!r} {shown(row[output])} both name things"
        raise refusal(path, f"{seen}; either may be what is made", "json")
    return output


def _refuse_joined(path: Path, values: Sequence[Any]) -> None:
    """Refuse texts that all hold a sign such as a comma: they may be labels or pairs."""
    filled = [value for value in values if value]
    sign = common_sign(filled)
    if sign:
        text = filled[0][0] if isinstance(filled[0], list) else filled[0]
        parts = " + ".join(part.strip() for part in text.split(sign))
        raise refusal(
            path,
            f"every ingredient holds {sign!r}: {text[:60]!r} may be one label, or {parts[:60]}",
            "json",
            'Write pairs as lists, such as ["water", "earth"].',
        )


def _result_map(path: Path, value: Any, where: str, columns: Sequence[str] | None) -> _Found | None:
    """An object of recipes by result: pairs, a pair, a sum, or null for a base entity."""
    if not isinstance(value, dict) or not value:
        return None
    values = list(value.values())
    if not all(each is None or isinstance(each, (list, str)) for each in values):
        return None
    filled = [each for each in values if each]
    if any(isinstance(each, str) and not _is_sum(each) for each in filled):
        return None
    _refuse_about(path, value)
    if len(filled) > 1 and all(map(_is_long, filled)) and len(set(map(len, filled))) == 1:
        seen = f"lists of {len(filled[0]):,} labels under {', '.join(map(repr, list(value)[:6]))}"
        remedy = "If they are columns, name them with `columns`."
        raise refusal(path, f"{seen}; they may be columns, or ingredients", "json", remedy)
    _refuse_joined(path, filled)
    _refuse_partners(path, value)
    listed = [key for key, each in value.items() if not each]
    return _Found("recipes by result", _of_results(value.items(), where), listed)


def _is_long(value: Any) -> bool:
    return isinstance(value, list) and len(value) >= _LONG and all(map(_is_name, value))


def _refuse_about(path: Path, value: Mapping[str, Any]) -> None:
    """Refuse a key such as base that says something about the book, next to results."""
    for key, each in value.items():
        rows = each if isinstance(each, list) else []
        is_flat = rows and not any(isinstance(row, list) or _is_sum(row) for row in rows)
        if key in _ABOUT and is_flat:
            seen = f"{key!r} may be a result, or a list for the whole book"
            remedy = 'Write {"entities": [...], "base": [...], "recipes": [[a, b, result]]}.'
            raise refusal(path, seen, "json", remedy)


def _refuse_partners(path: Path, value: Mapping[str, Any]) -> None:
    """Refuse pairs that rather are partners with results, judged like a table without a header."""
    rows = [
        [key, *pair]
        for key, each in islice(value.items(), _LOOKED_AT)
        for pair in _pairs(each)
        if len(pair) == 2 and all(isinstance(part, str) for part in pair)
    ]
    if result_by_rows(rows) in (1, 2):
        key, one, other = rows[0]
        seen = f"{key[:40]!r} with {one[:40]!r} and {other[:40]!r}: the key may be an ingredient"
        raise refusal(path, f"{seen} ({key} + {one} = {other}) or the result", "json")


def _of_results(items: Iterable[tuple[str, Any]], where: str) -> Iterator[_Raw | Fault | LeftOut]:
    for result, value in items:
        place = f"{where}['{result}']"
        pairs = _pairs(value)
        if not pairs:
            yield (
                LeftOut(place, "without a recipe")
                if not value
                else Fault(
                    place,
                    "row",
                    f"{place} is {shown(value)}; expected pairs of ingredients.",
                    "pairs",
                )
            )
        for index, pair in enumerate(pairs):
            yield _Raw(f"{place}[{index}]", pair, pair, result)


def _amounts(path: Path, value: Any, where: str, columns: Sequence[str] | None) -> _Found | None:
    """An object of numbers of ingredients by result: ``{"torch": {"stick": 1, "coal": 1}}``."""
    if not isinstance(value, dict) or not value:
        return None
    rows = list(value.values())
    if not all(isinstance(row, dict) and row for row in rows):
        return None
    if not all(type(number) is int and number > 0 for row in rows for number in row.values()):
        return None
    if property_keys(rows, value.keys()):
        return None
    return _Found("numbers of ingredients by result", _of_results(value.items(), where))


def _nested(path: Path, value: Any, where: str, columns: Sequence[str] | None) -> _Found | None:
    """An object ``{a: {b: result}}``, with several results as a list, and null for none."""
    if not isinstance(value, dict) or not value:
        return None
    inner = [each or {} for each in value.values() if each is None or isinstance(each, dict)]
    if len(inner) < len(value):
        return None
    leaves = list(chain.from_iterable(each.values() for each in inner))
    # Objects with values of other kinds are another shape, unless they hold properties.
    is_nested = any(leaves) and all(_made(leaf) is not None for leaf in leaves)
    made = {leaf for leaf in leaves if isinstance(leaf, str)} if is_nested else set()
    _refuse_properties(path, value, property_keys(inner, made | value.keys()))
    if not is_nested:
        return None

    def raws() -> Iterator[_Raw | Fault | LeftOut]:
        for one, partners in value.items():
            for other, made in (partners or {}).items():
                place = f"{where}['{one}']['{other}']"
                results = _made(made)
                if not results:
                    yield LeftOut(place, "without a result")
                for result in results or ():
                    yield _Raw(place, [one, other, result], [one, other], result)

    return _Found("results by two keys", raws())


def _refuse_properties(
    path: Path,
    value: Mapping[str, Any],
    keys: Sequence[str],
) -> None:
    """Refuse objects with keys that may be properties of things."""
    if keys:
        one = next(key for key, each in value.items() if each and keys[0] in each)
        made = shown(value[one][keys[0]])
        seen = (
            f"objects with the keys {', '.join(repr(key[:40]) for key in keys[:6])}, which may be "
            f"properties ({one[:40]!r} has {keys[0][:40]!r} {made}) or ingredients ({one[:40]} + "
            f"{keys[0][:40]} = {made})"
        )
        raise refusal(path, f"{seen}; recipes in a known shape are missing", "json")


def _key_sums(path: Path, value: Any, where: str, columns: Sequence[str] | None) -> _Found | None:
    """An object of results by a key such as ``"water+earth"``."""
    if not isinstance(value, dict) or not value:
        return None
    results = [_made(each) for each in value.values()]
    parts = _parts_of_keys(path, list(value))
    if parts is None or any(made is None for made in results):
        return None
    filled = [made for made in results if made]
    if filled and all(all(map(_is_sum, made)) for made in filled):
        key, made = next((key, made) for key, made in zip(value, results, strict=True) if made)
        seen = f"sums on either side: {key[:60]!r} may make {shown(made[0])}, or be made of it"
        raise refusal(path, seen, "json")
    # Labels with such signs are usual, and several labels may be the ingredients.
    is_label = any(sign in key for sign in ",&" for key in islice(value, 1))
    if is_label and filled and all(len(made) > 1 for made in filled):
        key = next(iter(value))
        seen = f"{key[:60]!r} may be made of {shown(value[key])}, or be a sum that makes them"
        raise refusal(path, seen, "json")

    def raws() -> Iterator[_Raw | LeftOut]:
        for key, labels, made in zip(value, parts, results, strict=True):
            place = f"{where}['{key}']"
            if not made:
                yield LeftOut(place, "without a result")
            for result in made or ():
                yield _Raw(place, key, labels, result)

    return _Found("results by a sum", raws())


def _parts_of_keys(path: Path, keys: Sequence[str]) -> list[list[str]] | None:
    """Return the ingredients in keys such as ``water+earth`` or ``["water", "earth"]``.

    Returns:
        None if not all keys hold two ingredients.

    Raises:
        RecipeFileError: if keys could be parted in two ways, or only some are lists.
    """
    if all(key[:1] in ("(", "[") and key[-1:] in (")", "]") for key in keys):
        lists = [listed_parts(key) for key in keys]
        read = [each for each in lists if each is not None]
        if len(read) < len(keys):
            key = keys[lists.index(None)]
            raise refusal(path, f"the key {key[:60]!r} is no list of labels", "json")
        return read
    joiners = [
        joiner
        for joiner in _KEY_JOINERS
        if all(
            len(key.split(joiner)) == 2 and all(map(str.strip, key.split(joiner))) for key in keys
        )
    ]
    # " + " holds "+": the longer one is meant.
    joiners = [joiner for joiner in joiners if joiner != "+" or " + " not in joiners]
    if len(joiners) > 1:
        seen = f"keys such as {keys[0][:60]!r} could be parted at {joiners[0]!r} or {joiners[1]!r}"
        raise refusal(path, seen, "json")
    return [[part.strip() for part in key.split(joiners[0])] for key in keys] if joiners else None


_ShapeOf = Callable[[Path, Any, str, Sequence[str] | None], _Found | None]
LAYOUTS: tuple[_ShapeOf, ...] = (_own, _official, _hif, _craft_items, _craft_elements, _split)
"""Layouts with keys of their own, which are tried first."""
SHAPES: tuple[_ShapeOf, ...] = (
    _columnar,
    _record,
    _rows_of_three,
    _records,
    _key_sums,
    _named_records,
    _amounts,
    _nested,
    _result_map,
)
"""Other readable shapes, in the order in which they are tried, also below a key such as data."""


# --- values --------------------------------------------------------------------------------------


def _pairs(value: Any) -> list[Sequence[Any]]:
    """Return the recipes that a value holds, each as a list of ingredients.

    A list of lists holds several recipes; a list of labels is one recipe, unless each is a sum; an
    object of numbers is one recipe with counts.
    """
    if isinstance(value, str):
        return [_summands(value)] if value.strip() else []
    if isinstance(value, dict):
        return _pairs_of_object(value)
    if not isinstance(value, list) or not value:
        return []
    if all(map(_is_sum, value)):
        return [_summands(each) for each in value]
    if all(isinstance(each, (str, int)) or _is_entity(each) for each in value):
        return [value]
    if all(map(_is_counted, value)):
        return [[{"name": label, "count": number} for label, number in value]]
    if all(isinstance(each, list) for each in value):
        return list(value)
    if all(isinstance(each, dict) for each in value):
        pairs = [_pairs(each) for each in value]
        # One object that is no recipe must not vanish among others.
        return list(chain.from_iterable(pairs)) if all(pairs) else []
    return []


def _is_counted(value: Any) -> bool:
    """Whether a value is a label with a number of pieces, such as ``["iron-plate", 2]``."""
    return (
        isinstance(value, list)
        and len(value) == 2
        and isinstance(value[0], str)
        and isinstance(value[1], (int, float))
        and not isinstance(value[1], bool)
        and 0 < value[1] < _MOST_PIECES
    )


def _made(value: Any) -> list[Any] | None:
    """Return the results that a value stands for; None if it stands for none.

    A result is a label, an object with a name, or an object with a key such as ``result``; a list
    holds several.
    """
    if isinstance(value, list):
        each_made = [_made(each) for each in value if not isinstance(each, list)]
        lists = [made for made in each_made if made is not None]
        return list(chain.from_iterable(lists)) if len(lists) == len(value) else None
    if isinstance(value, dict):
        outputs = [key for key in value if _plain(key) in _RESULT_KEYS]
        others = any(_plain(key) in _RECIPE_KEYS for key in value)
        if len(outputs) == 1 and not others and not pair_keys(value):
            return _made(value[outputs[0]])
        return [value] if _is_entity(value) else None
    if value in (None, "", False):
        return []
    return [value] if _is_name(value) else None


def _is_sum(value: Any) -> bool:
    return isinstance(value, str) and "+" in value.strip("+ ")


def _pairs_of_object(value: Mapping[str, Any]) -> list[Sequence[Any]]:
    """Return the recipes of an object: an entity, numbers by label, or keys like columns."""
    if any(_plain(key) in _RESULT_KEYS for key in value):
        return []  # a recipe of another thing
    keys = pair_keys(value)
    if keys:
        return [[value[key] for key in keys]]
    if _is_entity(value):
        return [[value]]
    if value and all(isinstance(each, (int, float)) for each in value.values()):
        return [[{"name": key, "count": number} for key, number in value.items()]]
    inner = [each for key, each in value.items() if _plain(key) in _RECIPE_KEYS]
    return [pair for each in inner for pair in _pairs(each)]


def _results_of(value: Any, is_output: bool) -> list[Any]:
    if isinstance(value, list) and is_output:
        if all(map(_is_counted, value)):
            return [{"name": label, "count": number} for label, number in value]
        return [each for each in value if each not in (None, "")]
    if is_output and isinstance(value, dict) and not _is_entity(value):
        return list(value)  # numbers by product
    return [] if value in (None, "", []) else [value]


def _summands(text: str) -> list[str]:
    return [part.strip() for part in text.split(" + " if " + " in text else "+")]


def _is_name(value: Any) -> bool:
    return (isinstance(value, str) and bool(value)) or (
        isinstance(value, int) and not isinstance(value, bool)
    )


def _own_name(value: Any) -> Any:
    if isinstance(value, dict):
        return next((value[key] for key in _NAMES if _is_name(value.get(key))), value)
    return value


def _is_entity(value: Any) -> bool:
    """Whether an object stands for an entity: it has a name, and holds no recipe."""
    if not isinstance(value, dict):
        return False
    has_recipe = any(_plain(key) in _RECIPE_KEYS for key in value)
    return (
        not has_recipe and not pair_keys(value) and any(_is_name(value.get(key)) for key in _NAMES)
    )


def _has_count(value: Any) -> bool:
    return isinstance(value, dict) and any(value.get(key, 1) != 1 for key in _COUNTS)


def _is_index_row(row: Any) -> bool:
    return isinstance(row, list) and len(row) >= 2 and all(type(each) is int for each in row)


def _seen(value: Any) -> str:
    """Describe a JSON value for a refusal."""
    if isinstance(value, dict):
        keys = ", ".join(repr(key[:40]) for key in islice(value, 6))
        return (
            f"a JSON object with {len(value):,} keys ({keys})" if value else "an empty JSON object"
        )
    if isinstance(value, list):
        if value and all(isinstance(each, dict) for each in value):
            keys = ", ".join(repr(key[:40]) for key in islice(value[0], 6))
            return f"a JSON list of {len(value):,} objects, the first with the keys {keys}"
        first = f", the first {shown(value[0])}" if value else ""
        return f"a JSON list of {len(value):,} values{first}"
    return f"a JSON value, {shown(value)}"
