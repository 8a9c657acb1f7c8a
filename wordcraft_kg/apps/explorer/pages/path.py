"""The page for paths: from the base to a goal, and from any entity to another."""

import math
from itertools import pairwise
from operator import attrgetter
from typing import Literal

import numpy as np

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState, Paging, paging
from wordcraft_kg.apps.explorer.pages.entities import layers_of
from wordcraft_kg.apps.explorer.predictor import PlacedRecipe, placed_recipes, recipes_giving
from wordcraft_kg.base import ConfigError, Count, Record, approximate
from wordcraft_kg.graphs import COMPONENT_OF, PARTS, Part, Planner, Recipe

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
    graph = explored.opened.graph
    if not graph.num_entities:
        raise ConfigError("The graph has no entities.")
    furthest = np.argsort(-layers_of(graph), kind="stable")[:EXAMPLES].tolist()
    goal = graph.id_of(state.entity) if state.entity else furthest[0]
    planner = explored.planner()
    cost = planner.costs[goal]
    is_possible = cost < math.inf
    recipes = planner.derivation(goal).steps if is_possible else ()
    steps = placed_recipes(explored.opened.split, graph.rows_of_labels(recipes))
    outcome: Outcome = "made" if steps else "base"
    if not is_possible:
        outcome = "impossible"
    shown = paging(len(steps), state.page, STEPS_A_PAGE)
    parts = [step.part for step in steps]
    return PathView(
        entity=graph.entities[goal],
        examples=graph.labels(furthest[1:]),
        base=planner.start,
        outcome=outcome,
        steps=len(steps),
        cost=approximate(int(cost)) if is_possible else "",
        parts={part: parts.count(part) for part in PARTS if part in parts},
        paging=shown,
        listed=steps[shown.rows],
        recipes=len(graph.recipes_of(goal)),
        blocked=() if is_possible else _blocked(planner, goal),
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

    # Large graphs have millions of triples, so they are looked at once.
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
            steps = placed_recipes(split, np.array(rows, dtype=np.int64))
            return Chain(graph.entities[source], graph.entities[target], steps)
    return Chain(graph.entities[start], graph.entities[goal], ())


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
