"""Zero-shot recipe scorers, for a book without train recipes: learned from other books and outside knowledge."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.folds import Folds, make_folds
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import SplitConfig, make_split
from wordcraft_kg.models.recipes.outside import OutsideKnowledge, is_book, open_other_book, open_outside


class JointBook(NamedTuple):
    """Other books' recipes over a joint vocabulary with a graph's entities.

    Attributes:
        opened: the joint graph; all recipes are train recipes.
        own: ids of the graph's entities in the joint graph, shape (E,).
        folds: folds of the recipes.
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
    """Join other books with a graph's entities, without the graph's own recipes.

    ``keep_train`` keeps recipes of other books that are also train recipes of the graph; test recipes are always left
    out. Further arguments as for :func:`~wordcraft_kg.models.recipes.outside.open_outside`.

    Raises:
        ConfigError: if no source is a book.
    """
    books = [
        open_other_book(spec, opened, features, allow_missing=allow_missing, keep_train=keep_train)[0]
        for spec in filter(is_book, specs)
    ]
    if not books:
        raise ConfigError("`kg` none learns from other books only. Name at least one in `with`, such as everyday.")
    labels = sorted({label for book in books for label in book.labels})
    place = {label: row for row, label in enumerate(labels)}
    rows = [np.array([place[label] for label in book.labels])[book.recipes] for book in books]
    recipes = np.concatenate(rows)
    recipes[:, :2].sort(axis=1)
    graph = RecipeGraph(labels, np.unique(recipes, axis=0), [], name=f"books for {opened.graph.name}")
    joint = OpenedGraph(graph, make_split(graph, SplitConfig("none")), opened.source)
    others = open_outside([spec for spec in specs if not is_book(spec)], joint, features, allow_missing=allow_missing)
    sources = (*(book.source for book in books), *others.sources)
    own = torch.tensor([place[label] for label in opened.graph.entities])
    return JointBook(joint, own, make_folds(joint.split, folds), OutsideKnowledge(others.tables, sources))
