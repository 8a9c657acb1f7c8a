"""Tables: a row for each recipe, in any dialect, with columns in any order.

A table is a list of records by the names in its header, or of lists of cells without one. So its
columns have the rules of JSON: ``json_books`` finds ingredients and results by documented words, or
by the option `columns`.
"""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence, Set
from functools import cache
from itertools import chain
from operator import ne
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from wordcraft_kg.base.errors import ConfigError, RecipeFileError
from wordcraft_kg.base.wording import counted
from wordcraft_kg.graphs.book_files.cells import exact_fault, has_unseen, is_number, trim_unseen
from wordcraft_kg.graphs.book_files.documents import Document
from wordcraft_kg.graphs.book_files.paths import EACH
from wordcraft_kg.graphs.book_files.rows import (
    MAX_LINE_LENGTH,
    Fault,
    FileRows,
    LeftOut,
    refusal,
)
from wordcraft_kg.graphs.book_files.words import (
    KIND,
    is_documented,
    is_name,
    is_plain,
    ways_by_words,
)
from wordcraft_kg.graphs.plain_rows import number_plain_rows
from wordcraft_kg.graphs.reading import Reading
from wordcraft_kg.graphs.recipes import label_fault

CSV_HEADER = ("ingredient_a", "ingredient_b", "result")
ENDINGS = {".csv": ",", ".tsv": "\t", ".tab": "\t"}
"""Usual column delimiters by file ending."""
DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "pipes"}
"""Column delimiters that are tried, with their names."""
_SPELT = {"comma": ",", "semicolon": ";", "tab": "\t", "\\t": "\t", "pipe": "|", "space": " "}
_OWN = (CSV_HEADER, (*CSV_HEADER, KIND))
_SAMPLE_ROWS = 200
_EVEN = 0.9  # share of rows with the most frequent number of cells
_FEWEST_BELOW = 3  # rows below a header of other words
_HEADER_ROWS = 6  # first rows among which the header is
_RULE = re.compile(r"[-=+:\s|]*[-=]{2,}[-=+:\s|]*|[-=+:\s|]*:[-=][-=+:\s|]*")
"""The line below the header of a table in Markdown or Org."""


class Dialect(NamedTuple):
    """How the rows of a table are written.

    Attributes:
        delimiter: one character between cells.
        is_framed: whether delimiters also begin and end each row, as in Markdown.
    """

    delimiter: str
    is_framed: bool = False


class Line(NamedTuple):
    """A row of a table with its line number."""

    number: int
    cells: list[str]


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


# --- directives ----------------------------------------------------------------------------------


def read_directive(source: FileRows, number: int, line: str) -> Fault | None:
    """Note the entities that a comment such as ``# base: a, b`` declares; return its fault.

    Args:
        source: the file's rows, which get the entities.
        number: the line's number.
        line: a line with ``#``; other comments are passed over.
    """
    key, colon, rest = line.removeprefix("#").partition(":")
    name = key.strip().lower()
    if not line.startswith("#") or not colon or name not in ("base", "entities"):
        return None
    if len(line) > MAX_LINE_LENGTH:
        return Fault(number, "directive", too_long(line))
    # One line gives one row, or none if nothing follows the colon.
    labels = next(csv.reader([trimmed(rest.strip(), ",")]), [])
    for fault in filter(None, map(label_fault, labels)):
        return Fault(number, "directive", fault)
    if name == "base":
        source.base = (source.base or {}) | dict.fromkeys(labels, number)
    else:
        source.listed |= dict.fromkeys(labels, number)
    return None


def too_long(line: str) -> str:
    """Return the message for a line that is too long."""
    return f"a line of {len(line):,} characters; the limit is {MAX_LINE_LENGTH:,}."


# --- cells of a line -----------------------------------------------------------------------------


def cells_of(line: str, dialect: Dialect) -> list[str]:
    """Return the cells of a row, without spaces around them; spaces within quotes stay.

    Args:
        line: the row, with or without its line end.
        dialect: how the row is written.

    Returns:
        The cells; empty for a blank row.

    Raises:
        csv.Error: if a quote does not end, or text follows its end.
    """
    delimiter = dialect.delimiter
    line = line.rstrip("\r\n")
    if dialect.is_framed:
        line = line.strip().removeprefix(delimiter).removesuffix(delimiter)
    line = trimmed(line, delimiter)
    if not line:
        return []
    if '"' not in line:
        return line.split(delimiter)
    # Lines end where the file's lines end, which csv takes for several rows at lone \r only.
    rows = csv.reader(io.StringIO(line, newline=""), delimiter=delimiter, strict=True)
    (cells,) = rows
    return cells


