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
        name = next((row[key] for key in TEXT_KEYS if isinstance(row.get(key), str)), None)
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


def with_names(path: Path, found: FoundShape, names: Mapping[Any, str]) -> FoundShape:
    """Return a shape with names for ids if recipes name entities by id.

    Raises:
        RecipeFileError: if only some of the values are ids.
    """
    if not names or found.names:
        return found
    raws = list(found.raws)
    rows = [raw for raw in raws if isinstance(raw, RawRecipe)]
    used = {part for raw in rows for part in raw.ingredients if is_name(part)}
    results = {raw.result for raw in rows if is_name(raw.result)}
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
