"""Evidence from outside the train recipes for a recipe or a link.

It consists of cells of tables, and recipes of other books. Scores do not need this evidence,
so a source that is missing or has changed gives a warning and no evidence. Outside knowledge is the
same in all folds, and so is its evidence. The page docs/outside-knowledge.md shows it to users.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, islice, zip_longest
from pathlib import Path

import numpy as np

from wordcraft_kg.base import ArtefactError, Record, WordCraftKGError
from wordcraft_kg.base.statistics import standardised
from wordcraft_kg.graphs import COMBINES_WITH, RELATIONS, Entity, OpenedGraph, Recipe
from wordcraft_kg.models.knowledge.books import open_other_book
from wordcraft_kg.models.knowledge.knowledge_folder import (
    TABLES,
    TableInfo,
    knowledge_files,
    read_knowledge,
)
from wordcraft_kg.models.knowledge.outside import is_book
from wordcraft_kg.models.recipes.recipe_config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.recipe_records import RecipeMetrics
from wordcraft_kg.models.scorers.scorer_folder import MODEL, WEIGHTS
from wordcraft_kg.runs.config_file import CONFIG_FILE
from wordcraft_kg.runs.record import RunFiles, read_finished_run

LIMIT = 3
"""Most pieces of evidence for a recipe or a link."""
STANDS_OUT = 2.0
"""Smallest standardised value of a table cell that is evidence: about 1 cell in 50 of a language
model's tables.

With 1, most random triples of entities would have evidence."""
_Slots = tuple[int | None, int | None, int | None]
"""Ids of two ingredients and a result; None in a link for the missing part of a recipe."""


class OutsideEvidence(Record):
    """A piece of outside knowledge for a recipe or link.

    Attributes:
        source: the source's name.
        text: such as ``bread needs dough``.
        value: value of the table cell; None for recipes.
    """

    source: str
    text: str
    value: float | None

    def __str__(self) -> str:
        """Return a line such as ``language model: bread needs dough (+3.1)``."""
        value = "" if self.value is None else f" ({self.value:+.1f})"
        return f"{self.source}: {self.text}{value}"


_Source = Callable[[_Slots], Sequence[OutsideEvidence]]
"""Returns a source's evidence, strongest first."""


