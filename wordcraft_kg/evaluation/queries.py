"""Scorer queries: triples or recipes with at most one open entity, from arguments or a file."""

import csv
import io
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Self

from wordcraft_kg.base import (
    ConfigError,
    QueryFileError,
    UnknownEntityError,
    WordCraftKGError,
    nearest,
)
from wordcraft_kg.graphs.triples import RELATIONS

OPEN = ("_", "?")
"""Spellings for an open slot; shells expand ``?``, but not ``_``."""
_PLUS = "+"
_MAKES = ("=", "->", "→")
"""Signs of a recipe query, ``a + b = c``; ``=`` and ``+`` need no quotes in a shell."""
_SIGNS = {_PLUS, *_MAKES}
_SIGN = re.compile(r"\s*(\+|=|->|→)\s*")


@dataclass(frozen=True)
class Query:
    """A query for a triple, as labels of which at most one may be open.

    Attributes:
        columns: names of the slots, the header of a file of such queries.
        entity_slots: places of the slots that hold an entity.
        slots: a label for each column; None for the open slot.
        line: line of the file that the query was read from, from 1; None for arguments.
    """

    columns: ClassVar[tuple[str, str, str]] = ("head", "relation", "tail")
    entity_slots: ClassVar[tuple[int, ...]] = (0, 2)

    slots: tuple[str | None, str | None, str | None]
    line: int | None = None

    @classmethod
    def of(
        cls, words: Sequence[str], entities: Collection[str], *, line: int | None = None
    ) -> Self:
        """Make a query from three typed words; an empty word and :data:`OPEN` leave a slot open.

        Args:
            words: a word for each column.
            entities: labels of the graph. An entity may have the label ``_``, which then means the
                entity.
            line: line of the file, from 1; None for arguments.

        Raises:
            UnknownEntityError: for an unknown relation; the error names the nearest.
            ConfigError: if several slots are open.
        """
        cls._check_relation(words[1])
        first, second, third = (
            None if word in ("", *OPEN) and word not in entities else word for word in words
        )
        slots = (first, second, third)
        if slots.count(None) > 1:
            raise ConfigError(cls._too_open(slots))
        return cls(slots, line)

    @classmethod
    def _check_relation(cls, word: str) -> None:
        if word not in RELATIONS:
            raise UnknownEntityError(
                f"no relation '{word}'; expected {' or '.join(RELATIONS)}."
                f"{nearest(word, RELATIONS)}"
            )

    @classmethod
    def _too_open(cls, slots: Sequence[str | None]) -> str:
        return "both slots are open: name the head or the tail."

    @property
    def is_open(self) -> bool:
        """Whether a slot is open."""
        return None in self.slots

    @property
    def labels(self) -> list[str]:
        """The named entities."""
        labels = (self.slots[place] for place in self.entity_slots)
        return [label for label in labels if label is not None]


class RecipeQuery(Query):
    """A query for a recipe, see :class:`Query`."""

    columns = ("ingredient_a", "ingredient_b", "result")
    entity_slots = (0, 1, 2)

    @classmethod
    def _check_relation(cls, word: str) -> None:
        """Accept any word: the second slot of a recipe is an entity."""

    @classmethod
    def _too_open(cls, slots: Sequence[str | None]) -> str:
        first, second, result = (slot or "_" for slot in slots)
        return (
            f"{first} + {second} = {result} has several open slots: leave a single slot open, an "
            "ingredient or the result."
        )


def parse_query(words: Sequence[str], entities: Collection[str]) -> Query:
    """Parse a triple or recipe query from command line arguments.

    A triple is ``head relation [tail]``; a query without tail ranks all tails. A recipe is ``a +
    b``, ``a + b c`` or ``a + b = c``, in any number of arguments; ``->`` and ``→`` mean ``=``.
    Arguments that are labels in ``entities`` are never split. A query may name other entities.

    Args:
        words: the arguments.
        entities: labels of the graph.

    Raises:
        UnknownEntityError: for an unknown relation; the error names the nearest.
        ConfigError: if the arguments are neither triple nor recipe, or several entities are open.
    """
    # With a relation, the arguments are a triple, even if a label contains a sign.
    is_triple = any(word in RELATIONS for word in words)
    pieces = [] if is_triple else list(_pieces(words, entities))
    if _SIGNS.isdisjoint(pieces):
        if len(words) not in (2, 3):
            raise _unreadable(
                words, "query", "a head, a relation and perhaps a tail, or a recipe such as a + b"
            )
        return Query.of([*words, ""][:3], entities)
    # The sign before the result is optional: a + b c.
    if len(pieces) > 3 and pieces[3] in _MAKES:
        del pieces[3]
    labels = pieces[:1] + pieces[2:]
    if len(labels) not in (2, 3) or pieces[1] != _PLUS or not _SIGNS.isdisjoint(labels):
        raise _unreadable(
            words, "recipe", "a + b for its results, a + b = c, or _ + b = c for its partners"
        )
    return RecipeQuery.of([*labels, ""][:3], entities)