def trimmed(line: str, delimiter: str) -> str:
    """Strip spaces around the cells in a table row; spaces within quotes stay.

    Args:
        line: the row, with or without its line end.
        delimiter: one character between cells.
    """
    has_inner_space = f"{delimiter} " in line or f" {delimiter}" in line
    has_outer_space = line.startswith(" ") or line.rstrip("\r\n").endswith(" ")
    # The pattern is slow, and most rows of a large book have no spaces around cells.
    if not has_inner_space and not has_outer_space:
        return line
    # Group 1 is the cell after any spaces, with those at its end if it has no quotes.
    return _cell_pattern(delimiter).sub(lambda cell: cell[1].strip(" "), line)


@cache
def _cell_pattern(delimiter: str) -> re.Pattern[str]:
    """Return a pattern for a cell after any spaces.

    A quoted cell goes up to the spaces before its end, any other up to its end.
    """
    d = re.escape(delimiter)
    return re.compile(rf' *+("(?:[^"]|"")*+"(?= *+(?:[{d}\r\n]|$))|[^{d}\r\n]*+)')


def _tolerant_cells(line: str, dialect: Dialect) -> list[str]:
    """Return the cells of a row; one with a quote that does not end is split at delimiters."""
    try:
        return cells_of(line, dialect)
    except csv.Error:
        return [cell.strip(" ") for cell in line.rstrip("\r\n").split(dialect.delimiter)]


def _dialect(lines: Sequence[str], delimiter: str) -> Dialect:
    """Return the dialect with a delimiter, by lines that are not blank."""
    if delimiter != "|":
        return Dialect(delimiter)
    stripped = [line.strip() for line in lines]
    framed = [line.startswith("|") and line.count("|") > 1 for line in stripped]
    return Dialect(delimiter, all(framed) or (any(framed) and any(map(_is_rule, stripped))))


def _is_rule(line: str) -> bool:
    return bool(_RULE.fullmatch(line))


def _guess_dialect(path: Path, lines: Sequence[str], usual: str) -> Dialect:
    """Guess the dialect of a table: documented names in a header decide, else even rows.

    Raises:
        RecipeFileError: if two delimiters fit equally well; the message shows both readings.
    """
    with_header: list[Dialect] = []
    even: list[Dialect] = []
    for candidate in DELIMITERS:
        dialect = _dialect(lines, candidate)
        rows = [_tolerant_cells(line, dialect) for line in lines if not _is_rule(line.strip())]
        (width, number), *_ = Counter(map(len, rows)).most_common(1) or [(0, 0)]
        if any(map(_are_names, rows[:_HEADER_ROWS])):
            with_header.append(dialect)
        if width >= 3 and number >= _EVEN * len(rows):
            even.append(dialect)
    fitting = with_header or even or [_dialect(lines, usual)]
    if len(fitting) > 1:
        readings = []
        for dialect in fitting[:2]:
            cells = _tolerant_cells(lines[-1], dialect)
            readings.append(f"{cells} ({DELIMITERS[dialect.delimiter]})")
        seen = f"two delimiters fit: {' or '.join(readings)}"
        raise refusal(path, seen, "table", "Choose one with --delimiter.")
    return fitting[0]


def _are_names(cells: Sequence[str]) -> bool:
    """Return whether cells are documented words for ingredients and a result."""
    # Amounts stand in rows, such as "Weakness to Frost,3,30": words beside them are labels.
    if sum(map(is_number, cells)) > 1:
        return False
    paths = [(EACH, f".{cell}") for cell in cells]
    sure = [each for each in ways_by_words(paths) if each.is_documented]
    return any(each.is_named or is_name(each.results[0][-1][1:]) for each in sure)


def _are_mostly_names(cells: Sequence[str]) -> bool:
    """Return whether most cells are words of columns: labels such as item may be, too."""
    filled = list(filter(None, cells))
    num_words = sum(is_documented(cell) or not is_plain(cell) for cell in filled)
    return _are_names(cells) and 2 * num_words > len(filled)


def _are_unknown_names(body: Sequence[Line]) -> bool:
    """Return whether the first row is rather a header of other words: no cell stands below."""
    first, *below = [row.cells for row in body]
    return len(below) >= _FEWEST_BELOW and set(first).isdisjoint(chain.from_iterable(below))


# --- the table -----------------------------------------------------------------------------------


