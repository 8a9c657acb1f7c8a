"""Folders of Minecraft recipes, as data packs and mods have them: a JSON file for each recipe.

A pattern becomes the set of its ingredients, of two pieces a pair; where one of several items may
be used, each choice is a recipe. A tag, such as ``#minecraft:planks``, is an entity of its own.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, combinations_with_replacement, islice, product
from pathlib import Path, PurePosixPath
from typing import Any

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.book_files.json_text import parsed_json
from wordcraft_kg.graphs.book_files.rows import Entry, Fault, LeftOut, RowSource
from wordcraft_kg.graphs.recipes import label_fault, shown

_FOLDERS = frozenset({"recipe", "recipes"})
_MAX_FILES = 100_000
_MAX_FILE = 2**20  # bytes of one recipe
_MAX_CHOICES = 64
"""Recipes that one file may stand for, where each ingredient may be one of several items."""
_ENTITY_KEYS = ("item", "id", "tag", "fluid")
_COUNT_KEYS = ("count", "amount")
_RESULT_KEYS = ("result", "output", "results", "outputs")
_PARTS = frozenset({"type", "pattern", "ingredients", "ingredient", *_RESULT_KEYS})
"""Keys of which a recipe has at least one."""
_DAMAGED = "with a damaged pattern"


class MinecraftRecipes(RowSource):
    """The recipes of a data pack's folder or archive."""

    shape = "Minecraft recipes"

    def __init__(self, files: Iterable[tuple[str, bytes]]):
        """Take the files; they are parsed while iterating.

        Args:
            files: names and bytes of JSON files, in the order of their names.
        """
        super().__init__()
        self._files = files
        self.is_exact = True

    def __iter__(self) -> Iterator[Entry]:
        """Yield recipes, invalid files, and files of other kinds of recipes.

        Raises:
            RecipeFileError: if the iterable of files raises it, as :func:`json_members` does for a
                damaged archive. What is wrong with a single recipe is a fault instead.
        """
        for name, data in self._files:
            if is_recipe_file(name):
                yield from self._recipes(name, data)

    def _recipes(self, name: str, data: bytes) -> Iterator[Entry]:
        value = _parsed(name, data)
        if isinstance(value, Fault):
            yield value
            return
        parts = _parts(value)
        results = _results(value)
        reason = _why_left_out(parts, results)
        if reason:
            yield LeftOut(name, reason)
            return
        slots = [_choices(part) for part in parts]
        # One more than allowed tells that there are too many, and no product is made in full.
        choices = list(islice(_recipes_of(slots), _MAX_CHOICES + 1))
        if len(choices) > _MAX_CHOICES:
            message = f"{name}: more than {_MAX_CHOICES} choices of ingredients."
            yield Fault(name, "row", message, "choices")
            return
        self.counts_dropped += _number_of_counts(value, parts, results[0])
        for ingredients in choices:
            labels = [*ingredients, *_choices(results[0])]
            faults = filter(None, map(label_fault, labels))
            first_fault = next(faults, None)
            if first_fault is None:
                yield name, labels
            else:
                yield Fault(name, "label", f"{name}: {first_fault}")


def _parsed(name: str, data: bytes) -> dict[str, Any] | Fault:
    """Return the object in a file, or the file's fault."""
    try:
        # Some editors write a byte order mark, which the game reads over.
        value = parsed_json(name, data.decode("utf-8-sig"))
    except RecipeFileError as error:
        return Fault(name, "row", str(error), "not JSON")
    except ValueError as error:
        return Fault(name, "row", f"{name}: not JSON ({type(error).__name__}).", "not JSON")
    if not isinstance(value, dict):
        message = f"{name} is {shown(value)}; expected an object."
        return Fault(name, "row", message, "not an object")
    return value


def looks_like_recipe(name: str, data: bytes) -> bool:
    """Return whether a JSON file may be a recipe of Minecraft, rather than a recipe book.

    Args:
        name: its name, for errors.
        data: its bytes; what is not JSON may have been a recipe.
    """
    try:
        value = parsed_json(name, data.decode("utf-8-sig"))
    except (RecipeFileError, ValueError):
        return True
    return isinstance(value, dict) and not _PARTS.isdisjoint(value)


def is_recipe_file(name: str) -> bool:
    """Return whether a path is that of a recipe in a data pack: a JSON file below ``recipe(s)``."""
    path = PurePosixPath(name)
    return path.suffix.lower() == ".json" and not _FOLDERS.isdisjoint(path.parts[:-1])


def folder_files(folder: Path) -> list[Path]:
    """Return the recipe files below a folder, sorted; links are not followed.

    Args:
        folder: the folder. If it is called recipe or recipes, each JSON file below it is a recipe.

    Returns:
        The files; empty if there are none. Folders that cannot be listed are passed over.

    Raises:
        RecipeFileError: if there are too many, as below a folder that was meant to be another.
    """
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
                continue
            if not child.is_file():
                continue  # a pipe would be waited for without end
            name = child.relative_to(folder).as_posix()
            # Below a folder called recipes each JSON file is a recipe.
            is_json = child.suffix.lower() == ".json"
            if is_json and (inside or is_recipe_file(name)):
                found.append(child)
            if len(found) > _MAX_FILES:
                raise RecipeFileError(f"{folder}: more than {_MAX_FILES:,} recipe files.")
    return sorted(found)


