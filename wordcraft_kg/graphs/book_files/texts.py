"""Texts that people write: tables in any dialect, with columns in any order, and lines a + b = c.

A table is a list of records by the names in its header, or of lists of cells without one. So its
columns have the rules of JSON: ``documents`` finds ingredients and results by documented words, or
by the option `columns`. In lines, either side of the sign may hold the sum: ``mud = water + earth,
clay + rain`` gives two recipes. Marks of lists are no part of labels.
"""

import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence, Set
from functools import cache
from itertools import chain, takewhile
from operator import ne
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from wordcraft_kg.base import ConfigError, counted
from wordcraft_kg.graphs.book_files.cells import (
    ambiguity,
    is_number,
    read_labels,
    trim_unseen,
    without_markup,
)
from wordcraft_kg.graphs.book_files.documents import Document
from wordcraft_kg.graphs.book_files.rows import (
    INFINITE_CRAFT_BASE,
    MAX_LINE_LENGTH,
    Entry,
    Fault,
    FileRows,
    LeftOut,
    Row,
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
_EVEN = 0.9  # share of rows with the most frequent number of cells
_FEWEST_BELOW = 3  # rows below a header of other words
_HEADER_ROWS = 6  # first rows among which the header is
_COMMENT = re.compile(r"//|#(?:\s|$)|#\s*(?:base|entities)\s*:", re.IGNORECASE)
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
    key, _, label_list = line.partition(":")
    name = key.removeprefix("#").strip().lower()
    if name not in ("base", "entities") or not _is_comment(line):
        return None
    if len(line) > MAX_LINE_LENGTH:
        return Fault(number, "directive", too_long(line))
    labels = _tolerant_cells(label_list.strip(), Dialect(","))
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
        ValueError: if a quote does not end, or text follows its end.
    """
    delimiter = dialect.delimiter
    line = line.rstrip("\r\n")
    if dialect.is_framed:
        line = line.strip().removeprefix(delimiter).removesuffix(delimiter)
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


def _tolerant_cells(line: str, dialect: Dialect) -> list[str]:
    """Return the cells of a row; one with a quote that does not end is split at delimiters."""
    try:
        return cells_of(line, dialect)
    except ValueError:
        return [cell.strip(" ") for cell in line.rstrip("\r\n").split(dialect.delimiter)]


def _dialect(lines: Sequence[str], delimiter: str) -> Dialect:
    """Return the dialect with a delimiter, by lines that are not blank."""
    if delimiter != "|":
        return Dialect(delimiter)
    stripped = [line.strip() for line in lines]
    framed = [line.startswith("|") and line.count("|") > 1 for line in stripped]
    return Dialect(delimiter, all(framed) or (any(framed) and any(map(_RULE.fullmatch, stripped))))


def _guess_dialect(path: Path, lines: Sequence[str], usual: str) -> Dialect:
    """Guess the dialect of a table: documented names in a header decide, else even rows.

    Raises:
        RecipeFileError: if two delimiters fit equally well; the message shows both readings.
    """
    with_header: list[Dialect] = []
    even: list[Dialect] = []
    for candidate in DELIMITERS:
        dialect = _dialect(lines, candidate)
        rows = [
            _tolerant_cells(line, dialect) for line in lines if not _RULE.fullmatch(line.strip())
        ]
        (width, number), *_ = Counter(map(len, rows)).most_common(1) or [(0, 0)]
        if any(map(_are_names, rows[:_HEADER_ROWS])):
            with_header.append(dialect)
        if width >= 3 and number >= _EVEN * len(rows):
            even.append(dialect)
    fitting = with_header or even or [_dialect(lines, usual)]
    if len(fitting) > 1:
        last = lines[-1]
        readings = [f"{_tolerant_cells(last, d)} ({DELIMITERS[d.delimiter]})" for d in fitting[:2]]
        raise refusal(
            path,
            f"two delimiters fit: {' or '.join(readings)}",
            "table",
            "Choose one with --delimiter.",
        )
    return fitting[0]


def _are_names(cells: Sequence[str]) -> bool:
    """Return whether cells are documented words for ingredients and a result."""
    # Amounts stand in rows, such as "Weakness to Frost,3,30": words beside them are labels.
    if sum(map(is_number, cells)) > 1:
        return False
    paths = [(EACH, f".{cell}") for cell in cells]
    documented_ways = [way for way in ways_by_words(paths) if way.is_documented]
    return any(way.is_named or is_name(way.results[0][-1][1:]) for way in documented_ways)


def _are_unknown_names(body: Sequence[Line]) -> bool:
    """Return whether the first row is rather a header of other words: no cell stands below."""
    first, *below = [row.cells for row in body]
    return len(below) >= _FEWEST_BELOW and set(first).isdisjoint(chain.from_iterable(below))


# --- the table -----------------------------------------------------------------------------------


def _is_comment(line: str) -> bool:
    """Return whether a line is a comment: // or # and a blank, or a directive."""
    return _COMMENT.match(line) is not None


def _parsed(
    source: FileRows, lines: Iterable[tuple[int, str]], dialect: Dialect
) -> Iterator[Line | Fault | LeftOut]:
    """Yield the cells of each line; faults, comments, and text around a table of Markdown."""
    for number, line in lines:
        text = line.strip()
        if not text or (dialect.delimiter == "|" and _RULE.fullmatch(text)):
            continue
        if len(line) > MAX_LINE_LENGTH:
            yield Fault(number, "row", too_long(line), "long")
        elif line[0] == "\ufeff":
            message = "a byte order mark in the middle, as where two files were joined; remove it."
            yield Fault(number, "row", message, "mark")
        elif _is_comment(line):
            yield LeftOut(number, "comments")
        elif dialect.is_framed and not text.startswith("|"):
            yield LeftOut(number, "outside of the table")
        else:
            try:
                cells = cells_of(line, dialect)
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
    lines = list(enumerate(io.StringIO(text, newline=""), start=1))
    head = list(takewhile(lambda line: not line[1].strip() or _is_comment(line[1]), lines))
    lines = lines[len(head) :]
    if not lines:
        raise refusal(path, "no row of a table, only comments", "table")
    faults = list(filter(None, (read_directive(source, *line) for line in head)))
    first = lines[0]
    if len(first[1]) > MAX_LINE_LENGTH:
        raise refusal(path, f"no table: {too_long(first[1])[:-1]}", "table")
    sample = [line for _, line in lines[:_SAMPLE_ROWS] if line.strip()]
    dialect = Dialect(delimiter or usual)
    header = tuple(_tolerant_cells(first[1], dialect))
    is_own = header in _OWN
    if not is_own:
        dialect = _dialect(sample, delimiter) if delimiter else _guess_dialect(path, sample, usual)
    source.reading = Reading(shape="table", delimiter=dialect.delimiter)
    source.is_exact = is_own
    return source, _document(path, source, [*faults, *_parsed(source, lines, dialect)], is_named)


def _document(
    path: Path, source: FileRows, rows: list[Line | Fault | LeftOut], is_named: bool
) -> Document:
    """Return a table's rows as records by the names of its header, or by numbers without one."""
    body = [row for row in rows if isinstance(row, Line)]
    width = max((len(_without_blanks(row.cells)) for row in body), default=0)
    if width < 2:
        signs = DELIMITERS.get(source.reading.delimiter, repr(source.reading.delimiter))
        cell = body[0].cells[0] if body else ""
        raise refusal(
            path,
            f"no table, because {signs} give 1 column ({cell[:80]!r}), and no lines a + b = c "
            "with a sign such as = or ->",
            "lines",
            "Another delimiter is named with --delimiter.",
        )
    grid = _grid(body)
    if grid is not None:
        return grid
    heads = [row for row in body[:_HEADER_ROWS] if _are_names(row.cells)]
    is_first = not heads and (is_named or _are_unknown_names(body))
    header = next(iter(body[:1] if is_first else heads), None)
    number_of_header = header.number if header else 0
    names = _without_blanks(header.cells) if header else []
    # Numbers where names are missing or repeated.
    keys = [
        name if name and name not in names[:at] else f"{name or 'column'} {at + 1}"
        for at, name in enumerate(names)
    ] or [str(at + 1) for at in range(width)]
    document = Document([], is_table=True)
    # Labels may be words of columns, but hardly those right below the header; in our own tables
    # they stand as they are.
    words_of_columns = chain(filter(is_documented, names), *(row.cells for row in heads[1:2]))
    header_words = set() if source.is_exact else {word.casefold() for word in words_of_columns}
    for row in rows:
        if not isinstance(row, Line):
            document.others.append(row)
        elif row.number < number_of_header:
            document.others.append(LeftOut(row.number, "above the header"))
        elif row.number > number_of_header:
            odd = _odd_row(row, names, header_words, source.reading.delimiter)
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
    results = [record["result"] for record in document.value if record["result"]]
    # In a table of effects or numbers, results are no names.
    is_closed = 2 * sum(result in names for result in results) > len(results)
    return document if is_closed else None


def _odd_row(
    row: Line, names: Sequence[str], header_words: Set[str], delimiter: str
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
    if not header_words.isdisjoint(map(str.casefold, cells)) and _are_names(cells):
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

_FORWARD = "→⇒⟶⟹➡⇨➔➜"
_BACKWARD = "←⇐⟵⟸⬅⇦"
_SIGNS = tuple(
    re.compile(sign)
    for sign in (
        rf"[-=~—–]+(?:>|&gt;)|[{_FORWARD}]\ufe0f?",
        rf"[<‹][-=~—–]+|[{_BACKWARD}]\ufe0f?",
        r":=",
        r"\s=\s",
        r"=",
        r"\s:\s",
        r":",
    )
)
"""Signs between ingredients and results, the more certain ones first."""
_MARK = re.compile(
    r"(?:\s*(?:[-*•–·◦▪‣+>]\s+|\*{2,}\s+|>+\s+|\(?\d+[.)\]:]\s+|\d+[.)](?=[^\W\d])|\[\d+\]\s+"
    r"|\d+\s+[-–—]\s+|\[[ xX]?\]\s+|[☐☑☒✓✔✅]\ufe0f?\s*)){0,3}"
)
"""Marks of a list before a line: bullets, numbers, boxes, quotes."""
_END_MARK = re.compile(r"\s*(?:;|<br\s*/?>|\\|[✓✔✅]\ufe0f?)\s*$", re.IGNORECASE)
_QUOTED = re.compile(r"""(["'])((?:(?!\1).)+)\1""")
_WIDE_SIGNS = str.maketrans("＋＝：，", "+=:,")
"""Signs as East Asian keyboards write them."""
_HEADING = re.compile(r"\s*(?:#|//|={2,}|-{2,}|\*{2,}|`{3}|\[[^\]+=]*\]\s*$|[^+=:]*:\s*$)")
_TAG = re.compile(r"#[\w.-]+:\w")  # a label of Minecraft, such as #minecraft:planks
_LEFT_OVER = re.compile(
    rf"^[=<>~≈|:;*\"“`]|^-[-\s]|[=<>~≈|:;*\"”`]$|\s[-–—]$|[{_FORWARD}{_BACKWARD}≈]|\[\[|\]\]|;\s"
    r"|\s(?:[=<>~|#/]|//|:=)\s"
)
"""Signs, quotes and comments that a label does not hold."""
_PREFIX = re.compile(r"^(?:[^\w\s\"'(#]+\s*|.{0,30}?[:\])|]\s+|\S*\d\S*\s+)(?=.)")
_SUFFIX = re.compile(r"(?<=.)(?:\s*[\[(][^\[\]()]*[\])]|\s+[-–—]\s+.*|\s*[^\w\s\"')\]]+)$")
"""Beginnings and ends of lines that may be marks, or parts of labels."""
_OFTEN = 0.2  # share of the lines with a beginning or end
_SELDOM = 0.1  # how many times rarer it must be in other labels
_ENOUGH = 0.5  # share of the lines that are recipes, in a file of this shape
_SAMPLE_LINES = 200


_Sides = tuple[str, str, bool]
"""A line's two sides of the sign, and whether it is an arrow to the left."""


def looks_like_lines(text: str, *, is_table: bool) -> bool:
    """Return whether at least half of a text's first lines have a sum and a sign.

    Args:
        text: the text.
        is_table: whether the file's ending is that of a table; then the sum has to come before any
            delimiter, as in a + b = c, d.
    """
    lines = [line for line in text[: 2**17].splitlines() if line.strip()][:_SAMPLE_LINES]
    content = [line for line in lines if not _is_heading(line)]
    if is_table and any(sign in line for line in content[:20] for sign in ",;\t|"):
        starts = [_sides(re.split(r"[,;\t|]", line)[0]) for line in content]
        return bool(content) and all(sides is not None and "+" in sides[0] for sides in starts)
    sums = [line for line in content if _is_recipe(line[:MAX_LINE_LENGTH])]
    return bool(content) and len(sums) >= _ENOUGH * len(content)


def read_lines(path: Path, text: str, *, fold: bool = False) -> FileRows:
    """Read a text with a sum on each line.

    Args:
        path: the file, for errors.
        text: its text.
        fold: whether labels are in lower case.

    Raises:
        RecipeFileError: if sums are on both sides, or an arrow points at a sum.
    """
    lines = list(enumerate(io.StringIO(text, newline=""), start=1))
    parted = {number: _sides(line) for number, line in lines if not _is_heading(line)}
    sides = {number: pair for number, pair in parted.items() if pair is not None}
    for number, (left_side, _, is_backward) in sides.items():
        if is_backward and "+" in left_side:
            raise refusal(
                path, f"line {number}, whose arrow points at a sum of ingredients", "lines"
            )
    sum_is_left = any("+" in left_side for left_side, _, _ in sides.values())
    if sum_is_left and any("+" in right_side for _, right_side, _ in sides.values()):
        raise refusal(path, "lines with sums on either side of the sign, or on both", "lines")
    columns = ("sum", "result" if sum_is_left else "result before it")
    source = FileRows(Reading(shape="lines a + b = c", columns=columns))
    entries: list[Entry] = []
    for number, line in lines:
        if number in sides and len(line) <= MAX_LINE_LENGTH:
            entries += _recipes(source, number, sides[number], sum_is_left=sum_is_left)
        elif line.strip():
            fault = read_directive(source, number, line)
            entries.append(fault or _odd_line(number, line, is_heading=number not in parted))
    rows = [entry for entry in entries if isinstance(entry, Row)]
    labels = read_labels(rows, label_fault, fold=fold)
    source.entries = [labels.row(entry) if isinstance(entry, Row) else entry for entry in entries]
    labels.finish(source)
    # Each label of Infinite Craft's base as a word of its own.
    if all(re.search(rf"\b{word}\b", text) for word in INFINITE_CRAFT_BASE):
        source.entries = without_nothing(source.entries, fold=fold)
    _check_marks(path, rows, sum_is_left=sum_is_left)
    return source


def _check_marks(path: Path, rows: Sequence[Row], *, sum_is_left: bool) -> None:
    """Refuse lines of which many begin or end alike, as with a mark that is no part of a label.

    Raises:
        RecipeFileError: naming what they share.
    """
    first, last = ([row.ingredients[0] for row in rows], [row.result for row in rows])
    inner = [label for row in rows for label in row.ingredients[1:]]
    if not sum_is_left:
        first, last = last, [row.ingredients[-1] for row in rows]
    for verb, pattern, ends in (("begin", _PREFIX, first), ("end", _SUFFIX, last)):
        other_labels = [*inner, *(last if ends is first else first)]
        mark = _common_mark(pattern, ends, other_labels)
        if mark is not None:
            raise refusal(
                path,
                f"many lines {verb} as with {mark[:40]!r}, which may be a mark or part of a label",
                "lines",
                "Remove it from the lines.",
            )


def _common_mark(pattern: re.Pattern[str], ends: list[str], other_labels: list[str]) -> str | None:
    """Return what many labels at an end of lines have, and few other labels; None without one."""
    marks = [match[0].strip() for match in map(pattern.search, ends) if match]
    elsewhere = sum(1 for label in other_labels if pattern.search(label))
    share = len(marks) / max(len(ends), 1)
    is_mark = (
        len(marks) > 1 and share >= _OFTEN and elsewhere <= _SELDOM * share * len(other_labels)
    )
    return marks[0] if is_mark else None


def _odd_line(number: int, line: str, *, is_heading: bool) -> LeftOut | Fault:
    """Return a line without a recipe."""
    if is_heading:
        return LeftOut(number, "headings or comments")
    if len(line) > MAX_LINE_LENGTH:
        return Fault(number, "row", too_long(line), "long")
    sample = repr(line.strip()[:80])
    return Fault(
        number,
        "row",
        f"{sample} has no sign such as = or ->, or several; expected a + b = c.",
        "no sign",
    )


def _recipes(source: FileRows, number: int, sides: _Sides, *, sum_is_left: bool) -> Iterator[Entry]:
    left_side, right_side, _ = sides
    # Several results, or several sums of the same result, between commas.
    if sum_is_left:
        pairs = [(_summands(left_side), _unwrapped(result)) for result in right_side.split(",")]
        several_outputs = source.reading.several_outputs + (len(pairs) > 1)
        source.reading = replace(source.reading, several_outputs=several_outputs)
    else:
        pairs = [(_summands(part), _unwrapped(left_side)) for part in right_side.split(",")]
    for ingredients, result in pairs:
        # Each fault once, in the order of the labels.
        faults = dict.fromkeys(filter(None, map(_label_fault, (*ingredients, result))))
        message = ambiguity(ingredients, "+") or " Also, ".join(faults)
        yield Fault(number, "label", message) if message else Row(number, ingredients, result)


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
    """Return whether a line is a heading or comment; nested bullets and tags are recipes."""
    # The name of a column of lines.
    if len(line.split()) == 1 and is_documented(line):
        return True
    return _is_comment(line.lstrip()) or bool(_HEADING.match(line) and not _is_recipe(line))


def _is_recipe(line: str) -> bool:
    sides = _sides(line)
    return sides is not None and ("+" in sides[0] or "+" in sides[1])


def _sides(line: str) -> _Sides | None:
    """Return what stands left and right of a line's sign, or None without exactly one sign."""
    content = line.translate(_WIDE_SIGNS).strip()
    mark = _MARK.match(content)
    content = _END_MARK.sub("", content[mark.end() if mark else 0 :])
    for sign in _SIGNS:
        parts = sign.split(content, maxsplit=2)
        # A sign at an end is a mark; a less certain sign may part the line.
        if len(parts) < 2 or not parts[0].strip() or not parts[1].strip():
            continue
        if len(parts) > 2:
            return None
        return _unwrapped(parts[0]), _unwrapped(parts[1]), sign is _SIGNS[1]
    return None


def _summands(text: str) -> list[str]:
    """Return the parts of a sum; a plus without spaces is part of a label if there is one with."""
    return [_unwrapped(part) for part in text.split(" + " if " + " in text else "+")]


def _unwrapped(text: str) -> str:
    """Return a text without quotes or markup around all of it."""
    text = without_markup(text.strip())
    # Two quoted labels stay as they are, and are refused.
    quoted = _QUOTED.fullmatch(text)
    inner = quoted[2].strip() if quoted else ""
    return inner or text
