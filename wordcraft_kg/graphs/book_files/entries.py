"""Recipes from the values of a file: the labels in cells and in values of JSON."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, NamedTuple

from wordcraft_kg.graphs.book_files.cells import (
    JOINERS,
    WEAK_JOINERS,
    alternatives,
    find_joiner,
    formula_fault,
    is_number,
    labels_in,
    listed_value,
    parts_of,
    trim_unseen,
    without_markup,
)
from wordcraft_kg.graphs.book_files.rows import WITHOUT, Entry, Fault, LeftOut, Place, Row
from wordcraft_kg.graphs.book_files.rule import BookReading
from wordcraft_kg.graphs.chains import is_half_product
from wordcraft_kg.graphs.label_notes import is_missing
from wordcraft_kg.graphs.recipes import label_fault, shown

NUMBER = "\x01"
"""Before a number of JSON, which is an id until a list names it; no label holds it."""
Names = dict[str, str | None]
"""Names by id; None for an id of several names."""
_MOST_WITHOUT_GRID = 3  # ingredients; more may be the slots of a crafting grid
_OWN_NAMES = "ingredient_a,ingredient_b,result"
OWN_COLUMNS = (
    "Write each ingredient in a column of its own, as in ingredient_a,ingredient_b,ingredient_c,"
    "result, which `ingredients` chain reads, and one recipe in each row."
)
"""Remedy for a cell with several things."""


@dataclass
class Document:
    """A value of JSON, or the rows of a table as such a value.

    Attributes:
        value: the value.
        places: line of each row of a table.
        others: faults and rows left out.
        is_table: whether it is a table.
    """

    value: Any
    places: list[int] = field(default_factory=list)
    others: list[Entry] = field(default_factory=list)
    is_table: bool = False


class Raw(NamedTuple):
    """A row of a file: values in which labels are to be found.

    Attributes:
        place: where it stands.
        parts: cells or values of JSON with the ingredients.
        results: those with the results.
        kind: kind of reasoning.
    """

    place: Place
    parts: Sequence[Any]
    results: Sequence[Any]
    kind: str = ""


def fill(
    candidate: BookReading,
    raws: Iterable[Raw | Entry],
    *,
    is_sole: bool,
    in_lists: bool = False,
    is_given: bool = False,
    is_exact: bool = False,
    tables: Iterable[Names] = (),
) -> BookReading:
    """Fill a candidate with the recipes of a file's rows.

    Args:
        candidate: the reading, without entries.
        raws: rows, faults and rows left out.
        is_sole: whether a single column or path has all ingredients, so that a text may hold
            several of them.
        in_lists: whether it leads to lists; then each text of them has to hold several.
        is_given: whether the user names the reading, so that numbers are labels.
        is_exact: whether cells are labels as they stand, as in our own tables.
        tables: names by id, of each kind of ids that the file has.

    Returns:
        The candidate.
    """
    raws = list(raws)
    tables = list(tables)
    if is_exact:
        candidate.entries = [each for raw in raws for each in _exact(raw)]
        return candidate
    joiner = _joiner_of(candidate, raws, is_sole=is_sole, in_lists=in_lists)
    # Several columns or texts of a list may hold a whole recipe each.
    are_sums = bool(joiner) and (in_lists or not is_sole)
    # A grid has blanks, and as many slots in each row; in lists of labels they are slips.
    lists = [raw.parts for raw in raws if isinstance(raw, Raw) and raw.parts]
    is_uneven = is_sole and in_lists and len(set(map(len, lists))) > 1
    entries: list[Entry] = []
    # Most labels are met again: a look-up is faster than a check.
    clean: set[str] = set()
    for raw in raws:
        if not isinstance(raw, Raw):
            entries.append(raw)
        elif is_uneven and not joiner and "" in raw.parts[1:]:
            message = f"{raw.place}: a blank ingredient; fill it, or leave it out of the list."
            entries.append(Fault(raw.place, "label", message, "blank"))
        elif joiner == "" and clean and len(raw.results) == 1 and _are_clean(clean, raw):
            entries.append(Row(raw.place, raw.parts, raw.results[0], raw.kind))
        elif are_sums:
            for part in filter(None, raw.parts):
                entries += _entries(candidate, raw._replace(parts=[part]), joiner)
        else:
            entries += _entries(candidate, raw, joiner)
            if isinstance(entries[-1], Row):
                clean.update(each for each in (*entries[-1].ingredients, entries[-1].result))
    candidate.entries = _named(entries, tables, is_given=is_given)
    known = set(chain.from_iterable(table.values() for table in tables))
    # Numbers are no results, unless they are names.
    made = [row.result for row in candidate.rows if row.result not in known]
    if not is_given and made and len(made) == len(candidate.rows) and all(map(is_number, made)):
        candidate.entries = []
        del candidate.rows
    return candidate


def _joiner_of(
    candidate: BookReading, raws: Iterable[Raw | Entry], *, is_sole: bool, in_lists: bool
) -> str | None:
    """Return the sign between the ingredients in cells; None if it is not certain."""
    parts = [part for raw in raws if isinstance(raw, Raw) for part in raw.parts if part]
    if is_sole:
        cells = [cell for cell in parts if isinstance(cell, str) and not listed_value(cell)]
        return find_joiner(cells, in_all=in_lists, allows_weak=not candidate.by_place)
    are_sums = all(isinstance(part, str) and "+" in part for part in parts)
    return find_joiner(parts) if are_sums else ""


def _are_clean(clean: set[str], raw: Raw) -> bool:
    """Return whether values are labels that were met before."""
    try:
        return bool(raw.parts) and clean.issuperset(raw.parts) and raw.results[0] in clean
    except TypeError:  # an object or a list, which is not hashable
        return False


def _exact(raw: Raw | Entry) -> Iterator[Entry]:
    """Yield the recipe of a row of our own table."""
    if not isinstance(raw, Raw):
        yield raw
        return
    parts = [part for part in raw.parts if part]
    made = [each for each in raw.results if each]
    if not parts or not made:
        yield LeftOut(raw.place, WITHOUT)
        return
    labels = (*parts, *made, *filter(None, [raw.kind]))
    faults = [fault for label in labels if (fault := formula_fault(label) or label_fault(label))]
    message = " Also, ".join(dict.fromkeys(faults))
    yield Fault(raw.place, "label", message) if faults else Row(raw.place, parts, made[0], raw.kind)


def _entries(candidate: BookReading, raw: Raw, joiner: str | None) -> Iterator[Entry]:
    where = f"{raw.place}: " if isinstance(raw.place, str) else ""
    parts, message = _ingredients(raw, joiner)
    made: list[str] = []
    for value in raw.results:
        labels = _labels(_decoded(value))
        if labels is None:
            message = message or f"{shown(value)} holds no label under a documented key."
        made += labels or []
    if message is None and (not parts or not made):
        candidate.num_unmade += bool(parts)
        yield LeftOut(raw.place, WITHOUT)
        return
    if message is None:
        kind = [raw.kind] if raw.kind else []
        faults = filter(None, map(_fault, (*parts, *made, *kind)))
        message = " Also, ".join(dict.fromkeys(faults))
    if message:
        yield Fault(raw.place, "label", where + message)
        return
    candidate.several_outputs += len(made) > 1
    yield from (Row(raw.place, parts, result, raw.kind) for result in made)


def _ingredients(raw: Raw, joiner: str | None) -> tuple[list[str], str | None]:
    """Return the ingredients of a row, and why they are not certain, or None."""
    parts: list[str] = []
    message = None
    # Spreadsheets leave blank all cells but the first of those that they merged. In a grid of many
    # slots blanks are usual.
    if raw.parts[:1] == [""] and any(raw.parts) and len(raw.parts) <= _MOST_WITHOUT_GRID:
        filled = next(filter(None, raw.parts))
        message = (
            f"a blank cell before {filled!r:.80}, as where cells were merged; fill it, or write a "
            "single ingredient first."
        )
    for value in raw.parts:
        cell = _decoded(value)
        labels = _labels(cell)
        if labels is None:
            message = f"{shown(value)} holds no label under a documented key."
        elif isinstance(cell, list) and len(labels) > 1 and len(raw.parts) > 1:
            # A list in the place of one of several ingredients.
            message = (
                f"{shown(value)} may be choices of an ingredient or several ingredients; write "
                "each choice as a recipe of its own."
            )
        elif not isinstance(cell, str) or not cell or joiner == "":
            parts += labels
        elif joiner is None:
            message = f"{cell[:80]!r} may be one ingredient or several; write + between them."
        else:
            several = parts_of(cell, joiner)
            parts += several
            message = message or alternatives(several, joiner)
            if len(several) == 1 and any(sign in cell for sign in (*JOINERS, *WEAK_JOINERS)):
                message = f"{cell[:80]!r} may be one ingredient or several; write {joiner} between."
    return parts, message


def _decoded(value: Any) -> Any:
    """Return the list that a cell holds as text; any other value as it is."""
    listed = listed_value(value) if isinstance(value, str) else None
    return value if listed is None else listed


def _labels(value: Any) -> list[str] | None:
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        return [f"{NUMBER}{value}"]
    return labels_in(value)


def _fault(label: str) -> str | None:
    """Return why a cell may be no label, or None."""
    if label.startswith(NUMBER):
        return None
    seen = without_markup(trim_unseen(label))
    if is_missing(label):
        return (
            f"{label!r} may be a missing value or a label. Leave the cell empty; if it is a "
            f"label, write a table with the columns {_OWN_NAMES}."
        )
    if " + " in label and not is_half_product(label):
        return (
            f"{label[:80]!r} may be several things or one. {OWN_COLUMNS} As one label, it needs a "
            f"table with the columns {_OWN_NAMES} alone."
        )
    return formula_fault(label) or label_fault(seen)


# --- names ---------------------------------------------------------------------------------------


def names_by_id(things: Iterable[tuple[Any, Any]]) -> Names:
    """Return names by id.

    Args:
        things: id and name of each thing.

    Returns:
        The names; None where one id has several names. Empty if several ids have one name, so that
        names would merge things.
    """
    names: Names = {}
    for identifier, name in things:
        if identifier in (None, "") or not isinstance(name, str) or not name:
            continue
        keys = [str(identifier)]
        if is_number(identifier):
            keys.append(f"{NUMBER}{identifier}")
        for key in keys:
            known = names.setdefault(key, name)
            names[key] = name if known == name else None
    kept = [name for key, name in names.items() if name is not None and not key.startswith(NUMBER)]
    return {} if len(set(kept)) < len(kept) else names


def _named(entries: Sequence[Entry], tables: Sequence[Names], *, is_given: bool) -> list[Entry]:
    """Return entries in which the ids are names, if recipes use them."""
    rows = [entry for entry in entries if isinstance(entry, Row)]
    labels = {label for row in rows for label in (*row.ingredients, row.result)}
    table: Names = {}
    for each in tables:
        if labels & each.keys():
            table |= {
                key: name if table.get(key, name) == name else None for key, name in each.items()
            }
    if not labels & table.keys() and not any(label.startswith(NUMBER) for label in labels):
        return list(entries)
    names = set(table.values())
    # A label that is a name already stays, also if it is the id of something else.
    new = {label: label if label in names else table.get(label, label) for label in labels}
    if is_given:
        new = {label: (name or label).removeprefix(NUMBER) for label, name in new.items()}
    return [_renamed(entry, new) if isinstance(entry, Row) else entry for entry in entries]


def _renamed(row: Row, new: Names) -> Entry:
    *parts, made = labels = [new[label] for label in (*row.ingredients, row.result)]
    where = f"{row.place}: " if isinstance(row.place, str) else ""
    for old, label in zip((*row.ingredients, row.result), labels, strict=True):
        if label is None or label.startswith(NUMBER):
            belongs = "belongs to several things" if label is None else "is the id of nothing here"
            message = f"{where}{old.removeprefix(NUMBER)[:80]!r} {belongs}; give names instead."
            return Fault(row.place, "label", message, "id")
    return Row(row.place, [label or "" for label in parts], made or "", row.kind)
