"""What there is to look at: a graph, the models trained on it, and the runs of agents."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from wordcraft_kg.base.records import Count, Hash, Record
from wordcraft_kg.graphs.audit import SplitSummary, split_summary
from wordcraft_kg.graphs.folder import OpenedGraph, Taught
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.models.model import Model
from wordcraft_kg.models.scorers.recipes import RecipeScores

EXAMPLES = 12
"""Entities that a first page offers: the most used ones, and those that are the furthest from the base."""


class ModelLine(Record):
    """A model.

    Attributes:
        command: what made it, such as ``train-complex``.
        kg: what it was trained on.
        dose: what of the train recipes it was taught, in words; empty for all of them as they are.
        folds: number of its folds; 0 if it is not cross-fitted.
        scores_recipes: whether it scores recipes, and not links only.
    """

    name: str
    command: str
    kg: Taught
    dose: str
    folds: Count
    scores_recipes: bool


class Overview(Record):
    """What there is to look at.

    Attributes:
        reachable: entities that can be made from the base, which is included.
        layers: number of rounds in which they are made.
        most_used: entities in most recipes.
        furthest: entities that need most rounds, of those that can be made from the base.
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
    models: tuple[ModelLine, ...]
    runs: tuple[str, ...]


def view_overview(opened: OpenedGraph, models: Mapping[str, Model], runs: Mapping[str, Path]) -> Overview:
    """Sum up a graph, models of it by name, and runs on it by name."""
    graph, layer = opened.graph, layers(opened.graph)

    def first(keys: np.ndarray) -> tuple[str, ...]:
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
        split=split_summary(opened.split),
        most_used=first(graph.use_counts),
        furthest=first(layer),
        models=tuple(_line(name, model) for name, model in models.items()),
        runs=tuple(runs),
    )


def _line(name: str, model: Model) -> ModelLine:
    scorer = model.scorer
    folds = 0 if scorer.folds is None else scorer.folds.count
    scores_recipes = isinstance(scorer.whole, RecipeScores)
    return ModelLine(name, model.run.kind, model.kg, model.learned_from, folds, scores_recipes)
