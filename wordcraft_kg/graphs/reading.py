"""The record of how a recipe book's file was read: the guess that commands announce."""

from collections.abc import Iterator

import msgspec

from wordcraft_kg.base import Count, Record, counted, for_terminal

_SHOWN = 6  # names of columns that are left out, in the line


class Reading(Record, omit_defaults=True, kw_only=True):
    """How a recipe book's file was read, and what became of its rows.

    ``rows`` is the sum of ``kept`` and all numbers in ``left_out``: no row is lost in silence.

    Attributes:
        shape: kind of file, such as "table" or "lines a + b = c".
        container: compression or archive around the file, such as "gzip"; empty without one.
        encoding: encoding of the text; empty if it is not text, such as a folder.
        delimiter: column delimiter of a table; empty for other shapes.
        header: whether a table's first row names the columns.
        columns: columns, keys or fields with the ingredients and, last, the results.
        num_results: number of ``columns`` with results.
        ignored: further columns, which are not read.
        case: "fold" if labels were changed to lower case; empty if they are as in the file.
        rows: recipes in the file; a row with several results counts once for each.
        kept: rows that became a recipe of the book.
        left_out: number of other rows by reason.
        arities: number of rows by their number of ingredients, as digits.
        counts_dropped: ingredients whose number of pieces is not kept.
        trimmed: cells with characters at their ends that cannot be seen, which are left out.
        several_outputs: rows of the file with several results.
        notes: further remarks.
    """

    shape: str
    container: str = ""
    encoding: str = ""
    delimiter: str = ""
    header: bool = True
    columns: tuple[str, ...] = ()
    num_results: Count = 1
    ignored: tuple[str, ...] = ()
    case: str = ""
    rows: Count = 0
    kept: Count = 0
    left_out: dict[str, Count] = msgspec.field(default_factory=dict)
    arities: dict[str, Count] = msgspec.field(default_factory=dict)
    counts_dropped: Count = 0
    trimmed: Count = 0
    several_outputs: Count = 0
    notes: tuple[str, ...] = ()

    def line(self) -> str:
        """Return a sentence for people: shape, columns, rows kept, and rows left out with reasons.

        Example:
            >>> left_out = {"repeated": 1}
            >>> Reading(shape="table", delimiter=";", rows=3, kept=2, left_out=left_out).line()
            "read as table with delimiter ';'; kept 2 of 3 rows (1 repeated)"
        """
        facts = ", ".join(self._facts())
        return for_terminal(f"{facts}; {self._rows()}")

    def _rows(self) -> str:
        """Return how many rows were kept, and why the others were not."""
        row_summary = f"kept {self.kept:,} of {counted(self.rows, 'row')}"
        if not self.left_out:
            return row_summary
        reasons = [f"{number:,} {reason}" for reason, number in self.left_out.items()]
        return f"{row_summary} ({', '.join(reasons)})"

    def _facts(self) -> Iterator[str]:
        """Yield what the line says about the file, without what goes without saying."""
        shape = f"read as {self.shape}"
        if self.delimiter:
            shape = f"{shape} with delimiter {self.delimiter!r}"
        yield shape
        if self.columns:
            ingredients = self.columns[: -self.num_results]
            results = self.columns[-self.num_results :]
            yield f"{' + '.join(ingredients)} = {', '.join(results)}"
        if not self.header:
            yield "no header"
        if self.ignored:
            names = ", ".join(self.ignored[:_SHOWN])
            num_hidden = len(self.ignored) - _SHOWN
            if num_hidden > 0:
                names += f" and {num_hidden} more"
            yield f"other columns ignored: {names}"
        if self.container:
            yield f"from {self.container}"
        if self.encoding not in ("", "utf-8"):
            yield f"encoding {self.encoding}"
        yield from self._changes()

    def _changes(self) -> Iterator[str]:
        """Yield what is another than in the file."""
        if self.case:
            yield "labels in lower case"
        if self.counts_dropped:
            yield f"{counted(self.counts_dropped, 'number')} of pieces not kept"
        if self.trimmed:
            yield f"{counted(self.trimmed, 'cell')} without blanks that cannot be seen"
        if self.several_outputs:
            yield f"{counted(self.several_outputs, 'row')} with several results"
        if self.arities.keys() - {"2"}:
            arities = [f"{number:,} of {arity}" for arity, number in self.arities.items()]
            yield f"rows by number of ingredients: {', '.join(arities)}"
        yield from self.notes
