"""JSON layouts with keys of their own: ours, the paper's, HIF, saves of Infinite Craft."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.book_files.guide import refusal
from wordcraft_kg.graphs.book_files.json_found import FoundShape, JsonPart, RawRecipe
from wordcraft_kg.graphs.book_files.json_ids import names_of_ids
from wordcraft_kg.graphs.book_files.json_objects import Raws, recipes_of_results
from wordcraft_kg.graphs.book_files.json_values import own_name
from wordcraft_kg.graphs.book_files.rows import INFINITE_CRAFT_BASE, Fault, LeftOut
from wordcraft_kg.graphs.hif import is_hif, recipes_of_hif
from wordcraft_kg.graphs.recipes import shown


def our_layout(part: JsonPart) -> FoundShape | None:
    """Return the recipes of our own layout: lists of entities and of recipes by label.

    Recipes are made as they are read: a wrong row is a fault in its place, so that a check of the
    book lists all of them.

    Args:
        part: a value in the file.

    Returns:
        The recipes; None for another layout.

    Raises:
        RecipeFileError: if ``base`` is no list, or ``kinds`` no list with a kind for each recipe:
            the recipes cannot be read as they are meant without them.
    """
    value = part.value
    if not isinstance(value, dict) or not isinstance(value.get("recipes"), list):
        return None
    if not isinstance(value.get("entities"), list):
        return None
    entities = value["entities"]
    rows = value["recipes"]
    base = value.get("base")
    if base is not None and not isinstance(base, list):
        raise RecipeFileError(
            f"{part.path}: 'base' is {type(base).__name__}; expected a list of labels or null."
        )
    kinds = value.get("kinds")
    if kinds is not None and (not isinstance(kinds, list) or len(kinds) != len(rows)):
        expected = 'expected a list with a kind, or "", for each recipe.'
        raise RecipeFileError(f"{part.path}: kinds is {shown(kinds)}; {expected}")

    def raws() -> Iterator[RawRecipe | Fault]:
        for index, row in enumerate(rows):
            place = f"recipes[{index}]"
            if not isinstance(row, list) or len(row) < 2:
                message = f"{place} is {shown(row)}; expected [ingredient, ingredient, result]."
                yield Fault(place, "row", message, "own row")
            else:
                kind = kinds[index] if kinds else ""
                yield RawRecipe(place, row, row[:-1], row[-1], kind)

    known = frozenset(label for label in entities if isinstance(label, str))
    return FoundShape("our own JSON", raws(), entities, known, base)


def official_layout(part: JsonPart) -> FoundShape | None:
    """Return the recipes of the layout that the paper's code reads: pairs below each entity.

    Args:
        part: a value in the file.

    Returns:
        The recipes, made as they are read, with a fault for each wrong entry; None for another
        layout.
    """
    value = part.value
    entities = value.get("entities") if isinstance(value, dict) else None
    if not isinstance(entities, dict):
        return None

    def raws() -> Raws:
        for result, entry in entities.items():
            place = f"entities['{result}']"
            pairs = entry.get("recipes") if isinstance(entry, dict) else None
            if isinstance(pairs, list):
                yield from _listed_pairs(pairs, place, result)
            else:
                yield Fault(place, "row", f"{place} has no list 'recipes'.")

    return FoundShape("the paper's JSON", raws(), list(entities), frozenset(entities))


def _listed_pairs(pairs: Sequence[Any], place: str, result: Any) -> Raws:
    """Yield the recipes under a key ``recipes``."""
    for index, pair in enumerate(pairs):
        here = f"{place}.recipes[{index}]"
        if isinstance(pair, list) and pair:
            yield RawRecipe(here, pair, pair, result)
        else:
            message = f"{here} is {shown(pair)}; a recipe needs two ingredients."
            yield Fault(here, "row", message)


def hypergraph(part: JsonPart) -> FoundShape | None:
    """Return the recipes of a directed hypergraph in HIF, as `export --format hif` writes it.

    Args:
        part: a value in the file.

    Returns:
        The recipes; None for another layout.

    Raises:
        RecipeFileError: for a hypergraph that holds no recipes, with the edge and the reason.
    """
    if not is_hif(part.value):
        return None
    found = recipes_of_hif(part.value, str(part.path))
    raws = []
    # For people, edges count from 1.
    for number, (row, kind) in enumerate(zip(found.rows, found.kinds, strict=True), start=1):
        raws.append(RawRecipe(f"edge {number}", row, row[:-1], row[-1], kind))
    known = frozenset(found.listed)
    return FoundShape(
        "a hypergraph (HIF)",
        raws,
        found.listed,
        known,
        found.base,
        counts_dropped=found.dropped_counts,
    )


# --- Infinite Craft ------------------------------------------------------------------------------


def save_or_dump(part: JsonPart) -> FoundShape | None:
    """Return the recipes of a save of Infinite Craft (``.ic``), or of a dump with rows of indices.

    Args:
        part: a value in the file.

    Returns:
        The recipes, made as they are read, with a fault for each wrong entry; None for another
        layout.

    Raises:
        RecipeFileError: if an item's ``text`` is no text, or two items have one id.
    """
    value = part.value
    if not isinstance(value, dict):
        return None
    items = value.get("items")
    if not isinstance(items, list) or not items:
        return None
    recipes = value.get("recipes")
    # A dump names things by their index in ``items``; a save keeps recipes with each item.
    if isinstance(recipes, list) and all(map(_is_index_row, recipes)):
        names = {index: own_name(item) for index, item in enumerate(items)}
        return _infinite_craft("a dump of Infinite Craft", _index_recipes(recipes), names)
    if not all(isinstance(item, dict) and "text" in item for item in items):
        return None
    if not all(isinstance(item["text"], str) for item in items):
        raise refusal(part.path, "an item whose 'text' is no text", "infinite-craft")
    # An item without an id is named by its index.
    ids = ((item.get("id", index), item) for index, item in enumerate(items))
    names = names_of_ids(part.path, ids)
    return _infinite_craft("a save of Infinite Craft", _saved_recipes(items), names)


def _index_recipes(rows: Sequence[Sequence[int]]) -> Raws:
    """Yield the recipes of a dump: indices of ingredients, and last of the result."""
    for index, row in enumerate(rows):
        yield RawRecipe(f"recipes[{index}]", row, row[:-1], row[-1])


def _saved_recipes(items: Sequence[Mapping[str, Any]]) -> Raws:
    """Yield the recipes of a save, which stand with each item."""
    for index, item in enumerate(items):
        # First items, such as water, have no recipes, or null.
        pairs = item.get("recipes") or []
        if isinstance(pairs, list):
            yield from _listed_pairs(pairs, f"items[{index}]", item["text"])
        else:
            here = f"items[{index}].recipes"
            yield Fault(here, "row", f"{here} is {shown(pairs)}; expected a list of pairs.")


def _is_index_row(row: Any) -> bool:
    # By type: true and false are instances of int, but no indices.
    return isinstance(row, list) and len(row) >= 2 and all(type(each) is int for each in row)


def older_save(part: JsonPart) -> FoundShape | None:
    """Return the recipes of an older save of Infinite Craft: elements, and recipes by result.

    Args:
        part: a value in the file.

    Returns:
        The recipes, made as they are read; None for another layout.
    """
    value = part.value
    if not isinstance(value, dict):
        return None
    elements = value.get("elements")
    recipes = value.get("recipes")
    if not isinstance(elements, list) or not isinstance(recipes, dict):
        return None
    names = {index: own_name(element) for index, element in enumerate(elements)}
    raws = recipes_of_results(recipes.items(), "recipes")
    found = _infinite_craft("an older save of Infinite Craft", raws, names)
    # Its recipes name elements by their texts, so that a number is a label.
    found.indices = False
    return found


def _infinite_craft(
    shape: str, raws: Iterable[RawRecipe | Fault | LeftOut], names: Mapping[Any, Any]
) -> FoundShape:
    """Return a shape in which integers are indices, and Nothing is no entity.

    Args:
        shape: name of the shape, for people.
        raws: the entries.
        names: what each index stands for; values that are no texts are faults where they are used.
    """
    labels = [label for label in names.values() if isinstance(label, str)]
    has_whole_base = set(INFINITE_CRAFT_BASE) <= set(labels)
    base = INFINITE_CRAFT_BASE if has_whole_base else None
    return FoundShape(shape, raws, labels, base=base, names=names, indices=True, nothing=True)
