"""Texts that people write: tables, with columns in any order, and lines a + b = c.

A table is a list of records by the names in its header, or by numbers without one. So its columns
have the rules of JSON: ``documents`` finds ingredients and results by documented words, or by the
option `columns`. Marks of lists, and markup, are not read.
"""

import io
import re
from collections.abc import Iterable, Iterator, Sequence, Set
from functools import cache
from itertools import chain, takewhile
from operator import itemgetter, ne
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from wordcraft_kg.base import ConfigError, counted
from wordcraft_kg.graphs.book_files.cells import (
    find_joiner,
    is_number,
    read_labels,
    rows_of_raw,
    table_fault,
    trim_unseen,
)
from wordcraft_kg.graphs.book_files.documents import Document
from wordcraft_kg.graphs.book_files.rows import (
    MAX_LINE_LENGTH,
    Entry,
    Fault,
    FileRows,
    LeftOut,
    Raw,
    Row,
    is_infinite_craft,
    refusal,
    without_nothing,
)
from wordcraft_kg.graphs.book_files.words import (
    EACH,
    KIND,
    QUANTITIES,
    is_documented,
    is_name,
    own_header,
    ways_by_words,
)
from wordcraft_kg.graphs.recipes import MOST_INGREDIENTS, Reading, label_fault

ENDINGS = {".csv": ",", ".tsv": "\t", ".tab": "\t"}
"""Usual column delimiters by file ending."""
DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "pipes"}
"""Column delimiters that are tried, with their names."""
_SPELT = {"comma": ",", "semicolon": ";", "tab": "\t", "\\t": "\t", "pipe": "|", "space": " "}
_OWN = {
    (*own_header(number), *facts)
    for number in range(2, MOST_INGREDIENTS + 1)
    for facts in ((), (KIND,), (QUANTITIES,), (KIND, QUANTITIES))
}
_SAMPLE_ROWS = 200
_FEWEST_BELOW = 3  # rows below a header of other words
_HEADER_ROWS = 6  # first rows among which the header is
_COMMENT = re.compile(r"//|#(?:\s|$)|#\s*(?:base|entities)\s*:", re.IGNORECASE)
_RULE = re.compile(r"(?=.*[|+])(?:[-=+:\s|]*[-=]{2,}|[-=+:\s|]*:[-=])[-=+:\s|]*")
"""The line below the header of a table in Markdown or Org."""


class Line(NamedTuple):
    """A row of a table.

    Attributes:
        number: number of its line in the file, from 1.
        cells: its cells.
    """

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
    key, _, label_list = line.partition(":")
    name = key.removeprefix("#").strip().lower()
    if name not in ("base", "entities") or not _is_comment(line):
        return None
    if len(line) > MAX_LINE_LENGTH:
        return Fault(number, "directive", too_long(line))
    labels = _tolerant_cells(label_list.strip(), ",")
    if not source.is_exact:
        labels = list(map(trim_unseen, labels))
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


def _is_comment(line: str) -> bool:
    """Return whether a line is a comment: // or # and a blank, or a directive."""
    return _COMMENT.match(line) is not None


# --- cells of a line -----------------------------------------------------------------------------


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of a row, without spaces around them; spaces within quotes stay.

    Args:
        line: the row, with or without its line end.
        delimiter: one character between cells.

    Returns:
        The cells; empty for a blank row.

    Raises:
        ValueError: if a quote does not end, or text follows its end.
    """
    line = line.rstrip("\r\n")
    if not line.strip(" "):
        return []
    if '"' not in line:
        return [cell.strip(" ") for cell in line.split(delimiter)]
    cells = []
    at = 0
    while True:
        cell = _cell_pattern(delimiter).match(line, at)
        if cell is None:
            raise ValueError("a quote without its end, or text behind it")
        quoted, plain, is_more = cell.groups()
        cells.append(plain.strip(" ") if quoted is None else quoted.replace('""', '"'))
        if not is_more:
            return cells
        at = cell.end()


@cache
def _cell_pattern(delimiter: str) -> re.Pattern[str]:
    """Return a pattern for a cell in quotes or without, after any spaces, and its delimiter."""
    d = re.escape(delimiter)
    return re.compile(rf' *+(?:"((?:[^"]|"")*+)"|([^{d}"][^{d}]*+|)) *+(?:({d})|$)')


def _tolerant_cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a row; one with a quote that does not end is split at delimiters."""
    try:
        return cells_of(line, delimiter)
    except ValueError:
        return [cell.strip(" ") for cell in line.rstrip("\r\n").split(delimiter)]


