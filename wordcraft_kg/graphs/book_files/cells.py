"""What cells hold beside labels: lists, joiners, numbers of pieces, marks, unseen characters.

Characters at the ends that cannot be seen are left out. Numbers such as in ``2 water`` are left out
if many cells have them; a few may as well be part of labels, and are only named, as are marks.
"""

import ast
import json
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import chain
from typing import Any

from wordcraft_kg.graphs.book_files.rows import Row
from wordcraft_kg.graphs.book_files.words import is_documented, name_rank, names_thing
from wordcraft_kg.graphs.label_notes import count_in

UNSEEN = "".join(
    (
        " \u00a0\u1680\u2000\u2001\u2002\u2003\u2004\u2005\u2006\u2007\u2008\u2009\u200a\u202f",
        "\u205f\u3000",  # blanks of other widths
        "\u200b\u200c\u200d\u2060\ufeff\u00ad",  # of no width, and a hyphen that is not shown
        "\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069",  # directions
    )
)
"""Characters at the ends of a cell that cannot be seen, and are no part of a label."""
_UNSEEN = re.compile(f"[{UNSEEN[1:]}]")
_SIGN = re.compile(r"\d\s?[x×*]\s|(?:^|[\s(])[x×*]\s?\d|[×*]\s?\d+$")
"""A sign of multiplication beside a number."""
_MARKUP = (
    re.compile(r"“([^“”]+)”|«\s?([^«»]+?)\s?»|„([^„“”]+)[“”]"),
    re.compile(r"\*\*([^*]+)\*\*|__([^_]+)__|`([^`]+)`"),
    re.compile(r"\[\[([^\[\]|]+)\]\]|\[([^\[\]]+)\]\([^()\s]*\)"),
)
"""Quotes, and markup of wikis and Markdown such as links, around a whole cell."""
_BESIDE = re.compile(
    r"^!\[[^\]]*\](?:\[[^\]]*\]|\([^()]*\))\s*(?:<br\s*/?>)?\s*(?=\S)"
    r"|(?<=\S)\s*\(https?://[^\s()]*\)$"
)
"""An image before a label, and an address behind it."""
_CLEAR = 0.2  # share of the cells with numbers by which these are numbers of pieces
_MOST_MERGERS = 0.1  # share of the rows with numbers that may make what they are made of


class Cells:
    """The labels in a file's cells.

    Attributes:
        trimmed: cells with characters at their ends that cannot be seen.
        unwrapped: cells with quotes or markup around them.
        numbers: numbers of pieces other than one that were left out.
        example: a cell with a number of pieces; empty if none is left out.
    """

    def __init__(self, rows: Iterable[Row]):
        """Judge cells by a file's rows.

        Args:
            rows: the recipes.
        """
        self.trimmed = 0
        self.unwrapped = 0
        self.numbers = 0
        # Most labels are met again: a look-up is faster than a check.
        self._clean: set[str] = set()
        self.example = _first_count([(*row.ingredients, row.result) for row in rows])

    def are_clean(self, cells: Collection[str]) -> bool:
        """Return whether cells are labels that were met before, without anything beside them."""
        return self._clean.issuperset(cells)

    def counted_label(self, cell: str) -> tuple[str, int]:
        """Return the label in a cell, and its number of pieces."""
        trimmed = trim_unseen(cell)
        self.trimmed += trimmed != cell
        seen = without_markup(trimmed)
        self.unwrapped += seen != trimmed
        found = count_in(seen) if self.example else None
        if found is None:
            if seen == cell:
                self._clean.add(cell)
            return seen, 1
        label, number = found
        self.numbers += number != 1
        return label, number


def trim_unseen(cell: str) -> str:
    """Return a cell without characters at its ends that cannot be seen.

    A cell of nothing else is empty. A joiner of width zero within an emoji stays.
    """
    if cell.isascii():
        return cell.strip(" ")
    return cell.strip(UNSEEN)


