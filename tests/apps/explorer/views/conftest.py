"""Models of the kitchen that need no training, saved and opened once; read only."""

from collections.abc import Callable
from pathlib import Path

import pytest

from wordcraft_kg.apps.explorer.views.predictor import LinkPredictor
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_book
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph, write_graph_folder
from wordcraft_kg.graphs.recipes import RecipeBook
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.saving import save_scorer
from wordcraft_kg.models.scorers.baselines import NeighbourScorer
from wordcraft_kg.models.scorers.cross_fitting import cross_fit
from wordcraft_kg.models.scorers.kernel import KernelScorer

HOSTILE = ("<script>alert(1)</script>", "\"&'", "a/b", "..", "?#%2F", "🪨 émoji", "x" * 200)
"""Labels that are no harm to a book, and might be to what shows them."""


@pytest.fixture(scope="session")
def parted_kitchen(tmp_path_factory: pytest.TempPathFactory) -> OpenedGraph:
    """The kitchen with a train, a validation and a test part."""
    folder = tmp_path_factory.mktemp("graphs") / "kitchen"
    book = open_book("kitchen")
    split = make_split(RecipeGraph.from_book(book), SplitConfig(train_ratio=0.7, valid_ratio=0.15))
    write_graph_folder(folder, book, split)
    return open_graph(folder)


@pytest.fixture(scope="session")
def kernel(parted_kitchen: OpenedGraph, tmp_path_factory: pytest.TempPathFactory) -> LinkPredictor:
    """The recipe kernel, with folds and so with probabilities."""
    graph = parted_kitchen.graph
    scorer = cross_fit(parted_kitchen.split, lambda recipes: KernelScorer(graph, recipes), folds=3)
    return _opened(save_scorer(tmp_path_factory.mktemp("models") / "kernel", scorer, parted_kitchen, kg="partial"))


@pytest.fixture(scope="session")
def neighbours(parted_kitchen: OpenedGraph, tmp_path_factory: pytest.TempPathFactory) -> LinkPredictor:
    """The neighbour rule, without folds."""
    scorer = NeighbourScorer(parted_kitchen.graph, parted_kitchen.split.partial)
    return _opened(save_scorer(tmp_path_factory.mktemp("models") / "neighbours", scorer, parted_kitchen, kg="partial"))


@pytest.fixture(scope="session")
def all_seeing(parted_kitchen: OpenedGraph, tmp_path_factory: pytest.TempPathFactory) -> LinkPredictor:
    """A model of the full graph."""
    scorer = NeighbourScorer(parted_kitchen.graph, parted_kitchen.graph.triples)
    return _opened(save_scorer(tmp_path_factory.mktemp("models") / "full", scorer, parted_kitchen, kg="full"))


@pytest.fixture(scope="session")
def rankers(recipes_folder: Path) -> LinkPredictor:
    """A recipe scorer of the kitchen with its default split."""
    return _opened(recipes_folder)


@pytest.fixture(scope="session")
def of_recipes(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., LinkPredictor]:
    """Make a graph of recipes, and the neighbour rule on it."""

    def make(rows: list[tuple[str, str, str]], **settings: object) -> LinkPredictor:
        folder = tmp_path_factory.mktemp("graphs") / "mine"
        graph = RecipeGraph.from_recipes(rows, name="mine")
        split = make_split(graph, SplitConfig(**settings))
        write_graph_folder(folder, RecipeBook("mine", tuple(graph.recipe_labels()), graph.base), split)
        opened = open_graph(folder)
        kg = "full" if split.config.kind == "none" else "partial"
        scorer = NeighbourScorer(graph, opened.triples(kg))
        return _opened(save_scorer(tmp_path_factory.mktemp("models") / "mine", scorer, opened, kg=kg))

    return make


@pytest.fixture(scope="session")
def hostile(of_recipes: Callable[..., LinkPredictor]) -> LinkPredictor:
    """A graph of hostile labels."""
    rows = [(one, other, made) for one in HOSTILE for other in HOSTILE if one < other for made in HOSTILE[:2]]
    return of_recipes(rows, train_ratio=0.7)


def _opened(folder: Path) -> LinkPredictor:
    return LinkPredictor.of(folder.name, open_model(folder))