def _guess_delimiter(lines: Sequence[str], usual: str) -> str:
    """Guess the delimiter of a table: documented names in a header decide, else the file's ending.

    Args:
        lines: the first lines.
        usual: the delimiter of the file's ending.
    """
    for delimiter in DELIMITERS:
        rows = [_tolerant_cells(line, delimiter) for line in lines[:_HEADER_ROWS]]
        if any(map(_are_names, rows)):
            return delimiter
    return usual


def _are_names(cells: Sequence[str]) -> bool:
    """Return whether cells are documented words for ingredients and a result."""
    # Amounts stand in rows, such as "Weakness to Frost,3,30": words beside them are labels.
    if sum(map(is_number, cells)) > 1:
        return False
    ways = ways_by_words((EACH, f".{cell}") for cell in cells)
    return any(way.is_named or is_name(way.results[0][-1][1:]) for way in ways)


def _are_unknown_names(body: Sequence[Line]) -> bool:
    """Return whether the first row is rather a header of other words: no cell stands below."""
    first, *below = [row.cells for row in body]
    return len(below) >= _FEWEST_BELOW and set(first).isdisjoint(chain.from_iterable(below))


# --- the table -----------------------------------------------------------------------------------


def _parsed(
    source: FileRows, lines: Iterable[tuple[int, str]], delimiter: str
) -> Iterator[Line | Fault | LeftOut]:
    """Yield the cells of each line that is not blank; faults and comments."""
    for number, line in lines:
        if not line.strip():
            continue
        if len(line) > MAX_LINE_LENGTH:
            yield Fault(number, "row", too_long(line), "long")
        elif line[0] == "\ufeff":
            message = "a byte order mark in the middle, as where two files were joined; remove it."
            yield Fault(number, "row", message, "mark")
        elif _is_comment(line):
            yield LeftOut(number, "comments")
        else:
            try:
                cells = cells_of(line, delimiter)
            except ValueError as error:
                message = f"{error}; a quoted cell ends in its line, and a quote in it is doubled."
                yield Fault(number, "row", message, "quote")
                continue
            # A table that we write has quotes around cells that begin or end with blanks.
            if not line.isascii() and '"' not in line:
                trimmed_cells = list(map(trim_unseen, cells))
                trimmed = source.reading.trimmed + sum(map(ne, trimmed_cells, cells))
                source.reading = replace(source.reading, trimmed=trimmed)
                cells = trimmed_cells
            yield Line(number, cells) if any(cells) else LeftOut(number, "blank")


def read_table(
    path: Path,
    text: str,
    delimiter: str | None = None,
    *,
    usual: str = ",",
    columns: Sequence[str] | None = None,
) -> tuple[FileRows, Document]:
    """Read a table as a document.

    Args:
        path: the file, for errors.
        text: its text.
        delimiter: the delimiter; None to guess.
        usual: the delimiter of the file's ending.
        columns: columns that the user names.

    Returns:
        What is known of the rows, and the document: records by the names in the header, or by
        numbers without one.

    Raises:
        RecipeFileError: if the text is no table.
    """
    source = FileRows(Reading(shape="table"))
    lines = list(enumerate(io.StringIO(text, newline=""), start=1))
    head = list(takewhile(lambda line: not line[1].strip() or _is_comment(line[1]), lines))
    lines = lines[len(head) :]
    if not lines:
        raise refusal(path, "no row of a table, only comments", "table")
    _, first = lines[0]
    if len(first) > MAX_LINE_LENGTH:
        raise refusal(path, f"no table: {too_long(first)[:-1]}", "table")
    header = tuple(_tolerant_cells(first, delimiter or usual))
    source.is_exact = header in _OWN and columns is None
    if not source.is_exact:
        sample = [line for _, line in lines[:_SAMPLE_ROWS] if line.strip()]
        if any(_RULE.fullmatch(line.strip()) for line in sample):
            remedy = (
                "Without frame: sed -n '/[^-+:=| ]/{s/^ *| *//; s/ *| *$//; /|/p;}' b.md > c.csv."
            )
            raise refusal(path, "a table of Markdown, which is not read", "table", remedy)
        delimiter = delimiter or _guess_delimiter(sample, usual)
    faults = list(filter(None, (read_directive(source, *line) for line in head)))
    source.reading = Reading(shape="table", delimiter=delimiter or usual)
    parsed = _parsed(source, lines, source.reading.delimiter)
    return source, _document(path, source, [*faults, *parsed], columns or ())


