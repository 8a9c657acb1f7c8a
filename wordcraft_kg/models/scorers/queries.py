"""What a scorer is asked: a triple, or one with an open slot; read from arguments or from a file."""

import csv
import io
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from wordcraft_kg.errors import ConfigError, QueryFileError, UnknownEntityError, WordCraftKGError
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.settings import nearest

OPEN = ("_", "?")
"""How an open slot is written; ``_`` needs no quotes in a shell, where ``?`` stands for any file of one letter."""
HEADER = ["head", "relation", "tail"]


@dataclass(frozen=True)
class Query:
    """A triple of labels in which the head or the tail may be open (None).

    Attributes:
        line: line of the file that it was read from, from 1.
    """

    head: str | None
    relation: str
    tail: str | None
    line: int | None = None

    @classmethod
    def of(cls, head: str, relation: str, tail: str, entities: Collection[str], *, line: int | None = None) -> "Query":
        """Check a query as it was typed: :data:`OPEN` or nothing is an open slot, unless an entity has this label.

        Raises:
            UnknownEntityError: for an unknown entity or relation, with the nearest ones.
            ConfigError: if both slots are open.
        """
        slots = [None if slot in ("", *OPEN) and slot not in entities else slot for slot in (head, tail)]
        if slots == [None, None]:
            raise ConfigError("both slots are open: name the head or the tail.")
        if relation not in RELATIONS:
            hint = nearest(relation, RELATIONS)
            raise UnknownEntityError(f"no relation '{relation}'; expected one of {', '.join(RELATIONS)}.{hint}")
        for slot in slots:
            if slot is not None and slot not in entities:
                raise UnknownEntityError(f"no entity '{slot}'.{nearest(slot, list(entities))}")
        return cls(slots[0], relation, slots[1], line)

    @property
    def is_open(self) -> bool:
        """Whether a slot is open."""
        return self.head is None or self.tail is None


def read_queries(path: Path, entities: Collection[str]) -> list[Query]:
    """Read queries from a CSV or TSV file of three columns, head, relation and tail; a header is optional.

    Columns are separated by tabs if the first line has one, without quotes, as in a graph folder's ``triples/``; else
    by commas. Blank lines are skipped.

    Raises:
        QueryFileError: if the file cannot be read, naming the line if one is wrong.
    """
    queries: list[Query] = []
    for line, cells in _rows(path):
        if cells == HEADER and not queries:
            continue
        where = f"{path}, line {line}"
        if len(cells) != len(HEADER):
            shown = ",".join(cells)[:80]
            raise QueryFileError(f"{where}: '{shown}' has {len(cells)} columns; expected {', '.join(HEADER)}.")
        try:
            queries.append(Query.of(cells[0], cells[1], cells[2], entities, line=line))
        except WordCraftKGError as error:
            raise QueryFileError(f"{where}: {error}") from None
    if not queries:
        raise QueryFileError(f"{path} has no query; expected lines of {', '.join(HEADER)}.")
    return queries


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the cells of each line that is not blank, with the number of the line on which they begin."""
    if not path.is_file():
        raise QueryFileError(f"'{path}' is not a file; expected a CSV or TSV file of {', '.join(HEADER)}.")
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise QueryFileError(f"{path} is not UTF-8 (byte {error.start:,}). Save it as UTF-8.") from None
    lines = io.StringIO(text, newline="")
    if "\t" in text.partition("\n")[0]:
        reader = csv.reader(lines, delimiter="\t", quoting=csv.QUOTE_NONE, strict=True)
    else:
        reader = csv.reader(lines, strict=True)
    begun = 1
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield begun, cells
            begun = reader.line_num + 1
    except csv.Error as error:
        raise QueryFileError(f"{path}, line {reader.line_num}: {error}.") from None
