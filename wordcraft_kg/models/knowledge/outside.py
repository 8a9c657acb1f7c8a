"""Sources of knowledge from outside the train recipes, as features of links.

A source is a folder of tables or another book. Outside knowledge is the same in all folds. The page
docs/outside-knowledge.md describes the sources, and docs/explanation/recipe-scorer.md what a link
ranker does with a feature.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs import (
    COMBINES_WITH,
    COMPONENT_OF,
    OUTSIDE,
    Folds,
    OpenedGraph,
    RecipeGraph,
    SplitConfig,
    TrainSample,
    make_folds,
    make_split,
)
from wordcraft_kg.models.knowledge.books import (
    OtherBook,
    OutsideSource,
    Words,
    open_other_book,
    recipes_together,
    with_words_of,
)
from wordcraft_kg.models.knowledge.knowledge_folder import (
    KNOWLEDGE,
    TABLES,
    knowledge_files,
    read_knowledge,
)
from wordcraft_kg.models.scorers.features import EntityFeatures
from wordcraft_kg.models.scorers.neighbours.links import CELLS, link_features
from wordcraft_kg.models.scorers.neighbours.pair_encoder import PairEncoder
from wordcraft_kg.models.scorers.score_limits import check_table

_OF_A_BOOK = ("graph", "split", "overrides")
"""Inputs of a knowledge folder that differ between books; other inputs, such as weights, are of the
source."""
_Merged = dict[tuple[str, ...], Tensor]
"""Tables by role, name, source, and the hashes of the source's own inputs."""


class LinkTables(NamedTuple):
    """Features from outside the recipes, the same in all folds: tables of shape (E, E).

    Attributes:
        pairs: features of combinesWith links, symmetric.
        parts: features of componentOf links, row = ingredient.
        encoder: pair encoder of other books, for features of whole recipes; None without.
    """

    pairs: Sequence[Tensor] = ()
    parts: Sequence[Tensor] = ()
    encoder: PairEncoder | None = None


NOTHING = LinkTables()
"""No features from outside the recipes."""


@dataclass(frozen=True, eq=False)
class OutsideKnowledge:
    """Link features from all sources of outside knowledge.

    Attributes:
        tables: the features, over the entities of a graph.
        sources: records of the sources, in the order of the settings.
        books: the sources that are books.
    """

    tables: LinkTables
    sources: tuple[OutsideSource, ...]
    books: tuple[OtherBook, ...] = ()


def open_outside(
    specs: Sequence[str],
    opened: OpenedGraph,
    features: str,
    *,
    allow_missing: bool = False,
) -> OutsideKnowledge:
    """Open sources of outside knowledge for a graph's entities.

    Args:
        specs: knowledge folders, and graphs or books.
        opened: the graph; its split says which shared recipes are counted as test recipes.
        features: word vectors by which another book's recipes are compared.
        allow_missing: use zeros for labels without a vector.

    Returns:
        features in the order of the sources, those of knowledge folders last.

    Raises:
        ConfigError: if a source describes none of the entities, is the graph itself, or lacks word
            vectors.
        ArtefactError: if a folder is incomplete or damaged.
    """
    tables: dict[str, list[Tensor]] = {"pair": [], "part": []}
    merged = _Merged()
    sources: list[OutsideSource] = []
    books: list[OtherBook] = []
    for spec in specs:
        if is_book(spec):
            book, vectors = with_words_of(
                open_other_book(spec, opened), opened, features, allow_missing=allow_missing
            )
            pairs, parts = _of_book(book, vectors, opened.graph.num_entities)
            tables["pair"] += pairs
            tables["part"] += parts
            books.append(book)
            sources.append(book.source)
        else:
            sources.append(_of_folder(spec, opened.graph.entities, merged))
    # After all folders are read: tables of several folders may have become one.
    for (role, *_), table in merged.items():
        tables[role].append(table)
    return OutsideKnowledge(
        LinkTables(tables["pair"], tables["part"]), tuple(sources), tuple(books)
    )


def is_book(spec: str) -> bool:
    """Return whether a source is another book, not a knowledge folder."""
    return not (Path(spec) / KNOWLEDGE).is_file()


def _of_folder(spec: str, entities: Sequence[str], merged: _Merged) -> OutsideSource:
    """Add a folder's tables to those of the folders before, and return its record.

    Tables of one name and source complete each other, as those of several books.

    Args:
        spec: a knowledge folder.
        entities: labels of the graph's entities.
        merged: tables of the folders before; changed in place.

    Raises:
        ConfigError: if the folder describes none of the entities.
        ArtefactError: if the folder is incomplete or damaged.
    """
    knowledge = read_knowledge(spec).of_entities(entities)
    name = knowledge.record.source
    coverage = knowledge.coverage()
    if not coverage:
        raise ConfigError(
            f"`with` '{spec}': {name} describes none of the {len(entities):,} entities, such as "
            f"'{entities[0]}'. Make the folder for this graph."
        )
    run = knowledge_files(spec).run
    origin = sorted(sha256 for key, sha256 in run.inputs.items() if key not in _OF_A_BOOK)
    for info, table in zip(knowledge.record.tables, knowledge.tables, strict=True):
        key = (info.role, info.name, name, *origin)
        new = table.float()
        before = merged.get(key, new)
        # 0 is a cell that the earlier folder says nothing about.
        merged[key] = before.where(before != 0, new)
    return OutsideSource(name=name, kind="tables", sha256=run.outputs[TABLES], coverage=coverage)


