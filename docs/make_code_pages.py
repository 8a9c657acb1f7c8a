"""A hook for the website: pages that follow from the code.

The page of all commands is their own help. A page of the Python reference has the names of its row in
docs/reference.md.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from wordcraft_kg.cli import commands_by_group, make_app, manual_of

REFERENCE = Path(__file__).with_name("reference.md")
ROW = re.compile(r"^\| \[(.*?)\]\((reference/.*?)\) \| (.*) \|$", re.MULTILINE)
NAME = re.compile(r"\]\[(.+?)\]")
OPTION = re.compile(r"^\* `(.+?)`: (.*)$")
DEFAULT = re.compile(r" \*\[default: (.*?)\]\*$")
NAMED = re.compile(r"\b([A-Z_]+), --[\w-]+")
EVERY_COMMAND = re.compile(r"\*\*Output and configuration\*\*:\n\n(.*?)(?=\n\*\*|\Z)", re.DOTALL)


def page() -> str:
    """Return the page: a list of commands by group, then usage, description, options and examples
    of each command.
    """
    text = make_app().generate_docs(flatten_commands=True)
    sections = dict(
        re.findall(r"^# wordcraft-kg ([\w -]+)\n\n(.*?)(?=^# |\Z)", text, re.MULTILINE | re.DOTALL)
    )
    lines = [
        "# Commands",
        "",
        "From the help. Options of every command are [at the end](#options-of-every-command).",
    ]
    for group, names in commands_by_group().items():
        lines += [
            "",
            f"**{group}**: " + " · ".join(f"[{name}](#{_anchor(name)})" for name in names),
        ]
    shared = set()
    for name in (name for names in commands_by_group().values() for name in names):
        own = sections[name].replace(
            f"{name} {name} ", f"{name} ", 1
        )  # the usage repeats the command
        shared |= {found.strip() for found in EVERY_COMMAND.findall(own)}
        own = EVERY_COMMAND.sub("", own)
        lines += [
            "",
            f"## {name}",
            "",
            *_tables(own, name),
            "",
            "```",
            *manual_of(name).examples,
            "```",
        ]
    (common,) = shared
    return (
        "\n".join([*lines, "", "## Options of every command", "", *_tables(common, "all")]) + "\n"
    )


def _anchor(name: str) -> str:
    return name.replace(" ", "-")


def _tables(text: str, command: str) -> Iterator[str]:
    """Yield the lines with lists of options as tables; each option has an anchor such as
    ``train-agent--steps``.
    """
    file_only = manual_of(command).file_only if command != "all" else ()
    settings = []
    in_table = False
    for line in re.sub(r"\n +", " ", text).strip().splitlines():
        if option := OPTION.match(line):
            if not in_table:
                yield from ("| option | meaning | default |", "|---|---|---|")
            names, about = NAMED.sub(r"\1", option[1]), option[2].replace("|", "\\|")
            # Several names are separated by commas.
            name = names.split()[0].rstrip(",")
            default = DEFAULT.search(about)
            anchor = re.sub(r"[^\w-]", "", f"{_anchor(command)}{name}")
            cells = [DEFAULT.sub("", about), f"`{default[1]}`" if default else ""]
            if name in file_only:
                setting = name.removeprefix("--").replace("-", "_")
                settings.append([f"`{setting}`", *cells])
                continue
            cells.insert(0, f'<a id="{anchor}"></a>`{names}`')
            yield f"| {' | '.join(cells)} |"
        else:
            yield line
        in_table = bool(option)
    if settings:
        yield f"\n**By `--config FILE`, in a table `[{command.replace(' ', '.')}]`**:\n"
        yield from ("| setting | meaning | default |", "|---|---|---|")
        yield from (f"| {' | '.join(cells)} |" for cells in settings)


def reference_pages(index: str) -> dict[str, str]:
    """Return the pages of the Python reference by path below docs/: a directive for each name.

    Args:
        index: text of docs/reference.md, with a row for each page.
    """
    pages = {}
    for title, path, names in ROW.findall(index):
        directives = [f"::: {name}\n" for name in NAME.findall(names)]
        pages[path] = f"# {title}\n\n{''.join(directives)}"
    return pages


def on_files(files: Any, *, config: Any) -> Any:
    """Add the pages to the website."""
    from mkdocs.structure.files import File

    pages = {"commands.md": page(), **reference_pages(REFERENCE.read_text(encoding="utf-8"))}
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files
