"""What every reader yields: recipes, faults and rows left out; and the words of refusals."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.recipes import NOTHING, Reading, RecipeRows

Place = int | str
"""Line number from 1, or a path in a JSON file or archive, such as ``recipes[3]``."""
GUIDE = "docs/your-file.md"
"""Guide with an example of each readable shape."""
SHAPES = {
    "table": "a table with two columns of ingredients and one of results: a,b,result",
    "lines": "a line for each recipe: water + earth = mud",
    "json": 'JSON such as {"mud": [["water", "earth"]]} or '
    '[{"name": "mud", "recipes": [["water", "earth"]]}], or any JSON by paths in `--columns`, such '
    "as 'recipes[].parts[],recipes[].out.name'",
    "infinite-craft": 'a save of Infinite Craft: {"items": [{"id": 0, "text": "Water"}, ...]}',
    "minecraft": "a data pack with JSON files in a folder recipe or recipes",
    "compressed": "a file that is gzip, or a zip archive with one recipe book",
    "encodings": "text in UTF-8",
    "arities": "recipes of one to eight ingredients",
}
"""Readable shapes by the anchor of their section in the guide."""
MAX_LINE_LENGTH = 100_000
"""Longest line, in characters: a file without line ends fails early, with the reason."""
INFINITE_CRAFT_BASE = ("Earth", "Fire", "Water", "Wind")
WITHOUT = "without ingredients or result"


class Raw(NamedTuple):
    """A row of a file: values in which labels are to be found.

    Attributes:
        place: where it stands.
        parts: cells or values of JSON with the ingredients.
        results: those with the results.
        kind: kind of reasoning.
        quantities: a number for each ingredient, with blanks between; empty without them.
    """

    place: Place
    parts: Sequence[Any]
    results: Sequence[Any]
    kind: str = ""
    quantities: str = ""


class Row(NamedTuple):
    """A recipe.

    Attributes:
        place: where it stands.
        ingredients: one or more labels.
        result: label of what they make.
        kind: kind of reasoning; empty without one.
        quantities: a number for each ingredient, with blanks between; empty without them.
    """

    place: Place
    ingredients: Sequence[str]
    result: str
    kind: str = ""
    quantities: str = ""


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


@dataclass
class FileRows:
    """The entries of one file in one shape.

    Attributes:
        reading: what is known of how the file is read.
        entries: recipes, faults and rows left out, in the file's order.
        base: declared base entities with their places; None without a declaration.
        listed: entities that the file lists outside of recipes, with their places.
        is_exact: whether cells are labels as they stand, as in our own shapes.
        numbered: all recipes at once, if each row is a plain recipe of two ingredients.
        records: cells of a table's rows by the names of the columns, by line.
    """

    reading: Reading
    entries: Iterable[Entry] = ()
    base: dict[str, Place] | None = None
    listed: dict[str, Place] = field(default_factory=dict)
    is_exact: bool = False
    numbered: RecipeRows | None = None
    records: dict[Place, dict[str, str]] = field(default_factory=dict)


def refusal(path: Path | str, seen: str, anchor: str, remedy: str = "") -> RecipeFileError:
    """Return the error for a file that is not read; the caller raises it.

    Args:
        path: the file.
        seen: what was seen, and what is missing.
        anchor: key of :data:`SHAPES`: the nearest readable shape.
        remedy: a sentence about what to do; empty if the readable shape says it.

    Returns:
        The error, which names the nearest readable shape and the guide.
    """
    hint = f" {remedy}" if remedy else ""
    return RecipeFileError(
        f"{path}: {seen}.{hint} Nearest readable shape: {SHAPES[anchor]}. See {GUIDE}#{anchor}."
    )


def fault_at(place: Place, kind: str, message: str, group: str = "") -> Fault:
    """Return a fault, whose message names a place that is no line.

    Args:
        place: where the entry stands: a line, or the path of a value in JSON.
        kind: violated rule, see :class:`Fault`.
        message: what was found and what was expected.
        group: equal for faults of one cause; empty for a message that is its own group.
    """
    prefix = f"{place}: " if isinstance(place, str) else ""
    return Fault(place, kind, prefix + message, group)


def is_infinite_craft(entries: Iterable[Entry]) -> bool:
    """Return whether labels tell that the game is Infinite Craft: its base is among ingredients."""
    rows = (entry for entry in entries if isinstance(entry, Row))
    labels = set(chain.from_iterable(row.ingredients for row in rows))
    return labels.issuperset(INFINITE_CRAFT_BASE)


def without_nothing(entries: Iterable[Entry]) -> list[Entry]:
    """Return entries of Infinite Craft, in which Nothing is no result.

    Args:
        entries: all entries of a file whose labels hold the base of Infinite Craft.
    """
    filtered_entries: list[Entry] = []
    for entry in entries:
        if isinstance(entry, Row) and entry.result == NOTHING:
            filtered_entries.append(LeftOut(entry.place, "with the result Nothing"))
        elif isinstance(entry, Row) and NOTHING in entry.ingredients:
            filtered_entries.append(LeftOut(entry.place, "with Nothing as ingredient"))
        else:
            filtered_entries.append(entry)
    return filtered_entries
