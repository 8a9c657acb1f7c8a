"""Options that several commands take, with their help and with completions for the shell."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.base.artefacts import read_json
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.cli.console import Flag
from wordcraft_kg.graphs.library import ENDINGS, FETCHABLE, known_books
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from cyclopts.completion import CompletionContext

AGENT = "train-agent"
"""Kind of an agent's run."""


def _complete_book(context: "CompletionContext") -> Iterator[str]:
    """Offer the known books, book files, and graph folders, which are books too."""
    yield from (book.name for book in known_books() if book.path is not None)
    yield from (str(path) for path in _found(context, "*") if path.suffix in ENDINGS)
    yield from (str(path.parent) for path in _below(context, "graph.json"))


def _complete_run(*, agents: bool, models: bool) -> "Callable[[CompletionContext], Iterator[str]]":
    def complete(context: "CompletionContext") -> Iterator[str]:
        for path in _below(context, "run.json"):
            try:
                is_agent = read_json(path)["kind"] == AGENT
            except (ArtefactError, LookupError, TypeError):
                continue
            if agents if is_agent else models:
                yield str(path.parent)

    return complete


def _complete_played(context: "CompletionContext") -> Iterator[str]:
    yield from _complete_book(context)
    yield from _complete_run(agents=True, models=False)(context)


def _below(context: "CompletionContext", name: str) -> Iterator[Path]:
    """Yield the files of a name in the folder that has been typed, and down to two folders below it."""
    for pattern in (name, f"*/{name}", f"*/*/{name}"):
        yield from _found(context, pattern)


def _found(context: "CompletionContext", pattern: str) -> Iterator[Path]:
    folder = Path(os.path.dirname(context.incomplete))
    yield from (path for path in sorted(folder.glob(pattern)) if not any(part.startswith(".") for part in path.parts))


_MODEL = Parameter(completer=_complete_run(agents=False, models=True), negative=(), consume_multiple=False)
_AGENT = Parameter(completer=_complete_run(agents=True, models=False), negative=(), consume_multiple=False)

Book = Annotated[str, Parameter(completer=_complete_book)]
"""A recipe book or a graph: a file, a folder or a known name."""
Graph = Annotated[Book, Parameter(help="graph folder, recipe book or known book's name.")]
OptionalBook = Annotated[str | None, Parameter(completer=_complete_book)]
AgentOrBook = Annotated[str, Parameter(completer=_complete_played)]
FetchableBook = Annotated[str | None, Parameter(completer=lambda _: iter(FETCHABLE))]
Model = Annotated[Path, _MODEL]
"""Folder of a link predictor."""
Models = Annotated[list[Path] | None, _MODEL]
Scorer = Annotated[Path | None, _MODEL]
Agent = Annotated[Path, _AGENT]
"""Run folder of an agent."""
Agents = Annotated[list[Path] | None, _AGENT]
Run = Annotated[Path, Parameter(completer=_complete_run(agents=True, models=True))]
"""Folder of any training."""

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
    Parameter(
        help="where the metrics go too, comma-separated: tensorboard, wandb (offline), mlflow (a local file); each "
        "needs the extra of its name."
    ),
]
Part = Annotated[TaskPart, Parameter(help="tasks to play: train, valid, test or all.")]
Paths = Annotated[list[Path] | None, Parameter(negative=(), consume_multiple=False)]
MovedGraph = Annotated[
    str | None, Parameter(help="where the graph is now, if it has moved since the training.", show_default=False)
]
