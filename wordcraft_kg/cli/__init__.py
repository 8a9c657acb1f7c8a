"""The command line: thin modules of commands; results on stdout, log and progress on stderr.

Read ``import_knowledge`` first, a short command with all parts. This file makes the application
from the commands' modules, and runs a command line. ``console`` has what all commands share
(options, results as text or JSON), ``options`` the options that several have, ``failures`` the way
from an error to a message and an exit code. All other files are commands: those of one subject,
such as ``train``, lie in one file. What a command computes lies in other rooms.

To add a command, write a function named after the command, and examples in ``EXAMPLES`` of its
module; list the command in :data:`CORE`. Apps add commands by entry points in the group
``wordcraft_kg.commands``: the command's name, with a dot between two words, and
``module:function``. The module has ``EXAMPLES`` and ``GROUP``, the group in the help. If several
commands share the first word, such as ``people``, one module has ``SUBJECT``, the help text for
this word. Import heavy packages inside the function: help stays fast.

``FILE_ONLY`` of a module names options that the help lists as settings of the configuration file
alone, because no guide needs them. In a module with several commands, both are dictionaries by
command.

Change freely: help texts, examples, what is shown as text. Names of options and commands, the
fields of JSON output and exit codes are used by scripts: keep them, or say in the changelog what
changed.
"""

import gc
import json
import os
import re
import sys
import textwrap
import tomllib
from collections.abc import Sequence
from functools import cache
from importlib.metadata import entry_points
from itertools import chain
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, get_args

from cyclopts import App, ArgumentCollection, CoercionError, Group
from cyclopts.config import Dict
from cyclopts.help import DefaultFormatter, InlineText

from wordcraft_kg import __version__
from wordcraft_kg.base.artefacts import read_small_file
from wordcraft_kg.base.errors import ConfigError, StdoutError
from wordcraft_kg.base.registry import load_plugin
from wordcraft_kg.cli.console import Output, accept_all_characters
from wordcraft_kg.cli.failures import Failure, Manual, failure_of

CORE = {
    "Recipe books and graphs": {
        "build-graph": "graphs",
        "describe": "graphs",
        "check-book": "graphs",
        "books": "graphs",
        "export": "graphs",
    },
    "Link prediction": {
        "train-recipes": "train",
        "train-complex": "train",
        "train-links": "train",
        "evaluate-links": "links",
        "score": "links",
        "suggest": "links",
    },
    "Agents": {"train-agent": "train", "evaluate-agent": "agents", "explain": "agents"},
    "Comparisons and studies": {"compare": "compare", "reproduce": "reproduce"},
    "Tasks and play": {"discover": "agents"},
    "Knowledge from outside the book": {"import-knowledge": "import_knowledge"},
    "Installation": {"doctor": "doctor"},
}
"""Commands of the package itself, by group in the help, each with the module of its function."""
APPS = {
    point.name.replace(".", " "): point for point in entry_points(group="wordcraft_kg.commands")
}
"""Entry points of the commands that apps add, by command name."""
_MODULES = dict(chain.from_iterable(group.items() for group in CORE.values()))
"""Module of each core command."""
ALL = [*_MODULES, *sorted(APPS)]
"""All command names."""

ABOUT = """Build recipe graphs of crafting worlds, predict links, train agents, and report the
results. Start here:

  wordcraft-kg build-graph everyday --out graph
  wordcraft-kg train-recipes graph --out model
  wordcraft-kg evaluate-links model
  wordcraft-kg train-agent graph --scorer model --use combines,component,recipe --out run
  wordcraft-kg explain run
  wordcraft-kg explore graph --model model --run run

train-complex trains the paper's model instead; compare tests the differences between runs or
between models."""
# A line for each paragraph: the terminal wraps them.
CONFIGURED = (
    "Options can also be set in a TOML file, --config FILE, in a table named after the command."
    "\n\n"
    "--plugin FILE.py, before or after any command, adds own policies, sources, rewards, splits "
    "and players (docs/own-ideas.md). The file runs as a program: name only files that you have "
    "read."
)


