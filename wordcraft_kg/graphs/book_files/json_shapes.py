"""JSON in the shapes that games, clones and tools write.

Each shape is a function from the parsed value to entries, tried in the order of :data:`SHAPES`. A
shape yields raw recipes; :class:`JsonRecipes` checks their labels. The shapes are in files by idea:
``json_layouts``, ``json_tables``, ``json_records`` and ``json_objects``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

from wordcraft_kg.base.errors import ConfigError, RecipeFileError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.graphs.book_files.guide import refusal
from wordcraft_kg.graphs.book_files.json_found import FoundShape, JsonPart, RawRecipe, ShapeOf
from wordcraft_kg.graphs.book_files.json_ids import names_beside, with_names
from wordcraft_kg.graphs.book_files.json_layouts import (
    hypergraph,
    official_layout,
    older_save,
    our_layout,
    save_or_dump,
)
from wordcraft_kg.graphs.book_files.json_objects import (
    amounts_by_result,
    recipes_by_result,
    results_by_sum,
    results_by_two_keys,
)
from wordcraft_kg.graphs.book_files.json_records import list_of_records, one_record, records_by_name
from wordcraft_kg.graphs.book_files.json_tables import (
    MOST_COLUMNS,
    columns_of_cells,
    rows_of_labels,
    split_table,
)
from wordcraft_kg.graphs.book_files.json_text import load_json
from wordcraft_kg.graphs.book_files.json_values import (
    ENTITY_LISTS,
    WRAPPERS,
    described,
    has_count,
    own_name,
)
from wordcraft_kg.graphs.book_files.rows import (
    FROM_NOTHING,
    NOTHING,
    WITH_NOTHING,
    Entry,
    Fault,
    LeftOut,
    RowSource,
    is_infinite_craft,
)
from wordcraft_kg.graphs.recipes import check_label, label_fault, shown

_MOST_GROUPS = 1_000  # parts of one shape, such as tiers or pages
_MAX_DEPTH = 3  # objects around the recipes


LAYOUTS: tuple[ShapeOf, ...] = (
    our_layout,
    official_layout,
    hypergraph,
    save_or_dump,
    older_save,
    split_table,
)
"""Layouts with keys of their own, which are tried first."""


SHAPES: tuple[ShapeOf, ...] = (
    columns_of_cells,
    one_record,
    rows_of_labels,
    list_of_records,
    results_by_sum,
    records_by_name,
    amounts_by_result,
    results_by_two_keys,
    recipes_by_result,
)
"""Other readable shapes, in the order in which they are tried, also below a key such as data."""
_GROUPED: tuple[ShapeOf, ...] = (
    list_of_records,
    results_by_sum,
    results_by_two_keys,
    recipes_by_result,
)
"""Shapes of a part of a book, such as a tier."""
_FEWEST_GROUPS = 1  # a list of pages may have one


class JsonRecipes(RowSource):
    """The recipes of a JSON file or of JSON lines."""

    def __init__(self, path: Path, text: str, columns: Sequence[str] | None = None):
        """Parse the text and find its shape.

        Args:
            path: the file, for errors.
            text: its text.
            columns: the option `columns`; None to guess.

        Raises:
            RecipeFileError: if it is not JSON or has no readable shape, with what was seen; or if
                what stands outside of recipes, such as the base, is no label.
            ConfigError: if the shape has no columns and ``columns`` is given, or names none.
        """
        super().__init__()
        self._path = path
        content, self._is_lines = load_json(path, text)
        found = _shape_of(path, content, columns)
        self._found = found
        if found.known is None and is_infinite_craft(text):
            found.nothing = True
        self.shape = f"{found.shape} (JSON lines)" if self._is_lines else found.shape
        self.columns = found.columns
        self.num_results = found.num_results
        self.is_exact = found.known is not None
        self.ignored = found.ignored
        self.counts_dropped = found.counts_dropped
        self._read_listed()

    def _read_listed(self) -> None:
        """Read what stands outside of recipes: the list of entities, and the base."""
        found = self._found
        is_ours = found.known is not None
        for index, value in enumerate(found.listed):
            label = self._label(value)
            if found.nothing and label == NOTHING:
                continue
            place = f"entities[{index}]"
            where = f"{self._path}: {place}" if is_ours else f"{self._path}"
            self.listed[check_label(label, where)] = place
        if found.base is None:
            return
        self.base = {}
        for index, label in enumerate(found.base):
            where = f"base[{index}]"
            fault = self._unknown(label, where)
            if fault:
                raise RecipeFileError(f"{self._path}: {fault}")
            self.base[label] = where

    def __iter__(self) -> Iterator[Entry]:
        """Yield recipes, invalid entries and rows left out, in file order."""
        before: RawRecipe | None = None
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
            before = raw
            is_counted = is_same
            if self._found.known is None:
                self.counts_dropped += has_count(raw.result)
                if not is_same:
                    self.counts_dropped += raw.counts + sum(map(has_count, raw.ingredients))
            yield self._entry(raw)

    def _entry(self, raw: RawRecipe) -> Entry:
        found = self._found
        values = (*raw.ingredients, raw.result)
        # The frequent case in our own layouts: known labels need no further look.
        if not raw.kind and self._are_known(values):
            return raw.where, values
        labels = [self._label(value) for value in values]
        if found.nothing and NOTHING in labels:
            is_result = labels[-1] == NOTHING
            return LeftOut(raw.where, WITH_NOTHING if is_result else FROM_NOTHING)
        for label in labels:
            fault = self._unknown(label, raw.where)
            if fault:
                return Fault(raw.where, "label", fault)
        if len(labels) < 2:
            message = f"{raw.where} is {shown(raw.shown)}; a recipe needs two ingredients."
            return Fault(raw.where, "row", message)
        conflict = self._note_kind(raw, labels) if raw.kind else None
        return conflict or (raw.where, labels)

    def _are_known(self, values: Sequence[Any]) -> bool:
        """Return whether values are labels of a recipe that the file's list of entities holds."""
        known = self._found.known
        if known is None or len(values) < 2:
            return False
        try:
            return known.issuperset(values)
        except TypeError:  # an object or a list, which is not hashable
            return False

    def _note_kind(self, raw: RawRecipe, labels: Sequence[str]) -> Fault | None:
        """Keep a recipe's kind, or return what is wrong with it."""
        fault = label_fault(raw.kind)
        if fault:
            return Fault(raw.where, "label", f"{raw.where}: {fault}")
        *ingredients, result = labels
        parts = tuple(sorted(ingredients))
        known = self.kind_of.setdefault((parts, result), raw.kind)
        if known == raw.kind:
            return None
        recipe = f"{' + '.join(ingredients)} -> {result}"
        kinds = f"the kind '{raw.kind}' here, and '{known}' above"
        return Fault(raw.where, "row", f"{raw.where}: {recipe} has {kinds}.")

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
        return label if is_ours else label.strip(" ")

    def _named(self, value: Any) -> Any:
        """Return the name of an object, an id or an index; other values as they are."""
        found = self._found
        value = own_name(value)
        is_number = isinstance(value, int) and not isinstance(value, bool)
        if isinstance(value, str):
            return found.names.get(value, value)
        if is_number and found.indices:
            return found.names.get(value, value)
        if is_number and found.known is None:
            return found.names.get(value, str(value))
        return value


