"""Failed commands: conversion of errors into messages, hints and exit codes.

A user's mistake has one style, whoever found it: the parser, a setting's check or a file's reader.
A defect of the package keeps its traceback.
"""

import re
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from inspect import Parameter, signature
from typing import Any

from cyclopts import (
    CycloptsError,
    MissingArgumentError,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
)

from wordcraft_kg.base.errors import NAMED_SETTING, WordCraftKGError
from wordcraft_kg.base.extras import missing_package
from wordcraft_kg.base.registry import loaded_plugins, plugin_error
from wordcraft_kg.base.wording import for_terminal
from wordcraft_kg.cli.console import Output, json_line

OPTIONS = {"num_distractors": "distractors", "kind": "split", "trackers": "track"}
"""Option names by Python setting name, where the two differ."""
INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells give it: 128 and the number of SIGINT."""
# torch has no class of its own for this on the CPU.
_NO_MEMORY = re.compile("not enough memory|can't allocate memory|out of memory")
_NO_HOME = "Could not determine home directory"
"""Python's message for a user without HOME and without an entry in the list of users.

Containers often run as such users.
"""


@dataclass(frozen=True)
class Manual:
    """The usage of a command, shown in its help and after a mistake in the command line.

    Attributes:
        name: name of the command, such as ``describe`` or ``people serve``.
        function: the function that runs the command; its signature gives the usage.
        examples: complete command lines, to show in the help.
        file_only: names of the options that the help does not show, such as ``--clip``.
        group: group of an app's command in the help; empty for the package's own.
        subject: help text for the first of a command's two words, or empty.
    """

    name: str
    function: Callable[..., Any]
    examples: Sequence[str]
    file_only: Sequence[str]
    group: str
    subject: str

    @property
    def usage(self) -> str:
        """The usage line: command, positional arguments and required options."""
        words = ["wordcraft-kg", self.name]
        for parameter in signature(self.function).parameters.values():
            name = parameter.name.upper()
            is_required = parameter.default is parameter.empty
            if parameter.kind is parameter.VAR_POSITIONAL:
                words.append(f"{name}...")
            elif parameter.kind is not parameter.KEYWORD_ONLY:
                words.append(name if is_required else f"[{name}]")
            elif is_required:
                words.append(f"--{parameter.name} {name}")
        return " ".join([*words, "[OPTIONS]"])


@dataclass(frozen=True)
class Failure:
    """The failure of a command, as shown to the user.

    Attributes:
        kind: name of the error's class.
        message: what was found, what was expected, and what to do.
        code: exit code.
        hints: further lines for a terminal: usage and an example.
        setting: Python name of the setting with a refused value; empty without one.
    """

    kind: str
    message: str
    code: int = 1
    hints: tuple[str, ...] = ()
    setting: str = ""

    def show(self, output: Output) -> int:
        """Print the failure on stderr, and with --json as a JSON object on stdout.

        Return the exit code.
        """
        from rich.console import Console

        if output.json:
            error = {"kind": self.kind, "message": self.message}
            print(json_line({"error": error}))
        if output.verbose:
            traceback.print_exc()
        # No markup: messages repeat what users and files say, such as [b] in a file name.
        console = Console(stderr=True, soft_wrap=True, highlight=False, markup=False, emoji=False)
        if self.code != INTERRUPTED:
            console.print("error: ", style="bold red", end="")
        console.print("\n".join(map(for_terminal, [self.message, *self.hints])))
        return self.code


def failure_of(error: BaseException, manual: Manual | None) -> Failure | None:
    """Convert an error into text and exit code.

    Args:
        error: what a command has raised.
        manual: the usage of the command; None if the command line names no command.

    Returns:
        The failure; None for a defect of the package, which keeps its traceback.
    """
    error = _for_author(error)
    kind = type(error).__name__
    if isinstance(error, CycloptsError):
        return Failure(kind, _message(error), 2, _hints(error, manual))
    if isinstance(error, KeyboardInterrupt):
        return Failure(kind, str(error) or "interrupted; nothing was written", INTERRUPTED)
    if isinstance(error, WordCraftKGError):
        return Failure(error.kind, with_options(str(error), manual), setting=error.setting)
    if isinstance(error, ModuleNotFoundError):
        # Of an optional package the remedy is known; another missing module is a defect.
        missing = missing_package("this command", error)
        return None if missing is error else Failure(kind, str(missing))
    if isinstance(error, OSError):
        # Outputs are written at once or not at all, so nothing is half changed.
        file_name = f"'{error.filename}': " if error.filename else ""
        message = f"{file_name}{error.strerror or error}. Nothing was changed."
        if any("pystow" in place.filename for place in traceback.extract_tb(error.__traceback__)):
            message += " Set PYSTOW_HOME, PyKEEN's folder, to one with write permission."
        return Failure(kind, message)
    if isinstance(error, RuntimeError) and str(error).startswith(_NO_HOME):
        return Failure(
            kind,
            "this user has no home folder. Set HOME to a folder with write permission. Nothing was "
            "changed.",
        )
    # The RuntimeError comes from torch, for tensors.
    is_torch_memory = isinstance(error, RuntimeError) and _NO_MEMORY.search(str(error))
    if isinstance(error, MemoryError) or is_torch_memory:
        message = "this machine does not have enough memory. Nothing was changed."
        return Failure("MemoryError", message)
    return None


def _for_author(error: BaseException) -> BaseException:
    """Return a defect in a plugin's code as an error for its author, and others as they are."""
    if isinstance(error, Exception) and not isinstance(error, WordCraftKGError):
        files = {frame.f_code.co_filename for frame, _ in traceback.walk_tb(error.__traceback__)}
        for plugin in loaded_plugins():
            if str(plugin.path) in files:
                return plugin_error(error, plugin)
    return error


