"""Formats of their own: our JSON, the paper's, Infinite Craft, packs of Minecraft.

In a pack a pattern becomes the set of its ingredients, of two pieces a pair; where one of several
items may be used, each choice is a recipe. A tag that the pack defines stands for its members,
which are choices; any other tag, such as ``#minecraft:planks``, is an entity of its own.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, combinations_with_replacement, islice, product, repeat
from pathlib import Path, PurePosixPath
from typing import Any

from wordcraft_kg.base import RecipeFileError, nearest
from wordcraft_kg.graphs.book_files.cells import trim_unseen
from wordcraft_kg.graphs.book_files.files import parsed_json
from wordcraft_kg.graphs.book_files.rows import (
    INFINITE_CRAFT_BASE,
    WITHOUT,
    Entry,
    Fault,
    FileRows,
    LeftOut,
    Row,
    refusal,
    without_nothing,
)
from wordcraft_kg.graphs.book_files.words import QUANTITIES
from wordcraft_kg.graphs.recipes import NOTHING, Reading, check_label, label_fault, shown


def known_layout(path: Path, document: Any) -> FileRows | None:
    """Return the rows of a layout that its keys tell; None for any other document.

    Args:
        path: the file, for errors.
        document: the parsed JSON.

    Raises:
        RecipeFileError: if the base, kinds or items of such a layout are damaged.
    """
    if not isinstance(document, dict):
        return None
    entities, recipes, items = (document.get(key) for key in ("entities", "recipes", "items"))
    if isinstance(entities, list) and isinstance(recipes, list):
        return _our_layout(path, document)
    if isinstance(entities, dict):
        are_things = all(
            isinstance(thing, dict) and "recipes" in thing for thing in entities.values()
        )
        return _official_layout(path, entities) if are_things else None
    if not isinstance(items, list) or not items:
        return None
    rows = recipes if isinstance(recipes, list) else _saved_rows(items)
    # By type: true and false are instances of int, but no indices.
    forms = {isinstance(row, list) and tuple(map(type, row)) for row in rows}
    return _dump(path, items, rows) if forms == {(int, int, int)} else None


def _saved_rows(items: Sequence[Any]) -> list[Any]:
    """Return the rows of indices in a save, whose items have an id, and recipes by ids; or none."""
    rows: list[Any] = []
    try:
        index_of = {item["id"]: index for index, item in enumerate(items)}
        for index, item in enumerate(items):
            pairs = item.get("recipes") or ()
            rows += ([*map(index_of.__getitem__, pair), index] for pair in pairs)
    except (KeyError, TypeError):
        return []
    return rows


def _our_layout(path: Path, document: Mapping[str, Any]) -> FileRows:
    """Read our own layout, in which a wrong row is a fault in its place."""
    rows, base = document["recipes"], document.get("base")
    if base is not None and not isinstance(base, list):
        raise RecipeFileError(
            f"{path}: 'base' is {type(base).__name__}; expected a list of labels or null."
        )
    facts = []
    for name, noun in (("kinds", "a kind"), (QUANTITIES, "quantities")):
        texts = document.get(name)
        if texts is not None and (not isinstance(texts, list) or len(texts) != len(rows)):
            raise RecipeFileError(
                f'{path}: {name} is {shown(texts)}; expected a list with {noun}, or "", for each '
                "recipe."
            )
        facts.append(texts or repeat(""))
    source = _listing("our own JSON", path, document["entities"], base)
    places = (f"recipes[{index}]" for index in range(len(rows)))
    raws = zip(places, rows, *facts, strict=False)
    source.entries = list(_exact(raws, source.listed, "[ingredient, ingredient, result]"))
    return source


def _official_layout(path: Path, entities: Mapping[str, Mapping[str, Any]]) -> FileRows:
    """Read the layout of the paper's code: pairs below each entity."""
    source = _listing("the paper's JSON", path, list(entities), None)
    raws: list[tuple[str, Any]] = []
    for result, entry in entities.items():
        place = f"entities['{result}'].recipes"
        pairs = entry["recipes"]
        if isinstance(pairs, list):
            rows = ([*pair, result] if isinstance(pair, list) and pair else pair for pair in pairs)
            raws += ((f"{place}[{index}]", row) for index, row in enumerate(rows))
        else:
            raws.append((place, pairs))
    source.entries = list(_exact(raws, source.listed, "a list of ingredients"))
    return source


def _listing(
    shape: str, path: Path, entities: Iterable[Any], base: Sequence[Any] | None
) -> FileRows:
    """Return the rows of a file that lists its entities, and the base among them."""
    source = FileRows(Reading(shape=shape), is_exact=True)
    for index, label in enumerate(entities):
        place = f"entities[{index}]"
        source.listed[check_label(label, f"{path}: {place}")] = place
    if base is not None:
        source.base = {}
        for index, label in enumerate(base):
            fault = _unknown(label, source.listed)
            if fault:
                raise RecipeFileError(f"{path}: base[{index}]: {fault}")
            source.base[label] = f"base[{index}]"
    return source


def _unknown(label: Any, listed_labels: Mapping[str, Any]) -> str | None:
    """Return why a value is none of the labels that a file lists; these were checked already."""
    if isinstance(label, str) and label in listed_labels:
        return None
    return label_fault(label) or (
        f"'{label}' is not among the file's entities.{nearest(label, listed_labels)}"
    )