def _shape_of(path: Path, content: Any, columns: Sequence[str] | None) -> FoundShape:
    """Return the shape of a file's value, or of the one value within it that holds recipes."""
    part = JsonPart(path, content, columns=columns)
    names: dict[Any, str] = {}
    for _ in range(_MAX_DEPTH):
        inner = _unwrapped(part.value)
        # A key such as "elements" around a list is no result of its own.
        is_wrapped = inner is not None and inner.lower() in WRAPPERS
        for shape in LAYOUTS if is_wrapped else (*LAYOUTS, *SHAPES):
            found = shape(part)
            if found is not None:
                return with_names(path, _with_columns(part, found), names)
        if inner is None:
            groups = _groups(part)
            if groups is not None:
                return with_names(path, _with_columns(part, groups), names)
            break
        names = names or names_beside(path, part.value, inner)
        part = part._replace(names=names)
        where = f"{part.where}.{inner}".lstrip(".")
        part = part._replace(value=part.value[inner], where=where)
    raise refusal(path, f"{described(content)}; recipes in a known shape are missing", "json")


def _groups(part: JsonPart) -> FoundShape | None:
    """Parts of one shape, by a key such as a tier, or in a list such as that of pages."""
    parts = _parts(part)
    if len(parts) < _FEWEST_GROUPS or len(parts) > _MOST_GROUPS:
        return None
    found: list[FoundShape] = []
    listed: list[Any] = []
    ignored: dict[str, None] = {}
    for each in parts:
        shape = next(filter(None, (shape(each) for shape in _GROUPED)), None)
        if shape is None or shape.names:
            return None
        found.append(shape)
        listed += shape.listed
        ignored |= dict.fromkeys(shape.ignored)
    first, *others = found
    for other in others:
        # Parts of other shapes are no groups: one of them may only look like recipes.
        if other.shape != first.shape or other.columns != first.columns:
            return None
    return replace(
        first,
        shape=f"{first.shape} in {len(found):,} groups",
        raws=chain.from_iterable(each.raws for each in found),
        listed=listed,
        ignored=tuple(ignored),
    )


def _parts(part: JsonPart) -> list[JsonPart]:
    """Return the groups in a value: lists or objects by key, or the only ones in a list's rows."""
    value = part.value
    parts = []
    if isinstance(value, dict):
        for key in _filled_keys(value):
            where = f"{part.where}['{key}']"
            parts.append(part._replace(value=value[key], where=where))
    elif isinstance(value, list):
        for index, row in enumerate(value):
            inner = _filled_keys(row)
            if len(inner) != 1:
                return []
            (key,) = inner
            where = f"{part.where}[{index}].{key}"
            parts.append(part._replace(value=row[key], where=where))
    return parts


def _with_columns(part: JsonPart, found: FoundShape) -> FoundShape:
    """Return a shape that took the option `columns`, or refuse the option."""
    if part.columns is not None and not found.columns:
        raise ConfigError(
            f"`columns` {','.join(part.columns)}: {part.path} is read as {found.shape}, which has "
            "no columns; leave `columns` out."
        )
    return found


def _filled_keys(value: Any) -> list[str]:
    """Return the keys of an object with lists and objects that are not empty."""
    if not isinstance(value, dict):
        return []
    return [key for key, each in value.items() if isinstance(each, (dict, list)) and each]


def _unwrapped(value: Any) -> str | None:
    """Return the key of the only list or object in an object that may hold the recipes."""
    if not isinstance(value, dict):
        return None
    inner = _filled_keys(value)
    # Among many keys, one such as book is a result like the others.
    if len(inner) > MOST_COLUMNS:
        return None
    named = [key for key in inner if key.lower() in WRAPPERS]
    # Elements may be listed next to their recipes.
    recipes = [key for key in named if key.lower() not in ENTITY_LISTS]
    for keys in (named, recipes, inner):
        if len(keys) == 1:
            return keys[0]
    return None
