"""JSON in the shapes that games, clones and tools write.

Each shape is a function from the parsed value to entries, tried in the order of :data:`SHAPES`. A
shape yields ``_Raw`` recipes; :class:`JsonRecipes` checks their labels.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.graphs.book_files.columns import (
    readings,
    repeated_cells,
    result_by_rows,
    roles_of_header,
    roles_of_option,
    words_of,
)
from wordcraft_kg.graphs.book_files.guide import refusal
from wordcraft_kg.graphs.book_files.rows import Entry, Fault, LeftOut, RowSource
from wordcraft_kg.graphs.hif import is_hif, recipes_of_hif
from wordcraft_kg.graphs.recipes import check_label, label_fault, shown

INFINITE_CRAFT_BASE = ("Earth", "Fire", "Water", "Wind")
NOTHING = "Nothing"
"""Infinite Craft's word for a pair without a result."""
_NAMES = ("text", "name", "item", "id", "label", "title", "tag", "element", "displayName")
"""Keys of an object that stands for an entity, the usual ones first."""
_COUNTS = ("count", "amount", "quantity", "qty", "number")
_RECIPE_KEYS = words_of(
    "recipe recipes combinations combination combos canbemadewith madewith madefrom makeswith "
    "ingredients ingredient inputs input components component parents parent reagents "
    "reactants from craftedfrom crafting materials material requires parts pairs"
)
_RESULT_KEYS = words_of("result results output outputs product products")
_WRAPPERS = words_of(
    "recipes data items entities elements combinations results entries content payload book pairs"
)
_KEY_JOINERS = (" + ", "+", ";", "|", "&", ",")
_MAX_DEPTH = 3  # objects around the recipes
_FEW = 3  # objects by which a common key is told from an ingredient
_LOOKED_AT = 1_000  # entries by which a shape is judged


