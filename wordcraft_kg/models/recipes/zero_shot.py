"""Recipe scorers without the book's own recipes: learned from other books, or tables of outside knowledge alone."""

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
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.knowledge.folder import KNOWLEDGE, check_same_split
from wordcraft_kg.models.recipes.base import LinkTables
from wordcraft_kg.models.recipes.fitting import LinkRankers
from wordcraft_kg.models.recipes.outside import (
    OutsideKnowledge,
    is_book,
    open_other_book,
    open_outside,
    with_words_of,
)
from wordcraft_kg.models.scorers.pair_features import FEATURES, RecipeKnowledge, knowledge_of
from wordcraft_kg.models.scorers.ranker import Ranker


class JointBook(NamedTuple):
    """Other books' recipes over a joint vocabulary with a graph's entities.

    Attributes:
        opened: the joint graph; all recipes are train recipes. Without a book, the graph itself.
        own: ids of the graph's entities in the joint graph, shape (E,).
        folds: folds of the recipes; without recipes if no source is a book.
        outside: knowledge from sources that are not books, for the joint graph, and the books' counts.
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
    """Join other books with a graph's entities, without the graph's own recipes; ConfigError without a source.

    ``keep_train`` keeps recipes of other books that are also train recipes of the graph; test recipes are always left
    out. Further arguments as for :func:`~wordcraft_kg.models.recipes.outside.open_outside`.
    """
    if not specs:
        raise ConfigError(
            "`kg` none learns from outside knowledge only. Name a source in `with`, such as everyday."
        )
    books = [
        with_words_of(
            open_other_book(spec, opened, keep_train=keep_train),
            opened,
            features,
            allow_missing=allow_missing,
        )[0]
        for spec in filter(is_book, specs)
    ]
    if not books:
        graph = opened.graph
        no_recipe = TrainSample.of(graph, np.zeros(graph.num_recipes, dtype=bool))
        without = Folds(opened.split, folds, 0, np.full(graph.num_recipes, OUTSIDE), no_recipe)
        others = open_outside(specs, opened, features, allow_missing=allow_missing)
        return JointBook(opened, torch.arange(graph.num_entities), without, others)
    for spec in specs:
        if (Path(spec) / KNOWLEDGE).is_file():
            check_same_split(spec, opened)
    labels = sorted({label for book in books for label in book.labels})
    place = {label: row for row, label in enumerate(labels)}
    rows = [np.array([place[label] for label in book.labels])[book.recipes] for book in books]
    recipes = np.concatenate(rows)
    recipes[:, :2].sort(axis=1)
    graph = RecipeGraph(
        labels, np.unique(recipes, axis=0), [], name=f"books for {opened.graph.name}"
    )
    joint = OpenedGraph(graph, make_split(graph, SplitConfig("none")), opened.source)
    others = open_outside(
        [spec for spec in specs if not is_book(spec)], joint, features, allow_missing=allow_missing
    )
    sources = (*(book.source for book in books), *others.sources)
    own = torch.tensor([place[label] for label in opened.graph.entities])
    return JointBook(
        joint, own, make_folds(joint.split, folds), OutsideKnowledge(others.tables, sources)
    )


def tables_alone(outside: LinkTables, text: Tensor) -> tuple[RecipeKnowledge, LinkRankers]:
    """Return a scorer of mean standardised tables: ``parts[a, c] + parts[b, c] + pairs[a, b]``."""
    size = len(text)

    def mean(tables: Sequence[Tensor]) -> Tensor:
        scaled = [torch.from_numpy(standardised(table.numpy(), None)).float() for table in tables]
        return torch.stack(scaled).mean(0) if scaled else torch.zeros(size, size)

    links = mean(outside.pairs), mean(outside.parts)
    knowledge = knowledge_of(
        np.empty((0, 3), dtype=np.int64), torch.zeros(size, size), text, links, links
    )
    # relu(x) - relu(-x) is x.
    first = torch.zeros(len(FEATURES), 2)
    first[[FEATURES.index("link_sum"), FEATURES.index("pair_link")]] = torch.tensor([1.0, -1.0])
    ranker = Ranker(first, torch.zeros(2), torch.tensor([1.0, -1.0]), torch.zeros(()))
    unused = [
        Ranker(torch.zeros(1, 1), torch.zeros(1), torch.zeros(1), torch.zeros(()))
        for _ in RELATIONS
    ]
    return knowledge.with_ranker(ranker), (unused[0], unused[1])
