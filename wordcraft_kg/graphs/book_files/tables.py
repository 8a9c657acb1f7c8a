"""Tables: a row for each recipe, in any dialect, with columns in any order.

A header with our own names is read as it is. Any other table is guessed: the dialect from the
first rows, the columns from their names or, without a header, from the rows.
"""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain
from operator import ne
from pathlib import Path

from wordcraft_kg.base.wording import counted
from wordcraft_kg.graphs.book_files.cells import has_unseen, trim_unseen
from wordcraft_kg.graphs.book_files.columns import (
    KIND,
    Roles,
    are_reused,
    names_a_result,
    readings,
    repeated_cells,
    roles_of_header,
    roles_of_option,
)
from wordcraft_kg.graphs.book_files.dialects import (
    DELIMITERS,
    Dialect,
    cells_of,
    first_lines,
    guess_dialect,
    strict_cells,
    trimmed,
)
from wordcraft_kg.graphs.book_files.directives import is_directive, read_directive
from wordcraft_kg.graphs.book_files.guide import refusal
from wordcraft_kg.graphs.book_files.places import result_place
from wordcraft_kg.graphs.book_files.plain_rows import number_plain_rows
from wordcraft_kg.graphs.book_files.rows import (
    FROM_NOTHING,
    NOTHING,
    WITH_NOTHING,
    Entry,
    Fault,
    LeftOut,
    RowSource,
    alternatives,
    is_infinite_craft,
    is_missing,
)
from wordcraft_kg.graphs.chains import is_half_product
from wordcraft_kg.graphs.recipes import RecipeRows, label_fault

CSV_HEADER = ("ingredient_a", "ingredient_b", "result")
ENDINGS = {".csv": ",", ".tsv": "\t", ".tab": "\t"}
"""Usual column delimiters by file ending."""
MAX_LINE_LENGTH = 100_000
"""Longest row, in characters: a file without line ends fails early, with the reason."""
_OWN = (CSV_HEADER, (*CSV_HEADER, KIND))
_JUDGED_ROWS = 100_000  # rows by which columns without a header are judged
_HEAD_LINES = 1_000  # of the start of a file, to find the first rows below comments
_FORMULA = re.compile(
    r"[=@]\s*[A-Z.]+\(|=\$?[A-Z]{1,3}\$?\d|#(?:REF|VALUE|NAME|DIV/0|NULL|NUM)[!?]|#N/A$"
)
# The line below the header of a table in Markdown or Org; one sign alone may be a cell.
_RULE = re.compile(r"[-=+]{2,}|:[-=+]+:?|[-=+]+:")
_NUMBER = re.compile(r"[-+]?\d*[.,]?\d+(?:[eE][-+]?\d+)?%?")
_JOINERS = ("+", ";", "&", ",")  # between ingredients in one cell
_OTHER_JOINERS = ("/", "|", " and ", " or ", " with ", " x ", " et ", " und ")
"""Between ingredients in one cell, too, but also in labels: not parted."""
_TITLE_ROWS = 5  # rows below the first in which a header is looked for
_MOST_WITHOUT_GRID = 3  # columns of ingredients; more may be the slots of a crafting grid
_MOSTLY = 0.5  # share of a column's cells