def read_folder(folder: Path, files: Iterable[Path]) -> Iterator[tuple[str, bytes]]:
    """Yield names below ``recipes`` and bytes of recipe files.

    Args:
        folder: the folder, to which names are relative.
        files: the files, from :func:`folder_files`.

    Yields:
        Name and bytes of each file, in the given order.

    Raises:
        RecipeFileError: if a file cannot be read, or is too large for one recipe.
    """
    for path in files:
        name = path.relative_to(folder).as_posix()
        try:
            if path.stat().st_size > _MAX_FILE:
                raise RecipeFileError(f"{path}: more than {_MAX_FILE:,} bytes for one recipe.")
            data = path.read_bytes()
        except OSError as error:
            raise RecipeFileError(f"{path} cannot be read: {error.strerror}.") from None
        yield (name if is_recipe_file(name) else f"recipes/{name}"), data


def _why_left_out(parts: Sequence[Any], results: Sequence[Any]) -> str:
    """Return why a recipe is left out, or an empty text."""
    if _DAMAGED in parts:
        return _DAMAGED
    if not parts or not results:
        return "without ingredients or result"
    if len(results) > 1:
        return "with several results"
    if not all(map(_choices, parts)):
        return "with an ingredient of an unknown kind"
    if len(_choices(results[0])) != 1:
        return "without ingredients or result"
    return ""


def _parts(value: dict[str, Any]) -> list[Any]:
    """Return a recipe's ingredients as they are, one for each piece; empty if there are none."""
    # Crafting with a shape: signs in a pattern, and what each sign stands for.
    key = value.get("key")
    pattern = value.get("pattern")
    if isinstance(key, dict) and isinstance(pattern, list):
        return _cells(key, pattern)
    # Crafting without a shape.
    ingredients = value.get("ingredients")
    if isinstance(ingredients, list):
        return ingredients
    # Smithing.
    if "base" in value and "addition" in value:
        slots = (value.get(slot) for slot in ("template", "base", "addition"))
        return [part for part in slots if part]
    # Smelting, stonecutting and such.
    return [value["ingredient"]] if "ingredient" in value else []


def _cells(key: dict[str, Any], pattern: list[Any]) -> list[Any]:
    """Return the ingredients in a pattern's cells; a space is an empty cell."""
    is_text = all(isinstance(row, str) for row in pattern)
    if not is_text or " " in key:
        return [_DAMAGED]
    signs = "".join(pattern).replace(" ", "")
    if not set(signs) <= key.keys():
        return [_DAMAGED]
    return [key[sign] for sign in signs]


def _recipes_of(slots: Sequence[Sequence[str]]) -> Iterable[tuple[str, ...]]:
    """Return the sets of ingredients that a recipe allows.

    Args:
        slots: the items of which one is used, for each piece.
    """
    if len(slots) == 2:
        # A pair of equal things stays a pair; larger amounts are no part of a set.
        one, other = slots
        if set(one) == set(other):
            # Either order is one recipe.
            return combinations_with_replacement(one, 2)
        return product(one, other)
    # Equal slots are one ingredient of the set, and one choice.
    different = dict.fromkeys(map(tuple, slots))
    return product(*different)


def _number_of_counts(value: dict[str, Any], parts: Sequence[Any], result: Any) -> int:
    """Return how many numbers of pieces a recipe has that its set of ingredients does not keep."""
    dropped = 0
    for holder in (*parts, result, value):
        if isinstance(holder, dict):
            numbers = [holder.get(key, 1) for key in _COUNT_KEYS]
            dropped += any(number != 1 for number in numbers)
    # Two pieces are a pair as they stand; of more pieces, the set keeps each thing once.
    if len(parts) > 2:
        pieces_of_thing = Counter(tuple(_choices(part)) for part in parts)
        dropped += sum(number > 1 for number in pieces_of_thing.values())
    return dropped


def _choices(part: Any) -> list[str]:
    """Return the items of which one is used; empty if one of them is of an unknown kind."""
    if isinstance(part, list):
        choices = [_choices(each) for each in part]
        if not all(choices):
            return []
        return list(dict.fromkeys(chain.from_iterable(choices)))
    if isinstance(part, str):
        return [part] if part else []
    if isinstance(part, dict):
        for key in _ENTITY_KEYS:
            label = part.get(key)
            if isinstance(label, str) and label:
                # As in the game's files: a tag stands for several items.
                return [f"#{label}" if key == "tag" else label]
    return []


def _results(value: dict[str, Any]) -> list[Any]:
    """Return a recipe's results as they are."""
    for key in _RESULT_KEYS:
        result = value.get(key)
        if result:
            return result if isinstance(result, list) else [result]
    return []
