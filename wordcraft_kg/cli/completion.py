"""What the shell offers for books, graphs, models and runs when Tab is pressed."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.base.artefacts import read_json
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.graphs.library import ENDINGS, FETCHABLE, known_books

if TYPE_CHECKING:
    from cyclopts.completion import CompletionContext

AGENT = "train-agent"


def _complete_book(context: "CompletionContext") -> Iterator[str]:
    """Offer the known books, book files, and graph folders, which are books too."""
    yield from (book.name for book in known_books() if book.path is not None)
    yield from (str(path) for path in _found(context, "*") if path.suffix in ENDINGS)
    yield from (str(path.parent) for path in _below(context, "graph.json"))


def _complete_fetchable(context: "CompletionContext") -> Iterator[str]:
    yield from FETCHABLE


def _complete_model(context: "CompletionContext") -> Iterator[str]:
    yield from (str(folder) for folder, kind in _runs(context) if kind != AGENT)


def _complete_agent(context: "CompletionContext") -> Iterator[str]:
    yield from (str(folder) for folder, kind in _runs(context) if kind == AGENT)


def _complete_run(context: "CompletionContext") -> Iterator[str]:
    yield from (str(folder) for folder, _ in _runs(context))


Book = Annotated[str, Parameter(completer=_complete_book)]
"""A recipe book or a graph: a file, a folder or a known name."""
FetchableBook = Annotated[str, Parameter(completer=_complete_fetchable)]
Model = Annotated[Path, Parameter(completer=_complete_model)]
"""Folder of a link predictor."""
Models = Annotated[list[Path] | None, Parameter(completer=_complete_model, negative=(), consume_multiple=False)]
Scorer = Annotated[Path | None, Parameter(completer=_complete_model)]
Agent = Annotated[Path, Parameter(completer=_complete_agent)]
"""Run folder of an agent."""
Agents = Annotated[list[Path] | None, Parameter(completer=_complete_agent, negative=(), consume_multiple=False)]
Run = Annotated[Path, Parameter(completer=_complete_run)]
"""Folder of any training."""


def _runs(context: "CompletionContext") -> Iterator[tuple[Path, str]]:
    """Yield the folders of trainings and the commands that wrote them."""
    for path in _below(context, "run.json"):
        try:
            yield path.parent, read_json(path)["kind"]
        except (ArtefactError, LookupError, TypeError):
            continue


def _below(context: "CompletionContext", name: str) -> Iterator[Path]:
    """Yield the files of a name in the folder that has been typed, and down to two folders below it."""
    for pattern in (name, f"*/{name}", f"*/*/{name}"):
        yield from _found(context, pattern)


def _found(context: "CompletionContext", pattern: str) -> Iterator[Path]:
    folder = Path(os.path.dirname(context.incomplete))
    yield from (path for path in sorted(folder.glob(pattern)) if not any(part.startswith(".") for part in path.parts))
