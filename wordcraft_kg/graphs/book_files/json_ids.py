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
    """
    ids: list[tuple[Any, Mapping[str, Any]]] = []
    for key, each in value.items():
        if key == inner or key.lower() not in _NAME_LISTS:
            continue
        if isinstance(each, dict):
            ids += [(i, _as_row(name)) for i, name in each.items()]
        elif isinstance(each, list) and all(isinstance(name, str) for name in each):
            # As a text, because keys of JSON are texts.
            ids += [(str(i), {"name": name}) for i, name in enumerate(each)]
        elif isinstance(each, list):
            ids += [(row.get("id"), row) for row in each if isinstance(row, dict)]
    return names_of_ids(path, ids)


def _as_row(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {"name": value}


def names_of_ids(path: Path, rows: Iterable[tuple[Any, Mapping[str, Any]]]) -> dict[Any, str]:
    """Return names by id, for digits also by their number.

    Raises:
        RecipeFileError: if two names have one id.
    """
    names: dict[Any, str] = {}
    for identifier, row in rows:
        texts = [row[key] for key in TEXT_KEYS if isinstance(row.get(key), str)]
        # True and false are integers to Python, but no ids.
        is_id = isinstance(identifier, (int, str)) and not isinstance(identifier, bool)
        if not texts or not is_id:
            continue
        name = texts[0]
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


def _is_digits(text: str) -> bool:
    # Longer numbers are no ids, and int() refuses thousands of digits.
    return text.isascii() and text.isdigit() and len(text) < 20


def with_names(path: Path, found: FoundShape, names: Mapping[Any, str]) -> FoundShape:
    """Return a shape with names for ids if recipes name entities by id.

    Args:
        path: the file, for errors.
        found: the shape.
        names: names by id; empty without any.

    Raises:
        RecipeFileError: if only some of the values are ids.
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
        raise refusal(path, f"recipes name elements by id, but none has the id {missing!r}", "json")
    if all(isinstance(each, int) for each in ids):
        # A label of digits, such as '7', is no id where ids are numbers.
        names = {key: name for key, name in names.items() if isinstance(key, int)}
    return replace(found, names=names)
