"""The page for paths: from the base to a goal, and from any entity to another."""

import math
from collections.abc import Iterable
from itertools import pairwise
from operator import attrgetter
from typing import Literal

import numpy as np

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState, Paging, paging
from wordcraft_kg.apps.explorer.pages.entities import layers_of
from wordcraft_kg.apps.explorer.predictor import PlacedRecipe, recipes_giving
from wordcraft_kg.base import ConfigError, Count, Record, approximate
from wordcraft_kg.graphs import COMPONENT_OF, PARTS, Part, Planner, Recipe, Split

STEPS_A_PAGE = 200
"""Listed crafts on a page; a derivation may have thousands."""
EXAMPLES = 4
"""Example goals: the first is shown by default, the page links to the others."""
LISTED = 20
"""Maximum number of blocked recipes."""
Outcome = Literal["base", "made", "impossible"]


class PathState(PageState):
    """Page settings: a goal and a start.

    Attributes:
        entity: label of the goal; empty for an entity in the last crafting layer.
        page: page number in the list of crafts.
        start: label of the start; empty for the base.
    """

    entity: str = ""
    page: int = 1
    start: str = ""


class Chain(Record):
    """The shortest chain of recipes between two entities; each uses the result of the one before.

    Attributes:
        start: label of the first entity; the goal, if a chain leads only from the goal to the
            start.
        end: label of the last entity.
        steps: crafts in turn; empty if no chain leads either way.
    """

    start: str
    end: str
    steps: tuple[PlacedRecipe, ...]


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
        examples: labels of other goals in late layers.
        base: labels of the base entities.
        outcome: ``base`` without a craft, ``impossible`` if the entity cannot be made.
        steps: number of crafts.
        cost: crafts without reuse, in words, since the number may have thousands of digits; empty
            for an impossible goal.
        parts: number of crafts by the split part of their recipes; parts without any are left out.
        paging: which crafts are listed.
        listed: the listed crafts.
        recipes: number of recipes that make the goal.
        blocked: some of the ``recipes`` for an impossible goal.
        chain: the way from another start than the base; None for the base.
    """

    entity: str
    examples: tuple[str, ...]
    base: tuple[str, ...]
    outcome: Outcome
    steps: Count
    cost: str
    parts: dict[Part, Count]
    paging: Paging
    listed: tuple[PlacedRecipe, ...]
    recipes: Count
    blocked: tuple[Blocked, ...]
    chain: Chain | None


def _view(explored: Explored, state: PathState) -> PathView:
    split = explored.opened.split
    graph = explored.opened.graph
    if not graph.num_entities:
        raise ConfigError("The graph has no entities.")
    furthest = np.argsort(-layers_of(graph), kind="stable")[:EXAMPLES].tolist()
    goal = graph.id_of(state.entity) if state.entity else furthest[0]
    planner = explored.planner()
    cost = planner.costs[goal]
    steps: tuple[PlacedRecipe, ...] = ()
    blocked: tuple[Blocked, ...] = ()
    outcome: Outcome
    if cost == math.inf:
        outcome = "impossible"
        blocked = _blocked(planner, goal)
    else:
        steps = _steps(split, planner.derivation(goal).steps)
        outcome = "made" if steps else "base"
    shown = paging(len(steps), state.page, STEPS_A_PAGE)
    parts = [step.part for step in steps]
    return PathView(
        entity=graph.entities[goal],
        examples=graph.labels(furthest[1:]),
        base=planner.start,
        outcome=outcome,
        steps=len(steps),
        cost="" if cost == math.inf else approximate(int(cost)),
        parts={part: parts.count(part) for part in PARTS if part in parts},
        paging=shown,
        listed=steps[shown.rows],
        recipes=len(graph.recipes_of(goal)),
        blocked=blocked,
        chain=chain_between(explored, graph.id_of(state.start), goal) if state.start else None,
    )


def chain_between(explored: Explored, start: int, goal: int) -> Chain:
    """Return the shortest chain of recipes from an entity to a goal, or else the other way.

    The other ingredients of a recipe need not be reachable: the chain shows a connection, not a
    plan.

    Args:
        explored: graph and split.
        start: id of the entity.
        goal: id of the goal.

    Returns:
        the chain; of several recipes for a link, the first in train, valid or test, in this order.
    """
    import networkx as nx

    split = explored.opened.split
    graph = explored.opened.graph

    def components() -> nx.DiGraph:
        triples = graph.triples[graph.triples[:, 1] == COMPONENT_OF]
        return nx.DiGraph(triples[:, [0, 2]].tolist())

    links = explored.once("components", components)
    for source, target in ((start, goal), (goal, start)):
        # networkx raises for an entity without links.
        if source in links and target in links and nx.has_path(links, source, target):
            rows = []
            for head, tail in pairwise(nx.shortest_path(links, source, target)):
                giving = recipes_giving(graph, head, COMPONENT_OF, tail)
                # Part numbers ascend from train; argmin takes the first of equal ones.
                rows.append(int(giving[split.parts[giving].argmin()]))
            steps = _steps(split, graph.recipe_labels(graph.sets[rows]))
            return Chain(graph.entities[source], graph.entities[target], steps)
    return Chain(graph.entities[start], graph.entities[goal], ())


def _steps(split: Split, recipes: Iterable[Recipe]) -> tuple[PlacedRecipe, ...]:
    """Return the recipes of a derivation with their parts."""
    return tuple(PlacedRecipe(recipe, _part_of(split, recipe)) for recipe in recipes)


def _part_of(split: Split, recipe: Recipe) -> Part:
    graph = split.graph
    *ingredients, result = (graph.id_of(label) for label in recipe)
    padding = [graph.num_entities] * (graph.sets.shape[1] - len(recipe))
    rows = graph.recipes_of(result)
    # The graph has each recipe once, with ingredients in the order of ids, which is that of labels.
    is_wanted = (graph.sets[rows] == [*ingredients, *padding, result]).all(axis=1)
    (row,) = rows[is_wanted].tolist()
    return PARTS[split.parts[row]]  # type: ignore[return-value]


def _blocked(planner: Planner, goal: int) -> tuple[Blocked, ...]:
    """Return some recipes of a goal that cannot be made, with their missing ingredients."""
    graph = planner.graph
    rows = graph.sets[graph.recipes_of(goal)[:LISTED]]
    blocked = []
    for recipe in graph.recipe_labels(rows):
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
