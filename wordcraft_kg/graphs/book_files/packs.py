"""Folders of Minecraft recipes, as data packs and mods have them: a JSON file for each recipe.

A pattern becomes the set of its ingredients, of two pieces a pair; where one of several items may
be used, each choice is a recipe. A tag that the pack defines stands for its members, which are
choices; any other tag, such as ``#minecraft:planks``, is an entity of its own.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, combinations_with_replacement, islice, product
from pathlib import PurePosixPath
from typing import Any

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.book_files.containers import is_pack_file
from wordcraft_kg.graphs.book_files.json_text import parsed_json
from wordcraft_kg.graphs.book_files.rows import WITHOUT, Entry, Fault, FileRows, LeftOut, Row
from wordcraft_kg.graphs.recipes import label_fault, shown

_MAX_CHOICES = 256
"""Recipes that one file may stand for, where each ingredient may be one of several items."""
_ENTITY_KEYS = ("item", "id", "tag", "fluid")
_COUNT_KEYS = ("count", "amount")
_RESULT_KEYS = ("result", "output", "results", "outputs")
_PARTS = frozenset({"type", "pattern", "ingredients", "ingredient", *_RESULT_KEYS})
"""Keys of which a recipe has at least one."""
_DAMAGED = "with a damaged pattern"
_MOST_LEVELS = 8  # tags within tags
Tags = dict[str, list[str]]
"""Items by tag."""


def read_pack(files: Iterable[tuple[str, bytes]]) -> FileRows:
    """Read the recipes of a data pack.

    Args:
        files: names and bytes of its JSON files: recipes, and tags of items.
    """
    source = FileRows("Minecraft recipes", is_exact=True)
    tags: dict[str, list[Any]] = {}
    recipes: list[tuple[str, dict[str, Any]]] = []
    entries: list[Entry] = []
    for name, data in files:
        value = _parsed(name, data)
        tag = _tag_of(name)
        if isinstance(value, Fault):
            entries += [value] if tag is None else []
        elif tag is None:
            recipes.append((name, value))
        elif isinstance(value.get("values"), list):
            tags.setdefault(tag, []).extend(value["values"])
    members = _members_of(tags)
    for name, recipe in recipes:
        entries += _recipes(source, members, name, recipe)
    source.entries = entries
    if tags:
        source.notes.append(f"{len(tags):,} tags of the pack are choices of their items")
    return source


def _tag_of(name: str) -> str | None:
    """Return the tag that a file defines, such as ``demo:planks``; None for a recipe."""
    parts = PurePosixPath(name).with_suffix("").parts
    if "tags" not in parts or not is_pack_file(name, "tags"):
        return None
    at = parts.index("tags")
    space = parts[at - 1] if at else ""
    # Below tags is the registry, item or items, and then the tag's own path.
    return f"{space}:{'/'.join(parts[at + 2 :])}"


def looks_like_recipe(name: str, data: bytes) -> bool:
    """Return whether a JSON file may be a recipe of Minecraft, rather than a recipe book.

    Args:
        name: its name, for errors.
        data: its bytes; what is not JSON may have been a recipe.
    """
    value = _parsed(name, data)
    if isinstance(value, Fault):
        return value.group != "not an object"
    return not _PARTS.isdisjoint(value)


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


def _recipes(source: FileRows, tags: Tags, name: str, value: dict[str, Any]) -> Iterator[Entry]:
    parts = _parts(value)
    results = _results(value)
    slots = [list(dict.fromkeys(_choices(part, tags))) for part in parts]
    made = _choices(results[0], {}) if results else []
    reason = ""
    if _DAMAGED in parts:
        reason = _DAMAGED
    elif len(results) > 1:
        reason = "with several results"
    elif not parts or len(made) != 1:
        reason = WITHOUT
    elif not all(slots):
        reason = "with an ingredient of an unknown kind"
    if reason:
        yield LeftOut(name, reason)
        return
    # One more than allowed tells that there are too many, and no product is made in full.
    choices = list(islice(_sets_of(slots), _MAX_CHOICES + 1))
    if len(choices) > _MAX_CHOICES:
        yield LeftOut(name, f"with more than {_MAX_CHOICES} choices of ingredients")
        return
    source.counts_dropped += _number_of_counts(value, parts, results[0])
    for ingredients in choices:
        fault = next(filter(None, map(label_fault, (*ingredients, *made))), None)
        if fault is None:
            yield Row(name, ingredients, made[0])
        else:
            yield Fault(name, "label", f"{name}: {fault}")


def _parts(value: dict[str, Any]) -> list[Any]:
    """Return a recipe's ingredients as they are, one for each piece; empty if there are none."""
    # Crafting with a shape: signs in a pattern, and what each sign stands for; a space is empty.
    key = value.get("key")
    pattern = value.get("pattern")
    if isinstance(key, dict) and isinstance(pattern, list):
        is_text = all(isinstance(row, str) for row in pattern)
        signs = "".join(pattern).replace(" ", "") if is_text else ""
        is_damaged = not is_text or " " in key or not set(signs) <= key.keys()
        return [_DAMAGED] if is_damaged else [key[sign] for sign in signs]
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


