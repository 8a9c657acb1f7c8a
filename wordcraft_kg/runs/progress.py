"""Progress on stderr: a bar on a terminal, otherwise a plain line every few seconds."""

import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, ClassVar

from wordcraft_kg.base.wording import for_terminal

if TYPE_CHECKING:
    from rich.console import Console

MIN_BAR = 16
"""Minimum bar width in columns."""


class ProgressBar:
    """Reporter of progress for one piece of work, such as a training.

    A terminal has room for one bar: within a piece of work, nested work is not shown.

    Attributes:
        what: name of the work.
        unit: unit of its steps, such as epoch.
        hidden: whether nothing is shown.
        is_stage: whether a short piece of work prints no line.
    """

    # Seconds between plain lines.
    INTERVAL = 5.0
    # Of the class, because there is one terminal: the reporter whose bar is open,
    _current: ClassVar["ProgressBar | None"] = None
    # the time of the last plain line,
    _printed: ClassVar[float] = 0.0
    # and the names of the work on plain lines of this session.
    _named: ClassVar[set[str]] = set()

    def __init__(self, what: str, *, unit: str = "", hidden: bool = False, is_stage: bool = False):
        self.what = for_terminal(what)
        self.unit = unit
        self.hidden = hidden
        self.is_stage = is_stage
        self._bar: Any = None

    def __call__(self, done: int, total: int, figures: Mapping[str, float]) -> None:
        """Report progress.

        Args:
            done: number of units that are done.
            total: number of all units.
            figures: latest metrics by name.
        """
        from rich.console import Console

        # A generator that a failed command has left may be closed after the command has ended.
        given_up = self.is_stage and done == total and ProgressBar._current is None
        if self.hidden or given_up or ProgressBar._current not in (None, self):
            return
        ProgressBar._current = self
        # The bar has its own count and clock.
        names = [name for name in figures if name not in ("epoch", "seconds")]
        shown = [f"{name.replace('_', ' ')} {_figure(figures[name])}" for name in names]
        console = Console(stderr=True)
        # In a log file, a bar would be thousands of lines.
        if console.is_interactive:
            self._draw(console, done, total, shown)
        else:
            self._print(console, done, total, shown)
        if done == total:
            self.close()

    def _print(self, console: "Console", done: int, total: int, figures: list[str]) -> None:
        seconds = time.monotonic()
        # The end of a training is always worth a line, the end of a stage never.
        if done == total:
            is_due = not self.is_stage
        else:
            is_due = seconds - ProgressBar._printed >= self.INTERVAL
        if not is_due:
            return
        ProgressBar._printed = seconds
        place = f"{self.unit} {done:,} of {total:,}".lstrip() if total > 1 else "..."
        # A short stage that is repeated, such as ranking, is named once.
        if total == 1 and self.what in ProgressBar._named:
            return
        ProgressBar._named.add(self.what)
        line = ", ".join([f"{self.what}: {place}", *figures])
        console.print(line, markup=False, highlight=False, emoji=False, soft_wrap=True)

    def _draw(self, console: "Console", done: int, total: int, figures: list[str]) -> None:
        has_steps = total > 1
        count = f"{_short(done)}/{_short(total)}" if has_steps else ""
        # As many metrics as fit beside the smallest bar; the first ones matter most.
        around = f"{self.what}  {count} 0:00:00 left "
        room = console.width - len(around) - MIN_BAR
        while figures and len("  ".join(figures)) > room:
            figures.pop()
        if self._bar is None:
            self._bar = self._begin_bar(console)
            # The progress within a single step is unknown: the bar only shows activity.
            known_total = total if has_steps else None
            self._bar.add_task(self.what, total=known_total, count="", figures="")
            self._bar.start()
        # The time comes before it; a bar without steps has none.
        unit = "left" if has_steps else ""
        shown = "  ".join([unit, *figures])
        task = self._bar.task_ids[0]
        self._bar.update(task, completed=done, count=count, figures=shown)

    def _begin_bar(self, console: "Console") -> Any:
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        return Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            TextColumn("{task.fields[count]}"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[figures]}"),
            console=console,
            expand=True,
            redirect_stdout=False,  # a command's result may be piped
            refresh_per_second=4,
            # The result, which follows, says how the work ended: bars of several trainings would
            # only push it away.
            transient=True,
        )

    def close(self) -> None:
        """Close the bar, finished or not."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
        if ProgressBar._current is self:
            ProgressBar._current = None

    @classmethod
    @contextmanager
    def session(cls) -> Iterator[None]:
        """Close any open bar at the end of a ``with`` block, even after an error."""
        # Quick commands print no progress: the first plain line comes after one interval.
        cls._printed = time.monotonic()
        cls._named.clear()
        try:
            yield
        finally:
            cls.close_current()

    @classmethod
    def close_current(cls) -> None:
        """Close the bar on the terminal, if a bar is open."""
        if cls._current is not None:
            cls._current.close()


class Stages:
    """Listener for :mod:`wordcraft_kg.base.progress` that shows stages of work, one at a time."""

    # Seconds between two steps on display.
    INTERVAL = 0.1

    def __init__(self) -> None:
        self._now: ProgressBar | None = None
        self._began = 0.0
        self._shown = 0.0

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show that ``done`` of ``total`` steps of a stage are done.

        Args:
            stage: name of the stage; a stage within another one is not shown.
            done: number of steps that are done.
            total: number of all steps.
        """
        seconds = time.monotonic()
        if self._now is None:
            self._now = ProgressBar(stage, is_stage=True)
            self._began = seconds
        elif self._now.what != stage or (
            0 < done < total and seconds - self._shown < self.INTERVAL
        ):
            return
        self._shown = seconds
        self._now(done, total, {})
        if done == total:
            self._now = None
            logging.getLogger(__name__).info("%s: %.1f s", stage, seconds - self._began)


def _figure(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 1e4 else f"{value:.4g}"


def _short(number: int) -> str:
    """Return a number in at most six characters: 9,999 and 10.0k and 1.25M."""
    if number < 10_000:
        return f"{number:,}"
    return f"{number / 1e3:.1f}k" if number < 1_000_000 else f"{number / 1e6:.2f}M"
