"""Data packs of Minecraft, as packs and mods have them: a JSON file for each recipe.

A pattern becomes the set of its ingredients, of two pieces a pair; where one of several items may
be used, each choice is a recipe. A tag that the pack defines stands for its members, which are
choices; any other tag, such as ``#minecraft:planks``, is an entity of its own.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, combinations_with_replacement, islice, product
from pathlib import PurePosixPath
from typing import Any

from msgspec.structs import replace

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.book_files.rows import WITHOUT, Entry, Fault, FileRows, LeftOut, Row
from wordcraft_kg.graphs.book_files.text import parsed_json
from wordcraft_kg.graphs.reading import Reading
from wordcraft_kg.graphs.recipes import label_fault, shown

_MAX_CHOICES = 256
"""Recipes that one file may stand for, where each ingredient may be one of several items."""
_ENTITY_KEYS = ("item", "id", "tag", "fluid")
_RESULT_KEYS = ("result", "output", "results", "outputs")
_MOST_LEVELS = 8  # tags within tags
Tags = dict[str, list[str]]
"""Items by tag."""


def read_pack(files: Iterable[tuple[str, bytes]]) -> FileRows:
    """Read the recipes of a data pack.

    Args:
        files: names and bytes of its JSON files: recipes, and tags of items.
    """
    source = FileRows(Reading(shape="Minecraft recipes"), is_exact=True)
    tags: dict[str, list[Any]] = {}
    recipes: list[tuple[str, Any]] = []
    for name, data in files:
        value = _parsed(name, data)
        parts = PurePosixPath(name).with_suffix("").parts
        if "tags" not in parts:
            recipes.append((name, value))
        elif isinstance(value, dict) and isinstance(value.get("values"), list):
            # data/demo/tags/items/planks is the tag demo:planks; below tags is the registry.
            at = parts.index("tags")
            tag = f"{parts[at - 1]}:{'/'.join(parts[at + 2 :])}"
            tags.setdefault(tag, []).extend(value["values"])
    members = _members_of(tags)
    source.entries = list(chain.from_iterable(_recipes(source, members, *each) for each in recipes))
    if tags:
        notes = (f"{len(tags):,} tags of the pack are choices of their items",)
        source.reading = replace(source.reading, notes=notes)
    return source


def _parsed(name: str, data: bytes) -> Any:
    """Return the value in a file, or the file's fault."""
    try:
        # Some editors write a byte order mark, which the game reads over.
        return parsed_json(name, data.decode("utf-8-sig"))
    except RecipeFileError as error:
        return Fault(name, "row", str(error), "not JSON")
    except ValueError as error:
        return Fault(name, "row", f"{name}: not JSON ({type(error).__name__}).", "not JSON")


def _recipes(source: FileRows, tags: Tags, name: str, value: Any) -> Iterator[Entry]:
    if not isinstance(value, dict):
        message = f"{name} is {shown(value)}; expected an object."
        yield value if isinstance(value, Fault) else Fault(name, "row", message, "not an object")
        return
    parts = _parts(value)
    result: Any = next(filter(None, map(value.get, _RESULT_KEYS)), [])
    results = result if isinstance(result, list) else [result]
    made = _choices(results[0], {}) if results else []
    slots = [list(dict.fromkeys(_choices(part, tags))) for part in parts or ()]
    # One more than allowed tells that there are too many, and no product is made in full.
    choices = list(islice(_sets_of(slots), _MAX_CHOICES + 1))
    labels = set(chain(made, *slots))
    reason = ""
    if parts is None:
        reason = "with a damaged pattern"
    elif len(results) > 1:
        reason = "with several results"
    elif not parts or len(made) != 1:
        reason = WITHOUT
    elif not all(slots) or any(map(label_fault, labels)):
        reason = "with an ingredient of an unknown kind"
    elif len(choices) > _MAX_CHOICES:
        reason = f"with more than {_MAX_CHOICES} choices of ingredients"
    if reason:
        yield LeftOut(name, reason)
        return
    holders = [holder for holder in (*(parts or ()), *results, value) if isinstance(holder, dict)]
    numbers = [holder.get("count", holder.get("amount", 1)) for holder in holders]
    # Two pieces are a pair as they stand; of more pieces, the set keeps each thing once.
    is_set = len(set(map(tuple, slots))) < len(slots) > 2
    dropped = source.reading.counts_dropped + sum(number != 1 for number in numbers) + is_set
    source.reading = replace(source.reading, counts_dropped=dropped)
    yield from (Row(name, ingredients, made[0]) for ingredients in choices)


def _parts(value: dict[str, Any]) -> list[Any] | None:
    """Return a recipe's ingredients, one for each piece; None for a damaged pattern."""
    # Crafting with a shape: signs in a pattern, and what each sign stands for; a space is empty.
    key, pattern = value.get("key"), value.get("pattern")
    if isinstance(key, dict) and isinstance(pattern, list):
        is_text = all(isinstance(row, str) for row in pattern)
        signs = "".join(pattern).replace(" ", "") if is_text else ""
        is_damaged = not is_text or " " in key or not set(signs) <= key.keys()
        return None if is_damaged else [key[sign] for sign in signs]
    # Crafting without a shape.
    if isinstance(value.get("ingredients"), list):
        return list(value["ingredients"])
    # Smithing; smelting, stonecutting and such.
    slots = ("template", "base", "addition") if "addition" in value else ("ingredient",)
    return [value[slot] for slot in slots if value.get(slot)]


def _sets_of(slots: Sequence[Sequence[str]]) -> Iterable[tuple[str, ...]]:
    """Return the sets of ingredients that a recipe allows.

    Args:
        slots: the items of which one is used, for each piece.
    """
    # A pair of equal things stays a pair, in either order; larger amounts are no part of a set.
    if len(slots) == 2 and set(slots[0]) == set(slots[1]):
        return combinations_with_replacement(slots[0], 2)
    return product(*(slots if len(slots) == 2 else dict.fromkeys(map(tuple, slots))))


def _members_of(tags: dict[str, list[Any]]) -> Tags:
    """Return the items of each tag, in which other tags of the pack are items, too."""
    members = {tag: _choices(values, {}) for tag, values in tags.items()}
    # Each round opens one level of tags within tags; a circle ends with the rounds.
    for _ in range(_MOST_LEVELS):
        for tag, items in list(members.items()):
            members[tag] = list(dict.fromkeys(_choices(items, members)))
    return members


def _choices(part: Any, tags: Tags) -> list[str]:
    """Return the items of which one is used; empty if one of them is of an unknown kind."""
    if isinstance(part, list):
        choices = [_choices(each, tags) for each in part]
        return list(chain.from_iterable(choices)) if all(choices) else []
    label = part
    if isinstance(part, dict):
        # As in the game's files: a tag stands for several items.
        texts = [key for key in _ENTITY_KEYS if isinstance(part.get(key), str)]
        label = part[texts[0]] if texts else ""
        label = f"#{label}" if texts[:1] == ["tag"] else label
    if not isinstance(label, str) or not label:
        return []
    return tags.get(label[1:], [label]) if label.startswith("#") else [label]
