"""Options shared by several commands, with help texts."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Group, Parameter
from cyclopts.completion import CompletionContext

from wordcraft_kg.cli.console import Flag, split_labels
from wordcraft_kg.graphs.book_files import ReadOptions
from wordcraft_kg.graphs.library import FETCHABLE, known_books
from wordcraft_kg.graphs.tasks import TaskPart

AGENT = "train-agent"
"""Kind of run, as in ``run.json``, that trains an agent."""


def _complete_book(context: CompletionContext) -> Iterator[str]:
    yield from (book.name for book in known_books() if book.path is not None)
    # Not the whole path is given as a pattern: what a user has typed may hold a bracket or a star.
    folder = Path(os.path.dirname(context.incomplete))
    yield from map(str, sorted(folder.glob("[!.]*")))


Book = Annotated[str, Parameter(completer=_complete_book)]
"""A recipe book or a graph: a file, a folder or a known name."""
Graph = Annotated[Book, Parameter(help="graph folder, recipe book or known book's name.")]
OptionalBook = Annotated[str | None, Parameter(completer=_complete_book)]
FetchableBook = Annotated[str | None, Parameter(completer=lambda _: iter(FETCHABLE))]

# The types below are one text of help for each option, whichever command has it.
Force = Annotated[
    Flag,
    Parameter(
        help="replace an existing output. It stays until the new output is complete; an output of "
        "training until the new training can be resumed."
    ),
]
Words = Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)]
"""Comma-separated values; the option may be repeated."""
Base = Annotated[
    Words,
    Parameter(
        help="comma-separated base entities. Default: the book's base, or else entities without "
        "a recipe."
    ),
]
Seeds = Annotated[
    str | None,
    Parameter(
        help="seeds to train in turn, such as 0-4 or 0,3,7, each in a folder seed-N. Finished "
        "seeds are kept; after Ctrl-C, repeat the command to continue."
    ),
]
Trackers = Annotated[
    Words,
    Parameter(
        help="metric trackers, comma-separated: tensorboard, which needs the extra of its name."
    ),
]
Table = Annotated[
    Path | None,
    Parameter(help="file for a table of the results: LaTeX (.tex), CSV or Markdown (.md)."),
]
Part = Annotated[TaskPart, Parameter(help="tasks to play: train, valid, test or all.")]
Paths = Annotated[list[Path] | None, Parameter(negative=(), consume_multiple=False)]
MovedGraph = Annotated[
    str | None, Parameter(help="graph folder, if moved since training.", show_default=False)
]


@Parameter(name="*", group=Group("Recipe file", sort_key=1))
@dataclass(frozen=True)
class FileOptions:
    """What a user says about a recipe book's file; what is left out, documented words tell.

    Attributes:
        columns: comma-separated names, or numbers from 1, of the columns of ingredients and, last,
            of the result, such as item1,item2,product; in JSON paths, such as
            'recipes[].parts[].item,recipes[].out.name'.
        delimiter: column delimiter: a character, or comma, semicolon, tab, pipe or space.
        encoding: encoding of the text, such as cp1252.
        case: keep labels as they are, or fold them to lower case.
        single_ingredient: second ingredient for recipes with a single ingredient: self repeats the
            ingredient, alone adds none; a name such as furnace is added to each recipe. Default:
            none in a book of larger sets, else such a recipe is an error.
    """

    columns: Words = None
    delimiter: str | None = None
    encoding: str | None = None
    case: Literal["keep", "fold"] = "keep"
    single_ingredient: str | None = None

    def for_reading(self) -> ReadOptions:
        """Return the options as arguments of ``read_book``."""
        return {
            "columns": split_labels(self.columns) if self.columns else None,
            "delimiter": self.delimiter,
            "encoding": self.encoding,
            "case": self.case,
            "single_ingredient": self.single_ingredient,
        }
