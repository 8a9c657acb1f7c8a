"""An entity: its recipes, what a model predicts for it and why, and what is like it."""

from collections.abc import Iterator

from wordcraft_kg.apps.explorer import asked
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, State
from wordcraft_kg.apps.explorer.views.entities import EntityProfile, view_entity_profile
from wordcraft_kg.base.errors import ConfigError

EXPORTED = 5_000
"""Entities of which a static site has pages."""


class Entity(State):
    """An entity.

    Attributes:
        entity: its label; the most used one if it is empty.
        model: the model to ask; the first if it is empty.
        learned: whether predictions are listed that the model was trained on.
    """

    entity: str = ""
    model: str = ""
    learned: bool = False


def _view(explored: Explored, state: Entity) -> EntityProfile:
    graph = explored.opened.graph
    if not graph.num_entities:
        raise ConfigError("The graph has no entities.")
    label = state.entity or graph.entities[int(graph.use_counts.argmax())]
    return view_entity_profile(
        explored.opened.split,
        label,
        planner=asked.planner(explored),
        words=asked.words(explored),
        predictor=asked.predictor(explored, state.model) if explored.models else None,
        with_learned=state.learned,
    )


def _exported(explored: Explored) -> Iterator[Entity]:
    yield from (Entity(label) for label in explored.opened.graph.entities[:EXPORTED])


PAGE = Page("entity", Entity, _view, subject="entity", exported=_exported)