@dataclass(frozen=True, eq=False)
class OutsideEvidenceFinder:
    """Finds evidence for recipes and links in a recipe scorer's outside knowledge.

    The sources are opened at first use.

    Attributes:
        settings: name the sources.
        hashes: of the sources at the time of the training.
        opened: the graph of the scorer.

    Example:
        >>> finder = OutsideEvidenceFinder.open("models/kitchen-recipes", open_graph("kitchen"))
        >>> finder is None  # trained without outside knowledge
        True
    """

    settings: RecipeScorerConfig
    hashes: frozenset[str]
    opened: OpenedGraph

    @classmethod
    def open(
        cls,
        folder: str | Path,
        opened: OpenedGraph,
        weights: str | None = None,
    ) -> "OutsideEvidenceFinder | None":
        """Open a model's outside knowledge.

        Args:
            folder: the model's folder.
            opened: the graph of the model.
            weights: expected hash of the scorer's weights; None for any.

        Returns:
            None for a scorer of another kind, or without outside knowledge.

        Raises:
            ArtefactError: if the folder is damaged, or has other weights.
        """
        folder = Path(folder)
        files = RunFiles(folder, read_finished_run(folder, MODEL, WEIGHTS))
        if weights not in (None, files.run.outputs[WEIGHTS]):
            raise ArtefactError(
                f"the scorer in '{folder}' has changed since the agent was trained."
            )
        if files.run.kind != RecipeScorerConfig.command:
            return None
        # Reading the file compares its hash with the record.
        files.bytes(CONFIG_FILE)
        settings = RecipesConfig.read(folder).settings
        # A model of sets has none.
        if not settings.with_:
            return None
        outside = files.record("metrics.json", RecipeMetrics).outside
        return cls(settings, frozenset(source.sha256 for source in outside), opened)

    def of_recipe(self, a: Entity, b: Entity, result: Entity) -> tuple[OutsideEvidence, ...]:
        """Return at most :data:`LIMIT` pieces of evidence for a recipe.

        The sources take turns in the order of the settings, each with its strongest evidence first:
        table cells by standardised value; recipes of another book by the number of shared entities.

        Args:
            a: label or id of an ingredient.
            b: of the other ingredient.
            result: of the result.

        Raises:
            UnknownEntityError: for a label or id that the graph lacks.
        """
        id_of = self.opened.graph.id_of
        return self._find((id_of(a), id_of(b), id_of(result)))

    def of_link(self, head: Entity, relation: str, tail: Entity) -> tuple[OutsideEvidence, ...]:
        """Return evidence for a link, as :meth:`of_recipe`, from tables with the relation's role.

        Args:
            head: label or id of the head.
            relation: ``combinesWith`` or ``componentOf``.
            tail: label or id of the tail.

        Raises:
            UnknownEntityError: for a label or id that the graph lacks.
        """
        id_of = self.opened.graph.id_of
        if relation == RELATIONS[COMBINES_WITH]:
            return self._find((id_of(head), id_of(tail), None))
        return self._find((id_of(head), None, id_of(tail)))

    def _find(self, slots: _Slots) -> tuple[OutsideEvidence, ...]:
        by_source = [source(slots) for source in self._sources]
        # In turns: the strongest evidence of each source, then the second of each.
        pieces = chain.from_iterable(zip_longest(*by_source))
        # None where a source has no more; each piece once, at its first place.
        distinct = dict.fromkeys(piece for piece in pieces if piece is not None)
        return tuple(islice(distinct, LIMIT))

    @cached_property
    def _sources(self) -> list[_Source]:
        """The sources that are as they were in the training; a warning for each missing one."""
        sources: list[_Source] = []
        for spec in self.settings.with_:
            try:
                open_source = self._book_source if is_book(spec) else self._folder_source
                sources.append(open_source(spec))
            except WordCraftKGError as error:
                logging.getLogger(__name__).warning("no evidence from '%s': %s", spec, error)
        return sources

    def _check(self, sha256: str) -> None:
        """Raise ArtefactError for a hash that no source had in the training."""
        if sha256 not in self.hashes:
            raise ArtefactError("the source has changed since the model was trained.")

    def _folder_source(self, spec: str) -> _Source:
        """Return a source of the cells that stand out in tables with phrases."""
        self._check(knowledge_files(spec).run.outputs[TABLES])
        knowledge = read_knowledge(spec).of_entities(self.opened.graph.entities)
        source = knowledge.record.source
        entities = knowledge.record.entities
        described = [
            (info, table, standardised(table.numpy()))
            for info, table in zip(knowledge.record.tables, knowledge.tables, strict=True)
            if info.phrase
        ]

        def find(slots: _Slots) -> list[OutsideEvidence]:
            evidence: list[tuple[float, OutsideEvidence]] = []
            for info, table, strengths in described:
                for row, column in _cells(info, slots):
                    value = float(table[row, column])
                    strength = float(strengths[row, column])
                    if value > 0 and strength >= STANDS_OUT:
                        text = info.words(entities[row], entities[column])
                        evidence.append((strength, OutsideEvidence(source, text, value)))
            evidence.sort(key=lambda pair: -pair[0])
            return [piece for _, piece in evidence]

        return find

    def _book_source(self, spec: str) -> _Source:
        # As in the training: a zero-shot scorer may use recipes of the train part.
        book = open_other_book(
            spec,
            self.opened,
            keep_train=self.settings.kg == "none",
        )
        self._check(book.source.sha256)
        pairs = book.recipes[:, :2]
        results = book.recipes[:, 2]
        labels = np.array(book.labels, dtype=object)

        def find(slots: _Slots) -> list[OutsideEvidence]:
            a, b, result = slots
            uses_any = (pairs == a).any(1) | (pairs == b).any(1)
            uses_both = np.zeros(len(pairs), dtype=bool)
            if a is not None and b is not None:
                # Ingredients of a book's recipes are sorted.
                uses_both = (pairs == sorted((a, b))).all(1)
            # An ingredient with the result says more than both ingredients with another result.
            strength = 2 * (uses_any & (results == result)) + uses_both
            order = np.argsort(-strength, kind="stable")[: np.count_nonzero(strength)]
            recipes = [Recipe.of(*row) for row in labels[book.recipes[order[:LIMIT]]]]
            return [OutsideEvidence(book.source.name, str(recipe), None) for recipe in recipes]

        return find


def _cells(info: TableInfo, slots: _Slots) -> Iterator[tuple[int, int]]:
    """Yield the rows and columns of a table's cells for a recipe or a link."""
    a, b, result = slots
    cells = [(a, b)] if info.role == "pair" else [(a, result), (b, result)]
    # a + a has one cell for its ingredient; a link has no cell for the missing part.
    for row, column in dict.fromkeys(cells):
        if row is not None and column is not None:
            yield row, column
