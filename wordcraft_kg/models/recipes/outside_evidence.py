"""Evidence from outside the train recipes for a recipe or a link.

It consists of cells of tables, facts, and recipes of other books. Scores do not need this evidence,
so a source that is missing or has changed gives a warning and no evidence. Outside knowledge is the
same in all folds, and so is its evidence.
"""

import logging
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import chain, islice, zip_longest
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.base.errors import ArtefactError, WordCraftKGError
from wordcraft_kg.base.records import Record
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS
from wordcraft_kg.models.knowledge.folder import (
    FACTS,
    KNOWLEDGE,
    TABLES,
    KnowledgeTables,
    TableInfo,
    knowledge_files,
    read_knowledge,
)
from wordcraft_kg.models.recipes.config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.outside import is_book, open_other_book
from wordcraft_kg.models.recipes.records import RecipeMetrics
from wordcraft_kg.models.scorers.folder import MODEL, WEIGHTS
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
_NO_DEVIATION = 1e-9
"""Smallest deviation of a table's cells by which they are divided: a table may be constant."""


class OutsideEvidence(Record):
    """A piece of outside knowledge for a recipe or link.

    Attributes:
        source: the source's name.
        text: such as ``bread needs dough``.
        value: value of the table cell; None for facts and recipes.
    """

    source: str
    text: str
    value: float | None

    def __str__(self) -> str:
        """Return a line such as ``language model: bread needs dough (+3.1)``."""
        line = f"{self.source}: {self.text}"
        if self.value is None:
            return line
        return f"{line} ({self.value:+.1f})"


_Source = Callable[[_Slots], Sequence[OutsideEvidence]]
"""Returns a source's evidence, strongest first."""


class OutsideEvidenceFinder:
    """Finds evidence for recipes and links in a recipe scorer's outside knowledge.

    The sources are opened at first use.

    Example:
        >>> finder = OutsideEvidenceFinder.open("models/kitchen-recipes", open_graph("kitchen"))
        >>> finder is None  # trained without outside knowledge
        True
    """

    def __init__(self, settings: RecipeScorerConfig, hashes: frozenset[str], opened: OpenedGraph):
        """Prepare to find evidence.

        Args:
            settings: name the sources.
            hashes: of the sources at the time of the training.
            opened: the graph of the scorer.
        """
        self._settings = settings
        self._hashes = hashes
        self._opened = opened

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
        metrics = files.record("metrics.json", RecipeMetrics)
        hashes = frozenset(source.sha256 for source in metrics.outside)
        return cls(settings, hashes, opened) if settings.with_ else None

    def of_recipe(self, a: Entity, b: Entity, result: Entity) -> tuple[OutsideEvidence, ...]:
        """Return at most :data:`LIMIT` pieces of evidence for a recipe.

        The sources take turns in the order of the settings, each with its strongest evidence first:
        facts, then table cells by standardised value; recipes of another book by the number of
        shared entities.

        Args:
            a: label or id of an ingredient.
            b: of the other ingredient.
            result: of the result.

        Raises:
            UnknownEntityError: for a label or id that the graph lacks.
        """
        id_of = self._opened.graph.id_of
        slots = (id_of(a), id_of(b), id_of(result))
        return self._find(slots)

    def of_link(self, head: Entity, relation: str, tail: Entity) -> tuple[OutsideEvidence, ...]:
        """Return evidence for a link, as :meth:`of_recipe`, from tables with the relation's role.

        Args:
            head: label or id of the head.
            relation: ``combinesWith`` or ``componentOf``.
            tail: label or id of the tail.

        Raises:
            UnknownEntityError: for a label or id that the graph lacks.
        """
        id_of = self._opened.graph.id_of
        one = id_of(head)
        other = id_of(tail)
        if relation == RELATIONS[COMBINES_WITH]:
            return self._find((one, other, None))
        return self._find((one, None, other))

    def _find(self, slots: _Slots) -> tuple[OutsideEvidence, ...]:
        by_source = [source(slots) for source in self._sources]
        # In turns: the strongest evidence of each source, then the second of each.
        pieces = chain.from_iterable(zip_longest(*by_source))
        # None where a source has no more; each piece once, at its first place.
        distinct = dict.fromkeys(piece for piece in pieces if piece is not None)
        return tuple(islice(distinct, LIMIT))

    @cached_property
    def _sources(self) -> list[_Source]:
        """The sources that are as they were in the training; a warning for each other one."""
        sources: list[_Source] = []
        for spec in self._settings.with_:
            try:
                if (Path(spec) / KNOWLEDGE).is_file():
                    sources.append(self._of_folder(spec))
                elif is_book(spec):
                    sources.append(self._of_book(spec))
            except WordCraftKGError as error:
                logging.getLogger(__name__).warning("no evidence from '%s': %s", spec, error)
        return sources

    @cached_property
    def _left_out_books(self) -> list[RecipeGraph]:
        """The books of the setting `without`, read once for all sources."""
        return [open_graph(book).graph for book in self._settings.without]

    def _check(self, sha256: str) -> None:
        """Raise ArtefactError for a hash that no source had in the training."""
        if sha256 not in self._hashes:
            raise ArtefactError("the source has changed since the model was trained.")

    def _of_folder(self, spec: str) -> _Source:
        files = knowledge_files(spec)
        entities = self._opened.graph.entities
        self._check(files.run.outputs[TABLES])
        tables = _Tables(read_knowledge(spec).of_entities(entities))
        facts = _Facts(files) if FACTS in files.run.outputs else None

        def find(slots: _Slots) -> list[OutsideEvidence]:
            evidence = []
            if facts:
                labels = [entities[entity] for entity in slots if entity is not None]
                # a + a has each fact once.
                distinct = list(dict.fromkeys(labels))
                for text in facts.about(distinct):
                    evidence.append(OutsideEvidence(tables.source, text, None))
            return evidence + tables.find(slots)

        return find

    def _of_book(self, spec: str) -> _Source:
        # As in the training: a zero-shot scorer may use recipes of the train part.
        keep_train = self._settings.kg == "none"
        book = open_other_book(
            spec, self._opened, keep_train=keep_train, without=self._left_out_books
        )
        self._check(book.source.sha256)

        def find(slots: _Slots) -> list[OutsideEvidence]:
            a, b, result = slots
            pairs = book.recipes[:, :2]
            made = book.recipes[:, 2]
            uses_a = (pairs == a).any(1)
            uses_b = (pairs == b).any(1)
            uses_both = np.zeros(len(pairs), dtype=bool)
            if a is not None and b is not None:
                # Ingredients of a book's recipes are sorted.
                uses_both = (pairs == sorted((a, b))).all(1)
            # An ingredient with the result says more than both ingredients with another result.
            makes_result = (uses_a | uses_b) & (made == result)
            strength = 2 * makes_result + uses_both
            number = np.count_nonzero(strength)
            order = np.argsort(-strength, kind="stable")
            best = order[: min(LIMIT, number)]
            evidence = []
            for row in book.recipes[best].tolist():
                labels = [book.labels[entity] for entity in row]
                recipe = Recipe(*labels)
                evidence.append(OutsideEvidence(book.source.name, str(recipe), None))
            return evidence

        return find