def _read_head(source: FileRows, file: io.StringIO) -> tuple[list[Fault], tuple[int, str] | None]:
    """Read comments up to the first row; return faults and this row."""
    faults: list[Fault] = []
    for number, line in enumerate(file, start=1):
        if line.startswith("//") or _is_comment(line):
            faults += filter(None, [read_directive(source, number, line)])
        elif line.strip():
            return faults, (number, line)
    return faults, None


def _is_comment(line: str) -> bool:
    """Return whether a line is a comment: # and a blank, or a directive, or only #."""
    if not line.startswith("#"):
        return False
    return not line[1:2].strip() or bool(re.match(r"#\s*(?:base|entities)\s*:", line, re.I))


def _parsed(
    source: FileRows, lines: Iterable[tuple[int, str]], dialect: Dialect
) -> Iterator[Line | Fault | LeftOut]:
    """Yield the cells of each line; faults, comments, and text around a table of Markdown."""
    for number, line in lines:
        text = line.strip()
        if dialect.delimiter == "|" and _is_rule(text):
            continue
        if not text:
            continue
        if len(line) > MAX_LINE_LENGTH:
            yield Fault(number, "row", too_long(line), "long")
        elif line[0] == "\ufeff":
            message = "a byte order mark in the middle, as where two files were joined; remove it."
            yield Fault(number, "row", message, "mark")
        elif line.startswith(("# ", "// ")):
            yield LeftOut(number, "comments")
        elif dialect.is_framed and not text.startswith("|"):
            yield LeftOut(number, "outside of the table")
        else:
            try:
                cells = cells_of(line, dialect)
            except (csv.Error, ValueError) as error:
                message = f"{error}; a quoted cell ends in its line, and a quote in it is doubled."
                yield Fault(number, "row", message, "quote")
                continue
            # A table that we write has quotes around cells that begin or end with blanks.
            if not line.isascii() and '"' not in line:
                seen = list(map(trim_unseen, cells))
                trimmed = source.reading.trimmed + sum(map(ne, seen, cells))
                source.reading = replace(source.reading, trimmed=trimmed)
                cells = seen
            yield Line(number, cells) if any(cells) else LeftOut(number, "blank")


def read_table(
    path: Path,
    text: str,
    delimiter: str | None = None,
    *,
    usual: str = ",",
    is_named: bool = False,
) -> tuple[FileRows, Document]:
    """Read a table as a document.

    Args:
        path: the file, for errors.
        text: its text.
        delimiter: the delimiter; None to guess.
        usual: the delimiter of the file's ending.
        is_named: whether the user names columns, so that the first row is a header.

    Returns:
        What is known of the rows, and the document: records, or lists without a header.

    Raises:
        RecipeFileError: if two delimiters fit, or the text is no table.
    """
    source = FileRows(Reading(shape="table"))
    file = io.StringIO(text, newline="")
    faults, first = _read_head(source, file)
    if first is None:
        raise refusal(path, "no row of a table, only comments", "table")
    start = file.tell()
    lines = [first, *enumerate(file, first[0] + 1)]
    sample = [line for _, line in lines if line.strip()][:_SAMPLE_ROWS]
    if max(map(len, sample)) > MAX_LINE_LENGTH:
        raise refusal(path, f"no table: {too_long(max(sample, key=len))[:-1]}", "table")
    if all(map(_is_single_quoted, sample)):
        remedy = "Write double quotes, or none."
        raise refusal(path, "a table with single quotes around its cells", "table", remedy)
    dialect = Dialect(delimiter or usual)
    is_own = tuple(_tolerant_cells(first[1], dialect)) in _OWN
    if not is_own:
        dialect = _dialect(sample, delimiter) if delimiter else _guess_dialect(path, sample, usual)
    source.reading = Reading(shape="table", delimiter=dialect.delimiter)
    source.is_exact = is_own
    # Blanks at the ends that cannot be seen are slips, unless they are in quotes.
    if is_own and KIND not in first[1] and not faults and not has_unseen(text):
        source.numbered = number_plain_rows(text, start, dialect.delimiter, _is_odd)
    return source, _document(path, source, [*faults, *_parsed(source, lines, dialect)], is_named)


def _is_single_quoted(line: str) -> bool:
    """Return whether a row begins and ends with single quotes, which are no part of labels."""
    cells = line.strip(",;|\t\r\n ")
    return len(cells) > 1 and cells[0] == cells[-1] == "'"


def _is_odd(label: str) -> bool:
    """Return whether a label may be no label: of a repeated header, a comment or a formula."""
    is_word = label in CSV_HEADER or label.startswith(("# ", "// "))
    return is_word or bool(exact_fault(label))


