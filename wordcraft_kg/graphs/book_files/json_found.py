"""What the shapes of JSON have in common: the value they look at, and what they find."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from wordcraft_kg.graphs.book_files.rows import Fault, LeftOut


class RawRecipe(NamedTuple):
    """A recipe before its labels are checked.

    Attributes:
        where: place in the file.
        shown: the value, for errors.
        ingredients: values that stand for ingredients.
        result: value that stands for the result.
        kind: kind of reasoning, or empty.
        counts: numbers of pieces next to the values, which are not kept.
    """

    where: str
    shown: Any
    ingredients: Sequence[Any]
    result: Any
    kind: Any = ""
    counts: int = 0


@dataclass
class FoundShape:
    """A shape that fits a value.

    Attributes:
        shape: name for people.
        raws: recipes, faults and rows left out.
        listed: entities outside of recipes, as values.
        known: labels that recipes may name; None for any.
        base: declared base; None without one.
        columns: keys that were read, those of results last.
        num_results: number of keys of results.
        ignored: keys that were not read.
        names: labels by id, for values that are ids.
        indices: whether integers are indices into ``names``.
        nothing: whether Infinite Craft's Nothing is no entity.
        counts_dropped: numbers of results that are not kept.
    """

    shape: str
    raws: Iterable[RawRecipe | Fault | LeftOut]
    listed: Sequence[Any] = ()
    known: frozenset[str] | None = None
    base: Sequence[str] | None = None
    columns: tuple[str, ...] = ()
    num_results: int = 1
    ignored: tuple[str, ...] = ()
    names: Mapping[Any, str] = field(default_factory=dict)
    indices: bool = False
    nothing: bool = False
    counts_dropped: int = 0


class JsonPart(NamedTuple):
    """A value within a JSON file, as the shapes look at it.

    Attributes:
        path: the file, for errors.
        value: the parsed value.
        where: keys that lead to the value, with points between them; empty for the whole file.
        columns: the option `columns`; None to guess.
        names: names of things by id, where they stand beside the value.
    """

    path: Path
    value: Any
    where: str = ""
    columns: Sequence[str] | None = None
    names: Mapping[Any, str] = MappingProxyType({})

    def with_names(self, rows: Sequence[Sequence[Any]]) -> list[list[Any]]:
        """Return rows of cells with names in place of ids; other cells stay as they are."""
        named = []
        for row in rows:
            named.append([self.names.get(cell, cell) for cell in row])
        return named


ShapeOf = Callable[[JsonPart], FoundShape | None]
"""Returns what it finds in a value, or None if the value has another shape."""
