"""Options common to all commands, results as text or JSON, and small parsers."""

import io
import logging
import re
import shlex
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from itertools import chain, zip_longest
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.base import (
    ConfigError,
    OutputExistsError,
    Record,
    as_values,
    check_output_file,
    for_terminal,
    json_text,
    listed,
    listening,
    quoted,
    staged_file,
    write_atomically,
)
from wordcraft_kg.base.errors import StdoutError
from wordcraft_kg.base.wording import for_json
from wordcraft_kg.runs.progress import ProgressBar, Stages
from wordcraft_kg.runs.run_folder import Progress


@Parameter(name="*", group="Output and configuration")
@dataclass(frozen=True)
class Output:
    """Common options.

    Attributes:
        json: print a JSON object on stdout instead of text; after a failure, {"error": {"kind",
            "message"}}.
        quiet: no progress on stderr.
        verbose: log stage durations and error tracebacks on stderr.
        config: TOML file with options in a table named after the command; the command line takes
            precedence.
    """

    json: Annotated[bool, Parameter(negative="", show_default=False)] = False
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative="", show_default=False)] = (
        False
    )
    verbose: Annotated[
        bool, Parameter(name=["--verbose", "-v"], negative="", show_default=False)
    ] = False
    config: Path | None = None

    def result(self, view: "Record | dict[str, Any]", text: Iterable[str]) -> None:
        """Print a command's result: ``view`` with --json, otherwise ``text``.

        Args:
            view: the result as a record, printed as a JSON object.
            text: the result as lines.

        Raises:
            StdoutError: if stdout takes no more; a command writes its files before its result, so
                they remain.
            BrokenPipeError: if the reader of stdout has closed it, as `| head` does.
        """
        # Training may end before the last epoch.
        ProgressBar.close_current()
        # Labels and names come from files that anyone may have written: control characters could
        # rewrite what the terminal shows.
        lines = [json_line(as_values(view))] if self.json else [*map(for_terminal, text)]
        try:
            for line in lines:
                print(line)
            # At the exit of Python, an error would have no message.
            print(end="", flush=True)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise StdoutError(
                f"the result could not be printed on stdout ({error.strerror or error}). Files "
                "that the command has written remain. Redirect stdout to another place."
            ) from None

    # Progress goes to stderr, so that a result on stdout can be piped.
    def progress(self, what: str, unit: str = "epoch") -> Progress:
        """Return a reporter that shows progress of the work ``what`` on stderr, by ``unit``."""
        # A training that stopped early has not reported the end.
        ProgressBar.close_current()
        return ProgressBar(what, unit=unit) if not self.quiet else lambda done, total, figures: None

    @contextmanager
    def session(self) -> Iterator[None]:
        """Show warnings and stages of work on stderr while a command runs.

        Clear the bar at the end.
        """
        logging.basicConfig(level=logging.WARNING, format="%(message)s", handlers=[_Stderr()])
        logging.captureWarnings(True)
        logging.getLogger("wordcraft_kg").setLevel(logging.INFO if self.verbose else logging.NOTSET)
        with listening(None if self.quiet else Stages()), ProgressBar.session():
            yield


def json_line(value: Any) -> str:
    """Return a value as JSON in one line that stdout can encode.

    If its encoding is not Unicode, other characters than ASCII become JSON's own escapes; the value
    is unchanged.
    """
    is_unicode = (sys.stdout.encoding or "utf-8").lower().startswith("utf")
    return for_json(json_text(value, ensure_ascii=not is_unicode))


def accept_all_characters() -> None:
    r"""Let stdout print every text, with codes such as ``\u03bb`` for what its encoding lacks.

    The encoding is not UTF-8 on Windows, if stdout is a file, or where PYTHONIOENCODING says so.
    """
    # Without the method, stdout is not a file: a caller has replaced it by an object of its own.
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


class _Stderr(logging.Handler):
    """Writes to the present ``sys.stderr``, which a bar replaces, so that the bar moves down."""

    def emit(self, record: logging.LogRecord) -> None:
        # Warnings of Python and tracebacks have several lines.
        lines = f"{record.levelname.lower()}: {self.format(record)}".split("\n")
        print("\n".join(map(for_terminal, lines)), file=sys.stderr)


