"""The page for paths from the base to a goal."""

import math
from operator import attrgetter
from typing import Literal

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState, Paging, paging
from wordcraft_kg.apps.explorer.pages.entities import layers_of
from wordcraft_kg.apps.explorer.predictor import PlacedRecipe, placed_recipes
from wordcraft_kg.base import ConfigError, Count, Record
from wordcraft_kg.graphs import PARTS, Part, Planner, Recipe

STEPS_A_PAGE = 200
"""Listed crafts on a page; a derivation may have thousands."""
LISTED = 20
"""Maximum number of blocked recipes."""
Outcome = Literal["base", "made", "impossible"]


class PathState(PageState):
    """Page settings: a goal.

    Attributes:
        entity: label of the goal; empty for an entity in the last crafting layer.
        page: page number in the list of crafts.
    """

    entity: str = ""
    page: int = 1


class Blocked(Record):
    """An impossible recipe.

    Attributes:
        recipe: recipe by labels.
        missing: labels of the ingredients that cannot be made.
    """

    recipe: Recipe
    missing: tuple[str, ...]


class PathView(Record):
    """The path from the base to an entity.

    Attributes:
        entity: label of the goal.
        base: labels of the base entities.
        outcome: ``base`` without a craft, ``impossible`` if the entity cannot be made.
        parts: number of crafts by the split part of their recipes; parts without any are left out.
        paging: which crafts are listed.
        listed: the listed crafts.
        blocked: some of the recipes that make an impossible goal.
    """

    entity: str
    base: tuple[str, ...]
    outcome: Outcome
    parts: dict[Part, Count]
    paging: Paging
    listed: tuple[PlacedRecipe, ...]
    blocked: tuple[Blocked, ...]


def _view(explored: Explored, state: PathState) -> PathView:
    graph = explored.opened.graph
    if not graph.num_entities:
        raise ConfigError("The graph has no entities.")
    goal = graph.id_of(state.entity) if state.entity else int(layers_of(graph).argmax())
    planner = explored.planner()
    is_possible = planner.costs[goal] < math.inf
    recipes = planner.derivation(goal).steps if is_possible else ()
    steps = placed_recipes(explored.opened.split, graph.rows_of_labels(recipes))
    outcome: Outcome = "made" if steps else "base"
    if not is_possible:
        outcome = "impossible"
    shown = paging(len(steps), state.page, STEPS_A_PAGE)
    parts = [step.part for step in steps]
    return PathView(
        entity=graph.entities[goal],
        base=planner.start,
        outcome=outcome,
        parts={part: parts.count(part) for part in PARTS if part in parts},
        paging=shown,
        listed=steps[shown.rows],
        blocked=() if is_possible else _blocked(planner, goal),
    )


def _blocked(planner: Planner, goal: int) -> tuple[Blocked, ...]:
    """Return some recipes of a goal that cannot be made, with their missing ingredients."""
    graph = planner.graph
    blocked = []
    for recipe in graph.recipe_labels(graph.sets[graph.recipes_of(goal)[:LISTED]]):
        # An entity that is needed twice is missing once.
        ingredients = map(graph.id_of, dict.fromkeys(recipe.ingredients))
        missing = [entity for entity in ingredients if planner.costs[entity] == math.inf]
        blocked.append(Blocked(recipe, graph.labels(missing)))
    return tuple(blocked)


PAGE = Page(
    "path",
    PathState,
    _view,
    title="Paths",
    subject="entity",
    # Only the first page of each list: other pages would be many files.
    exported=lambda explored: map(PathState, ("", *explored.opened.graph.entities)),
    is_there=attrgetter("opened.graph.num_entities"),
)
