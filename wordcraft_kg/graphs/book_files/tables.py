"""Tables: a row for each recipe, in any dialect, with columns in any order.

A header with our own names is read as it is. Any other table has columns that documented words
name, or that the option `columns` names, and a reading of them that the rule takes. Without a
header the labels tell: a pair seldom makes two things.
"""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from itertools import chain
from operator import ne
from pathlib import Path
from typing import NamedTuple

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.base.wording import counted
from wordcraft_kg.graphs.book_files.cells import formula_fault, has_unseen, is_number, trim_unseen
from wordcraft_kg.graphs.book_files.entries import Names, Raw, fill, names_by_id
from wordcraft_kg.graphs.book_files.paths import EACH
from wordcraft_kg.graphs.book_files.paths import Path as Steps
from wordcraft_kg.graphs.book_files.rows import (
    MAX_LINE_LENGTH,
    Entry,
    Fault,
    FileRows,
    LeftOut,
    Row,
    refusal,
    without_nothing,
)
from wordcraft_kg.graphs.book_files.rule import Candidate, choose, result_place
from wordcraft_kg.graphs.book_files.words import (
    COUNT,
    KIND,
    Reading,
    is_id,
    is_name,
    readings,
    words_of,
)
from wordcraft_kg.graphs.plain_rows import number_plain_rows
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
_HEADER_ROWS = 6  # first rows among which the header is
_RULE = re.compile(r"[-=+:\s|]*[-=]{2,}[-=+:\s|]*|[-=+:\s|]*:[-=][-=+:\s|]*")
"""The line below the header of a table in Markdown or Org."""
_MOST_WITHOUT_GRID = 3  # columns of ingredients; more may be the slots of a crafting grid
_MOSTLY = 0.5  # share of a column's cells


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
    """Note the entities that a comment such as ``# base: a, b`` declares; return its fault, or None.

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
    delimiter, quote, is_framed = dialect
    line = line.rstrip("\r\n")
    if is_framed:
        line = line.strip().removeprefix(delimiter).removesuffix(delimiter)
    line = trimmed(line, delimiter, quote)
    if not line:
        return []
    if quote not in line:
        return line.split(delimiter)
    # Lines end where the file's lines end, which csv takes for several rows at lone \r only.
    rows = csv.reader(
        io.StringIO(line, newline=""), delimiter=delimiter, quotechar=quote, strict=True
    )
    (cells,) = rows
    return cells


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
    # Group 1 is the cell after any spaces, with those at its end if it has no quotes.
    return _cell_pattern(delimiter, quote).sub(lambda cell: cell[1].strip(" "), line)


@cache
def _cell_pattern(delimiter: str, quote: str) -> re.Pattern[str]:
    """Return a pattern for a cell after any spaces.

    A quoted cell goes up to the spaces before its end, any other up to its end.
    """
    d = re.escape(delimiter)
    return re.compile(
        rf" *+({quote}(?:[^{quote}]|{quote}{quote})*+{quote}(?= *+(?:[{d}\r\n]|$))|[^{d}\r\n]*+)"
    )


def _tolerant_cells(line: str, dialect: Dialect) -> list[str]:
    """Return the cells of a row; one with a quote that does not end is split at delimiters."""
    try:
        return cells_of(line, dialect)
    except csv.Error:
        return [cell.strip(" ") for cell in line.rstrip("\r\n").split(dialect.delimiter)]


def _dialect(lines: Sequence[str], delimiter: str) -> Dialect:
    """Return the dialect with a delimiter: its quotes and frames, by lines that are not blank."""
    stripped = [line.strip() for line in lines]
    framed = [line.startswith("|") and line.count("|") > 1 for line in stripped]
    is_framed = delimiter == "|" and (all(framed) or any(map(_is_rule, stripped)))
    if is_framed and not any(framed):
        is_framed = False
    # A label may hold an apostrophe; quotes of a dialect begin and end every row.
    inner = [line.strip(f"{delimiter} ") for line in stripped]
    is_single = all(len(line) > 1 and line[0] == line[-1] == "'" for line in inner)
    return Dialect(delimiter, "'" if is_single else '"', is_framed)


def _is_rule(line: str) -> bool:
    return bool(_RULE.fullmatch(line))


def _guess_dialect(path: Path, lines: Sequence[str], usual: str) -> Dialect:
    """Guess the dialect of a table: documented names in a header decide, else even rows.

    Raises:
        RecipeFileError: if two delimiters fit equally well; the message shows both readings.
    """
    with_header: list[Dialect] = []
    even: list[Dialect] = []
    mostly: list[Dialect] = []
    for candidate in DELIMITERS:
        dialect = _dialect(lines, candidate)
        rows = [_tolerant_cells(line, dialect) for line in lines if not _is_rule(line.strip())]
        (width, number), *_ = Counter(map(len, rows)).most_common(1) or [(0, 0)]
        if any(map(_are_names, rows[:_HEADER_ROWS])):
            with_header.append(dialect)
        if width >= 3 and number >= _EVEN * len(rows):
            even.append(dialect)
        # Of a few rows, one that is spoilt is many.
        if width >= 3 and number > len(rows) / 2:
            mostly.append(dialect)
    fitting = with_header or even or mostly or [_dialect(lines, usual)]
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
    paths = [(EACH, f".{cell}") for cell in cells]
    return len(cells) > 1 and any(readings(paths))


# --- the table -----------------------------------------------------------------------------------


def read_table(
    path: Path,
    text: str,
    delimiter: str | None = None,
    columns: Sequence[str] | None = None,
    *,
    usual: str = ",",
    fold: bool = False,
    allows_single: bool = False,
) -> FileRows:
    """Read a table.

    Args:
        path: the file, for errors.
        text: its text.
        delimiter: the delimiter; None to guess.
        columns: names or numbers of the columns of ingredients and, last, of the result; None for
            documented words.
        usual: the delimiter of the file's ending.
        fold, allows_single: see :func:`~wordcraft_kg.graphs.book_files.rule.choose`.

    Raises:
        RecipeFileError: if two delimiters fit or the columns cannot be told, with the readings;
            or if the text is no table.
        ConfigError: if ``columns`` are not in the table.
    """
    source = FileRows("table")
    file = io.StringIO(text, newline="")
    head, first, named = _read_head(source, file)
    if first is not None and columns is None:
        own = [delimiter] if delimiter else [usual]
        if tuple(cell.strip() for cell in first[1].rstrip("\r\n").split(own[0])) in _OWN:
            return _own_table(source, head, text, file, first, own[0])
    numbered = list(enumerate(file, 1 if first is None else first[0] + 1))
    lines = [*filter(None, [first]), *numbered]
    filled = [line for _, line in lines if line.strip()][: 5 * _SAMPLE_ROWS]
    if not filled:
        raise refusal(path, "no row of a table, only comments", "table")
    if max(map(len, filled)) > MAX_LINE_LENGTH:
        raise refusal(path, f"no table: {too_long(max(filled, key=len))[:-1]}", "table")
    given = delimiter or named
    sample = filled[:_SAMPLE_ROWS]
    dialect = _dialect(sample, given) if given else _guess_dialect(path, sample, usual)
    source.delimiter = dialect.delimiter
    source.quote = dialect.quote if dialect.quote != '"' else ""
    rows = [*head, *_parsed(source, lines, dialect)]
    _Table(path, rows, source).read(columns, fold=fold, allows_single=allows_single)
    return source


def _read_head(
    source: FileRows, file: io.StringIO
) -> tuple[list[Fault], tuple[int, str] | None, str | None]:
    """Read comments up to the first row; return faults, this row, and the delimiter of ``sep=``."""
    faults: list[Fault] = []
    named = None
    for number, line in enumerate(file, start=1):
        separator = re.fullmatch(r'"?sep=(.)"?', line.strip("\r\n "))
        if line.startswith("//") or _is_comment(line):
            faults += filter(None, [read_directive(source, number, line)])
        elif separator and named is None:
            named = separator[1]
        elif line.strip():
            return faults, (number, line), named
    return faults, None, named


def _is_comment(line: str) -> bool:
    """Return whether a line is a comment: # and a blank, or a directive, or only #."""
    if not line.startswith("#"):
        return False
    return not line[1:2].strip() or bool(re.match(r"#\s*(?:base|entities)\s*:", line, re.I))