def _document(
    path: Path, source: FileRows, rows: list[Line | Fault | LeftOut], columns: Sequence[str]
) -> Document:
    """Return a table's rows as records by the names of its header, or by numbers without one."""
    body = [row for row in rows if isinstance(row, Line)]
    width = max((len(_without_blanks(row.cells)) for row in body), default=0)
    delimiter = source.reading.delimiter
    if width < 2:
        signs = DELIMITERS.get(delimiter, repr(delimiter))
        cell = body[0].cells[0] if body else ""
        raise refusal(
            path,
            f"no table, because {signs} give 1 column ({cell[:80]!r}), and no lines a + b = c "
            "with a sign, = or ->",
            "lines",
            "Another delimiter is named with --delimiter.",
        )
    heads = [row for row in body[:_HEADER_ROWS] if _are_names(row.cells)]
    is_named = not all(column.strip().isdecimal() for column in columns)
    is_first = not heads and (is_named or _are_unknown_names(body))
    header = next(iter(body[:1] if is_first else heads), Line(0, []))
    names = _without_blanks(header.cells)
    # Numbers where names are missing or repeated.
    keys = [
        name if name and name not in names[:at] else f"{name or 'column'} {at + 1}"
        for at, name in enumerate(names)
    ] or [str(at + 1) for at in range(width)]
    document = Document([], is_table=True, fault=table_fault)
    # Labels may be words of columns, but hardly those right below the header; in our own tables
    # they stand as they are.
    words_of_columns = chain(filter(is_documented, names), *(row.cells for row in heads[1:2]))
    header_words = set() if source.is_exact else {word.casefold() for word in words_of_columns}
    for row in rows:
        if isinstance(row, Line) and row.number < header.number:
            document.others.append(LeftOut(row.number, "above the header"))
        elif isinstance(row, Line) and row.number > header.number:
            fault = _row_fault(row, names, header_words, delimiter)
            if fault is None:
                cells = [*row.cells, *[""] * (len(keys) - len(row.cells))]
                document.places.append(row.number)
                document.value.append(dict(zip(keys, cells, strict=False)))
            else:
                document.others.append(fault)
        elif not isinstance(row, Line):
            document.others.append(row)
    source.reading = replace(source.reading, header=bool(names))
    return document


def _row_fault(
    row: Line, names: Sequence[str], header_words: Set[str], delimiter: str
) -> Fault | None:
    """Return why a row below the header is no recipe, or None."""
    number, cells = row.number, _without_blanks(row.cells)
    is_of_words = not header_words.isdisjoint(map(str.casefold, cells)) and _are_names(cells)
    if is_of_words or (names and cells == names):
        message = f"{', '.join(cells)!r:.80} names the columns again; keep one table."
        return Fault(number, "header", message, "header")
    if names and len(cells) > len(names):
        message = (
            f"'{delimiter.join(cells)[:80]}' has {counted(len(cells), 'cell')}; the table has "
            f"{len(names)} columns. Quote a cell with a delimiter in it."
        )
        return Fault(number, "row", message, f"width {len(cells)}")
    return None


def _without_blanks(cells: list[str]) -> list[str]:
    """Return cells without the blank ones at the end."""
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells


# --- lines ---------------------------------------------------------------------------------------

_SIGN = re.compile(r"[-=]+>|→|⇒|=")
"""The sign between ingredients and results."""
_LINE = re.compile(rf"[^,;\t|]*\+[^,;\t|]*(?:{_SIGN.pattern})|[^,;\t|]*(?:{_SIGN.pattern}).*\+")
"""A sum and a sign; a table has delimiters before the sign."""
_HEADING = re.compile(r"\s*(?:#|//|={2,}|-{2,}|\*{2,}|`{3}|\[[^\]+=]*\]\s*$|[^+=:]*:\s*$)")
_TAG = re.compile(r"#[\w.-]+:\w")  # a label of Minecraft, such as #minecraft:planks
_LEFT_OVER = re.compile(
    r"^[=<>~≈|:;*\"“„«`☐☑☒✓✔✅]|^'.*'$|^__|^--|^[-•–·◦▪‣+]\s|^\d+\s+[-–—]\s|^\[[ xX\d]*\]\s"
    r"|^\(?\d+[.)\]:](?:\s|[^\W\d])|[=<>~≈|:;*\"”`\\✓✔✅]\ufe0f?$|\s[-–—]$|[→⇒⟶⟹➡⇨➔➜←⇐⟵⟸⬅⇦≈]"
    r"|\[\[|\]\]|\]\(|;\s|&gt;|\s(?:[=<>~|#/]|//|:=)\s"
)
"""Signs, quotes, marks of lists, and comments, that a label does not hold."""
_PREFIX = re.compile(r"^(?:[^\w\s\"'(#]+\s*|.{0,30}?[:\])|]\s+|\S*\d\S*\s+)(?=.)")
_SUFFIX = re.compile(r"(?<=.)(?:\s*[\[(][^\[\]()]*[\])]|\s+[-–—]\s+.*|\s*[^\w\s\"')\]]+)$")
"""Beginnings and ends of lines that may be marks, or parts of labels."""
_OFTEN = 0.2  # share of the lines with a beginning or end
_SELDOM = 0.1  # how many times rarer it must be in other labels
_ENOUGH = 0.5  # share of the lines that are recipes, in a file of this shape
_SAMPLE_LINES = 200


