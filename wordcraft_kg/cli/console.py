"""What commands share: common options, results as text or JSON, and progress."""

import json
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.errors import ConfigError

if TYPE_CHECKING:
    from wordcraft_kg.records import Record


@Parameter(name="*", group="Output and configuration")
@dataclass(frozen=True)
class Output:
    """Options of every command.

    Attributes:
        json: print one JSON object on stdout instead of text.
        quiet: no progress on stderr.
        config: TOML file with options in a table named after the command; the command line takes precedence.
    """

    json: Annotated[bool, Parameter(negative="", show_default=False)] = False
    quiet: Annotated[bool, Parameter(negative="", show_default=False)] = False
    config: Path | None = None

    def result(self, view: "Record | dict[str, Any]", text: Iterable[str]) -> None:
        """Print the result of a command, as one JSON object or as lines of text."""
        if self.json:
            from wordcraft_kg.records import as_values

            print(json.dumps(as_values(view), ensure_ascii=False))
        else:
            for line in text:
                print(line)

    def progress(self, what: str, unit: str = "epoch") -> "Progress":
        """Return a progress reporter for the epochs, or other units, of a training."""
        return Progress(what, unit=unit, hidden=self.quiet)


Flag = Annotated[bool, Parameter(negative="", show_default=False)]
"""An option that can only be switched on."""


def split_labels(values: Sequence[str]) -> list[str]:
    """Split comma-separated labels; a label that contains a comma has to come from a file."""
    return [label for value in values for part in value.split(",") if (label := part.strip())]


def whole_numbers(option: str, values: Sequence[str]) -> list[int]:
    """Return comma-separated whole numbers, each once.

    Raises:
        ConfigError: naming the option.
    """
    try:
        numbers = list(dict.fromkeys(int(value) for value in split_labels(values)))
    except ValueError:
        numbers = []
    if not numbers:
        raise ConfigError(f"--{option} '{','.join(values)}': expected whole numbers, such as 1,2,8.")
    return numbers


class Progress:
    """A bar on a terminal, or else a plain line every few seconds; always on stderr."""

    INTERVAL = 5.0  # seconds between plain lines

    def __init__(self, what: str, *, unit: str = "epoch", hidden: bool = False):
        """Take the name of what is counted; ``hidden`` reports nothing."""
        self.what = what
        self.unit = unit
        self.hidden = hidden
        self._bar: Any = None
        self._last = time.monotonic()

    def __call__(self, done: int, total: int, figures: dict[str, float]) -> None:
        """Report that ``done`` of ``total`` are done, with the latest figures."""
        if self.hidden:
            return
        shown = {
            name: f"{value:,.0f}" if abs(value) >= 1e4 else f"{value:.4g}"
            for name, value in figures.items()
            if name not in ("epoch", "seconds")
        }
        if sys.stderr.isatty():
            from tqdm import tqdm

            if self._bar is None:
                begun = done - 1 if self.unit == "epoch" else 0
                self._bar = tqdm(total=total, initial=begun, desc=self.what, unit=self.unit, ncols=80, file=sys.stderr)
            self._bar.set_postfix(shown, refresh=False)
            self._bar.update(done - self._bar.n)
            if done == total:
                self.close()
        elif time.monotonic() - self._last >= self.INTERVAL or done == total:
            self._last = time.monotonic()
            detail = " ".join(f"{name} {value}" for name, value in shown.items())
            print(f"{self.what}: {self.unit} {done:,} of {total:,}, {detail}", file=sys.stderr, flush=True)

    def close(self) -> None:
        """Close the bar, even if it is not full."""
        if self._bar is not None:
            self._bar.close()


def aligned(rows: Iterable[tuple[str, str]]) -> list[str]:
    """Lay out ``name  value`` lines with the values aligned."""
    pairs = list(rows)
    width = max((len(name) for name, _ in pairs), default=0)
    return [f"{name:<{width}}  {value}" for name, value in pairs]


def names(labels: Sequence[str], total: int | None = None) -> str:
    """Join labels with commas; if only some are listed, add how many more there are."""
    more = (total if total is not None else len(labels)) - len(labels)
    return ", ".join(labels) + (f" and {more:,} more" if more > 0 else "")
