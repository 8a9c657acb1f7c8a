"""A game in a terminal: lines of text and typed selections."""

import io
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TextIO

from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.base.labels import read_label

WIDTH = 80  # columns
UNDO = ("u", "undo")
Commands = Mapping[str, Callable[[], Iterable[str]]]
"""Functions that return the lines to show, by typed command, such as ``?``."""


class Quit(Exception):
    """The player stops, or the input has ended."""


@dataclass(frozen=True)
class Terminal:
    """Show the game on a stream and read stdin."""

    stream: TextIO

    def __post_init__(self) -> None:
        if isinstance(sys.stdin, io.TextIOWrapper) and sys.stdin.errors != "replace":
            sys.stdin.reconfigure(errors="replace")  # stray bytes are bad input, not a failure

    def say(self, *lines: str) -> None:
        """Show lines of text."""
        for line in lines:
            print(line, file=self.stream, flush=True)

    @contextmanager
    def until_quit(self, tally: Callable[[], str]) -> Iterator[None]:
        """Run a game in a ``with`` block until :class:`Quit`; after Ctrl-C, the message has the result so far."""
        try:
            yield
        except Quit:
            self.say("")
        except KeyboardInterrupt:
            self.say("")
            raise KeyboardInterrupt(f"interrupted; {tally()}") from None

    def ask(self, prompt: str) -> str:
        """Return a typed line; ``q`` and the end of the input raise :class:`Quit`."""
        print(prompt, end="", file=self.stream, flush=True)
        line = sys.stdin.readline() if sys.stdin else ""
        if not line or not sys.stdin.isatty():
            self.say(line.strip())  # a terminal has shown the line already
        if not line or line.strip().casefold() == "q":
            raise Quit
        return line.strip()

    def select(self, prompt: str, table: Sequence[str], commands: Commands) -> int | None:
        """Ask the player for an entity until the input is valid, and run typed commands in between.

        Args:
            prompt: text before the input.
            table: labels of the selectable entities.
            commands: functions by typed word, such as ``?``; the terminal shows the lines that a function returns.

        Returns:
            The index of the entity in ``table``; None if the player types ``undo``.
        """
        while True:
            typed = self.ask(prompt)
            if typed.casefold() in UNDO:
                return None
            if typed.casefold() in commands:
                self.say(*commands[typed.casefold()]())
                continue
            try:
                return read_label(typed, table)
            except ActionError as error:
                self.say(str(error))

    def select_two(self, prompt: str, table: Sequence[str], commands: Commands) -> tuple[int, int]:
        """Return two selected indices in ``table``, as :meth:`select`; ``{}`` in the prompt is the first selection."""
        while True:
            one = self.select(prompt.format("none"), table, commands)
            if one is None:
                self.say("There is no selection to undo.")
                continue
            other = self.select(prompt.format(table[one]), table, commands)
            if other is not None:
                return one, other
            self.say(f"Undone: {table[one]}.")


def numbered_columns(labels: Sequence[str]) -> Iterator[str]:
    """Yield lines of text with the labels in columns, each label after its number."""
    numbered = [f"{place:>3} {label}" for place, label in enumerate(labels, start=1)]
    width = max(map(len, numbered)) + 2
    per_line = max(1, WIDTH // width)
    for first in range(0, len(numbered), per_line):
        yield "".join(f"{cell:<{width}}" for cell in numbered[first : first + per_line]).rstrip()