Flag = Annotated[bool, Parameter(negative="", show_default=False)]
"""An option that can only be switched on."""


def split_labels(values: Sequence[str]) -> list[str]:
    """Split comma-separated labels; labels with commas must come from a file."""
    labels = map(str.strip, ",".join(values).split(","))
    return [label for label in labels if label]


MOST_NUMBERS = 1_000
"""Most numbers in a list: a slip such as ``--seeds 0-40000`` would train for weeks."""


def whole_numbers(option: str, values: Sequence[str]) -> list[int]:
    """Parse numbers and ranges: ``0-2,7`` gives 0, 1, 2 and 7; each once, in the order given.

    Args:
        option: name of the option, for the error.
        values: texts, each with numbers between commas.

    Raises:
        ConfigError: for other text, or more than :data:`MOST_NUMBERS` numbers.
    """
    text = ",".join(values)
    numbers: dict[int, None] = {}  # an ordered set
    for part in text.split(","):
        # 19 digits hold every seed; more would make integers of any size.
        match = re.fullmatch(r"\s*(\d{1,19})(?:-(\d{1,19}))?\s*", part)
        first = int(match[1]) if match else 0
        last = int(match[2] or match[1]) if match else -1
        # Checked before the range is walked through: it may have a quintillion members.
        is_short = first <= last < first + MOST_NUMBERS
        numbers |= dict.fromkeys(range(first, last + 1) if is_short else ())
        if not is_short or len(numbers) > MOST_NUMBERS:
            raise ConfigError(
                f"`{option}` '{text}': expected whole numbers, such as 1,2,8 or 0-4, at most "
                f"{MOST_NUMBERS:,}."
            )
    return list(numbers)


def refuse_given(options: Any, about: str) -> None:
    """Raise a ConfigError if an option was given that would have no effect.

    Args:
        options: a dataclass of options with defaults; another value than the default was given.
        about: the proper use of the options, for the message.
    """
    for field in fields(options):
        # The parser fills in defaults, so a given default cannot be told from none.
        if getattr(options, field.name) != getattr(type(options)(), field.name):
            raise ConfigError(f"`{field.name}` is for {about}; leave it out.")


def check_file(out: Path | None, *, force: bool) -> None:
    """Raise an OutputExistsError before long work if a file cannot be written."""
    if out is not None:
        check_output_file(out, force=force)


def write_file(out: Path, content: str | Iterable[str], *, force: bool) -> None:
    """Write a text file atomically.

    Args:
        out: the file.
        content: text, or parts of it in order.
        force: whether an existing file is replaced.

    Raises:
        OutputExistsError: if the file exists, without ``force``.
    """
    with staged_file(out, force=force) as file:
        write_atomically(file, content)


TABLES = (".tex", ".csv", ".md")
"""Endings of files with tables: LaTeX, CSV and Markdown."""


def check_table(out: Path | None, *, force: bool = False) -> None:
    """Raise an error before long work if a table cannot be written, see :func:`write_table`."""
    if out is not None and out.suffix not in TABLES:
        raise ConfigError(f"`table` '{out}': expected a file that ends in {', '.join(TABLES)}.")
    if out is not None and out.exists() and not force:
        raise OutputExistsError(f"`table` '{out}' exists. Name another file, or remove this one.")
    check_file(out, force=True)


def write_table(
    out: Path | None, rows: Iterable[Mapping[str, Any]], *, force: bool = False
) -> list[str]:
    """Write results for a paper as LaTeX, CSV or Markdown, by the file's ending.

    Args:
        out: the file; None writes nothing.
        rows: values by column; an interval is a pair of numbers.
        force: whether an existing file is replaced.

    Returns:
        A line for the command's text.

    Raises:
        OutputExistsError: if the file exists, without ``force``.
    """
    if out is None:
        return []
    import pandas as pd

    frame = pd.DataFrame(
        {name: _interval(value) for name, value in row.items() if value is not None} for row in rows
    )
    content = {
        ".tex": lambda: frame.to_latex(index=False, na_rep="", float_format="%.3f", escape=True),
        ".csv": lambda: frame.map(_in_csv).to_csv(index=False, lineterminator="\n"),
        # Names such as 1e5 are no numbers.
        ".md": lambda: (
            frame.map(_in_markdown).to_markdown(index=False, disable_numparse=True) + "\n"
        ),
    }
    write_file(out, content[out.suffix](), force=force)
    return [f"wrote {out}"]


