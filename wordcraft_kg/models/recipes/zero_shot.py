"""Recipe scorers without the book's own recipes.

They are learned from other books, or are tables of outside knowledge alone.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.statistics import standardised
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.folds import OUTSIDE, Folds, make_folds
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import SplitConfig, make_split
from wordcraft_kg.graphs.train_samples import TrainSample
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF
from wordcraft_kg.models.knowledge.folder import KNOWLEDGE, check_same_split
from wordcraft_kg.models.recipes.fitting import LinkTables, Words
from wordcraft_kg.models.recipes.outside import (
    OtherBook,
    OutsideKnowledge,
    is_book,
    open_other_book,
    open_outside,
    recipes_together,
    with_words_of,
)
from wordcraft_kg.models.scorers.config import check_table
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.neighbours.pair_features import FEATURES
from wordcraft_kg.models.scorers.ranker import Ranker


class JointBook(NamedTuple):
    """Other books' recipes over a joint vocabulary with a graph's entities.

    Attributes:
        opened: the joint graph; all recipes are train recipes. Without a book, the graph itself.
        own: ids of the graph's entities in the joint graph, shape (E,).
        folds: folds of the recipes; without recipes if no source is a book.
        outside: knowledge from sources that are not books, for the joint graph, and the books'
            counts.
    """

    opened: OpenedGraph
    own: Tensor
    folds: Folds
    outside: OutsideKnowledge


def join_books(
    specs: Sequence[str],
    opened: OpenedGraph,
    features: str,
    *,
    folds: int,
    allow_missing: bool = False,
    keep_train: bool = True,
) -> JointBook:
    """Join other books with a graph's entities, without the graph's own recipes.

    Args:
        specs: sources: other books, and others as for
            :func:`~wordcraft_kg.models.recipes.outside.open_outside`.
        opened: the graph; its split says which shared recipes are test recipes.
        features: word vectors by which recipes are compared.
        folds: number of folds of the other books' recipes.
        allow_missing: use zeros for labels without a vector.
        keep_train: keep recipes of other books that are also train recipes of the graph; test
            recipes are always left out.

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
        other = open_other_book(spec, opened, keep_train=keep_train)
        counted, _ = with_words_of(other, opened, features, allow_missing=allow_missing)
        books.append(counted)
    # Tables and word vectors alone: there is nothing to join, and no recipe to learn from.
    if not books:
        own_graph = opened.graph
        number = own_graph.num_recipes
        no_recipe = TrainSample.of(own_graph, np.zeros(number, dtype=bool))
        without = Folds(opened.split, folds, 0, np.full(number, OUTSIDE), no_recipe)
        others = open_outside(specs, opened, features, allow_missing=allow_missing)
        return JointBook(opened, torch.arange(own_graph.num_entities), without, others)
    # Before the books are joined: the joint graph's split has no test part to compare with.
    for spec in specs:
        if (Path(spec) / KNOWLEDGE).is_file():
            check_same_split(spec, opened)
    joint, place = _joined(books, opened)
    no_books = [spec for spec in specs if not is_book(spec)]
    if no_books:
        check_table("outside knowledge of all books", joint.graph.num_entities)
    others = open_outside(no_books, joint, features, allow_missing=allow_missing)
    of_books = [book.source for book in books]
    outside = OutsideKnowledge(others.tables, (*of_books, *others.sources))
    own = torch.tensor([place[label] for label in opened.graph.entities])
    return JointBook(joint, own, make_folds(joint.split, folds), outside)


def _joined(books: Sequence[OtherBook], opened: OpenedGraph) -> tuple[OpenedGraph, dict[str, int]]:
    """Return a graph with the recipes of all books, and the id of each label in it."""
    distinct: set[str] = set()
    for book in books:
        distinct.update(book.labels)
    labels = sorted(distinct)
    place = {label: row for row, label in enumerate(labels)}
    recipes = recipes_together(books, labels)
    graph = RecipeGraph(labels, recipes, [], name=f"books for {opened.graph.name}")
    split = make_split(graph, SplitConfig("none"))
    return OpenedGraph(graph, split, opened.source), place


def tables_alone(outside: LinkTables, words: Words) -> RecipeKnowledge:
    """Return a scorer of mean standardised tables: ``parts[a, c] + parts[b, c] + pairs[a, b]``.

    Args:
        outside: the tables, shape (E, E) each.
        words: word vectors; they are kept, and have weight 0.
    """
    size = len(words.vectors)

    def mean(tables: Sequence[Tensor]) -> Tensor:
        if not tables:
            return torch.zeros(size, size)
        scaled = []
        for table in tables:
            values = standardised(table.numpy(), None)
            scaled.append(torch.from_numpy(values).float())
        return torch.stack(scaled).mean(0)

    pairs = mean(outside.pairs)
    parts = mean(outside.parts)
    no_recipes = np.empty((0, 3), dtype=np.int64)
    knowledge = RecipeKnowledge.of_recipes(no_recipes, words.vectors, words.near)
    tables = {COMBINES_WITH: pairs, COMPONENT_OF: parts}
    # A ranker that adds two features with two hidden units: relu(x) - relu(-x) is x.
    signs = torch.tensor([1.0, -1.0])
    first = torch.zeros(len(FEATURES), 2)
    for name in ("component_sum", "combines_pair"):
        first[FEATURES.index(name)] = signs
    ranker = Ranker(first, torch.zeros(2), signs.clone(), torch.zeros(()))
    return knowledge.with_link_tables(tables).with_ranker(ranker)