def _own_table(
    source: FileRows,
    head: list[Fault],
    text: str,
    file: io.StringIO,
    first: tuple[int, str],
    delimiter: str,
) -> FileRows:
    """Read our own table: any label as it stands, all rows at once if they are plain."""
    names = [cell.strip() for cell in first[1].split(delimiter)]
    source.delimiter = delimiter
    source.columns = CSV_HEADER
    source.is_exact = True
    if len(names) == 3 and not head:

        def is_odd(label: str) -> bool:
            # Such a label may be of a header that is repeated in the middle, or of a comment.
            is_word = label in CSV_HEADER or label.startswith("# ")
            return is_word or bool(formula_fault(label) or label_fault(label))

        # Blanks at the ends that cannot be seen are slips, unless they are in quotes.
        if not has_unseen(text):
            source.numbered = number_plain_rows(text, file.tell(), delimiter, '"', is_odd)
    lines = enumerate(file, first[0] + 1)
    below = _own_entries(_parsed(source, lines, Dialect(delimiter)), names, delimiter)
    source.entries = chain(head, below)
    return source


def _own_entries(
    rows: Iterable["Line | Fault | LeftOut"], names: list[str], delimiter: str
) -> Iterator[Entry]:
    width = len(names)
    for row in rows:
        if not isinstance(row, Line):
            yield row
            continue
        number, cells = row
        while len(cells) > width and not cells[-1]:
            cells = cells[:-1]
        if cells == names:
            yield Fault(number, "header", "the header is repeated in the middle", "header")
        elif not 3 <= len(cells) <= width:
            yield Fault(number, "row", _own_width(cells, delimiter), f"width {len(cells)}")
        else:
            parts = [cell for cell in cells[:2] if cell] or [""]
            faults = [formula_fault(cell) or label_fault(cell) for cell in (*parts, cells[2])]
            faults += map(label_fault, filter(None, cells[3:]))
            if any(faults):
                yield Fault(number, "label", " Also, ".join(dict.fromkeys(filter(None, faults))))
            else:
                yield Row(number, parts, cells[2], cells[3] if len(cells) > 3 else "")


