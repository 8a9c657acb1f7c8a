"""Evidence from outside the train recipes for a recipe or a link: cells of tables, facts, and recipes of other books.

Scores do not need this evidence, so a source that is missing or has changed gives a warning and no evidence. Outside
knowledge is the same in all folds, and so is its evidence.
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
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.recipe_graph import Entity
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
from wordcraft_kg.runs.files import RunFiles
from wordcraft_kg.runs.record import read_finished_run

LIMIT = 3
"""Most pieces of evidence for a recipe or a link."""
STANDS_OUT = 2.0
"""Smallest standardised value of a table cell that is evidence: about 1 cell in 50 of a language model's tables.

With 1, most random triples of entities would have evidence."""
_Slots = tuple[int | None, int | None, int | None]
"""Ids of two ingredients and a result; None in a link for the missing part of a recipe."""


class OutsideEvidence(Record):
    """Outside knowledge for a recipe or link: the source's name, a text such as ``bread needs dough``, a value."""

    source: str
    text: str
    value: float | None

    def __str__(self) -> str:
        """Return a line such as ``language model: bread needs dough (+3.1)``."""
        return f"{self.source}: {self.text}" + (
            "" if self.value is None else f" ({self.value:+.1f})"
        )


_Source = Callable[[_Slots], Sequence[OutsideEvidence]]


class OutsideEvidenceFinder:
    """Finds evidence for recipes and links in a recipe scorer's outside knowledge; opens the sources at first use.

    Example:
        >>> finder = OutsideEvidenceFinder.open("models/kitchen-recipes", open_graph("kitchen"))
        >>> finder is None  # trained without outside knowledge
        True
    """

    def __init__(self, settings: RecipeScorerConfig, hashes: frozenset[str], opened: OpenedGraph):
        self._settings, self._hashes, self._opened = settings, hashes, opened

    @classmethod
    def open(
        cls, folder: str | Path, opened: OpenedGraph, weights: str | None = None
    ) -> "OutsideEvidenceFinder | None":
        """Open a model's outside knowledge, if any; ArtefactError if damaged, or not of these ``weights``."""
        folder = Path(folder)
        files = RunFiles(folder, read_finished_run(folder, MODEL, WEIGHTS))
        if weights not in (None, files.run.outputs[WEIGHTS]):
            raise ArtefactError(
                f"the scorer in '{folder}' has changed since the agent was trained."
            )
        if files.run.kind != RecipeScorerConfig.command:
            return None
        files.bytes(CONFIG_FILE)
        settings = RecipesConfig.read(folder).settings
        hashes = frozenset(
            source.sha256 for source in files.record("metrics.json", RecipeMetrics).outside
        )
        return cls(settings, hashes, opened) if settings.with_ else None

    def of_recipe(self, a: Entity, b: Entity, result: Entity) -> tuple[OutsideEvidence, ...]:
        """Return at most :data:`LIMIT` pieces of evidence for a recipe, by labels or ids.

        The sources take turns in the order of the settings, each with its strongest evidence first: facts, then table
        cells by standardised value; recipes of another book by the number of shared entities.
        """
        id_of = self._opened.graph.id_of
        return self._find((id_of(a), id_of(b), id_of(result)))

    def of_link(self, head: Entity, relation: str, tail: Entity) -> tuple[OutsideEvidence, ...]:
        """Return evidence for a link, as :meth:`of_recipe`: from tables with the role of the relation."""
        one, other = map(self._opened.graph.id_of, (head, tail))
        return self._find(
            (one, other, None) if relation == RELATIONS[COMBINES_WITH] else (one, None, other)
        )

    def _find(self, slots: _Slots) -> tuple[OutsideEvidence, ...]:
        rounds = chain.from_iterable(zip_longest(*(source(slots) for source in self._sources)))
        return tuple(islice(dict.fromkeys(piece for piece in rounds if piece is not None), LIMIT))

    @cached_property
    def _sources(self) -> list[_Source]:
        sources = list[_Source]()
        for spec in self._settings.with_:
            try:
                if (Path(spec) / KNOWLEDGE).is_file():
                    sources.append(self._of_folder(spec))
                elif is_book(spec):
                    sources.append(self._of_book(spec))
            except WordCraftKGError as error:
                logging.getLogger(__name__).warning("no evidence from '%s': %s", spec, error)
        return sources

    def _check(self, sha256: str) -> None:
        if sha256 not in self._hashes:
            raise ArtefactError("the source has changed since the model was trained.")

    def _of_folder(self, spec: str) -> _Source:
        files, entities = knowledge_files(spec), self._opened.graph.entities
        self._check(files.run.outputs[TABLES])
        tables = _Tables(read_knowledge(spec).of_entities(entities))
        facts = _Facts(files) if FACTS in files.run.outputs else None

        def find(slots: _Slots) -> list[OutsideEvidence]:
            labels = list(dict.fromkeys(entities[entity] for entity in slots if entity is not None))
            texts = facts.about(labels) if facts else ()
            return [
                *(OutsideEvidence(tables.source, text, None) for text in texts),
                *tables.find(slots),
            ]

        return find

    def _of_book(self, spec: str) -> _Source:
        keep_train = self._settings.kg == "none"
        book = open_other_book(spec, self._opened, keep_train=keep_train)
        self._check(book.source.sha256)

        def find(slots: _Slots) -> list[OutsideEvidence]:
            a, b, result = slots
            pairs, made = book.recipes[:, :2], book.recipes[:, 2]
            uses_one, uses_both = (
                (pairs == a).any(1) | (pairs == b).any(1),
                np.zeros(len(pairs), dtype=bool),
            )
            if a is not None and b is not None:
                uses_both = (pairs == sorted((a, b))).all(1)
            strength = 2 * (uses_one & (made == result)) + uses_both
            best = np.argsort(-strength, kind="stable")[: min(LIMIT, int((strength > 0).sum()))]
            recipes = (
                Recipe(*(book.labels[entity] for entity in recipe))
                for recipe in book.recipes[best].tolist()
            )
            return [OutsideEvidence(book.source.name, str(recipe), None) for recipe in recipes]

        return find


