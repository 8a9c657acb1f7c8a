"""Scorer queries: triples or recipes with at most one open entity, from arguments or a file."""

import csv
import io
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wordcraft_kg.base.errors import (
    ConfigError,
    QueryFileError,
    UnknownEntityError,
    WordCraftKGError,
)
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.graphs.triples import RELATIONS

OPEN = ("_", "?")
"""Spellings for an open slot; shells expand ``?``, but not ``_``."""
HEADER = ["head", "relation", "tail"]
"""Optional header of a file of triples."""
_RECIPE_HEADER = ["ingredient_a", "ingredient_b", "result"]
"""Header of a file of recipe queries; files without header contain triples."""
_PLUS = "+"
_MAKES = ("=", "->", "→")
"""Signs of a recipe query, ``a + b = c``; ``=`` and ``+`` need no quotes in a shell."""
_SIGNS = {_PLUS, *_MAKES}
_SIGN = re.compile(r"\s*(\+|=|->|→)\s*")


class _Slots:
    """Labels of a query, of which one may be open (None)."""

    @property
    def slots(self) -> tuple[str | None, ...]:
        raise NotImplementedError

    @property
    def is_open(self) -> bool:
        """Whether a slot is open."""
        return None in self.slots

    @property
    def labels(self) -> list[str]:
        """The named entities."""
        return [slot for slot in self.slots if slot is not None]


@dataclass(frozen=True)
class Query(_Slots):
    """A query for a triple, as labels.

    Attributes:
        head: the head; None if open.
        relation: the relation.
        tail: the tail; None if open.
        line: line of the file that the query was read from, from 1; None for arguments.
    """

    head: str | None
    relation: str
    tail: str | None
    line: int | None = None

    @classmethod
    def of(
        cls,
        head: str,
        relation: str,
        tail: str,
        entities: Collection[str],
        *,
        line: int | None = None,
    ) -> "Query":
        """Make a query from typed words; an empty word and :data:`OPEN` leave a slot open.

        Args:
            head: the typed head.
            relation: the typed relation.
            tail: the typed tail.
            entities: labels of the graph. An entity may have the label ``_``, which then means the
                entity.
            line: line of the file, from 1; None for arguments.

        Raises:
            UnknownEntityError: for an unknown relation; the error names the nearest.
            ConfigError: if both slots are open.
        """
        slots = _slots((head, tail), entities)
        if slots == [None, None]:
            raise ConfigError("both slots are open: name the head or the tail.")
        if relation not in RELATIONS:
            hint = nearest(relation, RELATIONS)
            raise UnknownEntityError(
                f"no relation '{relation}'; expected {' or '.join(RELATIONS)}.{hint}"
            )
        return cls(slots[0], relation, slots[1], line)

    @property
    def slots(self) -> tuple[str | None, str | None]:
        """Head and tail, None if open."""
        return self.head, self.tail


@dataclass(frozen=True)
class RecipeQuery(_Slots):
    """A query for a recipe, as labels of which at most one may be open.

    Attributes:
        ingredient_a: an ingredient; None if open.
        ingredient_b: the second ingredient; None if open.
        result: the result; None if open.
        line: line of the file that the query was read from, from 1; None for arguments.
    """

    ingredient_a: str | None
    ingredient_b: str | None
    result: str | None
    line: int | None = None

    @classmethod
    def of(
        cls, a: str, b: str, result: str, entities: Collection[str], *, line: int | None = None
    ) -> "RecipeQuery":
        """Make a query from typed words; open slots are those of :meth:`Query.of`.

        Args:
            a: the typed ingredient.
            b: the typed second ingredient.
            result: the typed result.
            entities: labels of the graph.
            line: line of the file, from 1; None for arguments.

        Raises:
            ConfigError: if several slots are open.
        """
        slots = _slots((a, b, result), entities)
        if slots.count(None) > 1:
            shown = f"{slots[0] or '_'} + {slots[1] or '_'} = {slots[2] or '_'}"
            raise ConfigError(
                f"{shown} has several open slots: leave a single slot open, an ingredient or the "
                "result."
            )
        return cls(slots[0], slots[1], slots[2], line)

    @property
    def slots(self) -> tuple[str | None, str | None, str | None]:
        """Both ingredients and the result, None if open."""
        return self.ingredient_a, self.ingredient_b, self.result


def parse_query(words: Sequence[str], entities: Collection[str]) -> Query | RecipeQuery:
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
        head, relation, *tail = words
        return Query.of(head, relation, tail[0] if tail else "", entities)
    # The sign before the result is optional: a + b c.
    if len(pieces) > 3 and pieces[3] in _MAKES:
        del pieces[3]
    labels = pieces[:1] + pieces[2:]
    if len(labels) not in (2, 3) or pieces[1] != _PLUS or not _SIGNS.isdisjoint(labels):
        raise _unreadable(
            words, "recipe", "a + b for its results, a + b = c, or _ + b = c for its partners"
        )
    a, b, *result = labels
    return RecipeQuery.of(a, b, result[0] if result else "", entities)


def _pieces(words: Sequence[str], entities: Collection[str]) -> Iterator[str]:
    """Yield labels and signs; a word that is a label, such as ``a+b``, is not split."""
    for word in words:
        if word in entities:
            yield word
        else:
            yield from filter(None, _SIGN.split(word))


def _unreadable(words: Sequence[str], what: str, expected: str) -> ConfigError:
    return ConfigError(
        f"cannot parse {what} '{' '.join(words)}'; expected {expected}. Quote labels with several "
        "words."
    )


def _slots(typed: Sequence[str], entities: Collection[str]) -> list[str | None]:
    return [None if slot in ("", *OPEN) and slot not in entities else slot for slot in typed]


def read_queries(path: Path, entities: Collection[str]) -> list[Query] | list[RecipeQuery]:
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
    header = rows[0][1] if rows and rows[0][1] in (HEADER, _RECIPE_HEADER) else None
    has_recipes = header == _RECIPE_HEADER
    kind = RecipeQuery if has_recipes else Query
    columns = _RECIPE_HEADER if has_recipes else HEADER
    # An entity may be called "head": only a whole row of these words is a header.
    if header is not None:
        del rows[0]
    queries: list[Any] = []
    for line, cells in rows:
        if len(cells) != 3:
            shown = ",".join(cells)[:80]
            expected = ", ".join(columns)
            raise QueryFileError(
                f"{path}, line {line}: '{shown}' has {len(cells)} columns; expected {expected}."
            )
        try:
            queries.append(kind.of(cells[0], cells[1], cells[2], entities, line=line))
        except WordCraftKGError as error:
            raise QueryFileError(f"{path}, line {line}: {error}") from None
    if not queries:
        raise QueryFileError(f"{path} has no query; expected lines with {', '.join(columns)}.")
    return queries


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the cells of each line that is not blank, and the line where they begin."""
    if not path.is_file():
        raise QueryFileError(
            f"'{path}' is not a file; expected a CSV or TSV file with {', '.join(HEADER)}."
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
    begun = 1
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield begun, cells
            begun = reader.line_num + 1
    except csv.Error as error:
        raise QueryFileError(f"{path}, line {reader.line_num}: {error}.") from None