def _own_width(cells: Sequence[str], delimiter: str) -> str:
    count = len(cells) - 1
    missing = "" if count else " missing"
    hint = " For a single ingredient, leave the second cell empty." if count == 1 else ""
    return (
        f"'{delimiter.join(cells)[:80]}' has {counted(count, 'ingredient')} and a result{missing}; "
        f"a recipe needs two and a result, in three columns.{hint}"
    )


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
            if not line.isascii() and dialect.quote not in line:
                seen = list(map(trim_unseen, cells))
                source.trimmed += sum(map(ne, seen, cells))
                cells = seen
            yield Line(number, cells) if any(cells) else LeftOut(number, "blank")


class _Table:
    """A table that is not our own: its header, its columns, and its readings."""

    def __init__(self, path: Path, rows: list[Line | Fault | LeftOut], source: FileRows):
        self.path = path
        self.rows = rows
        self.source = source
        self.names: list[str] = []
        self.body = [row for row in rows if isinstance(row, Line)]
        if not self.body:
            raise refusal(path, "no row of a table", "table")
        for index, row in enumerate(self.body[:_HEADER_ROWS]):
            if _are_names(row.cells):
                self._take_header(index)
                break
        width = max((len(_without_blanks(row.cells)) for row in self.body), default=0)
        self.width = max(width, len(self.names))

    def _take_header(self, index: int) -> None:
        """Take a row as the header; rows above it are no recipes."""
        header = self.body[index]
        names = _without_blanks(header.cells)
        below = self.body[index + 1 :]
        # In R's tables, row names have no name.
        is_longer = [len(_without_blanks(row.cells)) == len(names) + 1 for row in below]
        if below and names[0] and all(is_longer):
            names = ["", *names]
        above = {row.number for row in self.body[:index]}
        rows: list[Line | Fault | LeftOut] = []
        for row in self.rows:
            if isinstance(row, Line) and row.number in above:
                rows.append(LeftOut(row.number, "above the header"))
            elif not isinstance(row, Line) or row.number != header.number:
                rows.append(row)
        if below and _are_names(below[0].cells) and below[0].cells != header.cells:
            again = ", ".join(map(repr, below[0].cells[:4]))
            seen = f"the row below line {header.number} names the columns again: {again}"
            raise refusal(self.path, seen, "table", "Keep one header line.")
        self.rows = rows
        self.names = names
        self.body = below

    def read(self, columns: Sequence[str] | None, *, fold: bool, allows_single: bool) -> None:
        """Fill the source with the rows of the reading that the option names or the rule takes."""
        if columns is not None:
            best: Candidate | None = self._candidate(self._reading_of(columns), is_given=True)
        elif self.names:
            names: list[Steps] = [(EACH, f".{name}") for name in self.names]
            found = [self._candidate(self._indexed(each)) for each in readings(names)]
            best = choose(self.path, found, "table", fold=fold, allows_single=allows_single)
        else:
            best = self._without_header()
        if best is None:
            raise self._unnamed()
        source = self.source
        source.entries = without_nothing(best.entries)
        source.header = bool(self.names)
        source.columns = best.columns
        source.num_results = best.num_results
        source.ignored = best.ignored
        source.counts_dropped = best.counts_dropped
        source.several_outputs = best.several_outputs

    def _indexed(self, reading: Reading) -> Reading:
        """Return a reading with the numbers of columns as paths."""
        index_of: dict[str, list[int]] = {}
        for i, name in enumerate(self.names):
            index_of.setdefault(name, []).append(i)

        def indices(paths: Sequence[Steps]) -> tuple[Steps, ...]:
            return tuple((str(i),) for path in paths for i in index_of[path[1][1:]])

        return reading._replace(parts=indices(reading.parts), results=indices(reading.results))

    def _name(self, column: int) -> str:
        """Return a column's name for people; a number stands for a missing name."""
        name = self.names[column] if column < len(self.names) else ""
        return name or f"column {column + 1}"

    def _option(self, column: int) -> str:
        """Return how the option `columns` names a column."""
        name = self.names[column] if column < len(self.names) else ""
        is_clear = name and "," not in name and self.names.count(name) == 1
        return name if is_clear and not name.isdecimal() else str(column + 1)

    def _reading_of(self, columns: Sequence[str]) -> Reading:
        """Return the reading that the option `columns` gives: ingredients, and last the result."""
        if not self.names and not all(column.strip().isdecimal() for column in columns):
            self._take_header(0)
        by_name: dict[str, int] = {}
        for i, name in enumerate(self.names):
            # Of columns of one name, the first one is meant.
            by_name.setdefault(name.strip().casefold(), i)
        chosen: list[Steps] = []
        for column in columns:
            index = by_name.get(column.strip().casefold())
            # A name goes before a number: a header may hold numbers.
            if index is None and column.strip().isdecimal() and 1 <= int(column) <= self.width:
                index = int(column) - 1
            if index is None:
                names = [name for name in self.names if name]
                there = ", ".join(map(repr, names)) or f"numbers from 1 to {self.width}"
                hint = nearest(column, names)
                raise ConfigError(
                    f"`columns` {column!r}: no such column; the table has {there}.{hint}"
                )
            chosen.append((str(index),))
        if len(chosen) < 2 or len(set(chosen)) < len(chosen):
            raise ConfigError(
                f"`columns` {','.join(columns)}: expected different columns, of the ingredients "
                "and, last, of the result."
            )
        return Reading(tuple(chosen[:-1]), (chosen[-1],))

    def _candidate(self, reading: Reading, *, is_given: bool = False) -> Candidate:
        """Return the recipes of a reading, whose paths are numbers of columns."""
        parts = [int(path[0]) for path in reading.parts]
        made = [int(path[0]) for path in reading.results]
        used = (*parts, *made)
        plain = [name.strip().lower() for name in self.names]
        kind = plain.index(KIND) if KIND in plain else None
        kind = None if kind in used else kind
        others = [i for i in range(len(self.names)) if i not in used and i != kind]
        candidate = Candidate(
            tuple(map(self._option, used)),
            [],
            reading.is_documented,
            reading.is_named,
            num_results=len(made),
            ignored=tuple(map(self._name, others)),
        )
        # Where ingredients are numbers as well, such as ids, numbers are labels.
        cells = [cell for i in parts for cell in self._column(i)]
        are_ids = bool(cells) and all(map(is_number, cells))
        if (
            not is_given
            and not are_ids
            and all(is_number(cell) for i in made for cell in self._column(i))
        ):
            return candidate
        if not is_given and len(parts) > 1 and any(map(self._holds_sums, parts)):
            return candidate
        raws = [self._raw(row, parts, made, kind) for row in self.rows]
        counts = [i for i in others if words_of(self._name(i)) & COUNT]
        for row in self.body:
            numbers = [row.cells[i] for i in counts if i < len(row.cells)]
            candidate.counts_dropped += sum(number not in ("", "1") for number in numbers)
        tables = self._tables(made[0])
        return fill(candidate, raws, is_sole=len(parts) == 1, is_given=is_given, tables=tables)

    def _column(self, index: int) -> list[str]:
        """Return the cells of a column that are not blank."""
        return [
            row.cells[index] for row in self.body if len(row.cells) > index and row.cells[index]
        ]

    def _holds_sums(self, column: int) -> bool:
        """Return whether cells of a column are recipes of their own, in a table of several such."""
        cells = self._column(column)
        joined = [cell for cell in cells if re.search(r"[+;&,]", cell)]
        return len(joined) > _MOSTLY * len(cells)

    def _tables(self, result: int) -> Iterator[Names]:
        """Yield names by each column of ids, such as slugs or emoji, of a table of things."""
        for i, name in enumerate(self.names):
            if i != result and is_id(name) and is_name(self._name(result)):
                rows = [row.cells for row in self.body if len(row.cells) > max(i, result)]
                yield names_by_id((cells[i], cells[result]) for cells in rows)

    def _raw(
        self,
        row: Line | Fault | LeftOut,
        parts: Sequence[int],
        made: Sequence[int],
        kind: int | None,
    ) -> Raw | Entry:
        """Return the cells of a row in which labels are, or why it has none."""
        if not isinstance(row, Line):
            return row
        number, cells = row
        limit = max(len(self.names) or self.width, max(*parts, *made) + 1)
        # Spreadsheets write empty cells at the end of a row up to the widest one.
        while len(cells) > limit and not cells[-1]:
            cells = cells[:-1]
        shown = self.source.delimiter.join(cells)[:80]
        if cells == self.names and self.source.delimiter == "|":
            return LeftOut(number, "headers")  # of further tables of Markdown
        if cells == self.names:
            return Fault(number, "header", "the header is repeated in the middle", "header")
        if not max(*parts, *made) < len(cells) <= limit:
            message = (
                f"'{shown}' has {counted(len(cells), 'cell')}; the table has {limit} columns. "
                "Quote a cell with a delimiter in it."
            )
            return Fault(number, "row", message, f"width {len(cells)}")
        # Spreadsheets leave blank all cells but the first of those that they merged. In a grid of
        # many slots blanks are usual.
        is_grid = len(parts) > _MOST_WITHOUT_GRID
        if not cells[parts[0]] and any(cells[i] for i in parts) and not is_grid:
            message = (
                f"'{shown}' has a blank cell before an ingredient, as where cells were merged; "
                "fill it, or write a single ingredient first."
            )
            return Fault(number, "row", message, "merged")
        kind_of_row = cells[kind] if kind is not None and kind < len(cells) else ""
        return Raw(number, [cells[i] for i in parts], [cells[i] for i in made], kind_of_row)

    def _without_header(self) -> Candidate | None:
        """Return the reading of a table without a header, if its rows tell the result.

        Raises:
            RecipeFileError: if they do not, with the readings.
        """
        widths = Counter(len(_without_blanks(row.cells)) for row in self.body)
        (width, _), *_ = widths.most_common(1)
        if width == 2:
            sums = [self._holds_plus(0), self._holds_plus(1)]
            if sums.count(True) == 1:
                place = sums.index(True)
                return self._candidate(
                    Reading(((str(place),),), ((str(1 - place),),)), is_given=True
                )
        # Words of columns are no labels of a first recipe.
        if width != 3 or any(map(is_documented, self.body[0].cells)):
            return None
        places = ("012", "120", "021")
        found = [self._candidate(Reading(((a,), (b,)), ((c,),))) for a, b, c in places]
        place_of_result = result_place(found)
        if place_of_result is not None:
            return found[place_of_result]
        clean = [each for each in found if each.is_clean]
        if not clean:
            return found[0] if found[0].entries else None
        seen = (
            f"the labels do not tell which column is the result: {' or '.join(map(str, clean[:2]))}"
        )
        raise refusal(self.path, seen, "table", "Choose with --columns, or name the columns.")

    def _holds_plus(self, column: int) -> bool:
        cells = self._column(column)
        return bool(cells) and all("+" in cell for cell in cells)

    def _unnamed(self) -> Exception:
        first = (self.names or self.body[0].cells)[:8]
        seen = ", ".join(repr(cell[:40]) for cell in first)
        delimiter = self.source.delimiter
        signs = DELIMITERS.get(delimiter, repr(delimiter))
        if self.width == 1:
            return refusal(
                self.path,
                f"no table, because {signs} give 1 column ({seen}), and no lines a + b = c "
                "with a sign such as = or ->",
                "lines",
                "Another delimiter is named with --delimiter.",
            )
        return refusal(
            self.path,
            f"a table with {signs} and {counted(len(first), 'column')} ({seen}); no documented "
            "words name columns of ingredients and of a result",
            "table",
            "Name the columns of ingredients and, last, of the result with --columns.",
        )


def _without_blanks(cells: list[str]) -> list[str]:
    """Return cells without the blank ones at the end."""
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells
