"""The first page."""

import numpy as np

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.apps.explorer.predictor import LinkPredictor
from wordcraft_kg.base.records import Count, Hash, Record
from wordcraft_kg.graphs.audit import SplitSummary, split_summary
from wordcraft_kg.graphs.folder import TrainedOn
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.models.scorers.cross_fitting import folds_of

EXAMPLES = 12


class HomeState(PageState):
    """Page settings: none."""


class ModelLine(Record):
    """A model: command, training data, train sample in words (empty for all train recipes), and folds."""

    name: str
    command: str
    kg: TrainedOn
    train_sample: str
    folds: Count
    scores_recipes: bool


class Overview(Record):
    """A graph with models and runs: reachable entities with the base, crafting rounds, and the furthest entities."""

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


def _view(explored: Explored, _: HomeState) -> Overview:
    graph = explored.opened.graph
    layer = layers(graph)

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
        split=split_summary(explored.opened.split),
        most_used=first(graph.use_counts),
        furthest=first(layer),
        models=tuple(map(_line, explored.models.values())),
        runs=tuple(explored.runs),
    )


def _line(predictor: LinkPredictor) -> ModelLine:
    model = predictor.model
    cross_fitted = folds_of(model.scorer)
    folds = cross_fitted.count if cross_fitted else 0
    kind, train_sample = model.run.kind, model.learned_from
    return ModelLine(predictor.name, kind, model.kg, train_sample, folds, predictor.scores_recipes)


PAGE = Page("home", HomeState, _view)