def _sets_of(slots: Sequence[Sequence[str]]) -> Iterable[tuple[str, ...]]:
    """Return the sets of ingredients that a recipe allows.

    Args:
        slots: the items of which one is used, for each piece.
    """
    if len(slots) == 2:
        # A pair of equal things stays a pair; larger amounts are no part of a set.
        one, other = slots
        # Either order is one recipe.
        is_same = set(one) == set(other)
        return combinations_with_replacement(one, 2) if is_same else product(one, other)
    # Equal slots are one ingredient of the set, and one choice.
    return product(*dict.fromkeys(map(tuple, slots)))


def _number_of_counts(value: dict[str, Any], parts: Sequence[Any], result: Any) -> int:
    """Return how many numbers of pieces a recipe has that its set of ingredients does not keep."""
    dropped = 0
    for holder in (*parts, result, value):
        if isinstance(holder, dict):
            dropped += any(holder.get(key, 1) != 1 for key in _COUNT_KEYS)
    # Two pieces are a pair as they stand; of more pieces, the set keeps each thing once.
    if len(parts) > 2:
        pieces_of_thing = Counter(tuple(_choices(part, {})) for part in parts)
        dropped += sum(number > 1 for number in pieces_of_thing.values())
    return dropped


def _members_of(tags: dict[str, list[Any]]) -> Tags:
    """Return the items of each tag, in which other tags of the pack are items, too."""
    members = {tag: _choices(values, {}) for tag, values in tags.items()}
    # Each round opens one level of tags within tags; a circle ends with the rounds.
    for _ in range(_MOST_LEVELS):
        members = {
            tag: list(dict.fromkeys(_opened(items, members))) for tag, items in members.items()
        }
    return members


def _opened(items: Iterable[str], tags: Tags) -> Iterator[str]:
    """Yield items with the members of the tags among them."""
    for item in items:
        yield from tags.get(item.removeprefix("#"), [item]) if item.startswith("#") else [item]


def _choices(part: Any, tags: Tags) -> list[str]:
    """Return the items of which one is used; empty if one of them is of an unknown kind."""
    if isinstance(part, list):
        choices = [_choices(each, tags) for each in part]
        return list(chain.from_iterable(choices)) if all(choices) else []
    label = part
    if isinstance(part, dict):
        keys = [key for key in _ENTITY_KEYS if isinstance(part.get(key), str)]
        label = part[keys[0]] if keys else None
        # As in the game's files: a tag stands for several items.
        label = f"#{label}" if keys and keys[0] == "tag" else label
    return list(_opened([label], tags)) if isinstance(label, str) and label else []


def _results(value: dict[str, Any]) -> list[Any]:
    """Return a recipe's results as they are."""
    found = filter(None, map(value.get, _RESULT_KEYS))
    result = next(found, [])
    return result if isinstance(result, list) else [result]
