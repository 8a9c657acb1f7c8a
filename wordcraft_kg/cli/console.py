"""Options common to all commands, results as text or JSON, and small parsers."""

import json
import logging
import re
import shlex
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.base.artefacts import check_output_file, staged_file, write_atomically
from wordcraft_kg.base.errors import ConfigError, StdoutError
from wordcraft_kg.base.escaping import for_json, for_terminal
from wordcraft_kg.base.progress import listening
from wordcraft_kg.cli.progress import Progress, Stages

if TYPE_CHECKING:
    from wordcraft_kg.base.records import Record

OUTPUT_GROUP = "Output and configuration"
"""Title in the help of the options that every command has."""


@Parameter(name="*", group=OUTPUT_GROUP)
@dataclass(frozen=True)
class Output:
    """Common options.

    Attributes:
        json: print a JSON object on stdout instead of text; after a failure, {"error": {"kind", "message"}}.
        quiet: no progress on stderr.
        verbose: log stage durations and error tracebacks on stderr.
        config: TOML file with options in a table named after the command; the command line takes precedence.
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
        """Print a command's result: ``view`` as a JSON object with --json, otherwise the lines of ``text``.

        Raises:
            StdoutError: if stdout takes no more; a command writes its files before its result, so they remain.
            BrokenPipeError: if the reader of stdout has closed it, as `| head` does.
        """
        Progress.close_current()  # training may end before the last epoch
        if self.json:
            from wordcraft_kg.base.records import as_values

            lines = [for_json(json.dumps(as_values(view), ensure_ascii=False))]
        else:
            lines = [for_terminal(line) for line in text]
        try:
            for line in lines:
                print(line)
            # At the exit of Python, an error would have no message.
            print(end="", flush=True)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise StdoutError(
                f"the result could not be printed on stdout ({error.strerror or error}). Files that the command has "
                "written remain. Redirect stdout to another place."
            ) from None

    def progress(self, what: str, unit: str = "epoch") -> Progress:
        """Return a reporter that shows progress of the work ``what`` on stderr, in epochs or another unit."""
        Progress.close_current()  # a training that stopped early has not reported the end
        return Progress(what, unit=unit, hidden=self.quiet)

    @contextmanager
    def session(self) -> Iterator[None]:
        """Show warnings and stages of work on stderr while a command runs; clear the bar at the end."""
        logging.basicConfig(level=logging.WARNING, format="%(message)s", handlers=[_Stderr()])
        logging.captureWarnings(True)
        logging.getLogger("wordcraft_kg").setLevel(logging.INFO if self.verbose else logging.NOTSET)
        with listening(None if self.quiet else Stages()), Progress.session():
            yield


class _Stderr(logging.Handler):
    """Writes to the current ``sys.stderr``: a bar on the terminal moves down."""

    def emit(self, record: logging.LogRecord) -> None:
        # Warnings of Python and tracebacks have several lines.
        lines = f"{record.levelname.lower()}: {self.format(record)}".split("\n")
        print("\n".join(map(for_terminal, lines)), file=sys.stderr)


Flag = Annotated[bool, Parameter(negative="", show_default=False)]
"""An option that can only be switched on."""


def split_labels(values: Sequence[str]) -> list[str]:
    """Split comma-separated labels; labels with commas must come from a file."""
    return [label for value in values for part in value.split(",") if (label := part.strip())]


def whole_numbers(option: str, values: Sequence[str]) -> list[int]:
    """Parse comma-separated integers without repetition; a ConfigError for other text names the option."""
    try:
        numbers = list(dict.fromkeys(int(value) for value in split_labels(values)))
    except ValueError:
        numbers = []
    if not numbers:
        raise ConfigError(
            f"`{option}` '{','.join(values)}': expected whole numbers, such as 1,2,8."
        )
    return numbers


def refuse_given(options: Any, about: str) -> None:
    """Raise a ConfigError if an option was given that has no effect; ``about`` names the proper use in the message."""
    for field in fields(options):
        if getattr(options, field.name) != getattr(type(options)(), field.name):
            raise ConfigError(f"`{field.name}` is for {about}; leave it out.")


def check_file(out: Path | None, *, force: bool) -> None:
    """Raise an OutputExistsError before long work if a file cannot be written."""
    if out is not None:
        check_output_file(out, force=force)


def write_file(out: Path, content: str | Iterable[str], *, force: bool) -> None:
    """Write a text file atomically; ``force`` replaces an existing file."""
    with staged_file(out, force=force) as file:
        write_atomically(file, content)


def command_line(*words: str | Path) -> str:
    """Return a command to repeat in a shell: labels and paths with blanks or signs are quoted."""
    return shlex.join(["wordcraft-kg", *map(str, words)])


MOST_SEEDS = 1_000


def read_seeds(text: str) -> list[int]:
    """Parse a list of different seeds from numbers and ranges: 0-2,7 gives 0, 1, 2 and 7; else a ConfigError."""
    seeds: dict[int, None] = {}
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,19})(?:-(\d{1,19}))?\s*", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        chosen = range(first, last + 1) if last < first + MOST_SEEDS else range(0)
        seeds |= dict.fromkeys(chosen)
        if not chosen or len(seeds) > MOST_SEEDS:
            raise ConfigError(
                f"`seeds` '{text}': expected at most {MOST_SEEDS:,} seeds, such as 0-4 or 0,3,7."
            )
    return list(seeds)


def aligned(rows: Iterable[Sequence[str]], *, numbers: bool = False) -> list[str]:
    """Return the lines of a text table with aligned columns.

    Empty columns are left out; ``numbers`` right-aligns all columns after the first.
    """
    columns = [column for column in zip_longest(*rows, fillvalue="") if any(column)]
    widths = [
        f"{'>' if numbers and place else '<'}{max(map(len, column))}"
        for place, column in enumerate(columns)
    ]
    return ["  ".join(map(format, row, widths)).rstrip() for row in zip(*columns, strict=True)]


def lines_of(values: Any) -> list[str]:
    """Return a record as text, one line for each field; nested fields are indented."""
    from wordcraft_kg.base.records import as_values

    return aligned(_rows(as_values(values), ""))


def _rows(values: dict[str, Any], indent: str) -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        label = indent + name.replace("_", " ")
        if isinstance(value, dict):
            yield label, ""
            yield from _rows(value, f"{indent}  ")
        elif isinstance(value, list):
            if value:  # a record counts the elements of a shortened list, such as unreachable and unreachable_entities
                total = values.get(
                    {"examples": "pairs_with_several_results"}.get(name) or name.rpartition("_")[0]
                )
                yield (
                    label,
                    names(
                        [_cell(one) for one in value],
                        total if isinstance(total, int) else len(value),
                    ),
                )
        elif value is not None:
            yield label, _cell(value)


def _cell(value: Any) -> str:
    if isinstance(value, dict):
        return ": ".join(map(_cell, value.values()))
    if isinstance(value, list):
        return " ".join(map(_cell, value))
    if isinstance(value, bool):
        return str(value).lower()
    return (
        f"{value:,}"
        if isinstance(value, int)
        else f"{value:.3g}"
        if isinstance(value, float)
        else str(value)
    )


def names(labels: Sequence[str], total: int, most: int = 10) -> str:
    """Return the first ``most`` labels as text, joined by commas, with the number of further labels up to ``total``."""
    listed = ", ".join(labels[:most])
    return f"{listed} and {total - most:,} more" if total > most else listed