def text_table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return results as lines of text, in the columns that :func:`write_table` writes.

    Args:
        rows: values by column; None is an empty cell.
    """
    filled = [{name: value for name, value in row.items() if value is not None} for row in rows]
    names = list(dict.fromkeys(chain.from_iterable(filled)))
    cells = [[_in_text(row.get(name, "")) for name in names] for row in filled]
    return aligned([names, *cells])


def _in_text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3f}"
    return f"{value:,}" if isinstance(value, int) else str(_interval(value))


def _interval(value: Any) -> Any:
    """Return an interval as text, and any other value as it is."""
    return "[{:.3f}, {:.3f}]".format(*value) if isinstance(value, tuple | list) else value


def _in_csv(value: Any) -> Any:
    """Return a cell that no spreadsheet takes for a formula: names come from anyone."""
    is_formula = isinstance(value, str) and value.startswith(("=", "+", "-", "@"))
    return f"'{value}" if is_formula else value


def _in_markdown(value: Any) -> str:
    """Return a cell as text without markup: names of folders come from anyone."""
    if value != value:  # NaN, for no value
        return ""
    return _in_text(value).replace("<", "&lt;").replace("|", "\\|")


def command_line(*words: str | Path) -> str:
    """Return a command to repeat in a shell: labels and paths with blanks or signs are quoted."""
    return shlex.join(["wordcraft-kg", *map(str, words)])


def aligned(rows: Iterable[Sequence[str]], *, numbers: bool = False) -> list[str]:
    """Return the lines of a text table with aligned columns; empty columns are left out.

    Args:
        rows: cells by row; a short row is filled with empty cells.
        numbers: whether all columns after the first are right-aligned.
    """
    # From rows to columns, for the widths, and back.
    columns = [column for column in zip_longest(*rows, fillvalue="") if any(column)]
    formats = []
    for place, column in enumerate(columns):
        side = ">" if numbers and place else "<"
        formats.append(f"{side}{max(map(len, column))}")
    return ["  ".join(map(format, row, formats)).rstrip() for row in zip(*columns, strict=True)]


def lines_of(values: Any, *, of_sets: bool = False) -> list[str]:
    """Return a record as text, one line for each field; nested fields are indented.

    Args:
        values: the record.
        of_sets: whether it is about recipes of other sizes than two, whose ingredients are no
            pairs.
    """
    return aligned(_rows(as_values(values), "", _OF_SETS if of_sets else {}))


_OF_SETS = {
    "pairs": "ingredient sets",
    "pairs_by_number_of_results": "sets by number of results",
    "pairs_with_several_results": "sets with several results",
    "pairs_on_both_sides": "sets on both sides",
}
"""Fields that count sets of ingredients, by words for books with other sets than pairs."""
_COUNTS = {"examples": "pairs_with_several_results"}
"""Fields that count a list's elements, by the list's field, where the names do not say it."""


def _rows(
    values: dict[str, Any], indent: str, words: Mapping[str, str]
) -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        label = indent + words.get(name, name.replace("_", " "))
        # Records within the record are indented below their name.
        if isinstance(value, dict):
            yield label, ""
            yield from _rows(value, f"{indent}  ", words)
        elif isinstance(value, list):
            if value:
                cells = [_cell(item, in_list=True) for item in value]
                # A record counts the elements of a shortened list, such as `unreachable` for
                # `unreachable_entities`.
                total = values.get(_COUNTS.get(name) or name.rpartition("_")[0])
                yield label, listed(cells, total=total if isinstance(total, int) else len(value))
        elif value is not None:
            yield label, _cell(value)


def _cell(value: Any, *, in_list: bool = False) -> str:
    if isinstance(value, dict):
        return ": ".join(_cell(item, in_list=in_list) for item in value.values())
    if isinstance(value, list):
        return " ".join(_cell(item, in_list=in_list) for item in value)
    if isinstance(value, str):
        return quoted(value) if in_list else value
    # Before int: a bool is an int.
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