def without_markup(cell: str) -> str:
    """Return a cell without quotes and markup around all of it.

    Example:
        >>> [without_markup(cell) for cell in ("**[mud](/wiki/mud)**", "“mud”", "a **b**")]
        ['mud', 'mud', 'a **b**']
    """
    if "](" in cell or "![" in cell or "://" in cell:
        cell = _BESIDE.sub("", cell)
    # Markup may be nested, such as a bold link: each kind once from outside, and once more.
    for pattern in (*_MARKUP, *_MARKUP):
        found = pattern.fullmatch(cell)
        if found:
            cell = next(filter(None, found.groups())).strip()
    return cell


def has_unseen(text: str) -> bool:
    """Return whether a text holds characters that cannot be seen, other than plain spaces."""
    return not text.isascii() and _UNSEEN.search(text) is not None


def _first_count(rows: Sequence[Sequence[str]]) -> str:
    """Return a cell with a number of pieces if a clear share of the cells has such numbers.

    In games of merging, ``sword (1) + sword (1) = sword (2)``, numbers belong to labels: without
    them, rows would make what they are made of.
    """
    every_cell = chain.from_iterable(rows)
    times = Counter(without_markup(trim_unseen(cell)) for cell in every_cell)
    # Labels by the cells that hold a number of pieces beside them.
    bare: dict[str, str] = {}
    for cell in times:
        found = count_in(cell)
        if found:
            label, _ = found
            bare[cell] = label
    numbered = sum(times[cell] for cell in bare)
    if numbered < max(_CLEAR * times.total(), 1):
        return ""
    surely_counted = sum(times[cell] for cell in _surely_counted(bare, times))
    if surely_counted < _CLEAR * numbered:
        return ""  # such as 7 Up
    with_numbers = [row for row in rows if not bare.keys().isdisjoint(row)]
    mergers = sum(_is_merger(row, bare) for row in with_numbers)
    if mergers > _MOST_MERGERS * len(with_numbers):
        return ""
    return next(iter(bare))


def _surely_counted(bare: Mapping[str, str], cells: Collection[str]) -> list[str]:
    """Return cells whose number has a sign, or whose label also has another number, or none."""
    forms = Counter(bare.get(cell, cell) for cell in cells)
    return [cell for cell, label in bare.items() if _SIGN.search(cell) or forms[label] > 1]


def _is_merger(row: Sequence[str], bare: dict[str, str]) -> bool:
    """Return whether a row makes one of its ingredients only if numbers are left out."""
    *ingredients, result = row
    if result in ingredients:
        return False
    bare_ingredients = {bare.get(cell, cell) for cell in ingredients}
    return bare.get(result, result) in bare_ingredients


# --- several labels in one cell ------------------------------------------------------------------

JOINERS = (" + ", "+", ";", "|", "\n", "<br>", ",", "、", "，")
"""Signs between ingredients in one cell, the more certain ones first; cells without are single."""
WEAK_JOINERS = (" and ", " & ", "&", " x ", " × ", "×", " X ", " und ", " et ", " y ", "/", " - ")
"""Signs that labels hold as well: between ingredients if each cell has one."""
_OFTEN = 0.5  # share of the cells with a joiner
_LISTED = re.compile(r"\s*[\[({]\s*(?:[\[({]\s*)?[\"'].*[\])}]\s*", re.DOTALL)
_MOST_BRACKETS = 1_000  # in a cell; deeper lists are no recipes


def listed_value(cell: str) -> Any:
    """Return the list or dictionary in a cell, as pandas and other programs write it.

    Nothing is run: the cell is JSON, or literals of Python.

    Returns:
        The value; None for any other text.

    Example:
        >>> listed_value("['flour', 'egg']"), listed_value('{"egg": 2}'), listed_value("egg")
        (['flour', 'egg'], {'egg': 2}, None)
    """
    if not _LISTED.fullmatch(cell) or sum(map(cell.count, "[{(")) > _MOST_BRACKETS:
        return None
    for parse in (json.loads, ast.literal_eval):
        try:
            return parse(cell)
        except (ValueError, SyntaxError, TypeError, RecursionError, MemoryError):
            continue
    return None


