"""The first page: graph, models and runs."""

import numpy as np

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.apps.explorer.pages.entities import layers_of
from wordcraft_kg.base.records import Count, Hash, Record
from wordcraft_kg.graphs import SplitSummary
from wordcraft_kg.graphs.audit import split_summary

EXAMPLES = 12
"""Entities in each list of examples."""


class HomeState(PageState):
    """Page settings: none."""


class Overview(Record):
    """A graph with models and runs.

    Attributes:
        graph: name of the graph.
        hash: content hash of the graph.
        entities: number of entities.
        recipes: number of recipes.
        base: labels of the base entities.
        reachable: number of entities that can be made from the base, which is included.
        layers: number of crafting rounds in which they are made.
        split: summary of the split.
        most_used: entities in most recipes.
        furthest: entities that need most rounds, of those that can be made.
        models: names of the models.
        runs: names of the runs.
    """

    graph: str
    hash: Hash
    entities: Count
    recipes: Count
    base: tuple[str, ...]
    reachable: Count
    layers: Count
    split: SplitSummary
    most_used: tuple[str, ...]
    furthest: tuple[str, ...]
    models: tuple[str, ...]
    runs: tuple[str, ...]


def _view(explored: Explored, _: HomeState) -> Overview:
    graph = explored.opened.graph
    layer = layers_of(graph)

    def first(keys: np.ndarray) -> tuple[str, ...]:
        # Only positive keys: unused entities, the base (layer 0) and unreachable entities (-1) are
        # no examples.
        order = np.argsort(-keys, kind="stable")
        return graph.labels(order[keys[order] > 0][:EXAMPLES].tolist())

    return Overview(
        graph=graph.name,
        hash=graph.hash,
        entities=graph.num_entities,
        recipes=graph.num_recipes,
        base=graph.base,
        reachable=int((layer >= 0).sum()),
        layers=max(int(layer.max(initial=0)), 0),
        split=split_summary(explored.opened.split),
        most_used=first(graph.use_counts),
        furthest=first(layer),
        models=tuple(explored.models),
        runs=tuple(explored.runs),
    )


PAGE = Page("home", HomeState, _view)