class Table(RowSource):
    """A table of recipes, read row by row."""

    shape = "table"

    def __init__(
        self,
        path: Path,
        text: str,
        delimiter: str | None = None,
        columns: Sequence[str] | None = None,
        usual: str = ",",
    ):
        """Guess the dialect and the columns.

        Args:
            path: the file, for errors.
            text: its text.
            delimiter: the delimiter; None to guess.
            columns: names or numbers of the columns of ingredients and, last, of the result; None
                to guess.
            usual: the delimiter of the file's ending.

        Raises:
            RecipeFileError: if two delimiters fit or the columns cannot be told, with the readings;
                or if the text is no table.
            ConfigError: if ``columns`` are not in the table.
        """
        super().__init__()
        self._path = path
        self._text = text
        self._file = io.StringIO(text, newline="")
        self._lines = enumerate(self._file, start=1)
        self._faults: list[Fault] = []
        self._comments: list[tuple[int, str]] = []
        self._first: tuple[int, str] | None = None
        named = self._read_head()
        first = "" if self._first is None else self._first[1]
        self._is_own = _is_own(first, delimiter or usual)
        self._dialect = Dialect(delimiter or usual)
        self._joiner = ""
        self._known: dict[str, str] = {}
        if self._is_own and columns is None:
            names = [cell.strip() for cell in first.split(self._dialect.delimiter)]
            self._names: list[str] | None = names
            self._roles = Roles((0, 1), (2,), 3 if len(names) == 4 else None)
            self._width = len(names)
        else:
            self._guess(delimiter or named, usual, columns)
        self.delimiter = self._dialect.delimiter
        # The double quote goes without saying.
        self.quote = "" if self._dialect.quote == '"' else self._dialect.quote
        self.header = self._names is not None
        self._may_hold_formula = any(sign in text for sign in "=#@")
        self._drops_nothing = not self._is_own and is_infinite_craft(text)
        # Our own tables hold any label, so that what is written is read again.
        self.is_exact = self._is_own
        self._has_unseen = self._is_own and has_unseen(text)
        # A row of three cells needs no further look, the frequent case in a large book.
        has_usual_order = self._roles.ingredients == (0, 1) and self._roles.results == (2,)
        needs_a_look = (
            self._drops_nothing
            or self._has_unseen
            or self.delimiter == "|"  # rules and frames of Markdown
        )
        self._is_plain = has_usual_order and self._width == 3 and not needs_a_look
        self._name_columns()

    # --- the head ---------------------------------------------------------------------------------

    def _read_head(self) -> str | None:
        """Read comments up to the first row; return the delimiter that Excel's first line names."""
        named = None
        for number, line in self._lines:
            if line.startswith(("#", "//")):
                if not is_directive(line):
                    self._comments.append((number, line))
                fault = read_directive(self, number, line)
                if fault is not None:
                    self._faults.append(fault)
            elif re.fullmatch(r'"?sep=(.)"?', line.strip("\r\n ")) and named is None:
                named = line.strip('\r\n "')[4]
            elif line.strip():
                self._first = (number, line)
                break
        return named

    # --- the guess --------------------------------------------------------------------------------

    def _guess(self, delimiter: str | None, usual: str, columns: Sequence[str] | None) -> None:
        """Set dialect, header and roles."""
        if self._first is None:
            raise refusal(self._path, "no row of a table, only comments", "table")
        number, first = self._first
        self._check_comments(first, delimiter, usual)
        lines = first_lines([first, *self._following(_HEAD_LINES)])
        if max(map(len, lines)) > MAX_LINE_LENGTH:
            longest = max(lines, key=len)
            raise refusal(self._path, f"no table: {_too_long(longest)[:-1]}", "table")
        self._dialect = guess_dialect(self._path, lines, delimiter, usual)
        rows = [cells_of(line, self._dialect) for line in lines]
        names, *rows = [row for row in rows if not self._is_rule(row)]
        # A delimiter at the end of a header begins no column.
        while len(names) > 1 and not names[-1]:
            names = names[:-1]
        self._width = max(len(_without_blanks(row)) for row in [names, *rows])
        self._names = names
        if columns is not None:
            self._take_columns(columns, names, rows)
            return
        roles = roles_of_header(names)
        if roles is None:
            self._judge_rows()
            return
        repeated = repeated_cells(names, roles, rows)
        if repeated:
            raise refusal(
                self._path,
                f"line {number} may name the columns or be a recipe: "
                f"{', '.join(map(repr, repeated[:3]))} also stands below",
                "table",
                "Choose with `columns`: names take the line as header, numbers as recipe.",
            )
        self._check_names(number, names, rows)
        self._roles = roles
        self._shift_row_names(names, rows)
        self._check_results(rows)
        self._check_sums(rows)
        self._width = max(self._width, max((*self._roles.used, 0)) + 1)
        self._find_joiner(rows)

    def _check_comments(self, first: str, delimiter: str | None, usual: str) -> None:
        """Refuse comments that have the cells of a row, such as ids with # or tags.

        Raises:
            RecipeFileError: naming the line.
        """
        # The usual delimiter first, and each once.
        signs = [delimiter] if delimiter else dict.fromkeys((usual, *DELIMITERS))
        for number, line in self._comments:
            # A space after the mark is what a comment has, and a label with # has not.
            if line[1:2].isspace():
                continue
            for sign in signs:
                if sign in line and line.count(sign) == first.count(sign):
                    raise refusal(
                        self._path,
                        f"line {number} begins with # and has the cells of a row: it may be a "
                        "comment or a row",
                        "table",
                        "Write a space after the # of a comment, or quotes around a label.",
                    )

    def _check_names(self, number: int, names: list[str], rows: Sequence[Sequence[str]]) -> None:
        """Refuse a header of two rows: a column without a name, or names below names."""
        # Row names, in the first column, have no header in R and pandas.
        for i in range(1, len(names)):
            if not names[i] and any(len(row) > i and row[i] for row in rows):
                raise refusal(
                    self._path,
                    f"line {number} names no column {i + 1}, but it is filled below",
                    "table",
                    "Give each column a name, or choose with `columns`.",
                )
        second = roles_of_header(rows[0]) if rows else None
        if second is not None and len(second.ingredients) > 1:
            again = ", ".join(map(repr, rows[0][:4]))
            raise refusal(
                self._path,
                f"the row below line {number} names the columns again: {again}",
                "table",
                "Keep one header line, or choose with `columns`.",
            )

    def _check_results(self, rows: Sequence[Sequence[str]]) -> None:
        """Refuse a column that is taken for results only because it is left over, or of numbers."""
        names = self._names or []
        parts: set[str] = set()
        for i in self._roles.ingredients:
            parts.update(_column(rows, i))
        # Where ingredients are numbers as well, such as ids, numbers are labels.
        are_ids = all(map(_NUMBER.fullmatch, parts))
        for i in self._roles.results:
            cells = _column(rows, i)
            has_only_numbers = bool(cells) and all(map(_NUMBER.fullmatch, cells))
            is_numeric = has_only_numbers and not are_ids
            is_told = names_a_result(names[i]) or are_reused(set(cells), parts)
            if is_numeric or not is_told:
                why = "holds only numbers" if is_numeric else "is not named as results"
                raise refusal(
                    self._path,
                    f"a table whose column {i + 1} ({names[i][:40]!r}) {why}; a column of results "
                    "is missing",
                    "table",
                    "Name the columns of ingredients and, last, of the result with `columns`.",
                )

    def _check_sums(self, rows: Sequence[Sequence[str]]) -> None:
        """Refuse several columns of ingredients whose cells are recipes of their own."""
        if len(self._roles.ingredients) == 1:
            return
        for i in self._roles.ingredients:
            cells = _column(rows, i)
            for joiner in _JOINERS:
                joined = [cell for cell in cells if joiner in cell and not is_half_product(cell)]
                if joined and len(joined) > _MOSTLY * len(cells):
                    raise refusal(
                        self._path,
                        f"a table with several columns of ingredients, in which {joined[0][:60]!r} "
                        f"may be a recipe of its own, with {joiner!r} between ingredients",
                        "table",
                        "Write one recipe in each row.",
                    )

    def _following(self, limit: int) -> list[str]:
        """Return lines below the first row, at most as many as the limit."""
        number = 0 if self._first is None else self._first[0]
        lines = []
        for index, line in enumerate(io.StringIO(self._text, newline=""), start=1):
            if index > number:
                lines.append(line)
            if len(lines) >= limit:
                break
        return lines

    def _take_columns(
        self, columns: Sequence[str], names: Sequence[str], rows: Sequence[Sequence[str]]
    ) -> None:
        """Take the roles from the option; numbers alone leave a header to its names."""
        by_number = all(column.strip().isdecimal() for column in columns)
        if by_number:
            roles = roles_of_header(names)
            if roles is None or repeated_cells(names, roles, rows):
                self._names = None
        self._roles = roles_of_option(columns, self._names, self._width)
        self._find_joiner(rows)

    def _judge_rows(self) -> None:
        """Find the roles of columns without known names, or refuse the table."""
        rows = self._judged_rows()
        first_row, *others = rows
        seen = ", ".join(repr(cell[:40]) for cell in first_row[:8])
        delimiter = self._dialect.delimiter
        delimiters = DELIMITERS.get(delimiter, repr(delimiter))
        named = f"a table with {delimiters}"
        remedy = "Name the columns of ingredients and, last, of the result with `columns`."
        self._check_title(others)
        if len(first_row) == 2 and any("+" in cell for cell in first_row):
            self._plus_columns(rows)
            return
        if max(map(len, rows)) == 1:
            raise refusal(
                self._path,
                f"no table, because {delimiters} give 1 column ({seen}), and no lines a + b = c "
                "with a sign such as = or ->",
                "lines",
                "Another delimiter is named with `delimiter`.",
            )
        if len(first_row) != 3:
            raise refusal(
                self._path,
                f"{named} and {counted(len(first_row), 'column')} ({seen}); none is named as "
                "ingredients and result",
                "table",
                remedy,
            )
        full = [row for row in rows if len(row) == 3 and all(row)]
        # Without the first row, which may be a header.
        below = full[1:]
        numeric = []
        if below:
            numeric = [i for i in range(3) if all(map(_NUMBER.fullmatch, _column(below, i)))]
        # Three columns of numbers are ids; a single one holds weights or such.
        if len(numeric) == 1:
            (column,) = numeric
            raise refusal(
                self._path,
                f"{named} whose column {column + 1} ({first_row[column][:40]!r}) holds only "
                "numbers, such as weights or ids; a column of results is missing",
                "table",
                remedy,
            )
        known = set(chain.from_iterable(others))
        if others and known.isdisjoint(first_row):
            raise refusal(
                self._path,
                f"{named} whose first row ({seen}) may name the columns or be a recipe",
                "table",
                "Choose with `columns`: names take the row as header, numbers as recipe.",
            )
        result = result_place(full) if full else None
        if result is None:
            raise refusal(
                self._path,
                f"{named} without a header, and the rows do not tell which column is the result: "
                f"{readings(first_row)}",
                "table",
            )
        self._names = None
        self._width = 3
        ingredients = tuple(i for i in range(3) if i != result)
        self._roles = Roles(ingredients, (result,))

    def _judged_rows(self) -> list[list[str]]:
        """Return the cells of the first rows, without rules, blank rows and blank ends of rows."""
        _, first = self._first or (0, "")
        rows = []
        for line in [first, *self._following(_JUDGED_ROWS)]:
            cells = cells_of(line, self._dialect) if line.strip() else []
            if any(cells) and not self._is_rule(cells):
                rows.append(_without_blanks(cells))
        return rows

    def _check_title(self, others: Sequence[Sequence[str]]) -> None:
        """Refuse a table whose header stands below other rows.

        Raises:
            RecipeFileError: naming the header.
        """
        for row in others[:_TITLE_ROWS]:
            if len(row) > 1 and roles_of_header(row) is not None:
                raise refusal(
                    self._path,
                    f"rows above the row that names the columns ({', '.join(row[:4])[:80]})",
                    "table",
                    "Remove what stands above it, such as a title.",
                )

    def _plus_columns(self, rows: Sequence[Sequence[str]]) -> None:
        """Take two columns without known names, of which one has sums of ingredients."""
        sums = []
        if all(len(row) == 2 for row in rows):
            sums = [i for i in range(2) if all("+" in row[i] for row in rows)]
        if len(sums) != 1:
            raise refusal(
                self._path,
                "a table of two columns, where '+' stands in both or not in all rows",
                "lines",
            )
        self._names = None
        self._width = 2
        self._roles = Roles((sums[0],), (1 - sums[0],))
        self._joiner = "+"

    def _shift_row_names(self, names: list[str], rows: Sequence[Sequence[str]]) -> None:
        """R writes row numbers without a name in the header: all names move by one column."""
        is_shifted = bool(rows) and all(
            len(row) == len(names) + 1 and row[0].isdecimal() for row in rows
        )
        if not is_shifted:
            return
        self._names = ["", *names]
        self._roles = self._roles.shifted()

    def _find_joiner(self, rows: Sequence[Sequence[str]]) -> None:
        """Find what stands between ingredients, if one column holds them all."""
        if len(self._roles.ingredients) != 1:
            return
        (column,) = self._roles.ingredients
        cells = _column(rows, column)
        counts = {joiner: sum(joiner in cell for cell in cells) for joiner in _JOINERS}
        fitting = [joiner for joiner in _JOINERS if counts[joiner]]
        everywhere = [joiner for joiner in fitting if counts[joiner] == len(cells)]
        # The only sign that each cell holds is meant; others are part of labels.
        if len(everywhere) == 1:
            fitting = everywhere
        if len(fitting) > 1:
            one, other = fitting[:2]
            cell = next(cell for cell in cells if one in cell or other in cell)
            raise refusal(
                self._path,
                f"ingredients such as {cell[:60]!r} could be parted at {one!r} or at {other!r}",
                "table",
                "Write each ingredient in a column of its own.",
            )
        if fitting:
            self._joiner = fitting[0]
            return
        self._check_single(rows)
        for joiner in _OTHER_JOINERS:
            joined = [cell for cell in cells if joiner in cell]
            if joined and len(joined) > _MOSTLY * len(cells):
                raise refusal(
                    self._path,
                    f"one column of ingredients, and {joiner!r} in cells such as "
                    f"{joined[0][:60]!r} may stand between them or be part of a label",
                    "table",
                    "Write + between the ingredients, or each in a column of its own.",
                )

    def _check_single(self, rows: Sequence[Sequence[str]]) -> None:
        """Refuse a column of single ingredients if results repeat: rows may be parts of a recipe.

        Raises:
            RecipeFileError: naming such a result.
        """
        results = Counter(_column(rows, self._roles.results[0]))
        for result, number in results.most_common(1):
            if number > 1:
                raise refusal(
                    self._path,
                    f"one ingredient in each row, and {number:,} rows with the result "
                    f"{result[:40]!r}: they may be one recipe or several",
                    "table",
                    "Write one recipe in each row.",
                )

    def _is_rule(self, cells: Sequence[str]) -> bool:
        return self._dialect.delimiter == "|" and all(_RULE.fullmatch(cell) for cell in cells)

    def _name_columns(self) -> None:
        """Note the names of columns for the announcement; a number stands for a missing name."""
        roles = self._roles
        self.num_results = len(roles.results)
        names = self._names
        if names is None:
            names = [f"column {i + 1}" for i in range(self._width)]
        self.columns = tuple(names[i] for i in (*roles.ingredients, *roles.results))
        ignored = []
        for i, name in enumerate(names):
            if i not in roles.used:
                ignored.append(name or f"column {i + 1}")
        self.ignored = tuple(ignored)

    # --- the rows ---------------------------------------------------------------------------------

    def all_rows(self) -> RecipeRows | None:
        """Return the rows of our own tables, the usual ones of a large book, if all are plain."""
        if not self._is_plain or not self._is_own or self._names is None or self._faults:
            return None

        def is_odd(label: str) -> bool:
            # Such a label may be of a header that is repeated in the middle.
            return label in CSV_HEADER or self._label_fault(label) is not None

        dialect = self._dialect
        # Behind the header; a file remembers how far it was read.
        start = self._file.tell()
        return number_plain_rows(self._text, start, dialect.delimiter, dialect.quote, is_odd)

    def __iter__(self) -> Iterator[Entry]:
        """Yield recipes, invalid rows and rows left out, in file order."""
        yield from self._faults
        if self._first is not None and self._names is None:
            yield from self._read(*self._first)
        for number, line in self._lines:
            labels = self._plain_labels(line) if self._is_plain else None
            if labels is not None:
                yield number, labels
            else:
                yield from self._read(number, line)

    def _plain_labels(self, line: str) -> list[str] | None:
        """Return three valid labels of an unquoted row, the frequent case, or None."""
        if self._dialect.quote in line or len(line) > MAX_LINE_LENGTH or line[0] == "\ufeff":
            return None
        delimiter = self._dialect.delimiter
        cells = trimmed(line.rstrip("\r\n"), delimiter).split(delimiter)
        if len(cells) != 3 or not all(cells) or cells == self._names:
            return None
        # Most labels were met before: a look-up is faster than a check, and repeated labels become
        # one object, which saves memory and makes sorting faster.
        known = self._known
        try:
            return [known[cells[0]], known[cells[1]], known[cells[2]]]
        except KeyError:
            if any(map(self._label_fault, cells)):
                return None
            return [known.setdefault(cell, cell) for cell in cells]

    def _read(self, number: int, line: str) -> Iterator[Entry]:
        if len(line) > MAX_LINE_LENGTH:
            yield Fault(number, "row", _too_long(line), "long")
            return
        if line[0] == "\ufeff":
            message = "a byte order mark in the middle, as where two files were joined; remove it."
            yield Fault(number, "row", message, "mark")
            return
        try:
            cells = strict_cells(line, self._dialect)
        except (csv.Error, ValueError) as error:
            message = f"{error}; a quoted cell ends in its line, and a quote in it is doubled."
            yield Fault(number, "row", message, "quote")
            return
        # A table that we write has quotes around cells that begin or end with blanks.
        if self._has_unseen and self._dialect.quote not in line:
            trimmed = list(map(trim_unseen, cells))
            self.trimmed += sum(map(ne, trimmed, cells))
            cells = trimmed
        if not cells or self._is_rule(cells):
            return
        if not any(cells):
            yield LeftOut(number, "blank")
        elif self._names is not None and cells == self._names:
            yield Fault(number, "header", "the header is repeated in the middle", "header")
        else:
            yield from self._recipes(number, cells)

    def _recipes(self, number: int, cells: list[str]) -> Iterator[Entry]:
        roles = self._roles
        # Spreadsheets write empty cells at the end of a row up to the widest one.
        while len(cells) > self._width and not cells[-1]:
            cells = cells[:-1]
        needed = max(*roles.ingredients, *roles.results) + 1
        limit = self._width if self._names is None else max(len(self._names), needed)
        if not needed <= len(cells) <= limit:
            yield Fault(number, "row", self._wrong_width(cells, limit), f"width {len(cells)}")
            return
        ingredients = [cells[i] for i in roles.ingredients if cells[i]]
        message = self._merged(cells)
        if message:
            yield Fault(number, "row", message, "merged")
            return
        if self._joiner and ingredients:
            # One cell holds all ingredients.
            parts = ingredients[0].split(self._joiner)
            ingredients = [part.strip() for part in parts]
            message = alternatives(ingredients) or self._not_parted(ingredients)
            if message:
                yield Fault(number, "row", message, "alternatives")
                return
        # Of no result, the first column's blank cell stays: a fault that names the row.
        results = [cells[i] for i in roles.results if cells[i]] or [cells[roles.results[0]]]
        kind = self._kind_in(cells)
        # A blank label is a fault, so that a row without ingredients names it; a blank kind is not.
        labels = [*(ingredients or [""]), *results, *filter(None, [kind])]
        faults = dict.fromkeys(filter(None, map(self._label_fault, labels)))
        if faults:
            yield Fault(number, "label", " Also, ".join(faults))
            return
        # Counted after the faults, so that refused rows do not count.
        self.counts_dropped += self._counts_in(cells)
        if self._drops_nothing and NOTHING in ingredients:
            yield LeftOut(number, FROM_NOTHING)
            return
        self.several_outputs += len(results) > 1
        for result in results:
            if self._drops_nothing and result == NOTHING:
                yield LeftOut(number, WITH_NOTHING)
                continue
            fault = self._note_kind(number, ingredients, result, kind)
            yield fault or (number, [*ingredients, result])

    def _kind_in(self, cells: Sequence[str]) -> str:
        """Return the kind of a row, or an empty text."""
        column = self._roles.kind
        return "" if column is None or column >= len(cells) else cells[column]

    def _counts_in(self, cells: Sequence[str]) -> int:
        """Return how many numbers of pieces a row loses; one piece is meant without a number."""
        counts = [cells[i] for i in self._roles.counts if i < len(cells)]
        return sum(count not in ("", "1") for count in counts)

    def _merged(self, cells: Sequence[str]) -> str | None:
        """Return why a row's first ingredient may stand in the row above, or None.

        Spreadsheets leave blank all cells but the first of those that they merged. In a grid of
        many slots blanks are usual, and our own tables have single ingredients in either column.
        """
        first, *others = self._roles.ingredients
        is_grid = len(others) + 1 > _MOST_WITHOUT_GRID
        if self._is_own or is_grid:
            return None
        is_first_blank = not cells[first]
        is_other_filled = any(cells[i] for i in others)
        if not is_first_blank or not is_other_filled:
            return None
        row = self._dialect.delimiter.join(cells)
        return (
            f"'{row[:80]}' has a blank cell before an ingredient, as where cells were merged; fill "
            "it, or write a single ingredient first."
        )

    def _not_parted(self, parts: Sequence[str]) -> str | None:
        """Return why a cell without the table's joiner may hold several ingredients, or None."""
        if len(parts) > 1:
            return None
        for joiner in (*_JOINERS, *_OTHER_JOINERS):
            if joiner in parts[0]:
                return (
                    f"{parts[0][:80]!r} may be one ingredient or several, with "
                    f"{joiner.strip()!r} between them; write {self._joiner} as in other rows."
                )
        return None

    def _label_fault(self, label: str) -> str | None:
        if self._may_hold_formula and _FORMULA.match(label):
            return f"{label[:80]!r} is a spreadsheet's formula or its error; save the values."
        if not self._is_own and is_missing(label):
            return (
                f"{label!r} may be a missing value or a label. Leave the cell empty; if it is a "
                f"label, name the columns {','.join(CSV_HEADER)}."
            )
        if not self._is_own and " + " in label and not is_half_product(label):
            return (
                f"{label[:80]!r} may be several things or one. Write one recipe in each row; if it "
                f"is a label, name the columns {','.join(CSV_HEADER)}."
            )
        return label_fault(label)

    def _note_kind(
        self, number: int, ingredients: list[str], result: str, kind: str
    ) -> Fault | None:
        """Keep a recipe's kind, if any, or return a fault if it has another kind above."""
        if not kind:
            return None
        parts = tuple(sorted(ingredients))
        known = self.kind_of.setdefault((parts, result), kind)
        if known == kind:
            return None
        recipe = f"{' + '.join(parts)} -> {result}"
        message = f"{recipe} has the kind '{kind}' here, and '{known}' above."
        return Fault(number, "row", message)

    def _wrong_width(self, cells: Sequence[str], limit: int) -> str:
        row = self._dialect.delimiter.join(cells)[:80]
        if not self._is_plain and not self._is_own:
            return (
                f"'{row}' has {counted(len(cells), 'cell')}; the table has {limit} columns. Quote "
                "a cell with a delimiter in it."
            )
        count = len(cells) - 1
        missing = "" if count else " missing"
        hint = " For a single ingredient, leave the second cell empty." if count == 1 else ""
        return (
            f"'{row}' has {counted(count, 'ingredient')} and a result{missing}; a recipe needs "
            f"two and a result, in three columns.{hint}"
        )


def _without_blanks(cells: list[str]) -> list[str]:
    """Return cells without the blank ones at the end."""
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells


def _column(rows: Sequence[Sequence[str]], index: int) -> list[str]:
    """Return the cells of a column that are not blank."""
    return [row[index] for row in rows if len(row) > index and row[index]]


def _is_own(line: str, delimiter: str) -> bool:
    """Return whether a line is the header of our own tables."""
    cells = line.rstrip("\r\n").split(delimiter)
    names = tuple(cell.strip() for cell in cells)
    return names in _OWN


def _too_long(line: str) -> str:
    return f"a line of {len(line):,} characters; the limit is {MAX_LINE_LENGTH:,}."