@cache
def make_app() -> App:
    """Build the command-line application with the commands of the package and the apps.

    A program that runs several command lines builds it once.
    """
    app = App(
        name="wordcraft-kg",
        help=ABOUT,
        help_epilogue=CONFIGURED,
        version=__version__,
        version_flags=("--version", "-V"),
        help_format="plaintext",
        help_formatter=_FlowingHelp(),
        config=_configure,
        # `main` runs the command itself: it needs the exit code, and shows errors in one style.
        result_action="return_value",
        suppress_keyboard_interrupt=False,
    )
    app.register_install_completion_command(
        help="Install completion for bash, zsh or fish: a script, and a line in ~/.bashrc "
        "or ~/.zshrc.",
        help_epilogue="",
    )
    for rank, (title, commands) in enumerate(commands_by_group().items()):
        group = Group(title, sort_key=rank)
        for place, name in enumerate(commands):
            manual = manual_of(name)
            *subject, word = name.split()
            _subject(app, subject, group).command(
                manual.function,
                name=word,
                group=None if subject else group,
                sort_key=place,
                usage=f"Usage: {manual.usage}",
                help_epilogue=_examples(manual) + _file_options(name, manual.file_only),
                help_formatter=_FlowingHelp(manual.file_only),
                # "train" is not a command, but suggests the training commands.
                synonym=tuple(word.split("-")),
            )
    return app


def _subject(app: App, words: list[str], group: Group) -> App:
    """Return where a command is added: the application, or the one for the command's first word."""
    if not words:
        return app
    (word,) = words
    if word not in app:
        manuals = [manual_of(name) for name in ALL if name.startswith(f"{word} ")]
        about = next(manual.subject for manual in manuals if manual.subject)
        app.command(
            App(
                name=word,
                help=about,
                help_epilogue=_examples(*manuals),
                group=group,
                version_flags=(),
            )
        )
    return app[word]


_WIDTH = 77
"""Columns of a command in the help: of the 80 of a small terminal, without the mark of a line that
goes on."""


def _examples(*manuals: Manual) -> str:
    lines = chain.from_iterable(manual.examples for manual in manuals)
    return "Examples:\n\n" + "\n".join(map(_continued, lines))


