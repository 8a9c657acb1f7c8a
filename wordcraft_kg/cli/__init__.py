"""The command line: one thin module per command; results on stdout, log and progress on stderr.

A new command is a module with a function of its own name and ``EXAMPLES``, and an entry in :data:`COMMANDS`. Heavy
imports go inside the function, so that help stays fast.
"""

import gc
import logging
import os
import re
import sys
import tomllib
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from cyclopts import App, Group
from cyclopts.config import Dict

from wordcraft_kg import __version__
from wordcraft_kg.errors import ConfigError, WordCraftKGError
from wordcraft_kg.settings import nearest

COMMANDS = {
    "Recipe books": ["books", "fetch", "check-book"],
    "Graphs": ["build-graph", "describe", "export"],
    "Environments": ["tasks", "play", "human-summary", "discover", "baselines"],
    "Link prediction": [
        "train-complex",
        "train-links",
        "tune-links",
        "import-pykeen",
        "evaluate-links",
        "compare-links",
        "score",
    ],
    "Agents": ["train-agent", "resume", "evaluate-agent", "explain", "compare-agents"],
}
"""Commands by group."""

OPTIONS = {"num_distractors": "distractors", "kind": "split"}
"""Options by the settings that they set, where the two have different names."""

START = """Start here:

  wordcraft-kg build-graph everyday --out graphs/everyday
  wordcraft-kg train-complex graphs/everyday --out models/everyday
  wordcraft-kg evaluate-links models/everyday

Options can also be set in a TOML file, --config FILE, in a table named after the command."""


def make_app() -> App:
    """Build the application with all its commands."""
    app = App(
        name="wordcraft-kg",
        help="Recipe graphs of crafting worlds, link prediction on them, and honest reports.",
        help_epilogue=START,
        version=__version__,
        help_format="plaintext",
        result_action="return_value",
        suppress_keyboard_interrupt=False,
    )
    for rank, (title, commands) in enumerate(COMMANDS.items()):
        group = Group(title, sort_key=rank)
        for name in commands:
            module = import_module(f"{__name__}.{name.replace('-', '_')}")
            examples = "Examples:\n\n" + "\n".join(f"  {line}" for line in module.EXAMPLES)
            app.command(getattr(module, name.replace("-", "_")), name=name, group=group, help_epilogue=examples)
    return app


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 bad input or a failed check, 2 misuse, 130 interrupted."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s", stream=sys.stderr)
    logging.captureWarnings(True)
    # A large book makes millions of small objects that all stay: collecting garbage would take longer than making them.
    gc.set_threshold(200_000, 20, 100)
    tokens = list(sys.argv[1:] if arguments is None else arguments)
    try:
        app = make_app()
        path = _config_path(tokens)
        if path:
            app.config = [Dict(_read_toml(path, tokens), source=path)]
        return int(app(tokens) or 0)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 1
    except KeyboardInterrupt as interruption:
        return _fail(str(interruption) or "interrupted; nothing was written", 130)
    except WordCraftKGError as error:
        return _fail(f"{type(error).__name__}: {with_options(str(error))}", 1)
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package in ("", "wordcraft_kg"):
            raise  # a bug of this package
        return _fail(f"this command needs {package}, which is not installed. Install it: pip install wordcraft-kg", 1)
    except BrokenPipeError:
        # The reader of the output has gone, as with `| head`: not an error, but Python must not flush into it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        where = f"'{error.filename}': " if error.filename else ""
        return _fail(f"{type(error).__name__}: {where}{error.strerror or error}. Nothing was changed.", 1)
    except MemoryError:
        return _fail("MemoryError: this machine does not have enough memory for this. Nothing was changed.", 1)


def _config_path(tokens: Sequence[str]) -> str | None:
    for i, token in enumerate(tokens):
        if token == "--config" and i + 1 < len(tokens):
            return tokens[i + 1]
        if token.startswith("--config="):
            return token.removeprefix("--config=")
    return None


def _read_toml(path: str, tokens: Sequence[str]) -> dict[str, Any]:
    try:
        content = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"--config {path}: no such file.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"--config {path}: not a TOML file ({error}).") from None
    known = [name for names in COMMANDS.values() for name in names]
    for key, value in content.items():
        if key not in known or not isinstance(value, dict):
            raise ConfigError(f"--config {path}: '{key}' is not a table named after a command.{nearest(key, known)}")
    command = next((token for token in tokens if token in known), None)
    if command and command not in content:
        raise ConfigError(f"--config {path}: no table [{command}]; found {', '.join(content) or 'nothing'}.")
    # A run's own config.toml gives paths relative to itself.
    from wordcraft_kg.runs.config_file import moved

    def beside(value: str) -> str:
        there = os.path.normpath(Path(path).parent / value)
        return there if os.path.exists(there) and not os.path.exists(value) else value

    return {name: moved(options, beside) for name, options in content.items()}


def with_options(message: str) -> str:
    """Return a library's error with its settings, which are in backticks, replaced by the command line's options."""

    def option(match: re.Match[str]) -> str:
        name = OPTIONS.get(match[1], match[1])
        return f"--{name.replace('_', '-')}"

    return re.sub(r"`([a-z]\w*)`", option, message)


def _fail(message: str, code: int) -> int:
    print(message, file=sys.stderr)
    return code
