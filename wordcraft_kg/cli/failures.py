"""Failures of commands: messages, hints and exit codes."""

import json
import re
import traceback
from collections.abc import Callable, Container
from dataclasses import dataclass
from inspect import signature
from types import ModuleType
from typing import Any

from cyclopts import CycloptsError, MissingArgumentError, UnknownCommandError, UnusedCliTokensError

from wordcraft_kg.base.errors import NAMED_SETTING, WordCraftKGError
from wordcraft_kg.cli.console import Output

OPTIONS = {"num_distractors": "distractors", "kind": "split", "trackers": "track"}
"""Options by the settings that they set, where the two have different names."""
INTERRUPTED = 130
_NO_MEMORY = re.compile("not enough memory|can't allocate memory|out of memory")


@dataclass(frozen=True)
class Manual:
    """How a command is used.

    Attributes:
        command: program and command, as they are typed.
        function: the command's function.
        module: module of that function, with ``EXAMPLES``: command lines that work.
    """

    command: str
    function: Callable[..., Any]
    module: ModuleType

    @property
    def places(self) -> dict[str, str]:
        """Positional parameters, and their form in the usage."""
        shown = {}
        for one in signature(self.function).parameters.values():
            name = one.name.upper()
            if one.kind is one.VAR_POSITIONAL:
                shown[one.name] = f"{name}..."
            elif one.kind is not one.KEYWORD_ONLY:
                shown[one.name] = name if one.default is one.empty else f"[{name}]"
        return shown

    @property
    def usage(self) -> str:
        """The command with its arguments and required options."""
        options = (one for one in signature(self.function).parameters.values() if one.kind is one.KEYWORD_ONLY)
        needed = (f"--{one.name} {one.name.upper()}" for one in options if one.default is one.empty)
        return " ".join([self.command, *self.places.values(), *needed, "[OPTIONS]"])


@dataclass(frozen=True)
class Failure:
    """Why a command has failed.

    Attributes:
        kind: name of the error's class.
        message: the found and expected values, and the remedy.
        code: exit code.
        hints: further lines for a terminal: usage and an example.
        setting: Python name of the refused setting, if there is one.
    """

    kind: str
    message: str
    code: int = 1
    hints: tuple[str, ...] = ()
    setting: str = ""

    def show(self, output: Output) -> int:
        """Print it on stderr, and with --json as the one object on stdout; return the exit code."""
        from rich.console import Console

        if output.json:
            error = {"kind": self.kind, "message": self.message}
            print(json.dumps({"error": error}, ensure_ascii=False))
        if output.verbose:
            traceback.print_exc()
        console = Console(stderr=True, soft_wrap=True, highlight=False, markup=False, emoji=False)
        if self.code != INTERRUPTED:
            console.print("error: ", style="bold red", end="")
        console.print("\n".join([self.message, *self.hints]))
        return self.code


def failure_of(error: BaseException, manual: Manual | None) -> Failure | None:
    """Return an error as a failure of its command; None for a defect of this package."""
    kind = type(error).__name__
    if isinstance(error, CycloptsError):
        return Failure(kind, _said(error, manual), 2, _hints(error, manual))
    if isinstance(error, KeyboardInterrupt):
        return Failure(kind, str(error) or "interrupted; nothing was written", INTERRUPTED)
    if isinstance(error, WordCraftKGError):
        shown = with_options(str(error), manual.places if manual else ())
        return Failure(error.kind, shown, setting=error.setting)
    if isinstance(error, ModuleNotFoundError):
        package = (error.name or "").partition(".")[0]
        needed = f"this command needs {package}, which is not installed. Install it: pip install wordcraft-kg"
        return None if package in ("", "wordcraft_kg") else Failure(kind, needed)
    if isinstance(error, OSError):
        where = f"'{error.filename}': " if error.filename else ""
        return Failure(kind, f"{where}{error.strerror or error}. Nothing was changed.")
    # The second is torch's error about its tensors.
    if isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and _NO_MEMORY.search(str(error))):
        return Failure("MemoryError", "this machine does not have enough memory for this. Nothing was changed.")
    return None


def _hints(error: CycloptsError, manual: Manual | None) -> tuple[str, ...]:
    if manual is None or isinstance(error, UnknownCommandError):
        return ("`wordcraft-kg --help` lists all commands.",)
    return f"usage:   {manual.usage}", f"example: {manual.module.EXAMPLES[0]}"


def _said(error: CycloptsError, manual: Manual | None) -> str:
    """Return the parser's message without its Python terms."""
    if isinstance(error, UnusedCliTokensError) and error.unused_tokens:
        return f"unexpected argument '{error.unused_tokens[0]}'."
    if type(error) is MissingArgumentError and error.argument is not None:
        given = error.keyword or next((token.keyword for token in error.argument.tokens if token.keyword), None)
        if given:
            return f"{given} needs a value."
        name = error.argument.field_info.name
        return f"{name.upper() if manual and name in manual.places else error.argument.name} is missing."
    error.verbose = False
    return str(error).partition(" Available commands:")[0]


def with_options(message: str, places: Container[str] = ()) -> str:
    """Replace the settings of an error's message, in backticks, by options, or by the arguments ``places``."""

    def named(match: re.Match[str]) -> str:
        name = OPTIONS.get(match[1], match[1])
        return name.upper() if name in places else f"--{name.replace('_', '-')}"

    return NAMED_SETTING.sub(named, message)