def looks_like_lines(text: str) -> bool:
    """Return whether at least half of a text's first lines have a sum and a sign."""
    lines = [line for line in text[: 2**17].splitlines() if line.strip()][:_SAMPLE_LINES]
    content = [line for line in lines if not _is_heading(line)]
    sums = [line for line in content if _LINE.match(line[:MAX_LINE_LENGTH])]
    return bool(content) and len(sums) >= _ENOUGH * len(content)


def read_lines(path: Path, text: str) -> FileRows:
    """Read a text with a sum, a sign and results on each line.

    Args:
        path: the file, for errors.
        text: its text.

    Raises:
        RecipeFileError: if a sum is behind a sign, or many lines have the same mark.
    """
    source = FileRows(Reading(shape="lines a + b = c"))
    raws: list[Raw] = []
    entries: list[Entry] = []
    for number, line in enumerate(io.StringIO(text, newline=""), start=1):
        sides = [side.strip() for side in _SIGN.split(line)]
        if not line.strip():
            continue
        if _is_heading(line):
            fault = read_directive(source, number, line)
            entries.append(fault or LeftOut(number, "headings or comments"))
        elif len(line) > MAX_LINE_LENGTH:
            entries.append(Fault(number, "row", too_long(line), "long"))
        elif len(sides) != 2:
            sample = repr(line.strip()[:80])
            message = f"{sample} has no sign such as = or ->, or several; expected a + b = c."
            entries.append(Fault(number, "row", message, "no sign"))
        elif "+" in sides[1]:
            sign = _SIGN.findall(line)[0]
            remedy = f"The result is last: sed -E 's/(.*){sign}(.*)/\\2 {sign} \\1/' b.txt > c.txt."
            if "+" in sides[0] or raws:
                remedy = "Write a sum, a sign and the results on each line, these between commas."
            raise refusal(path, f"line {number} has a sum behind its sign", "lines", remedy)
        else:
            results = [result.strip() for result in sides[1].split(",")]
            raws.append(Raw(number, sides[:1], results))
    joiner = find_joiner([raw.parts[0] for raw in raws if raw.parts[0]])
    for raw in raws:
        entries += rows_of_raw(raw, joiner, {})
    _check_marks(path, [entry for entry in entries if isinstance(entry, Row)])
    entries.sort(key=itemgetter(0))
    labelled, trimmed = read_labels(entries, _label_fault, is_given=True)
    source.entries = without_nothing(labelled) if is_infinite_craft(labelled) else labelled
    source.reading = replace(source.reading, trimmed=trimmed)
    return source


def _check_marks(path: Path, rows: Sequence[Row]) -> None:
    """Refuse lines of which many begin or end alike, as with a mark that is no part of a label.

    Raises:
        RecipeFileError: naming what they share.
    """
    first = [row.ingredients[0] for row in rows]
    inner = list(chain.from_iterable(row.ingredients[1:] for row in rows))
    last = [row.result for row in rows]
    for verb, pattern, ends, opposite in (
        ("begin", _PREFIX, first, last),
        ("end", _SUFFIX, last, first),
    ):
        marks = [match[0].strip() for match in map(pattern.search, ends) if match]
        elsewhere = sum(1 for _ in filter(pattern.search, chain(inner, opposite)))
        share = len(marks) / max(len(ends), 1)
        is_elsewhere = elsewhere > _SELDOM * share * (len(inner) + len(opposite))
        if len(marks) > 1 and share >= _OFTEN and not is_elsewhere:
            raise refusal(
                path,
                f"many lines {verb} as with {marks[0][:40]!r}, which may be a mark or part of a "
                "label",
                "lines",
                "Remove it from the lines.",
            )


def _label_fault(label: str) -> str | None:
    sign = _LEFT_OVER.search(label)
    if sign is None and label.startswith("#") and not _TAG.match(label):
        return f"{label[:80]!r} may be a comment or a label; remove the #."
    if sign is not None and label_fault(label) is None:
        return (
            f"{label[:80]!r} holds {sign[0].strip() or sign[0]!r}, which may be a sign, a mark or "
            "part of a label; expected a + b = c."
        )
    return label_fault(label)


def _is_heading(line: str) -> bool:
    """Return whether a line is a heading or a comment; one that begins with a tag is a recipe."""
    return _is_comment(line.lstrip()) or bool(_HEADING.match(line) and not _LINE.match(line))
