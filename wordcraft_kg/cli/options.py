"""Options that several commands take, with their help."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.console import Flag
from wordcraft_kg.graphs.library import FETCHABLE, known_books
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from cyclopts.completion import CompletionContext

AGENT = "train-agent"
"""Kind of an agent's run."""


def _complete_book(context: "CompletionContext") -> Iterator[str]:
    """Offer the known books, and files and folders."""
    yield from (book.name for book in known_books() if book.path is not None)
    yield from map(str, sorted(Path(os.path.dirname(context.incomplete)).glob("[!.]*")))


Book = Annotated[str, Parameter(completer=_complete_book)]
"""A recipe book or a graph: a file, a folder or a known name."""
Graph = Annotated[Book, Parameter(help="graph folder, recipe book or known book's name.")]
OptionalBook = Annotated[str | None, Parameter(completer=_complete_book)]
FetchableBook = Annotated[str | None, Parameter(completer=lambda _: iter(FETCHABLE))]

Force = Annotated[Flag, Parameter(help="replace the output if it exists.")]
Words = Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)]
"""Comma-separated values; the option may be repeated."""
Base = Annotated[
    Words,
    Parameter(help="comma-separated base entities. Default: the book's own, or else the entities without a recipe."),
]
SingleIngredient = Annotated[
    str | None,
    Parameter(
        help="how to read recipes of one ingredient: self combines it with itself, any other name is what it is "
        "combined with, such as furnace. Default: such a recipe is an error."
    ),
]
Seeds = Annotated[
    str | None,
    Parameter(
        help="seeds to train one after the other, such as 0-4 or 0,3,7, each in a folder seed-N of its own. Seeds that "
        "are done are kept, so the same command goes on after Ctrl-C."
    ),
]
Trackers = Annotated[
    Words,
    Parameter(help="where the metrics go too, comma-separated: tensorboard, wandb (offline); each needs its extra."),
]
Part = Annotated[TaskPart, Parameter(help="tasks to play: train, valid, test or all.")]
Paths = Annotated[list[Path] | None, Parameter(negative=(), consume_multiple=False)]
MovedGraph = Annotated[
    str | None, Parameter(help="where the graph is now, if it has moved since the training.", show_default=False)
]
