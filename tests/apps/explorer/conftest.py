"""Small graphs with models and runs, made once; read only."""

from dataclasses import replace

import pytest

from tests.apps.explorer.shown import HOSTILE, explored_graph
from wordcraft_kg import (
    AgentConfig,
    ComplExConfig,
    ImpalaConfig,
    LinksConfig,
    PolicyConfig,
    TaskConfig,
    cross_fit,
    open_model,
    save_scorer,
    train_agent,
    train_links,
)
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.predictor import LinkPredictor
from wordcraft_kg.apps.explorer.site import export_site
from wordcraft_kg.graphs import (
    RecipeBook,
    RecipeGraph,
    SplitConfig,
    make_split,
    open_graph,
    write_graph_folder,
)
from wordcraft_kg.models.scorers.baselines import KernelScorer, NeighbourScorer

SHORT = ImpalaConfig(steps=1_024, batch_size=16, log_every=128, eval_every=512)
LEARNED = PolicyConfig(features="random", key_size=8, value_size=8, hidden_size=8)


@pytest.fixture(scope="session")
def links_folder(kitchen_folder, made_once):
    """A small ComplEx of the kitchen's partial graph, with folds."""
    config = LinksConfig(str(kitchen_folder), ComplExConfig(dim=8, epochs=5, n3=0.1, folds=2))
    return made_once("explored/kitchen-complex", lambda out: train_links(config, out))


@pytest.fixture(scope="session")
def run_folder(kitchen_folder, recipes_folder, made_once):
    """An agent that was trained for a moment, with the recipe scorer of the kitchen."""
    policy, trainer = PolicyConfig(use="u,v,w"), ImpalaConfig(steps=1_600, batch_size=16)
    config = AgentConfig(str(kitchen_folder), str(recipes_folder), policy=policy, trainer=trainer)
    return made_once("explored/guided", lambda out: train_agent(config, out))


@pytest.fixture(scope="session")
def explored(kitchen_folder, links_folder, recipes_folder, run_folder):
    """The kitchen with two models and an agent."""
    return Explored.open(kitchen_folder, [links_folder, recipes_folder], [run_folder])


@pytest.fixture(scope="session")
def agents(kitchen_folder, run_folder, made_once):
    """The kitchen with an agent that mixes the scores of a cross-fitted scorer, one without, and an
    mlp."""
    plain = AgentConfig(str(kitchen_folder), None, TaskConfig(distractors=8), LEARNED, SHORT)
    mlp = replace(plain, policy=replace(LEARNED, policy="mlp"), tasks=TaskConfig(distractors=2))
    folders = [
        made_once(f"explored/{name}", lambda out, config=config: train_agent(config, out))
        for name, config in (("plain", plain), ("mlp", mlp))
    ]
    return Explored.open(kitchen_folder, [], [run_folder, *folders])


@pytest.fixture(scope="session")
def hostile():
    """A graph of labels that a page must show as text, and that addresses must survive."""
    rows = zip(HOSTILE, HOSTILE[1:], HOSTILE[2:], strict=False)
    return explored_graph(
        RecipeGraph.from_recipes([*rows, ("water", "earth", "mud")], name="<b>hostile</b>")
    )


@pytest.fixture(scope="session")
def static_site(explored, tmp_path_factory):
    """The kitchen's site as files."""

    out = tmp_path_factory.mktemp("static") / "site"
    export_site(explored, out)
    return out


@pytest.fixture(scope="session")
def saved(tmp_path_factory):
    """Save a scorer of an opened graph as a model: `saved(name, scorer, opened, kg)`."""

    def saved(name, scorer, opened, kg="partial"):
        return _opened(save_scorer(tmp_path_factory.mktemp("models") / name, scorer, opened, kg=kg))

    return saved


@pytest.fixture(scope="session")
def kernel(parted_kitchen, saved):
    """The recipe kernel, with folds and so with probabilities."""
    graph = parted_kitchen.graph
    scorer = cross_fit(parted_kitchen.split, lambda recipes: KernelScorer(graph, recipes), folds=3)
    return saved("kernel", scorer, parted_kitchen)


@pytest.fixture(scope="session")
def neighbours(parted_kitchen, saved):
    """The neighbour rule, without folds."""
    return saved(
        "neighbours",
        NeighbourScorer(parted_kitchen.graph, parted_kitchen.split.partial),
        parted_kitchen,
    )


@pytest.fixture(scope="session")
def rankers(recipes_folder):
    """A recipe scorer of the kitchen with its default split."""
    return _opened(recipes_folder)


@pytest.fixture(scope="session")
def of_recipes(tmp_path_factory, saved):
    """Make a graph of recipes, and the neighbour rule on it; without a split it
    knows everything."""

    def make(rows, kg="", **settings):
        folder = tmp_path_factory.mktemp("mine") / "graph"
        graph = RecipeGraph.from_recipes(rows, name="mine")
        split = make_split(graph, SplitConfig(**settings))
        write_graph_folder(
            folder, RecipeBook("mine", tuple(graph.recipe_labels()), graph.base), split
        )
        opened, kg = (
            open_graph(folder),
            kg or ("full" if split.config.kind == "none" else "partial"),
        )
        return saved("model", NeighbourScorer(graph, opened.triples(kg)), opened, kg)

    return make


@pytest.fixture(scope="session")
def hostile_predictor(of_recipes):
    """A model of a graph of hostile labels."""
    results = (max(HOSTILE, key=len), *HOSTILE[:2])
    rows = [
        (one, other, made)
        for one in HOSTILE
        for other in HOSTILE
        if one < other
        for made in results
    ]
    return of_recipes(rows, train_ratio=0.7)


def _opened(folder):
    return LinkPredictor(folder.name, folder, open_model(folder))