def _continued(command: str) -> str:
    """Return a command line for the help, indented, and continued before an option if it is long.

    Where a terminal wraps a line, a copy of it is two commands.
    """
    lines = textwrap.wrap(
        # Only spaces before an option may end a line: text is wrapped at none of the others.
        re.sub(" (?!--)", "\N{NO-BREAK SPACE}", command),
        _WIDTH,
        initial_indent="  ",
        subsequent_indent="    ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return " \\\n".join(lines).replace("\N{NO-BREAK SPACE}", " ")


def _file_options(name: str, file_only: Sequence[str]) -> str:
    """Return the help's last paragraph: options that it shows as settings of a file alone."""
    if not file_only:
        return ""
    settings = ", ".join(option.removeprefix("--").replace("-", "_") for option in file_only)
    table = f"[{name.replace(' ', '.')}]"
    return f"\n\nFurther settings, by --config FILE in a table {table}: {settings}."


def commands_by_group() -> dict[str, list[str]]:
    """Return all command names by help group, core groups first."""
    # Copies: CORE stays as it is.
    groups = {title: list(names) for title, names in CORE.items()}
    for name in sorted(APPS):
        groups.setdefault(manual_of(name).group, []).append(name)
    return groups


def manual_of(name: str) -> Manual:
    """Return the usage and the examples of a command, by name; imports the command's module."""
    if name in APPS:
        function = APPS[name].load()
    else:
        function = resolve_name(f"{__name__}.{_MODULES[name]}:{name.replace('-', '_')}")
    module = sys.modules[function.__module__]

    def stated(constant: str) -> Any:
        """Return a constant of the module; of a dictionary by command, the value for this one."""
        values = getattr(module, constant, ())
        return values.get(name, ()) if isinstance(values, dict) else values

    return Manual(name, function, *map(stated, ("EXAMPLES", "FILE_ONLY", "GROUP", "SUBJECT")))


_NARROWEST = 20
"""Fewest columns for help: in a narrower terminal, rich would arrange a table without end."""


class _FlowingHelp(DefaultFormatter):
    """Help formatter that joins the lines of docstrings; blank lines and command lines stay.

    Args:
        hidden: names of options that are not shown, such as ``--clip``.
    """

    def __init__(self, hidden: Sequence[str] = ()) -> None:
        super().__init__()
        self.hidden = set(hidden)

    def __call__(self, console: Any, options: Any, panel: Any) -> None:
        """Show a panel with commands or options.

        Positional arguments are shown without an option name: each has one way to be given.

        Args:
            console: Rich's console.
            options: options of the console.
            panel: the panel; without an entry to show, nothing is printed.
        """
        entries = []
        for entry in panel.entries:
            if self.hidden.isdisjoint(entry.names):
                _flow(entry.description)
                by_place = bool(entry.positional_label)
                entries.append(entry.copy(positive_names=()) if by_place else entry)
        if entries:
            console.width = max(console.width, _NARROWEST)
            super().__call__(console, options, panel.copy(entries=entries))

    def render_description(self, console: Any, options: Any, description: Any) -> None:
        """Print a command's description.

        Args:
            console: Rich's console.
            options: options of the console.
            description: the docstring's text.
        """
        _flow(description)
        super().render_description(console, options, description)


def _flow(shown: Any) -> None:
    from rich.text import Text

    if isinstance(shown, InlineText) and isinstance(shown.primary_renderable, Text):
        text = "\n\n".join(map(_paragraph, shown.primary_renderable.plain.split("\n\n")))
        shown.primary_renderable = Text(text, end=shown.primary_renderable.end)


def _paragraph(text: str) -> str:
    lines = [line.strip() for line in text.splitlines()]
    # Command lines are copied and pasted, so each keeps its line.
    if all(line.startswith("wordcraft-kg ") for line in lines):
        return "\n".join(map(_continued, lines))
    return " ".join(" ".join(lines).split())


def command_in(tokens: Sequence[str]) -> str | None:
    """Return the name of the first command in the words of a command line, or None.

    The parser is not asked, because this is needed for its own errors, and for the table of the
    configuration file.
    """
    for place, token in enumerate(tokens):
        for name in (token, " ".join(tokens[place : place + 2])):
            if name in ALL:
                return name
    return None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line, and return the exit code.

    Args:
        arguments: words of the command line; None for those of this process.

    Returns:
        0 done, 1 bad input or failed check, 2 misuse, 130 interrupted.
    """
    # A large book creates millions of small, long-lived objects: garbage collection would take
    # longer than the work.
    gc.set_threshold(200_000, 20, 100)
    accept_all_characters()
    words = sys.argv[1:] if arguments is None else arguments
    # The arrow in a recipe would be taken for an option.
    tokens = ["→" if token == "->" else token for token in words]
    tokens, plugins = without_plugins(tokens)
    name = command_in(tokens)
    manual = manual_of(name) if name else None
    # A guess until the options are parsed: parsing itself may fail.
    output = Output(json="--json" in tokens)
    try:
        for token in tokens:
            _check_text(token)
        for plugin in plugins:
            load_plugin(plugin)
        command, bound, _ = make_app().parse_args(tokens, print_error=False, exit_on_error=False)
        output = bound.arguments.get("output", output)
        _check_working_folder()
        with output.session():
            return int(command(*bound.args, **bound.kwargs) or 0)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 1
    except BrokenPipeError:
        # The reader has closed the pipe, as `| head` does: not an error.
        _close_stdout()
        return 0
    except StdoutError as error:
        _close_stdout()
        return Failure(error.kind, str(error)).show(output)
    except (Exception, KeyboardInterrupt) as error:
        failure = failure_of(error, manual)
        if failure is None:
            raise
        return failure.show(output)


def without_plugins(tokens: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return a command line without ``--plugin FILE``, and the files; an absent file is "".

    Before the command line is parsed: a plugin's names are values of its options.
    """
    words = iter(tokens)
    command: list[str] = []
    files: list[str] = []
    for token in words:
        option, has_value, value = token.partition("=")
        if option == "--plugin":
            files.append(value if has_value else next(words, ""))
        else:
            command.append(token)
    return command, files


def _close_stdout() -> None:
    """Discard the text that stdout did not take: Python would flush it at exit, and fail again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _check_working_folder() -> None:
    """Raise ConfigError if the working folder was deleted: libraries then end the process."""
    try:
        os.getcwd()
    except FileNotFoundError:
        raise ConfigError(
            "the working folder does not exist any more. Change to an existing folder with cd."
        ) from None


def _check_text(text: str) -> None:
    """Refuse text that no file name or record may hold: not UTF-8, or with a NUL character."""
    if "\0" in text:
        raise ConfigError(f"{text!r} holds a NUL character. Remove this character.")
    try:
        text.encode()
    except UnicodeEncodeError:
        raise ConfigError(
            f"{text!r} is not UTF-8. Rename the file or folder, or correct the text."
        ) from None


def _configure(app: App, commands: tuple[str, ...], arguments: ArgumentCollection) -> None:
    """Take options from the file that ``--config`` names, and refuse fractions as whole numbers.

    Args:
        app: the application of the command.
        commands: words of the command.
        arguments: the options of the command line; those of the file are added.

    Raises:
        ConfigError: if the file cannot be read or has no table of the command.
        CoercionError: for a fraction as a whole number.
    """
    command = " ".join(commands)
    for argument in arguments.filter_by(has_tokens=True):
        if argument.name == "--config":
            path = argument.tokens[0].value
            Dict(_read_toml(path, command), source=path)(app, commands, arguments)
    # After the file's options have been added, for these too.
    _refuse_fractions(arguments)


def _refuse_fractions(arguments: ArgumentCollection) -> None:
    """Refuse a fraction for a whole number: the parser would cut it off without a word."""
    for argument in arguments:
        # `int`, `int | None`, `list[int]` and `list[int] | None`.
        hints = [argument.hint, *get_args(argument.hint)]
        if any(int in (hint, *get_args(hint)) for hint in hints):
            for token in argument.tokens:
                if "." in token.value:
                    raise CoercionError(argument=argument, token=token, target_type=int)


def _read_toml(path: str, command: str) -> dict[str, Any]:
    """Return the tables of a configuration file, with the command's paths from this folder."""
    try:
        if not Path(path).is_file():
            raise ConfigError(f"--config {path}: no such file.")
        content = tomllib.loads(read_small_file(Path(path)).decode())
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(f"--config {path}: not a TOML file ({error}).") from None
    # JSON's escape, wherever the text is.
    if r"\u0000" in json.dumps(content, default=str):
        raise ConfigError(f"--config {path}: a text holds a NUL character. Remove this character.")
    # A command of two words has a table in a table: [people.serve].
    options: Any = content
    for word in command.split():
        options = options.get(word) if isinstance(options, dict) else None
    if not isinstance(options, dict):
        tables = ", ".join(content) or "nothing"
        raise ConfigError(
            f"--config {path}: no table [{command.replace(' ', '.')}]; found {tables}. Put the "
            "options into a table named after the command."
        )
    if "plugin" in options:
        raise ConfigError(
            f"--config {path}: found `plugin`, but a file may come from anyone, so it names no "
            "program to run. Remove it, and give --plugin FILE on the command line."
        )
    # Paths in a run's config.toml are relative to the file.
    from wordcraft_kg.runs.config_file import moved

    def resolved(value: str) -> str:
        # Any text may be a path: only one that exists there, and not here, is taken for one.
        target = os.path.normpath(Path(path).parent / value)
        return target if os.path.exists(target) and not os.path.exists(value) else value

    options |= moved(options, resolved)
    return content
