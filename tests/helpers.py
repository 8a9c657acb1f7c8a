"""Helpers of tests of several rooms."""

import gc
import json
import tempfile
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs import (
    OpenedGraph,
    RecipeBook,
    RecipeGraph,
    SplitConfig,
    make_split,
    open_book,
    write_graph_folder,
)
from wordcraft_kg.graphs.splits import Draw, Split

FOLDER = tempfile.TemporaryDirectory()


def in_file(command, **settings):
    """Write settings into a configuration file; return the options that name it."""
    number = len(list(Path(FOLDER.name).iterdir()))
    path = Path(FOLDER.name) / f"{number}.toml"
    lines = [f"{name} = {json.dumps(value)}" for name, value in settings.items()]
    path.write_text("\n".join([f"[{command}]", *lines, ""]))
    return ("--config", path)


@contextmanager
def frozen():
    """Exempt the objects of this process from collections, which PyKEEN's pipeline asks for.

    Each takes .3 s for all modules that the tests import. `pykeen_guard` does this in the package.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def write_graph(folder, book="kitchen", **split):
    """Write a book's graph folder, with a split of these settings; one that exists is replaced."""
    recipes = open_book(book)
    write_graph_folder(
        folder,
        recipes,
        make_split(RecipeGraph.from_book(recipes), SplitConfig(**split)),
        force=True,
    )
    return folder


def lines_of(path):
    """Return the values of a file of JSON lines."""
    return [json.loads(line) for line in path.read_text().splitlines()]


@contextmanager
def refuses(setting, error=ConfigError):
    """Expect an error of exactly this class about this setting."""
    with pytest.raises(error) as raised:
        yield
    assert (raised.value.kind, raised.value.setting) == (error.__name__, setting)


def resume(folder, *, graph=None, **options):
    """Train into a run folder again; ``graph`` is the present path of a moved graph."""
    from wordcraft_kg.agents.agent_config import AgentConfig
    from wordcraft_kg.agents.agent_training import train_agent
    from wordcraft_kg.models.links.link_config import LinksConfig
    from wordcraft_kg.models.links.link_training import train_links
    from wordcraft_kg.models.recipes.recipe_config import RecipesConfig
    from wordcraft_kg.models.recipes.recipe_training import train_recipes
    from wordcraft_kg.runs.record import read_run

    trainers = {AgentConfig: train_agent, LinksConfig: train_links, RecipesConfig: train_recipes}
    kind = read_run(folder).kind
    config_type, train = next(
        (config, train) for config, train in trainers.items() if kind in config.commands
    )
    config = config_type.read(folder)
    return train(replace(config, graph=graph or config.graph), folder, **options)


def recorded(monkeypatch, module, name):
    """Return a list that receives what a function is asked to fit: its third argument.

    A run that begins anew ends with the same bytes as one that goes on: what it fits tells them
    apart.
    """
    wanted = []
    function = getattr(module, name)

    def call(folds, words, missing, **others):
        wanted.extend(missing)
        return function(folds, words, missing, **others)

    monkeypatch.setattr(module, name, call)
    return wanted


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
