"""Graphs with other test results: whatever training reads must not tell them apart."""

from pathlib import Path

import numpy as np

from wordcraft_kg.graphs import (
    OpenedGraph,
    RecipeBook,
    RecipeGraph,
    SplitConfig,
    make_split,
    write_graph_folder,
)
from wordcraft_kg.graphs.splits import Draw, Split


def with_other_results(opened: OpenedGraph, seed: int | None) -> OpenedGraph:
    """Replace the results of all held-out recipes: permuted by a seed, or all one entity for None.

    Train recipes, the parts of pairs and the entities stay. Equal recipes fall together, so that
    the rows of train recipes are other ones.
    """
    graph = opened.graph
    is_train = opened.split.is_in("train")
    recipes = graph.recipes.copy()
    results = recipes[~is_train, 2]
    is_permuted = seed is not None
    recipes[~is_train, 2] = (
        np.random.default_rng(seed).permutation(results) if is_permuted else results[0]
    )
    other = RecipeGraph(graph.entities, recipes, graph.base_ids, graph.name)
    train = set(map(tuple, graph.recipes[is_train].tolist()))
    part_of = dict(zip(map(tuple, recipes.tolist()), opened.split.parts.tolist(), strict=True))
    parts = [0 if row in train else part_of[row] for row in map(tuple, other.recipes.tolist())]
    assert (np.array(parts) == 0).sum() == is_train.sum()
    split = Split(other, opened.split.config, Draw(np.array(parts, dtype=np.int8)))
    return OpenedGraph(other, split, opened.source)


def split_of(graph: RecipeGraph, kind: str, seed: int = 0) -> OpenedGraph:
    """Split a graph into 70 % train, 10 % valid and 20 % test recipes, pairs, goals or slots."""
    return OpenedGraph(graph, make_split(graph, SplitConfig(kind, 0.7, 0.1, seed)), graph.name)


def write_opened(opened: OpenedGraph, folder: Path) -> Path:
    """Write a graph folder, with entities that are in no recipe."""
    graph = opened.graph
    rows = graph.recipe_labels()
    book = RecipeBook.of(graph.name, rows, listed=graph.entities, keep_self_results=True)
    write_graph_folder(folder, book, opened.split)
    return folder
