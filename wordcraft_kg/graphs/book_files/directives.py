"""Comments that declare entities, in tables and lines: ``# base: a, b`` and ``# entities: c``."""

import csv

from wordcraft_kg.graphs.book_files.dialects import trimmed
from wordcraft_kg.graphs.book_files.rows import Fault, RowSource
from wordcraft_kg.graphs.recipes import label_fault

_LIMIT = 100_000  # characters in a line


def is_directive(line: str) -> bool:
    """Return whether a comment declares base entities, or lists entities."""
    if not line.startswith("#"):
        return False
    key, colon, _ = line[1:].partition(":")
    return bool(colon) and key.strip().lower() in ("base", "entities")


def read_directive(source: RowSource, number: int, line: str) -> Fault | None:
    """Note the entities that a comment declares; return its fault, or None.

    Args:
        source: the file's reader, which gets the entities.
        number: the line's number.
        line: a line with ``#``; other comments are passed over.
    """
    if not is_directive(line):
        return None
    if len(line) > _LIMIT:
        message = f"a line of {len(line):,} characters; the limit is {_LIMIT:,}."
        return Fault(number, "directive", message)
    key, _, rest = line[1:].partition(":")
    # One line gives one row, or none if nothing follows the colon.
    labels = next(csv.reader([trimmed(rest.strip(), ",")]), [])
    for label in labels:
        fault = label_fault(label)
        if fault is not None:
            return Fault(number, "directive", fault)
    if key.strip().lower() == "base":
        source.base = (source.base or {}) | dict.fromkeys(labels, number)
    else:
        source.listed |= dict.fromkeys(labels, number)
    return None