def labels_in(value: Any) -> list[str] | None:
    """Return the labels in a value of JSON: a text, a list, an object with a name, or with numbers.

    Args:
        value: such as "egg", ["egg", {"name": "flour", "amount": 2}] or {"egg": 2}.

    Returns:
        The labels; None for a value whose labels no documented word names.
    """
    if value is None or value == "":
        return []
    if isinstance(value, str):
        return [value]
    if isinstance(value, list | tuple | set):
        # A label and its number of pieces, as in ["egg", 2].
        values = list(value)
        if len(values) == 2 and isinstance(values[0], str) and is_number(values[1]):
            return [values[0]]
        parts = [labels_in(part) for part in values]
        if None in parts:
            return None
        return list(chain.from_iterable(filter(None, parts)))
    if isinstance(value, dict):
        names = [key for key in value if names_thing(str(key)) and isinstance(value[key], str)]
        if names:
            return [value[min(names, key=name_rank)]]
        if value and all(isinstance(key, str) and is_number(value[key]) for key in value):
            return None if any(map(is_documented, value)) else list(value)
    return None


def is_number(value: Any) -> bool:
    """Return whether a value is a number, or a text of one."""
    if isinstance(value, str):
        return bool(_FIGURE.fullmatch(value.strip()))
    return isinstance(value, int | float) and not isinstance(value, bool)


_FIGURE = re.compile(r"[-+]?\d*[.,]?\d+(?:[eE][-+]?\d+)?%?")


_FORMULA = re.compile(
    r"[=@]\s*[A-Z.]+\(|=\$?[A-Z]{1,3}\$?\d|#(?:REF|VALUE|NAME|DIV/0|NULL|NUM)[!?]|#N/A$"
)


def formula_fault(cell: str) -> str | None:
    """Return why a cell is a spreadsheet's formula, or None."""
    if cell[:1] in ("=", "@", "#") and _FORMULA.match(cell):
        return f"{cell[:80]!r} is a spreadsheet's formula or its error; save the values."
    return None


def find_joiner(
    cells: Sequence[str], *, in_all: bool = False, allows_weak: bool = True
) -> str | None:
    """Return the sign between ingredients in cells, or an empty text for single labels.

    Args:
        cells: texts that are not blank.
        in_all: whether a sign must be in each cell, as where each one of a list is a sum.
        allows_weak: whether a sign that labels hold as well is enough.

    Returns:
        None if two signs fit, or one of them is in a few cells only.
    """
    counts = {sign: sum(sign in cell for cell in cells) for sign in (*JOINERS, *WEAK_JOINERS)}
    everywhere = [sign for sign in counts if cells and counts[sign] == len(cells)]
    if everywhere:
        return everywhere[0] if allows_weak or everywhere[0] in JOINERS else None
    if in_all:
        return ""
    present = [sign for sign in JOINERS if counts[sign]]
    often = [sign for sign in present if counts[sign] >= _OFTEN * len(cells)]
    if often:
        return often[0]
    is_parted = bool(present) or any(counts[sign] > _OFTEN * len(cells) for sign in WEAK_JOINERS)
    return None if is_parted else ""


def parts_of(cell: str, joiner: str) -> list[str]:
    """Return the labels in a cell; without a joiner the cell is one label."""
    if not joiner:
        return [cell]
    return [part.strip() for part in cell.split(joiner)]


def alternatives(ingredients: Sequence[str], joiner: str) -> str | None:
    """Return why the parts of a cell may be those of several recipes, or None.

    Args:
        ingredients: parts between joiners, such as "water", "earth or rain", "dirt".
        joiner: the sign between them.
    """
    if len(ingredients) > 1 and ingredients[0][:1] in "([{" and ingredients[-1][-1:] in ")]}":
        return f"{joiner.join(ingredients)[:80]!r} is no list that is read; leave its brackets out."
    for part in ingredients:
        sign = _ALTERNATIVE.search(part)
        has_sum = joiner.strip() != "+" and " + " in part
        if has_sum or (sign and len(ingredients) > 2):
            shown = "+" if sign is None else sign[0].strip()
            return (
                f"{part[:80]!r} in a sum of {len(ingredients)} may be the end of one recipe and "
                f"the start of another, with {shown!r} between them; write one in each row."
            )
    return None


_ALTERNATIVE = re.compile(r"[;|]| or | / |<br\s*/?>|, ", re.IGNORECASE)