def describe_source(source: OutsideSource) -> str:
    """Return a line about a source: coverage, and a book's used and left-out recipes."""
    text = f"{source.name} ({source.kind}) describes {source.coverage:.0%} of the entities"
    if source.kind == "book":
        text += (
            f"; {source.recipes:,} recipes used, {source.left_out:,} shared recipes left out "
            f"({source.left_out_test:,} of them test or validation recipes), "
            f"{source.reworded:,} used recipes reword a test or validation recipe"
        )
    return text


# --- another book ---------------------------------------------------------------------------------


def _of_book(
    book: OtherBook, vectors: EntityFeatures, size: int
) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Return another book's features of combinesWith and componentOf links, tables (E, E) each.

    Args:
        book: the book.
        vectors: word vectors of all its labels.
        size: E, the graph's entities, which come first.
    """
    # The book's lists are made with all entities; the tables are of the graph's entities alone.
    lists = Words.of(vectors).lists(book.recipes)
    pairs: list[Tensor] = []
    parts: list[Tensor] = []
    every = torch.arange(size)
    for block in every.split(max(1, CELLS // size)):
        pairs.append(link_features(lists, COMBINES_WITH, block.numpy(), every.numpy()))
        parts.append(link_features(lists, COMPONENT_OF, block.numpy(), every.numpy()))
    # combinesWith is symmetric, and its features are so but for rounding.
    directed = torch.cat(pairs)
    symmetric = (directed + directed.transpose(0, 1)) / 2
    return _by_feature(symmetric), _by_feature(torch.cat(parts))


def _by_feature(features: Tensor) -> tuple[Tensor, ...]:
    """Return features (E, E, F) as a table (E, E) for each feature."""
    return features.permute(2, 0, 1).contiguous().unbind()


# --- other books alone ----------------------------------------------------------------------------


def join_books(
    specs: Sequence[str],
    opened: OpenedGraph,
    features: str,
    *,
    folds: int,
    allow_missing: bool = False,
    keep_train: bool = True,
) -> tuple[OpenedGraph, Tensor, Folds, OutsideKnowledge]:
    """Join other books with a graph's entities, without the graph's own recipes.

    Args:
        specs: sources: other books, and others as for
            :func:`open_outside`.
        opened: the graph; its split says which shared recipes are test recipes.
        features: word vectors by which recipes are compared.
        folds: number of folds of the other books' recipes.
        allow_missing: use zeros for labels without a vector.
        keep_train: keep recipes of other books that are also train recipes of the graph; test
            recipes are always left out.

    Returns:
        the joint graph, whose recipes are all train recipes, or the graph itself without a book;
        ids of the graph's entities in it, shape (E,); folds of its recipes, without recipes if no
        source is a book; and knowledge from sources that are not books, for the joint graph, with
        the books' counts.

    Raises:
        ConfigError: if there is no source, or a source does not fit the graph.
        ArtefactError: if a folder is incomplete or damaged.
    """
    if not specs:
        raise ConfigError(
            "`kg` none learns from outside knowledge only. Name a source in `with`, such as "
            "everyday."
        )
    books = []
    for spec in filter(is_book, specs):
        book_alone = open_other_book(spec, opened, keep_train=keep_train)
        other_book, _ = with_words_of(book_alone, opened, features, allow_missing=allow_missing)
        books.append(other_book)
    no_books = [spec for spec in specs if not is_book(spec)]
    if books:
        labels = sorted(set(chain.from_iterable(book.labels for book in books)))
        name = f"books for {opened.graph.name}"
        graph = RecipeGraph(labels, recipes_together(books, labels), [], name=name)
        joint = OpenedGraph(graph, make_split(graph, SplitConfig("none")), opened.source)
        ids = graph.ids_of(opened.graph.entities)
        joint_folds = make_folds(joint.split, folds)
    else:
        # Tables alone: there is nothing to join, and no recipe to learn from.
        joint = opened
        ids = np.arange(opened.graph.num_entities)
        number = opened.graph.num_recipes
        no_recipe = TrainSample.of(opened.graph, np.zeros(number, dtype=bool))
        joint_folds = Folds(opened.split, folds, 0, np.full(number, OUTSIDE), no_recipe)
    if no_books:
        check_table("outside knowledge of all books", joint.graph.num_entities)
    sources = open_outside(no_books, joint, features, allow_missing=allow_missing)
    every_source = (*(book.source for book in books), *sources.sources)
    outside = OutsideKnowledge(sources.tables, every_source)
    return joint, torch.from_numpy(ids), joint_folds, outside
