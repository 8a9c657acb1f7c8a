"""What every reader yields: recipes with places, faults, and rows that are no recipe."""

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from wordcraft_kg.graphs.recipes import RecipeRows

Place = int | str
"""Line number from 1, or a path in a JSON file or archive, such as ``recipes[3]``."""
Row = tuple[Place, Sequence[str]]
"""A recipe: its place, and valid labels, the result last and one or more ingredients before."""


class Fault(NamedTuple):
    """An entry that should be a recipe and is none.

    Attributes:
        place: where it stands.
        kind: violated rule: ``directive``, ``header``, ``row`` or ``label``.
        message: what was found and what was expected; for places in JSON, with the place.
        group: equal for faults of one cause, such as a column too many in all rows; empty for
            a message that is its own group.
    """

    place: Place
    kind: str
    message: str
    group: str = ""


class LeftOut(NamedTuple):
    """An entry that is rightly no recipe, such as a recipe whose result is Nothing.

    Attributes:
        place: where it stands.
        reason: words for a number of such rows, such as "with the result Nothing".
    """

    place: Place
    reason: str


Entry = Row | Fault | LeftOut
NOTHING = "Nothing"
"""Result of pairs that make nothing in Infinite Craft."""
WITH_NOTHING = "with the result Nothing"
FROM_NOTHING = "with Nothing as ingredient"
"""Reasons for which such rows are left out."""
INFINITE_CRAFT_BASE = ("Earth", "Fire", "Water", "Wind")
_MISSING = frozenset({"NA", "N/A", "n/a", "<NA>", "nan", "NaN", "NULL", "null", "None", "-", "--"})
_ALTERNATIVE = re.compile(r"[;|]| or | / |<br\s*/?>", re.IGNORECASE)


def is_missing(cell: str) -> bool:
    """Return whether a cell is what programs write for an empty one."""
    return cell in _MISSING


def is_infinite_craft(text: str) -> bool:
    """Return whether a text holds the base of Infinite Craft, and its Nothing."""
    words = (NOTHING, *INFINITE_CRAFT_BASE)
    # A plain search is fast, and most texts lack one of the words.
    if not all(word in text for word in words):
        return False
    return all(re.search(rf"\b{word}\b", text) for word in words)


def alternatives(ingredients: Sequence[str]) -> str | None:
    """Return why the parts of a sum may be those of several sums, or None.

    Args:
        ingredients: parts between pluses or other joiners, such as "water", "earth or rain",
            "dirt". With two parts, the sign may as well be part of a label.
    """
    for part in ingredients if len(ingredients) > 2 else ():
        sign = _ALTERNATIVE.search(part)
        if sign:
            return (
                f"{part[:80]!r} in a sum of {len(ingredients)} may be the end of one recipe and "
                f"the start of another, with {sign[0].strip()!r} between them; write one in each "
                "row."
            )
    return None


class RowSource(ABC):
    """The entries of one file in one shape; iterate once.

    Attributes:
        shape: name of the shape, for people.
        base: declared base entities with their places; None without a declaration.
        listed: entities that the file lists outside of recipes, with their places.
        kind_of: kind of reasoning by sorted ingredients and result; filled while iterating.
        delimiter, quote, columns, num_results, ignored, header: see
            :class:`~wordcraft_kg.graphs.reading.Reading`.
        is_exact: whether cells are labels as they stand, as in our own shapes.
        trimmed: cells without the characters at their ends that cannot be seen; counted while
            iterating.
        counts_dropped: ingredients whose number of pieces was dropped; counted while iterating.
        several_outputs: entries with several results; counted while iterating.
        notes: remarks for the announcement.
    """

    shape = ""

    def __init__(self) -> None:
        self.base: dict[str, Place] | None = None
        self.listed: dict[str, Place] = {}
        self.kind_of: dict[tuple[tuple[str, ...], str], str] = {}
        self.delimiter = ""
        self.quote = ""
        self.header = True
        self.columns: tuple[str, ...] = ()
        self.num_results = 1
        self.ignored: tuple[str, ...] = ()
        self.is_exact = False
        self.trimmed = 0
        self.counts_dropped = 0
        self.several_outputs = 0
        self.notes: list[str] = []

    def all_rows(self) -> RecipeRows | None:
        """Return all entries at once, if each is a plain recipe of valid labels; None to iterate.

        A recipe of this kind has two ingredients, and counts for nothing but itself.
        """
        return None

    @abstractmethod
    def __iter__(self) -> Iterator[Entry]:
        """Yield recipes, faults and rows left out, in the file's order."""
