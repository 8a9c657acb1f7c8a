"""What every reader yields: recipes with places, faults, and rows that are no recipe."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import NamedTuple

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


class RowSource(ABC):
    """The entries of one file in one shape; iterate once.

    Attributes:
        shape: name of the shape, for people.
        base: declared base entities with their places; None without a declaration.
        listed: entities that the file lists outside of recipes, with their places.
        kind_of: kind of reasoning by sorted ingredients and result; filled while iterating.
        delimiter, quote, columns, ignored, header: see
            :class:`~wordcraft_kg.graphs.reading.Reading`.
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
        self.ignored: tuple[str, ...] = ()
        self.counts_dropped = 0
        self.several_outputs = 0
        self.notes: list[str] = []

    @abstractmethod
    def __iter__(self) -> Iterator[Entry]:
        """Yield recipes, faults and rows left out, in the file's order."""
