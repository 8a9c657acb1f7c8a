"""Settings of trainings that take a moment and plain helpers for the tests of commands."""

import io
from contextlib import redirect_stdout

from helpers import in_file

from wordcraft_kg.cli import main

TINY = ("--dim", "8", "--epochs", "4", "--folds", "0", "--quiet")
QUICK = (*TINY, "--n3", "0.1")
SMALL = (
    "--steps",
    512,
    "--eval-every",
    256,
    "--quiet",
    *in_file("train-agent", batch_size=16, checkpoint_every=256),
)


def succeed(*commands):
    """Run commands that go well."""
    for command in commands:
        assert main([str(argument) for argument in command]) == 0


def text_of(*command):
    """Run a command that goes well, and return what it prints."""
    with redirect_stdout(io.StringIO()) as text:
        succeed(command)
    return text.getvalue()


def contents(folder):
    """Return all files and folders below, hidden ones too, with the bytes of files."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else b""
        for path in folder.rglob("*")
    }


def same(name, *folders):
    """Return whether a file is the same in all folders."""
    return len({(folder / name).read_bytes() for folder in folders}) == 1