def pieces_of_recipe(
    words: Sequence[str], entities: Collection[str]
) -> tuple[tuple[str, ...], str | None]:
    """Return the ingredients and the result of a recipe of any size, ``a + b + c -> d``.

    Args:
        words: the arguments, as for :func:`parse_query`.
        entities: labels of the graph, which are never split.

    Returns:
        Labels of the ingredients, and of the result; None without a result.

    Raises:
        ConfigError: if the arguments are no recipe.
    """
    pieces = list(_pieces(words, entities))
    result = None
    if len(pieces) > 2 and pieces[-2] in _MAKES:
        result = pieces.pop()
        pieces.pop()
    labels, signs = pieces[::2], pieces[1::2]
    if not labels or len(labels) == len(signs) or set(signs) - {_PLUS} or _SIGNS & set(labels):
        raise _unreadable(words, "recipe", "a + b + c -> d")
    return tuple(labels), result


def _pieces(words: Sequence[str], entities: Collection[str]) -> Iterator[str]:
    """Yield labels and signs; a word that is a label, such as ``a+b``, is not split."""
    for word in words:
        if word in entities:
            yield word
        else:
            yield from filter(None, _SIGN.split(word))


def _unreadable(words: Sequence[str], query: str, expected: str) -> ConfigError:
    return ConfigError(
        f"cannot parse {query} '{' '.join(words)}'; expected {expected}. Quote labels with several "
        "words."
    )


def read_queries(path: Path, entities: Collection[str]) -> list[Query]:
    """Read queries from a CSV or TSV file of triples or recipes.

    Recipes need the header ingredient_a, ingredient_b, result; triples need none. A tab in the
    first line means unquoted TSV, as in a graph folder's ``triples/``; otherwise the file is CSV.
    Blank lines are skipped.

    Args:
        path: the file.
        entities: labels of the graph.

    Raises:
        QueryFileError: if the file cannot be read, has no query, or has a wrong line, which the
            error names.
    """
    rows = list(_rows(path))
    header = tuple(rows[0][1]) if rows else ()
    kind = RecipeQuery if header == RecipeQuery.columns else Query
    # An entity may be called "head": only a whole row of these words is a header.
    if header == kind.columns:
        del rows[0]
    queries = []
    for line, cells in rows:
        if len(cells) != 3:
            shown = ",".join(cells)[:80]
            raise QueryFileError(
                f"{path}, line {line}: '{shown}' has {len(cells)} columns; expected "
                f"{', '.join(kind.columns)}."
            )
        try:
            queries.append(kind.of(cells, entities, line=line))
        except WordCraftKGError as error:
            raise QueryFileError(f"{path}, line {line}: {error}") from None
    if not queries:
        raise QueryFileError(f"{path} has no query; expected lines with {', '.join(kind.columns)}.")
    return queries


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the cells of each line that is not blank, and the line where they begin."""
    if not path.is_file():
        raise QueryFileError(
            f"'{path}' is not a file; expected a CSV or TSV file with {', '.join(Query.columns)}."
        )
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise QueryFileError(
            f"{path} is not UTF-8 (byte {error.start:,}). Save the file as UTF-8."
        ) from None
    lines = io.StringIO(text, newline="")
    if "\t" in text.partition("\n")[0]:
        reader = csv.reader(lines, delimiter="\t", quoting=csv.QUOTE_NONE, strict=True)
    else:
        reader = csv.reader(lines, strict=True)
    # A quoted cell may span lines, so the reader's line number is the last line of a row.
    begin = 1
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield begin, cells
            begin = reader.line_num + 1
    except csv.Error as error:
        raise QueryFileError(f"{path}, line {reader.line_num}: {error}.") from None
