"""Names for ids, where JSON lists elements with ids and recipes name those."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.book_files.guide import refusal
from wordcraft_kg.graphs.book_files.json_found import FoundShape, RawRecipe
from wordcraft_kg.graphs.book_files.json_values import ENTITY_LISTS, TEXT_KEYS, is_name

_NAME_LISTS = ENTITY_LISTS | frozenset({"names", "labels", "words"})
"""Keys of things, or of their names, next to recipes."""


def names_beside(path: Path, value: Mapping[str, Any], inner: str) -> dict[Any, str]:
    """Return the names by id of elements that stand next to the recipes.

    Elements are objects with ids, names by id, or names whose index is the id.

    Args:
        path: the file, for errors.
        value: the object around elements and recipes.
        inner: the key of the recipes.

    Returns:
        Names by id, see :func:`names_of_ids`; empty if no element stands there.

    Raises:
        RecipeFileError: if two names have one id.
    """
    rows: list[tuple[Any, Mapping[str, Any]]] = []
    for key, elements in value.items():
        if key != inner and key.lower() in _NAME_LISTS:
            rows += _rows_with_ids(elements)
    return names_of_ids(path, rows)


def _rows_with_ids(elements: Any) -> list[tuple[Any, Mapping[str, Any]]]:
    """Return ids, perhaps None, with objects that hold the names; none for another value."""
    if isinstance(elements, dict):
        return [(identifier, _as_row(name)) for identifier, name in elements.items()]
    if not isinstance(elements, list):
        return []
    if all(isinstance(name, str) for name in elements):
        # The index as a text, because keys of JSON are texts.
        return [(str(index), {"name": name}) for index, name in enumerate(elements)]
    objects = [row for row in elements if isinstance(row, dict)]
    return [(row.get("id"), row) for row in objects]


def _as_row(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {"name": value}


def names_of_ids(path: Path, rows: Iterable[tuple[Any, Mapping[str, Any]]]) -> dict[Any, str]:
    """Return names by id, for digits also by their number.

    Args:
        path: the file, for errors.
        rows: ids with objects that hold a name. Rows without a name, or with an id that is neither
            a number nor a text, are passed over.

    Returns:
        Names by id; the id ``"7"`` gives the keys ``"7"`` and ``7``.

    Raises:
        RecipeFileError: if two names have one id.
    """
    names: dict[Any, str] = {}
    for identifier, row in rows:
        name = _first_text(row)
        # True and false are integers to Python, but no ids.
        is_id = isinstance(identifier, (int, str)) and not isinstance(identifier, bool)
        if name is None or not is_id:
            continue
        keys: list[int | str] = [identifier]
        if isinstance(identifier, str) and _is_digits(identifier):
            # Keys of JSON are texts, even where recipes name the same elements by numbers.
            keys.append(int(identifier))
        for key in keys:
            known = names.setdefault(key, name)
            if known != name:
                both = f"{known[:60]!r} and {name[:60]!r}"
                shown = str(identifier)[:60]
                raise RecipeFileError(f"{path}: the id {shown} belongs to {both}.")
    return names


def _first_text(row: Mapping[str, Any]) -> str | None:
    """Return an object's name that is a text, the usual key first; None without one."""
    for key in TEXT_KEYS:
        name = row.get(key)
        if isinstance(name, str):
            return name
    return None


def _is_digits(text: str) -> bool:
    # Longer numbers are no ids, and int() refuses thousands of digits.
    return text.isascii() and text.isdigit() and len(text) < 20


def with_names(path: Path, found: FoundShape, names: Mapping[Any, str]) -> FoundShape:
    """Return a shape with names for ids if recipes name entities by id.

    Args:
        path: the file, for errors.
        found: the shape; its recipes are read here, so that all of them can be judged first.
        names: names by id; empty without any.

    Returns:
        The shape with ``names``; the given one if it has names, if ``names`` is empty, or if no
        recipe names an entity by id.

    Raises:
        RecipeFileError: if recipes name entities by id, and an ingredient is neither an id nor a
            name.
    """
    if not names or found.names:
        return found
    raws = list(found.raws)
    found = replace(found, raws=raws)
    used: set[Any] = set()
    results: set[Any] = set()
    for raw in raws:
        if isinstance(raw, RawRecipe):
            used.update(filter(is_name, raw.ingredients))
            if is_name(raw.result):
                results.add(raw.result)
    strange = (used | results).difference(names.values())
    ids = strange.intersection(names)
    if not ids:
        return found
    # A result that is no id may be the name of the object around it; an ingredient may not.
    unknown = (strange - ids) & used
    if unknown:
        others = map(str, strange - ids)
        missing = min(others)[:60]
        seen = f"recipes name elements by id, but none has the id {missing!r}"
        raise refusal(path, seen, "json")
    if all(isinstance(each, int) for each in ids):
        # A label of digits, such as '7', is no id where ids are numbers.
        names = {key: name for key, name in names.items() if isinstance(key, int)}
    return replace(found, names=names)
