"""Progress on stderr: a bar on a terminal, otherwise a plain line every few seconds."""

import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar

from wordcraft_kg.base.wording import for_terminal


class ProgressBar:
    """Reporter of progress for one piece of work, such as a training.

    A terminal has room for one bar: within a piece of work, nested work is not shown.

    Attributes:
        what: name of the work.
        unit: unit of its steps, such as epoch.
        is_stage: whether the end of the work is no line.
    """

    # Seconds between plain lines.
    INTERVAL = 5.0
    # Of the class, because there is one terminal: the reporter whose bar is open,
    _current: ClassVar["ProgressBar | None"] = None
    # and the time of the last plain line.
    _printed: ClassVar[float] = 0.0

    def __init__(self, what: str, *, unit: str = "", is_stage: bool = False):
        self.what = for_terminal(what)
        self.unit = unit
        self.is_stage = is_stage
        self._bar: Any = None

    def __call__(self, done: int, total: int, figures: Mapping[str, float]) -> None:
        """Report progress.

        Args:
            done: number of units that are done.
            total: number of all units; with one alone, the bar only shows activity.
            figures: latest metrics by name.
        """
        from rich.console import Console

        if ProgressBar._current not in (None, self):
            return
        ProgressBar._current = self
        # The bar has its own count and clock.
        names = [name for name in figures if name not in ("epoch", "seconds")]
        shown = [f"{name.replace('_', ' ')} {_figure(figures[name])}" for name in names]
        console = Console(stderr=True)
        if console.is_interactive:
            self._draw(console, done, total, "  ".join(shown))
        elif self._is_due(is_end=done == total):
            # In a log file, a bar would be thousands of lines.
            place = f"{self.unit} {done:,} of {total:,}".lstrip() if total > 1 else "..."
            line = ", ".join([f"{self.what}: {place}", *shown])
            console.print(line, markup=False, highlight=False, emoji=False, soft_wrap=True)
        if done == total:
            self.close()

    def _is_due(self, *, is_end: bool) -> bool:
        """Return whether a plain line is due, and note its time."""
        seconds = time.monotonic()
        # The end of a training is always worth a line, the end of a stage never.
        is_due = not self.is_stage if is_end else seconds - self._printed >= self.INTERVAL
        if is_due:
            ProgressBar._printed = seconds
        return is_due

    def _draw(self, console: Any, done: int, total: int, figures: str) -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
        from rich.table import Column

        has_steps = total > 1
        if self._bar is None:
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(bar_width=16),
                TextColumn("{task.fields[count]}"),
                TimeRemainingColumn(),
                # What a narrow terminal has no room for is cut off.
                TextColumn("{task.fields[figures]}", table_column=Column(no_wrap=True, ratio=1)),
                console=console,
                expand=True,
                redirect_stdout=False,  # a command's result may be piped
                refresh_per_second=4,
                # The result, which follows, says how the work ended: bars of several trainings
                # would only push it away.
                transient=True,
            )
            self._bar.add_task(self.what, total=total if has_steps else None, count="", figures="")
            self._bar.start()
        count = f"{done:,}/{total:,}" if has_steps else ""
        task = self._bar.task_ids[0]
        self._bar.update(task, completed=done, count=count, figures=figures)

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
