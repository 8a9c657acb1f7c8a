"""How a command's failure is said: one style for a user's mistake, whoever found it, and exit codes."""

import inspect
import json
import re
import traceback
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
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
    def examples(self) -> Sequence[str]:
        """Command lines that work."""
        return self.module.EXAMPLES

    @property
    def places(self) -> dict[str, str]:
        """What is given by its place and not by an option: names of parameters, and how the usage shows them."""
        return {
            name: _shown(name, parameter)
            for name, parameter in inspect.signature(self.function).parameters.items()
            if not _is_option(parameter)
        }

    @property
    def usage(self) -> str:
        """The command with what it needs."""
        parameters = inspect.signature(self.function).parameters.values()
        needed = (
            f"--{one.name} {one.name.upper()}" for one in parameters if _is_option(one) and one.default is one.empty
        )
        return " ".join([self.command, *self.places.values(), *needed, "[OPTIONS]"])


def _is_option(parameter: inspect.Parameter) -> bool:
    return parameter.kind is parameter.KEYWORD_ONLY


def _shown(name: str, parameter: inspect.Parameter) -> str:
    if parameter.kind is parameter.VAR_POSITIONAL:
        return f"{name.upper()}..."
    return name.upper() if parameter.default is parameter.empty else f"[{name.upper()}]"


@dataclass(frozen=True)
class Failure:
    """Why a command has failed.

    Attributes:
        kind: name of the error's class.
        message: what was found, what was expected and what to do; a Ctrl-C says what is left.
        code: exit code.
        hints: further lines for a terminal: usage and an example.
        setting: Python name of the setting that was refused, if the failure is one setting's.
    """

    kind: str
    message: str
    code: int
    hints: tuple[str, ...] = ()
    setting: str = ""

    def show(self, output: Output) -> int:
        """Say it on stderr; with --json, also print it as the one object on stdout. Return the exit code."""
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


def misuse(error: CycloptsError, manual: Manual | None) -> Failure:
    """Return the failure of a command line that cannot be understood."""
    hints: tuple[str, ...] = ("`wordcraft-kg --help` lists all commands.",)
    if manual is not None and not isinstance(error, UnknownCommandError):
        hints = (f"usage:   {manual.usage}", f"example: {manual.examples[0]}")
    return Failure(type(error).__name__, _said(error, manual), 2, hints)


def _said(error: CycloptsError, manual: Manual | None) -> str:
    """Return the parser's message, in our words where its own are those of a programmer."""
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


def failure_of(error: BaseException, manual: Manual | None) -> Failure | None:
    """Return the failure that a command's error means to its user; None for a defect of this package."""
    kind = type(error).__name__
    if isinstance(error, KeyboardInterrupt):
        return Failure(kind, str(error) or "interrupted; nothing was written", INTERRUPTED)
    if isinstance(error, WordCraftKGError):
        shown = with_options(str(error), manual.places if manual else ())
        return Failure(error.kind, shown, 1, setting=error.setting)
    if isinstance(error, ModuleNotFoundError):
        package = (error.name or "").partition(".")[0]
        if package in ("", "wordcraft_kg"):
            return None
        return Failure(
            kind, f"this command needs {package}, which is not installed. Install it: pip install wordcraft-kg", 1
        )
    if isinstance(error, OSError):
        where = f"'{error.filename}': " if error.filename else ""
        return Failure(kind, f"{where}{error.strerror or error}. Nothing was changed.", 1)
    # The second is what torch says about its tensors.
    if isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and _NO_MEMORY.search(str(error))):
        return Failure("MemoryError", "this machine does not have enough memory for this. Nothing was changed.", 1)
    return None


def with_options(message: str, places: Container[str] = ()) -> str:
    """Return a library's error with its settings, which are in backticks, named as the command line names them.

    Args:
        message: text of the error.
        places: names of the settings that the command takes by their place.
    """

    def named(match: re.Match[str]) -> str:
        name = OPTIONS.get(match[1], match[1])
        return name.upper() if name in places else f"--{name.replace('_', '-')}"

    return NAMED_SETTING.sub(named, message)
