"""Convert recipe graphs to networkx graphs and pandas frames."""

from typing import TYPE_CHECKING

import numpy as np

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import RELATIONS

if TYPE_CHECKING:
    import networkx as nx
    import pandas as pd


def to_networkx(graph: RecipeGraph, *, recipe_nodes: bool = False) -> "nx.MultiDiGraph":
    """Convert a recipe graph to a networkx graph.

    Entity nodes have ``kind="entity"``, ``base``, ``recipes`` (number of recipes for the entity), ``uses`` (number of
    recipes with the entity as ingredient) and, if reachable from the base, ``layer`` (crafting rounds).

    Args:
        graph: the recipe graph.
        recipe_nodes: False makes an edge per triple, with the key and attribute ``relation``. True adds a node ``recipe
            <index>`` with ``kind="recipe"`` per recipe, and edges ``ingredient -> recipe -> result``, two for an
            entity combined with itself; leading underscores avoid clashes with labels.
    """
    import networkx as nx

    view = nx.MultiDiGraph(name=graph.name, hash=graph.hash)
    in_base = np.isin(np.arange(graph.num_entities), graph.base_ids)
    columns = (in_base, graph.recipe_counts, graph.use_counts, layers(graph))
    for label, base, recipes, uses, layer in zip(graph.entities, *(c.tolist() for c in columns), strict=True):
        place = {"layer": layer} if layer >= 0 else {}  # GraphML cannot hold None
        view.add_node(label, kind="entity", base=base, recipes=recipes, uses=uses, **place)
    if recipe_nodes:
        prefix = "recipe "
        while any(label.startswith(prefix) for label in graph.entities):
            prefix = "_" + prefix
        for index, recipe in enumerate(graph.recipe_labels()):
            node = f"{prefix}{index}"
            view.add_node(node, kind="recipe")
            view.add_edge(recipe.ingredient_a, node, "ingredient_a", role="ingredient")
            view.add_edge(recipe.ingredient_b, node, "ingredient_b", role="ingredient")
            view.add_edge(node, recipe.result, "result", role="result")
    else:
        names = graph.entities
        view.add_edges_from(
            (names[head], names[tail], RELATIONS[relation], {"relation": RELATIONS[relation]})
            for head, relation, tail in graph.triples.tolist()
        )
    return view


def entities_frame(graph: RecipeGraph) -> "pd.DataFrame":
    """Return a row per entity: label, base, layer (crafting rounds, missing if unreachable), recipe and use counts."""
    import pandas as pd

    depth = layers(graph)
    return pd.DataFrame(
        {
            "entity": graph.entities,
            "base": np.isin(np.arange(graph.num_entities), graph.base_ids),
            "layer": pd.Series(depth, dtype="Int64").mask(depth < 0),
            "recipes": graph.recipe_counts,
            "uses": graph.use_counts,
        }
    )


def triples_frame(graph: RecipeGraph, triples: Ids | None = None) -> "pd.DataFrame":
    """Return a data frame of ``triples`` (default: all) with the label columns ``head``, ``relation`` and ``tail``."""
    import pandas as pd

    names = np.array(graph.entities, dtype=object)
    head, relation, tail = (graph.triples if triples is None else triples).T
    return pd.DataFrame(
        {"head": names[head], "relation": np.array(RELATIONS, dtype=object)[relation], "tail": names[tail]}
    )