def _exact(
    raws: Iterable[tuple[Any, ...]], listed_labels: Mapping[str, Any], expected: str
) -> Iterator[Entry]:
    """Yield the recipes of rows of labels that a file lists, with their kinds and quantities."""
    for place, row, *facts in raws:
        if not isinstance(row, list) or len(row) < 2:
            yield Fault(place, "row", f"{place} is {shown(row)}; expected {expected}.", "own row")
            continue
        faults = [_unknown(label, listed_labels) for label in row]
        faults += [label_fault(fact) for fact in facts if fact != ""]
        fault = next(filter(None, faults), None)
        if fault is None:
            yield Row(place, row[:-1], row[-1], *facts)
        else:
            yield Fault(place, "label", f"{place}: {fault}")


def _dump(path: Path, items: Sequence[Any], rows: Sequence[Sequence[int]]) -> FileRows:
    """Read Infinite Craft: rows of indices of two ingredients, and of the result."""
    labels = [
        item.get("text", item.get("name")) if isinstance(item, dict) else item for item in items
    ]
    names = []
    for label in labels:
        text = trim_unseen(label) if isinstance(label, str) else label
        names.append(check_label(text, f"{path}: items"))
    for place in chain.from_iterable(rows):
        if not 0 <= place < len(names):
            raise refusal(
                path, f"the index {place:,} in recipes, of {len(names):,} items", "infinite-craft"
            )
    source = FileRows(Reading(shape="Infinite Craft"), is_exact=True)
    source.listed = {name: "items" for name in names if name != NOTHING}
    if source.listed.keys() >= set(INFINITE_CRAFT_BASE):
        source.base = dict.fromkeys(INFINITE_CRAFT_BASE, "items")
    source.entries = without_nothing(
        Row(f"recipes[{number}]", [names[a], names[b]], names[result])
        for number, (a, b, result) in enumerate(rows)
    )
    return source


# --- packs of Minecraft --------------------------------------------------------------------------

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

    Raises:
        RecipeFileError: if a file is no object of JSON.
    """
    tags: Tags = {}
    recipes: list[tuple[str, Any]] = []
    for name, data in files:
        value = _object_in(name, data)
        parts = PurePosixPath(name).with_suffix("").parts
        if "tags" not in parts:
            recipes.append((name, value))
        elif isinstance(value.get("values"), list):
            # data/demo/tags/items/planks is the tag demo:planks; below tags is the registry.
            at = parts.index("tags")
            tag = f"{parts[at - 1]}:{'/'.join(parts[at + 2 :])}"
            tags.setdefault(tag, []).extend(_choices(value["values"], {}))
    notes = (f"{len(tags):,} tags of the pack are choices of their items",) if tags else ()
    # Each round opens one level of tags within tags; a circle ends with the rounds.
    for _ in range(_MOST_LEVELS):
        tags |= {tag: list(dict.fromkeys(_choices(items, tags))) for tag, items in tags.items()}
    pack_recipes = [_recipes(tags, name, value) for name, value in recipes]
    return FileRows(
        Reading(
            shape="Minecraft recipes",
            counts_dropped=sum(number for _, number in pack_recipes),
            notes=notes,
        ),
        list(chain.from_iterable(entries for entries, _ in pack_recipes)),
        is_exact=True,
    )


def _object_in(name: str, data: bytes) -> dict[str, Any]:
    """Return the object in a file of a pack."""
    value = parsed_json(name, data)
    if not isinstance(value, dict):
        raise RecipeFileError(f"{name} is {shown(value)}; expected an object.")
    return value


def _recipes(tags: Tags, name: str, value: dict[str, Any]) -> tuple[list[Entry], int]:
    """Return the recipes in a file, and how many numbers of pieces they do not keep."""
    parts = _parts(value)
    result: Any = next(filter(None, map(value.get, _RESULT_KEYS)), [])
    results = result if isinstance(result, list) else [result]
    result_items = _choices(results[0], {}) if results else []
    slots = [list(dict.fromkeys(_choices(part, tags))) for part in parts or ()]
    # One more than allowed tells that there are too many, and no product is made in full.
    choices = list(islice(_sets_of(slots), _MAX_CHOICES + 1))
    is_unknown = not all(slots) or any(map(label_fault, chain(result_items, *slots)))
    faults = (
        (parts is None, "with a damaged pattern"),
        (len(results) > 1, "with several results"),
        (not parts or len(result_items) != 1, WITHOUT),
        (is_unknown, "with an ingredient of an unknown kind"),
        (len(choices) > _MAX_CHOICES, f"with more than {_MAX_CHOICES} choices of ingredients"),
    )
    for is_fault, reason in faults:
        if is_fault:
            return [LeftOut(name, reason)], 0
    holders = [holder for holder in (*(parts or ()), *results, value) if isinstance(holder, dict)]
    dropped = sum(holder.get("count", holder.get("amount", 1)) != 1 for holder in holders)
    # Two pieces are a pair as they stand; of more pieces, the set keeps each thing once.
    is_set = len(set(map(tuple, slots))) < len(slots) > 2
    return [Row(name, ingredients, result_items[0]) for ingredients in choices], dropped + is_set


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


def _choices(part: Any, tags: Tags) -> list[str]:
    """Return the items of which one is used; empty if one of them is of an unknown kind."""
    if isinstance(part, list):
        choices = [_choices(choice, tags) for choice in part]
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
