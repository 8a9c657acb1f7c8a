"""Names for ids, where JSON lists elements with ids and recipes name those."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.book_files.guide import refusal
from wordcraft_kg.graphs.book_files.json_found import FoundShape, RawRecipe
from wordcraft_kg.graphs.book_files.json_values import ENTITY_LISTS, TEXT_KEYS, is_name


def names_beside(path: Path, value: Mapping[str, Any], inner: str) -> dict[Any, str]:
    """Return the names by id of elements that are listed next to the recipes."""
    lists = [each for key, each in value.items() if key != inner and key.lower() in ENTITY_LISTS]
    objects = [each for each in lists if isinstance(each, list)]
    rows = [row for row in chain.from_iterable(objects) if isinstance(row, dict)]
    return names_of_ids(path, ((row.get("id"), row) for row in rows))


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