def _hints(error: CycloptsError, manual: Manual | None) -> tuple[str, ...]:
    # Without a command there is no usage to show.
    if manual is None or isinstance(error, UnknownCommandError):
        return ("`wordcraft-kg --help` lists all commands.",)
    return f"usage:   {manual.usage}", f"example: {manual.examples[0]}"


def _message(error: CycloptsError) -> str:
    """Return the parser's message, in plainer words where its own are a programmer's."""
    if isinstance(error, UnusedCliTokensError) and error.unused_tokens:
        return f"unexpected argument '{error.unused_tokens[0]}'."
    # Not its subclasses, whose own messages are plain.
    if type(error) is MissingArgumentError and error.argument is not None:
        name = error.argument.name
        is_place = error.argument.index is not None
        return f"a value for {name.removeprefix('--').upper() if is_place else name} is missing."
    if isinstance(error, UnknownOptionError) and "-" in (error.token.keyword, error.token.value):
        # A shell reads `score MODEL a + b -> c` as the words `a + b -`, and writes the output to a
        # file `c`.
        return (
            "unexpected argument '-'. If it is the beginning of ->, a shell has read the > as a "
            "redirection to a file: write a + b = c, or quote 'a + b -> c'."
        )
    error.verbose = False
    return str(error).partition(" Available commands:")[0]


def with_options(message: str, manual: Manual | None = None) -> str:
    """Replace Python setting names in backticks by command-line names.

    So `batch_size` becomes --batch-size: errors of libraries name settings as Python does.

    Args:
        message: text of an error.
        manual: usage of the command, whose positional arguments become upper case, as in GRAPH.
    """
    parameters = signature(manual.function).parameters if manual else {}

    def named(match: re.Match[str]) -> str:
        name = OPTIONS.get(match[1], match[1])
        is_place = name in parameters and parameters[name].kind is not Parameter.KEYWORD_ONLY
        return name.upper() if is_place else f"--{name.replace('_', '-')}"

    return NAMED_SETTING.sub(named, message)