def _document(
    path: Path, source: FileRows, rows: list[Line | Fault | LeftOut], is_named: bool
) -> Document:
    """Return a table's rows as records by the names of its header, or by numbers without one."""
    body = [row for row in rows if isinstance(row, Line)]
    width = max((len(_without_blanks(row.cells)) for row in body), default=0)
    if width < 2:
        raise _no_table(path, body[0].cells[0] if body else "", source.reading.delimiter)
    grid = _grid(body)
    if grid is not None:
        return grid
    header = _header(path, body, is_named)
    number_of_header = header.number if header else 0
    names = _without_blanks(header.cells) if header else []
    keys = _different(names) if names else [str(number + 1) for number in range(width)]
    document = Document([], is_table=True)
    known = {name.casefold() for name in names if is_documented(name)}
    for row in rows:
        if not isinstance(row, Line):
            document.others.append(row)
        elif row.number < number_of_header:
            document.others.append(LeftOut(row.number, "above the header"))
        elif row.number > number_of_header:
            odd = _odd_row(row, names, known, source.reading.delimiter)
            if odd is None:
                cells = [*row.cells, *[""] * (len(keys) - len(row.cells))]
                document.places.append(row.number)
                document.value.append(dict(zip(keys, cells, strict=False)))
            else:
                document.others.append(odd)
    source.reading = replace(source.reading, header=bool(names))
    return document


def _grid(body: Sequence[Line]) -> Document | None:
    """Return the recipes of a grid: ingredients in the first row and column, results in cells."""
    (_, *names), *below = [row.cells for row in body]
    if len(names) < _FEWEST_BELOW or [cells[0] for cells in below] != names:
        return None
    document = Document([], is_table=True)
    for row in body[1:]:
        for name, result in zip(names, row.cells[1:], strict=False):
            document.places.append(row.number)
            document.value.append({"first": row.cells[0], "second": name, "result": result})
    results = [each["result"] for each in document.value if each["result"]]
    # In a table of effects or numbers, results are no names.
    is_closed = 2 * sum(result in names for result in results) > len(results)
    return document if is_closed else None


def _header(path: Path, body: Sequence[Line], is_named: bool) -> Line | None:
    """Return the row that names the columns, or None."""
    heads = [row for row in body[:_HEADER_ROWS] if _are_names(row.cells)]
    if not heads:
        return body[0] if is_named or _are_unknown_names(body) else None
    below = [row for row in body if row.number > heads[0].number]
    is_again = len(heads) > 1 and heads[1] is below[0] and _are_mostly_names(below[0].cells)
    if is_again and below[0].cells != heads[0].cells:
        again = ", ".join(map(repr, below[0].cells[:4]))
        seen = f"the row below line {heads[0].number} names the columns again: {again}"
        raise refusal(path, seen, "table", "Keep one header line.")
    return heads[0]


def _odd_row(
    row: Line, names: Sequence[str], known: Set[str], delimiter: str
) -> Fault | LeftOut | None:
    """Return why a row below the header is no recipe, or None."""
    number, cells = row.number, _without_blanks(row.cells)
    if names and cells == names:
        # Several tables of Markdown may follow each other.
        message = "the header is repeated in the middle"
        is_framed = delimiter == "|"
        return (
            LeftOut(number, "headers") if is_framed else Fault(number, "header", message, message)
        )
    if not known.isdisjoint(map(str.casefold, cells)) and _are_mostly_names(cells):
        message = f"{', '.join(cells)!r:.80} names the columns again; keep one table."
        return Fault(number, "header", message, "header")
    if names and len(cells) > len(names):
        message = (
            f"'{delimiter.join(cells)[:80]}' has {counted(len(cells), 'cell')}; the table has "
            f"{len(names)} columns. Quote a cell with a delimiter in it."
        )
        return Fault(number, "row", message, f"width {len(cells)}")
    return None


def _different(names: Sequence[str]) -> list[str]:
    """Return names of columns, with numbers where names are missing or repeated."""
    keys: list[str] = []
    for number, name in enumerate(names, start=1):
        key = name or f"column {number}"
        keys.append(f"{key} {number}" if key in keys else key)
    return keys


def _no_table(path: Path, cell: str, delimiter: str) -> RecipeFileError:
    signs = DELIMITERS.get(delimiter, repr(delimiter))
    return refusal(
        path,
        f"no table, because {signs} give 1 column ({cell[:80]!r}), and no lines a + b = c with a "
        "sign such as = or ->",
        "lines",
        "Another delimiter is named with --delimiter.",
    )


def _without_blanks(cells: list[str]) -> list[str]:
    """Return cells without the blank ones at the end."""
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells
