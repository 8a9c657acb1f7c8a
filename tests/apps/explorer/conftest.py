"""A small graph with models and a run, opened once; read only."""

from pathlib import Path

import pytest

from tests.apps.explorer.labels import HOSTILE
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.graphs import open_book
from wordcraft_kg.graphs.folder import write_graph_folder
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import SplitConfig, make_split


@pytest.fixture(scope="session")
def kitchen_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the kitchen's graph."""
    out = tmp_path_factory.mktemp("graphs") / "kitchen"
    book = open_book("kitchen")
    write_graph_folder(out, book, make_split(RecipeGraph.from_book(book), SplitConfig()))
    return out


@pytest.fixture(scope="session")
def links_folder(kitchen_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small ComplEx of the kitchen's partial graph, with folds."""
    from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig
    from wordcraft_kg.models.links.training import train_links

    out = tmp_path_factory.mktemp("models") / "kitchen-complex"
    return train_links(LinksConfig(str(kitchen_folder), ComplExConfig(dim=8, epochs=5, folds=2)), out).folder


@pytest.fixture(scope="session")
def run_folder(kitchen_folder: Path, recipes_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An agent that was trained for a moment, with the recipe scorer of the kitchen."""
    from wordcraft_kg.agents.config import AgentConfig, ImpalaConfig
    from wordcraft_kg.agents.training import train_agent
    from wordcraft_kg.models.policies.config import PolicyConfig

    out = tmp_path_factory.mktemp("runs") / "guided"
    config = AgentConfig(
        str(kitchen_folder), str(recipes_folder), policy=PolicyConfig(use="u,v,w"), trainer=ImpalaConfig(steps=4_000)
    )
    return train_agent(config, out).folder


@pytest.fixture(scope="session")
def explored(kitchen_folder: Path, links_folder: Path, recipes_folder: Path, run_folder: Path) -> Explored:
    """The kitchen with two models and an agent."""
    return Explored.open(kitchen_folder, [links_folder, recipes_folder], [run_folder])


@pytest.fixture(scope="session")
def hostile() -> Explored:
    """A graph of labels that a page must show as text, and that addresses must survive."""
    rows = [(one, other, made) for one, other, made in zip(HOSTILE, HOSTILE[1:], HOSTILE[2:], strict=False)]
    graph = RecipeGraph.from_recipes([*rows, ("water", "earth", "mud")], name="<b>hostile</b>")
    from wordcraft_kg.graphs.folder import OpenedGraph, default_split

    return Explored(OpenedGraph(graph, default_split(graph), "hostile"))
