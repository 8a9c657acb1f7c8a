"""Questions about entities that a model's graph does not have, which it may answer from their words."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from wordcraft_kg.base.errors import QueryFileError, UnknownEntityError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.evaluation.scores import ScoringModel
from wordcraft_kg.models.recipes.inductive import with_words
from wordcraft_kg.models.scorers.queries import OPEN, Query, RecipeQuery


class AnyLabel(Collection[str]):
    """The entities that a query may name if a model can tell something of any: all labels, but not an open slot."""

    def __init__(self, entities: Sequence[str]):
        """Take the entities of the graph, one of which may be called like an open slot."""
        self._entities = frozenset(entities)

    def __contains__(self, label: object) -> bool:
        """Return whether it is a label."""
        return label in self._entities or label not in ("", *OPEN)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the labels that are known."""
        return iter(self._entities)

    def __len__(self) -> int:
        """Return how many labels are known."""
        return len(self._entities)


def with_new_words(
    model: ScoringModel, folder: Path, queries: Sequence[Query | RecipeQuery], file: Path | None = None
) -> ScoringModel:
    """Return a model with the entities of queries that its graph does not have, described by their words alone.

    Args:
        model: the model.
        folder: its folder.
        queries: what will be asked.
        file: the file that they were read from.

    Raises:
        UnknownEntityError: if the model cannot tell anything of one of them, saying why.
        QueryFileError: the same for the queries of a file, with the line of the first one.
    """
    lines: dict[str, int | None] = {}
    known = frozenset(model.scorer.entities)
    for query in queries:
        for label in query.labels:
            if label not in known:
                lines.setdefault(label, query.line)
    if not lines:
        return model
    try:
        scorer = with_words(folder, model.scorer, tuple(lines), where=lambda label: _where(file, lines[label]))
    except UnknownEntityError as error:
        if file is None:
            raise
        raise QueryFileError(str(error)) from None
    return replace(model, scorer=scorer, by_words=tuple(lines))


def _where(file: Path | None, line: int | None) -> str:
    return "" if file is None else f"{file}, line {line}: "


LISTED = 5
"""Entities that a note names."""


def note_of_words(model: ScoringModel) -> list[str]:
    """Return what must be said about scores of entities that are not in the graph."""
    words = model.by_words
    if not words:
        return []
    if len(words) == 1:  # a misspelt word may have a vector, too
        known = model.scorer.entities[: -len(words)]
        return [f"'{words[0]}' is not in the graph: scored by its words alone.{nearest(words[0], known)}"]
    listed = ", ".join(f"'{label}'" for label in words[:LISTED])
    more = f" and {len(words) - LISTED:,} more" if len(words) > LISTED else ""
    return [f"{listed}{more} are not in the graph: scored by their words alone."]
