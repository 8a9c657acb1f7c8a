"""JSON layouts with keys of their own: ours, the paper's, HIF, dumps of Infinite Craft."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, repeat
from pathlib import Path
from typing import Any

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.graphs.book_files.cells import trim_unseen
from wordcraft_kg.graphs.book_files.rows import (
    INFINITE_CRAFT_BASE,
    Entry,
    Fault,
    FileRows,
    Row,
    refusal,
    without_nothing,
)
from wordcraft_kg.graphs.hif import is_hif, recipes_of_hif
from wordcraft_kg.graphs.label_notes import NOTHING
from wordcraft_kg.graphs.reading import Reading
from wordcraft_kg.graphs.recipes import check_label, label_fault, shown


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
    if is_hif(document):
        return _hypergraph(path, document)
    entities, recipes = document.get("entities"), document.get("recipes")
    items = document.get("items")
    if isinstance(entities, list) and isinstance(recipes, list):
        return _our_layout(path, document)
    if isinstance(entities, dict) and all(map(_has_pairs, entities.values())):
        return _official_layout(path, entities)
    if not isinstance(items, list) or not isinstance(recipes, list) or not items:
        return None
    is_dump = bool(recipes) and all(map(_is_index_row, recipes))
    return _dump(path, items, recipes) if is_dump else None


def _has_pairs(entry: Any) -> bool:
    return isinstance(entry, dict) and "recipes" in entry


def _is_index_row(row: Any) -> bool:
    # By type: true and false are instances of int, but no indices.
    return isinstance(row, list) and len(row) == 3 and all(type(each) is int for each in row)


def _our_layout(path: Path, document: Mapping[str, Any]) -> FileRows:
    """Read our own layout, in which a wrong row is a fault in its place."""
    rows, base, kinds = document["recipes"], document.get("base"), document.get("kinds")
    if base is not None and not isinstance(base, list):
        found = type(base).__name__
        raise RecipeFileError(f"{path}: 'base' is {found}; expected a list of labels or null.")
    if kinds is not None and (not isinstance(kinds, list) or len(kinds) != len(rows)):
        expected = 'expected a list with a kind, or "", for each recipe.'
        raise RecipeFileError(f"{path}: kinds is {shown(kinds)}; {expected}")
    source = FileRows(Reading(shape="our own JSON"), is_exact=True)
    _list(source, path, document["entities"], base)
    places = (f"recipes[{index}]" for index in range(len(rows)))
    raws = zip(places, rows, kinds or repeat(""), strict=False)
    source.entries = _exact(raws, source.listed, "[ingredient, ingredient, result]")
    return source


def _official_layout(path: Path, entities: Mapping[str, Mapping[str, Any]]) -> FileRows:
    """Read the layout of the paper's code: pairs below each entity."""
    source = FileRows(Reading(shape="the paper's JSON"), is_exact=True)
    _list(source, path, list(entities), None)
    source.entries = _exact(_pairs_below(entities), source.listed, "a list of ingredients")
    return source


def _pairs_below(entities: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, Any, Any]]:
    for result, entry in entities.items():
        place = f"entities['{result}'].recipes"
        pairs = entry["recipes"]
        if not isinstance(pairs, list):
            yield place, pairs, ""
            continue
        for index, pair in enumerate(pairs):
            row = [*pair, result] if isinstance(pair, list) and pair else pair
            yield f"{place}[{index}]", row, ""


def _list(source: FileRows, path: Path, entities: Iterable[Any], base: list[Any] | None) -> None:
    """Note the entities that a file lists, and its base among them."""
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


def _unknown(label: Any, known: Mapping[str, Any]) -> str | None:
    """Return why a value is none of the labels that a file lists; these were checked already."""
    if isinstance(label, str) and label in known:
        return None
    return label_fault(label) or (
        f"'{label}' is not among the file's entities.{nearest(label, known)}"
    )


def _exact(
    raws: Iterable[tuple[str, Any, Any]], known: Mapping[str, Any], expected: str
) -> Iterator[Entry]:
    """Yield the recipes of rows of labels that a file lists."""
    for place, row, kind in raws:
        if not isinstance(row, list) or len(row) < 2:
            yield Fault(place, "row", f"{place} is {shown(row)}; expected {expected}.", "own row")
            continue
        faults = [_unknown(label, known) for label in row]
        if kind != "":
            faults.append(label_fault(kind))
        fault = next(filter(None, faults), None)
        if fault is None:
            yield Row(place, row[:-1], row[-1], kind)
        else:
            yield Fault(place, "label", f"{place}: {fault}")


def _hypergraph(path: Path, document: Mapping[str, Any]) -> FileRows:
    """Read a directed hypergraph in HIF, as `export --format hif` writes it."""
    found = recipes_of_hif(document, str(path))
    source = FileRows(
        Reading(shape="a hypergraph (HIF)", counts_dropped=found.dropped_counts), is_exact=True
    )
    _list(source, path, found.listed, None if found.base is None else list(found.base))
    # For people, edges count from 1.
    source.entries = [
        Row(f"edge {number}", row[:-1], row[-1], kind)
        for number, (row, kind) in enumerate(zip(found.rows, found.kinds, strict=True), start=1)
    ]
    return source


def _dump(path: Path, items: Sequence[Any], rows: Sequence[Sequence[int]]) -> FileRows:
    """Read a dump of Infinite Craft: rows of indices of two ingredients, and of the result."""
    source = FileRows(Reading(shape="a dump of Infinite Craft"), is_exact=True)
    labels = [
        item.get("text", item.get("name")) if isinstance(item, dict) else item for item in items
    ]
    names = [check_label(trim_unseen(label), f"{path}: items") for label in map(str, labels)]
    for place in chain.from_iterable(rows):
        if not 0 <= place < len(names):
            seen = f"the index {place:,} in recipes, of {len(names):,} items"
            raise refusal(path, seen, "infinite-craft")
    source.listed = {name: "items" for name in names if name != NOTHING}
    if source.listed.keys() >= set(INFINITE_CRAFT_BASE):
        source.base = dict.fromkeys(INFINITE_CRAFT_BASE, "items")
    source.entries = without_nothing(
        Row(f"recipes[{number}]", [names[a], names[b]], names[made])
        for number, (a, b, made) in enumerate(rows)
    )
    return source
