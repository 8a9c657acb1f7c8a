"""Write docs/commands.md from the commands' own help; ``--check`` only compares."""

import contextlib
import io
import os
import sys
from pathlib import Path

from wordcraft_kg.cli import commands_by_group, main

PAGE = Path(__file__).with_name("commands.md")


def page() -> str:
    """Return the page: the help of every command, as a terminal of 80 columns shows it."""
    os.environ |= {"COLUMNS": "80", "NO_COLOR": "1", "TERM": "dumb"}
    parts = ["# Commands\n", "Made by `make docs` from `wordcraft-kg COMMAND --help`.\n"]
    for arguments in [[], *(name.split() for names in commands_by_group().values() for name in names)]:
        buffer = io.StringIO()
        with contextlib.redirect_stdout(buffer):
            main([*arguments, "--help"])
        text = "\n".join(line.rstrip() for line in buffer.getvalue().splitlines())
        parts.append(f"## {' '.join(['wordcraft-kg', *arguments])}\n\n```text\n{text.strip()}\n```\n")
    return "\n".join(parts)


if __name__ == "__main__":
    if "--check" in sys.argv:
        sys.exit("docs/commands.md is not up to date; run `make docs`" if PAGE.read_text() != page() else 0)
    PAGE.write_text(page())
