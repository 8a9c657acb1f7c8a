"""How progress is shown: a bar on a terminal, or else a plain line every few seconds; always on stderr."""

import logging
import sys
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from rich.console import Console

MIN_BAR = 16
"""Columns that are left to a bar, however many figures there are."""


class Progress:
    """The progress of one training or stage; of several at the same time, a terminal shows the one that began first."""

    INTERVAL = 5.0  # seconds between plain lines
    _shown: ClassVar["Progress | None"] = None

    def __init__(self, what: str, *, unit: str = "", hidden: bool = False, is_stage: bool = False):
        """Take the name of what is counted, and its unit.

        Args:
            what: name.
            unit: unit, such as epoch.
            hidden: report nothing.
            is_stage: whether the bar goes when it is full, and a short stage is not worth a line.
        """
        self.what, self.unit, self.hidden, self.is_stage = what, unit, hidden, is_stage
        self._bar: Any = None
        self._last = time.monotonic()

    def __call__(self, done: int, total: int, figures: Mapping[str, float]) -> None:
        """Report that ``done`` of ``total`` are done, with the latest figures."""
        if self.hidden:
            return
        shown = [
            f"{name} {value:,.0f}" if abs(value) >= 1e4 else f"{name} {value:.4g}"
            for name, value in figures.items()
            if name not in ("epoch", "seconds")
        ]
        from rich.console import Console

        console = Console(stderr=True)
        if console.is_interactive:
            self._draw(console, done, total, shown)
        elif time.monotonic() - self._last >= self.INTERVAL or (done == total and not self.is_stage):
            self._last = time.monotonic()
            place = " ".join(filter(None, [self.unit, f"{done:,} of {total:,}"]))
            print(", ".join(filter(None, [f"{self.what}: {place}", " ".join(shown)])), file=sys.stderr, flush=True)

    def _draw(self, console: "Console", done: int, total: int, figures: list[str]) -> None:
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        if Progress._shown not in (None, self):
            return
        count = f"{_short(done)}/{_short(total)}"
        if self._bar is None:
            columns = (
                TextColumn("{task.description}"),
                BarColumn(bar_width=None),
                TextColumn("{task.fields[count]}"),
                TimeRemainingColumn(elapsed_when_finished=True),
                TextColumn("{task.fields[figures]}"),
            )
            self._bar = Bar(*columns, console=console, transient=self.is_stage, expand=True, refresh_per_second=4)
            self._bar.add_task(self.what, total=total, completed=done, count=count, figures="")
            self._bar.start()
            Progress._shown = self
        others = len(self.what) + MIN_BAR + len(count) + len(" 0:00:00 ") + 3
        while figures and others + len("  ".join(figures)) > console.width:
            figures.pop()
        self._bar.update(self._bar.task_ids[0], completed=done, count=count, figures="  ".join(figures))
        if done == total:
            self.close()

    def close(self) -> None:
        """Close the bar, even if it is not full."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
        if Progress._shown is self:
            Progress._shown = None

    @classmethod
    def close_shown(cls) -> None:
        """Close the bar that is on the terminal, if there is one."""
        if cls._shown is not None:
            cls._shown.close()


class Stages:
    """Shows one stage of a command's work after the other; see :mod:`wordcraft_kg.progress`."""

    def __init__(self) -> None:
        """Begin without a stage."""
        self._now = Progress("", is_stage=True)
        self._began = 0.0

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show how far a stage has come."""
        if self._now.what != stage or done == 0:
            self._now.what, self._began = stage, time.monotonic()
        self._now(done, total, {})
        if done == total:
            logging.getLogger(__name__).info("%s: %.1f s", stage, time.monotonic() - self._began)


def _short(number: int) -> str:
    """Return a number in at most six characters: 9,999 and 10.0k and 1.25M."""
    if number < 10_000:
        return f"{number:,}"
    return f"{number / 1e3:.1f}k" if number < 1_000_000 else f"{number / 1e6:.2f}M"