class _Tables:
    """A knowledge folder's tables with phrases.

    Cells are compared with all cells off the table's diagonal.
    """

    def __init__(self, knowledge: KnowledgeTables):
        self.source = knowledge.record.source
        self._entities = knowledge.record.entities
        # A table with the mean and the deviation of its cells.
        self._tables: list[tuple[TableInfo, Tensor, float, float]] = []
        for info, table in zip(knowledge.record.tables, knowledge.tables, strict=True):
            if not info.phrase:
                continue
            # An entity's cell with itself would shift the mean.
            is_diagonal = torch.eye(len(table), dtype=torch.bool)
            cells = table[~is_diagonal].double()
            mean = float(cells.mean())
            deviation = float(cells.std(correction=0))
            self._tables.append((info, table, mean, deviation))

    def find(self, slots: _Slots) -> list[OutsideEvidence]:
        """Return the cells that stand out, by descending standardised value."""
        evidence: list[tuple[float, OutsideEvidence]] = []
        for info, table, mean, deviation in self._tables:
            for one, other in _cells(info, slots):
                value = float(table[one, other])
                strength = (value - mean) / max(deviation, _NO_DEVIATION)
                if value > 0 and strength >= STANDS_OUT:
                    text = _phrase(info, self._entities[one], self._entities[other])
                    evidence.append((strength, OutsideEvidence(self.source, text, value)))
        evidence.sort(key=lambda one: -one[0])
        return [piece for _, piece in evidence]


def _cells(info: TableInfo, slots: _Slots) -> list[tuple[int, int]]:
    """Return the rows and columns of a table's cells for a recipe or a link."""
    a, b, result = slots
    if info.role == "pair":
        places = [(a, b)]
    else:
        places = [(a, result), (b, result)]
    cells = []
    # a + a has one cell for its ingredient; a link has no cell for the missing part.
    for one, other in dict.fromkeys(places):
        if one is not None and other is not None:
            cells.append((one, other))
    return cells


def _phrase(info: TableInfo, one: str, other: str) -> str:
    """Return a table's phrase with two labels in it."""
    names = ("{ingredient}", "{result}")
    if info.role == "pair":
        names = ("{a}", "{b}")
    text = info.phrase.replace(names[0], one)
    return text.replace(names[1], other)


class _Facts:
    """A knowledge folder's facts: entity label, relation phrase, and a label or class."""

    def __init__(self, files: RunFiles):
        self._of_label = defaultdict[str, list[tuple[str, str]]](list)
        text = files.bytes(FACTS).decode(errors="replace")
        # Line 1 has the names of the columns. Split at newlines alone: labels may have others.
        _, *lines = text.removesuffix("\n").split("\n")
        for number, line in enumerate(lines, 2):
            if line.count("\t") != 2:
                raise ArtefactError(
                    f"{files.folder / FACTS}, line {number}: expected 3 columns. Make the folder "
                    "again."
                )
            head, phrase, tail = line.split("\t")
            self._of_label[head].append((phrase, tail))
        self._frequency = Counter(chain.from_iterable(self._of_label.values()))

    def about(self, labels: Sequence[str]) -> list[str]:
        """Return facts that link two labels, then facts that two labels share, rarest first."""
        links: list[str] = []
        shared: dict[tuple[str, str], str] = {}
        for position, head in enumerate(labels):
            later = labels[position + 1 :]
            for fact in self._of_label.get(head, ()):
                phrase, tail = fact
                text = f"{head} {phrase} {tail}"
                if tail in labels and tail != head:
                    links.append(text)
                for other in later:
                    if fact in self._of_label.get(other, ()):
                        shared.setdefault(fact, f"{text}, like {other}")
        # A fact that few labels share says more about these two.
        rarest_first = sorted(shared, key=lambda fact: self._frequency[fact])
        return links + [shared[fact] for fact in rarest_first]
