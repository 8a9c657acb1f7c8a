"""Odd values for every option of every command, on the command line and in a TOML file.

The options are taken from the application itself, so a new one is tried without a line here, unless
it is required and its name says nothing: then :data:`GIVEN` needs a sound value for it.
"""

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import get_args

from wordcraft_kg.cli import ALL, make_app

from .harness import IN, SERVERS, Trial
from .home import linked
from .spoiling import toml_of

GIVEN = {
    **dict.fromkeys(("external_results folder", "run folder", "runs folder"), "in/agent"),
    **dict.fromkeys(("book", "graph"), "in/graph"),
    **dict.fromkeys(("dim", "key_size", "value_size"), "4"),
    **dict.fromkeys(("checkpoint_every", "log_every"), "1000"),
    **dict.fromkeys(("distractor_seeds", "episodes", "epochs", "trials"), "1"),
    **dict.fromkeys(("eval_every", "port"), "0"),
    **dict.fromkeys(("attempts", "top"), "3"),
    **dict.fromkeys(("limit", "runs"), "2"),
    **{"model folder": "in/model", "studies folder": "in/study"},
    **{"agent": "trained", "batch_size": "16", "device": "cpu"},
    **{
        "features": "random",
        "format": "tsv",
        "mcp transport": "http",
        "model": "distmult",
        "player": "cat",
    },
    **{"query": "flour + water", "steps": "64"},
    **{"elicit model": "in/model", "encoder": "in/model"},
    **{
        "track": "craft-8-lite",
        "bench run player": "random",
        "chats player": "oracle",
    },
    # A list, and a file that is not there: a study would train for minutes.
    "study": "list",
}
"""Sound values that make a command quick, by option, and by command and option where it means
something else there; ``folder`` is added where the option is a path."""
NUMBERS = (
    *(
        "0",
        "-1",
        "-0",
        "1",
        "1.5",
        "1.0",
        "1e3",
        "0x10",
        "1_000",
        " 1",
        "1 ",
        "١",
        "true",
        "1,2",
        "null",
    ),
    *(
        "2147483647",
        "2147483648",
        "4294967296",
        "9223372036854775807",
        "9223372036854775808",
        "1" + 30 * "0",
    ),
    *(
        "100000000",
        "16777216",
        "65536",
        "1024",
        "1e308",
        "1e-320",
        "1e400",
        "nan",
        "inf",
        "-inf",
        "",
        "--",
        "½",
    ),
    *("1" * 5_000, "\udcff", "a\nb"),
)
TEXTS = (
    *(
        "",
        " ",
        "?",
        ",",
        ",,a",
        "-",
        "a,b",
        "é",
        "\udcff",
        "a\nb",
        "a\tb",
        "\x1b[31m",
        "x" * 300,
        "x" * 5_000,
        "nan",
    ),
    *(
        "0",
        "-1",
        "None",
        "in",
        "in/graph",
        "in/graph/graph.json",
        "in/model",
        "in/agent",
        "in/agent/run.json",
    ),
    *(
        "odd/empty",
        "odd/fifo",
        "odd/loop",
        "odd/dangling",
        "odd/none",
        "odd/none/x",
        "in/graph/graph.json/x",
        "~",
    ),
    *(".", ".."),
)
SOURCES = (
    *(
        "/dev/null",
        "/dev/zero",
        "/proc/self/mem",
        "shuffled:",
        "cuda",
        "cuda:99",
        "meta",
        "complex",
        "Cuda",
        "cpu:x",
    ),
)
"""Not for outputs: the tests may run as root."""
TOML = (
    *(
        0,
        -1,
        1.5,
        1.0,
        2**31,
        2**63,
        10**30,
        float("nan"),
        float("inf"),
        1e308,
        True,
        "",
        "1",
        "x",
        "é",
    ),
    *("1979-05-27", [], [1, 2], ["a", "b"], {}, {"a": 1}, [[]]),
)


@dataclass(frozen=True)
class Option:
    """An option of a command, or one of its positional parameters."""

    command: str
    name: str
    parameter: str
    is_path: bool
    is_number: bool
    is_required: bool

    @property
    def given(self):
        """A sound value for it, None if it is best left out."""
        if self.parameter == "out":
            return "out"
        parameter = f"{self.parameter} folder" if self.is_path else self.parameter
        return GIVEN.get(f"{self.command} {parameter}", GIVEN.get(parameter))


@cache
def _of(command):
    """Return the options of a command that take a value."""
    app = make_app()
    options = []
    for word in command.split():
        app = app[word]
    for argument in app.assemble_argument_collection():
        kinds = {
            kind
            for hint in (argument.hint, *get_args(argument.hint))
            for kind in (hint, *get_args(hint))
        }
        if argument.children or bool in kinds:
            continue
        name = argument.names[0]
        parameter = name.lstrip("-").lower().replace("-", "_")
        is_number, is_required = bool(kinds & {int, float}), bool(argument.required)
        options.append(Option(command, name, parameter, Path in kinds, is_number, is_required))
    return tuple(options)


@cache
def cases():
    """Return every option with each of its odd values, and whether it comes from the command line
    or a file."""
    chosen = []
    for option in (option for name in ALL for option in _of(name)):
        sources = () if option.parameter == "out" else SOURCES
        texts = NUMBERS if option.is_number else (*TEXTS, *NUMBERS[:22], *sources)
        chosen += [(option, "line", value) for value in texts]
        if option.parameter != "config" and option.name.startswith("--"):
            chosen += [(option, "file", value) for value in TOML]
    return tuple(chosen)


def trial(number, home, sandbox):
    """Give one option one odd value."""
    option, where, value = cases()[number % len(cases())]
    folder = sandbox / IN
    folder.mkdir()
    for kind in ("graph", "model", "model-table", "agent", "study"):
        linked(home, kind, folder / kind)
    _odd_paths(sandbox / "odd")
    command = [*option.command.split(), "--quiet"]
    if tuple(command[:-1]) in SERVERS and option.command not in ("mcp", "serve openenv"):
        command.append("--no-browser")
    for other in _of(option.command):
        given = other.given
        if other.name == option.name:
            continue
        if given is None and other.is_required:
            raise LookupError(
                f"`{other.parameter}` of {other.command} is required; give GIVEN a sound value for "
                "it"
            )
        if given is not None:
            command.append(f"{other.name}={given}" if other.name.startswith("--") else given)
    if where == "file":
        text = f"[{option.command.replace(' ', '.')}]\n{option.parameter} = {toml_of(value)}\n"
        (folder / "config.toml").write_text(text, "utf-8")
        command.append(f"--config={IN}/config.toml")
    else:
        command.append(f"{option.name}={value}" if option.name.startswith("--") else value)
    return Trial(
        f"{option.name} {value!r:.60} from the {where}", (tuple(command),), may_be_interrupted=True
    )


def _odd_paths(folder):
    (folder / "empty").mkdir(parents=True)
    os.mkfifo(folder / "fifo")
    (folder / "loop").symlink_to("loop")
    (folder / "dangling").symlink_to("nowhere")