class _Tables:
    """A knowledge folder's tables with phrases; cells are compared with all cells off the table's diagonal."""

    def __init__(self, knowledge: KnowledgeTables):
        self.source, self._entities = knowledge.record.source, knowledge.record.entities
        self._tables = list[tuple[TableInfo, Tensor, float, float]]()
        for info, table in zip(knowledge.record.tables, knowledge.tables, strict=True):
            cells = table[~torch.eye(len(table), dtype=torch.bool)].double()
            if info.phrase:
                self._tables.append(
                    (info, table, float(cells.mean()), float(cells.std(correction=0)))
                )

    def find(self, slots: _Slots) -> list[OutsideEvidence]:
        """Return the cells that stand out, by descending standardised value."""
        a, b, result = slots
        evidence = list[tuple[float, OutsideEvidence]]()
        for info, table, mean, deviation in self._tables:
            is_pair = info.role == "pair"
            names = ("{a}", "{b}") if is_pair else ("{ingredient}", "{result}")
            for one, other in [(a, b)] if is_pair else dict.fromkeys([(a, result), (b, result)]):
                if one is None or other is None:
                    continue
                value = float(table[one, other])
                strength = (value - mean) / max(deviation, 1e-9)
                if value > 0 and strength >= STANDS_OUT:
                    labels = self._entities[one], self._entities[other]
                    text = info.phrase.replace(names[0], labels[0]).replace(names[1], labels[1])
                    evidence.append((strength, OutsideEvidence(self.source, text, value)))
        return [piece for _, piece in sorted(evidence, key=lambda one: -one[0])]


class _Facts:
    """A knowledge folder's facts: entity label, relation phrase, and a label or class."""

    def __init__(self, files: RunFiles):
        self._of_label = defaultdict[str, list[tuple[str, str]]](list)
        lines = files.bytes(FACTS).decode(errors="replace").removesuffix("\n").split("\n")[1:]
        for number, line in enumerate(lines, 2):
            if line.count("\t") != 2:
                raise ArtefactError(
                    f"{files.folder / FACTS}, line {number}: expected 3 columns. Make the folder again."
                )
            head, phrase, tail = line.split("\t")
            self._of_label[head].append((phrase, tail))
        self._frequency = Counter(fact for facts in self._of_label.values() for fact in facts)

    def about(self, labels: Sequence[str]) -> list[str]:
        """Return facts that link two labels, then facts that two labels share, rarest first."""
        links, shared = list[str](), dict[tuple[str, str], str]()
        for position, head in enumerate(labels):
            for phrase, tail in self._of_label.get(head, ()):
                if tail in labels and tail != head:
                    links.append(f"{head} {phrase} {tail}")
                for other in labels[position + 1 :]:
                    if (phrase, tail) in self._of_label.get(other, ()):
                        shared.setdefault((phrase, tail), f"{head} {phrase} {tail}, like {other}")
        return links + [
            shared[fact] for fact in sorted(shared, key=lambda fact: self._frequency[fact])
        ]