class _Raw(NamedTuple):
    """A recipe before its labels are checked.

    Attributes:
        where: place in the file.
        shown: the value, for errors.
        ingredients: values that stand for ingredients.
        result: value that stands for the result.
        kind: kind of reasoning, or empty.
    """

    where: str
    shown: Any
    ingredients: Sequence[Any]
    result: Any
    kind: Any = ""


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
        self.counts_dropped += sum(map(_has_count, raw.ingredients))
        if raw.kind:
            fault = label_fault(raw.kind)
            if fault:
                return Fault(raw.where, "label", f"{raw.where}: {fault}")
            self.kind_of[tuple(sorted(labels[:-1])), labels[-1]] = raw.kind
        return raw.where, labels

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
        lines = [line for line in text.splitlines() if line.strip()]
        is_lines = error.msg == "Extra data" and len(lines) > 1 and error.lineno > 1
        if is_lines and all(line.lstrip()[:1] in "{[" for line in lines[:_LOOKED_AT]):
            return [
                _loaded_line(path, number, line)
                for number, line in enumerate(text.splitlines(), 1)
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


def _loads(path: Path, text: str) -> Any:
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
    for _ in range(_MAX_DEPTH):
        inner = _unwrapped(value)
        # A key such as "elements" around a list is no result of its own.
        is_wrapped = inner is not None and inner.lower() in _WRAPPERS
        for shape in LAYOUTS if is_wrapped else (*LAYOUTS, *SHAPES):
            found = shape(path, value, where, columns)
            if found is not None:
                return found
        if inner is None:
            break
        value, where = value[inner], f"{where}.{inner}".lstrip(".")
    raise refusal(path, f"{_seen(content)}; recipes in a known shape are missing", "json")


def _unwrapped(value: Any) -> str | None:
    """Return the key of the only list or object in an object that may hold the recipes."""
    if not isinstance(value, dict):
        return None
    inner = [key for key, each in value.items() if isinstance(each, (dict, list)) and each]
    named = [key for key in inner if key.lower() in _WRAPPERS]
    chosen = named if len(named) == 1 else inner
    return chosen[0] if len(chosen) == 1 else None


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
    names = {item.get("id", i): item["text"] for i, item in enumerate(items)}

    def saved() -> Iterator[_Raw | Fault]:
        for i, item in enumerate(items):
            for j, pair in enumerate(item.get("recipes") or ()):
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
    width = len(value[0])
    if not all(isinstance(cell, (str, int)) for row in value for cell in row) or width < 2:
        return None
    rows = [[str(cell) for cell in row] for row in value]
    names, *others = rows
    header = roles_of_header(names)
    if header is not None and not repeated_cells(names, header, others):
        roles, start = header, 1
    elif columns is not None:
        roles, start = roles_of_option(columns, None, width), 0
    else:
        full = [row for row in rows if len(row) == 3]
        result = result_by_rows(full)
        if width != 3 or result is None:
            seen = f"a list of lists of {width} labels, and nothing tells which is the result"
            two = f": {readings(names)}" if width == 3 else ""
            raise refusal(
                path, seen + two, "json", "Choose with `columns`, numbers with the result last."
            )
        roles, start = roles_of_option([str(1 + (result + i) % 3) for i in (1, 2, 3)], None, 3), 0

    def raws() -> Iterator[_Raw | Fault]:
        for index, row in enumerate(rows[start:], start):
            here = f"{where}[{index}]"
            if len(row) != width:
                message = f"{here} has {len(row)} labels; the first row has {width}."
                yield Fault(here, "row", message, f"width {len(row)}")
                continue
            parts = [row[i] for i in roles.ingredients if row[i]]
            yield _Raw(here, row, parts, row[roles.results[0]])

    titles = tuple(
        names[i] if start else f"place {i + 1}" for i in (*roles.ingredients, *roles.results)
    )
    ignored = [names[i] if start else f"place {i + 1}" for i in range(width) if i not in roles.used]
    return _Found("a list of lists", raws(), columns=titles, ignored=tuple(ignored))


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
    records = [{"name": key, **row} for key, row in value.items()]
    keys = _recipe_keys(records)
    # Without such a key the inner keys are ingredients, see _nested.
    inner = {key for row in islice(value.values(), _LOOKED_AT) for key in row}
    by_column = roles_of_header(sorted(inner)) if inner and len(inner) < len(value) else None
    return _of_records(path, records, places, columns) if keys or by_column else None


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
    if columns is None and recipe_keys and (outputs or names):
        return _entities(records, places, recipe_keys, outputs, names, keys)
    roles = (
        roles_of_option(columns, keys, len(keys)) if columns is not None else roles_of_header(keys)
    )
    if roles is None:
        return None
    parts = [keys[i] for i in roles.ingredients]
    made = [keys[i] for i in roles.results]

    def raws() -> Iterator[_Raw | Fault]:
        for row, place in zip(records, places, strict=True):
            ingredients = [row[key] for key in parts if row.get(key) not in (None, "")]
            results = [row[key] for key in made if row.get(key) not in (None, "")]
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
                yield _Raw(place, row, flat, result)

    ignored = tuple(key for key in keys if key not in (*parts, *made))
    return _Found("a list of objects", raws(), columns=(*parts, *made), ignored=ignored)


def _entities(
    records: Sequence[Mapping[str, Any]],
    places: Sequence[str],
    recipe_keys: Sequence[str],
    outputs: Sequence[str],
    name_keys: Sequence[str],
    keys: Sequence[str],
) -> _Found:
    """Objects with a key for recipes or ingredients, and one for the results or the name."""
    made = outputs[:1] or name_keys[:1]
    raws: list[_Raw | Fault | LeftOut] = []
    listed = []
    for row, place in zip(records, places, strict=True):
        results = _results_of(row.get(made[0]), bool(outputs))
        recipes = [pair for key in recipe_keys for pair in _pairs(row.get(key))]
        if not results:
            raws.append(
                Fault(
                    place, "row", f"{place} is {shown(row)}; {made[0]!r} names no result.", "result"
                )
            )
        elif not recipes:
            raws.append(LeftOut(place, "without a recipe"))
            listed += results if not outputs else []
        raws += [
            _Raw(f"{place}.{recipe_keys[0]}", pair, pair, result)
            for pair in recipes
            for result in results
        ]
    names = _names_by_id(records, raws)
    ignored = tuple(key for key in keys if key not in (*recipe_keys, *made))
    return _Found(
        "a list of objects",
        raws,
        listed,
        columns=(*recipe_keys, *made),
        ignored=ignored,
        names=names,
    )


def _names_by_id(records: Sequence[Mapping[str, Any]], raws: Iterable[Any]) -> dict[Any, str]:
    """Return names by id if recipes name entities by id, otherwise an empty dictionary."""
    names = {
        row["id"]: row[key]
        for row in records
        for key in ("name", "text", "label", "title")
        if isinstance(row.get("id"), (str, int)) and isinstance(row.get(key), str)
    }
    parts = [part for raw in raws if isinstance(raw, _Raw) for part in raw.ingredients]
    used = {part for part in parts if isinstance(part, (str, int)) and not isinstance(part, bool)}
    known = set(names.values())
    return names if used and used <= names.keys() and not used <= known else {}


def _result_map(path: Path, value: Any, where: str, columns: Sequence[str] | None) -> _Found | None:
    """An object of recipes by result: pairs, a pair, a sum, or null for a base entity."""
    if not isinstance(value, dict) or not value:
        return None
    values = list(value.values())
    if not all(each is None or isinstance(each, (list, str)) for each in values):
        return None
    filled = [each for each in values if each]
    sums_in_keys = all(_parted_key(key, value) for key in value)
    is_sum = [isinstance(each, str) and "+" in each for each in filled]
    if any(isinstance(each, str) for each in filled) and not all(
        isinstance(each, list) or "+" in each for each in filled
    ):
        return None
    if sums_in_keys and (all(is_sum) or not all(map(_holds_pairs, filled))):
        return None
    listed = [key for key, each in value.items() if not each]
    return _Found("recipes by result", _of_results(value.items(), where), listed)


def _holds_pairs(value: Any) -> bool:
    return (
        isinstance(value, str)
        or any(isinstance(each, (list, dict)) for each in value)
        or len(value) > 1
    )


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
    # A key of all objects is a property of things, such as a price.
    if len(rows) >= _FEW and set(rows[0]).intersection(*rows):
        return None
    return _Found("numbers of ingredients by result", _of_results(value.items(), where))


def _nested(path: Path, value: Any, where: str, columns: Sequence[str] | None) -> _Found | None:
    """An object ``{a: {b: result}}``, with several results as a list, and null for none."""
    if not isinstance(value, dict) or not value:
        return None
    inner = list(value.values())
    if not all(each is None or isinstance(each, dict) for each in inner):
        return None
    leaves = list(chain.from_iterable((each or {}).values() for each in inner))
    if not leaves or not all(
        leaf is None or isinstance(leaf, (str, list)) or _is_entity(leaf) for leaf in leaves
    ):
        return None

    def raws() -> Iterator[_Raw | Fault | LeftOut]:
        for one, partners in value.items():
            for other, made in (partners or {}).items():
                place = f"{where}['{one}']['{other}']"
                results = made if isinstance(made, list) else [made]
                if not any(results):
                    yield LeftOut(place, "without a result")
                for result in results:
                    if result:
                        yield _Raw(place, [one, other, result], [one, other], result)

    return _Found("results by two keys", raws())


def _key_sums(path: Path, value: Any, where: str, columns: Sequence[str] | None) -> _Found | None:
    """An object of results by a key such as ``"water+earth"``."""
    if not isinstance(value, dict) or not value:
        return None
    if not all(
        each is None or isinstance(each, (str, list)) or _is_entity(each) for each in value.values()
    ):
        return None
    joiners = [
        joiner
        for joiner in _KEY_JOINERS
        if all(
            len(key.split(joiner)) == 2 and all(map(str.strip, key.split(joiner))) for key in value
        )
    ]
    # " + " holds "+": the longer one is meant.
    joiners = [joiner for joiner in joiners if joiner != "+" or " + " not in joiners]
    if len(joiners) > 1:
        key = next(iter(value))
        seen = f"keys such as {key[:60]!r} could be parted at {joiners[0]!r} or {joiners[1]!r}"
        raise refusal(path, seen, "json")
    if not joiners:
        return None
    (joiner,) = joiners

    def raws() -> Iterator[_Raw | LeftOut]:
        for key, made in value.items():
            place = f"{where}['{key}']"
            parts = [part.strip() for part in key.split(joiner)]
            results = made if isinstance(made, list) else [made]
            if not any(results):
                yield LeftOut(place, "without a result")
            for result in results:
                if result:
                    yield _Raw(place, key, parts, result)

    return _Found("results by a sum", raws())


def _parted_key(key: str, value: Any) -> bool:
    return any(len(key.split(joiner)) == 2 for joiner in _KEY_JOINERS)


_ShapeOf = Callable[[Path, Any, str, Sequence[str] | None], _Found | None]
LAYOUTS: tuple[_ShapeOf, ...] = (_own, _official, _hif, _craft_items, _craft_elements)
"""Layouts with keys of their own, which are tried first."""
SHAPES: tuple[_ShapeOf, ...] = (
    _rows_of_three,
    _records,
    _named_records,
    _amounts,
    _nested,
    _result_map,
    _key_sums,
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
    if all(isinstance(each, str) and "+" in each.strip("+ ") for each in value):
        return [_summands(each) for each in value]
    if all(isinstance(each, (str, int)) or _is_entity(each) for each in value):
        return [value]
    if all(isinstance(each, list) for each in value):
        return list(value)
    if all(isinstance(each, dict) for each in value):
        return [pair for each in value for pair in _pairs(each)]
    return []


def _pairs_of_object(value: Mapping[str, Any]) -> list[Sequence[Any]]:
    """Return the recipes of an object: an entity, numbers by label, or keys like columns."""
    if _is_entity(value):
        return [[value]]
    if value and all(isinstance(each, (int, float)) for each in value.values()):
        return [[{"name": key, "count": number} for key, number in value.items()]]
    inner = [each for key, each in value.items() if _plain(key) in _RECIPE_KEYS]
    if inner:
        return [pair for each in inner for pair in _pairs(each)]
    keys = [*value]
    roles = roles_of_header([*keys, "result"])
    if roles is not None and roles.results == (len(keys),):
        return [[value[keys[i]] for i in roles.ingredients]]
    return []


def _results_of(value: Any, is_output: bool) -> list[Any]:
    if isinstance(value, list) and is_output:
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
    return not has_recipe and any(_is_name(value.get(key)) for key in _NAMES)


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
