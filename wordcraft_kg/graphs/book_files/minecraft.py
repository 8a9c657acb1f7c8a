"""Folders of Minecraft recipes, as data packs and mods have them: a JSON file for each recipe.

A pattern becomes the set of its ingredients; where one of several items may be used, each choice is
a recipe. A tag, such as ``#minecraft:planks``, is an entity of its own.
"""

import json
from collections.abc import Iterable, Iterator
from itertools import islice, product
from pathlib import Path, PurePosixPath
from typing import Any

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.book_files.rows import Entry, Fault, LeftOut, RowSource
from wordcraft_kg.graphs.recipes import label_fault, shown

_FOLDERS = frozenset({"recipe", "recipes"})
_MAX_FILES = 100_000
_MAX_FILE = 2**20  # bytes of one recipe
_MAX_CHOICES = 64
"""Recipes that one file may stand for, where each ingredient may be one of several items."""
_ENTITY_KEYS = ("item", "id", "tag", "fluid")


class MinecraftRecipes(RowSource):
    """The recipes of a data pack's folder or archive."""

    shape = "Minecraft recipes"

    def __init__(self, files: Iterable[tuple[str, bytes]]):
        """Take names and bytes of JSON files, in the order of their names."""
        super().__init__()
        self._files = files

    def __iter__(self) -> Iterator[Entry]:
        """Yield recipes, invalid files, and files of other kinds of recipes."""
        for name, data in self._files:
            if is_recipe_file(name):
                yield from self._recipes(name, data)

    def _recipes(self, name: str, data: bytes) -> Iterator[Entry]:
        try:
            value = json.loads(data.decode("utf-8-sig"))
        except (ValueError, RecursionError) as error:
            yield Fault(name, "row", f"{name}: not JSON ({type(error).__name__}).", "not JSON")
            return
        if not isinstance(value, dict):
            yield Fault(
                name, "row", f"{name} is {shown(value)}; expected an object.", "not an object"
            )
            return
        slots = _slots(value)
        result, count = _result(value)
        if not slots or result is None:
            yield LeftOut(name, "without ingredients or result")
            return
        choices = list(islice(product(*slots), _MAX_CHOICES + 1))
        if len(choices) > _MAX_CHOICES:
            message = f"{name}: more than {_MAX_CHOICES} choices of ingredients."
            yield Fault(name, "row", message, "choices")
            return
        self.counts_dropped += count != 1
        for ingredients in choices:
            labels = [*ingredients, result]
            fault = next(filter(None, map(label_fault, labels)), None)
            yield Fault(name, "label", f"{name}: {fault}") if fault else (name, labels)


def is_recipe_file(name: str) -> bool:
    """Return whether a path is that of a recipe in a data pack: a JSON file below ``recipe(s)``."""
    path = PurePosixPath(name)
    return path.suffix.lower() == ".json" and not _FOLDERS.isdisjoint(path.parts[:-1])


def folder_files(folder: Path) -> list[Path]:
    """Return the recipe files below a folder, sorted; links are not followed."""
    found: list[Path] = []
    inside = folder.name in _FOLDERS
    pending = [folder]
    while pending:
        current = pending.pop()
        try:
            children = sorted(current.iterdir())
        except OSError:
            continue
        for child in children:
            if child.is_symlink() or child.name.startswith("."):
                continue
            if child.is_dir():
                pending.append(child)
            elif not child.is_file():
                continue  # a pipe would be waited for without end
            elif inside or is_recipe_file(child.relative_to(folder).as_posix()):
                found += [child] if child.suffix.lower() == ".json" else []
            if len(found) > _MAX_FILES:
                raise RecipeFileError(f"{folder}: more than {_MAX_FILES:,} recipe files.")
    return sorted(found)


def read_folder(folder: Path, files: Iterable[Path]) -> Iterator[tuple[str, bytes]]:
    """Yield names below ``recipes`` and bytes of recipe files."""
    for path in files:
        name = path.relative_to(folder).as_posix()
        try:
            if path.stat().st_size > _MAX_FILE:
                raise RecipeFileError(f"{path}: more than {_MAX_FILE:,} bytes for one recipe.")
            data = path.read_bytes()
        except OSError as error:
            raise RecipeFileError(f"{path} cannot be read: {error.strerror}.") from None
        yield (name if is_recipe_file(name) else f"recipes/{name}"), data


def _slots(value: dict[str, Any]) -> list[list[str]]:
    """Return the choices for each ingredient of a recipe, without repetition; empty if unknown."""
    if isinstance(value.get("key"), dict) and isinstance(value.get("pattern"), list):
        used = set("".join(row for row in value["pattern"] if isinstance(row, str)))
        parts = [each for sign, each in value["key"].items() if sign in used]
    elif isinstance(value.get("ingredients"), list):
        parts = value["ingredients"]
    elif "base" in value and "addition" in value:
        parts = [value[key] for key in ("template", "base", "addition") if value.get(key)]
    elif "ingredient" in value:
        parts = [value["ingredient"]]
    else:
        return []
    slots = [_choices(part) for part in parts]
    distinct = [list(each) for each in dict.fromkeys(tuple(slot) for slot in slots)]
    # A pair of equal things stays a pair; larger amounts are no part of a set.
    if len(slots) == 2 and len(distinct) == 1:
        return [distinct[0], distinct[0]] if len(distinct[0]) == 1 else distinct
    return distinct if all(distinct) else []


def _choices(part: Any) -> list[str]:
    if isinstance(part, list):
        return list(dict.fromkeys(label for each in part for label in _choices(each)))
    if isinstance(part, str):
        return [part] if part else []
    if isinstance(part, dict):
        for key in _ENTITY_KEYS:
            if isinstance(part.get(key), str) and part[key]:
                return [f"#{part[key]}" if key == "tag" else part[key]]
    return []


def _result(value: dict[str, Any]) -> tuple[str | None, Any]:
    """Return the label of a recipe's result and the number of pieces."""
    result = value.get("result", value.get("output"))
    if isinstance(result, list) and len(result) == 1:
        (result,) = result
    if isinstance(result, str) and result:
        return result, value.get("count", 1)
    if isinstance(result, dict):
        name = next((result[key] for key in _ENTITY_KEYS if isinstance(result.get(key), str)), None)
        return name, result.get("count", 1)
    return None, 1
