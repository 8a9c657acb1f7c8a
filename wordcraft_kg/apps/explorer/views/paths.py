"""The way from the base to a goal: its cheapest derivation, layer by layer, or what is missing."""

import math
from typing import Literal

from wordcraft_kg.apps.explorer.views.paging import Paging, paging
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.base.wording import approximate
from wordcraft_kg.graphs.planner import Planner
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.splits import PARTS, Part, Split

STEPS_A_PAGE = 200
DRAWN = 60
"""Most steps that are drawn: the last ones."""
LISTED = 20
"""Most recipes and entities that are listed of what is missing."""


class PathStep(Record):
    """A craft on the way.

    Attributes:
        number: its place in the order of execution, from 1.
        recipe: what is made of what.
        part: the part of the split that the recipe is in.
        layer: a craft comes a layer after all that it needs, and as late as what needs it allows; the goal is last.
    """

    number: Count
    recipe: Recipe
    part: Part
    layer: Count


class Blocked(Record):
    """A recipe that cannot be carried out, and which of its ingredients cannot be made."""

    recipe: Recipe
    missing: tuple[str, ...]


class PathView(Record):
    """How an entity is made from the base.

    Attributes:
        entity: the goal.
        base: the base entities.
        outcome: ``base`` if there is nothing to make, ``impossible`` if it cannot be made.
        steps: number of crafts.
        layers: number of layers of crafts.
        cost: number of crafts if every use had to be made anew, in words, since it may have thousands of digits.
        parts: number of crafts by the part of their recipe; parts without any are left out.
        paging: which steps are listed.
        listed: these steps.
        drawn: the last steps, at most :data:`DRAWN`, in the order of execution.
        recipes: number of recipes that make the goal.
        blocked: some of the recipes that make an entity which cannot be made.
        sources: some of the entities that it depends on, that nothing makes and that are no base entities. If there are
            none, the recipes need each other's results.
        num_sources: number of all of them.
    """

    entity: str
    base: tuple[str, ...]
    outcome: Literal["base", "made", "impossible"]
    steps: Count
    layers: Count
    cost: str
    parts: dict[Part, Count]
    paging: Paging
    listed: tuple[PathStep, ...]
    drawn: tuple[PathStep, ...]
    recipes: Count
    blocked: tuple[Blocked, ...]
    sources: tuple[str, ...]
    num_sources: Count


def view_path(planner: Planner, split: Split, entity: str, page: int = 1) -> PathView:
    """Show the cheapest derivation of an entity.

    Args:
        planner: the cheapest derivations of the split's graph, from its base.
        split: parts of the recipes.
        entity: the goal.
        page: page of the list of steps, from 1.

    Raises:
        UnknownEntityError: if there is no such entity.
        ConfigError: if the list has no such page.
    """
    graph = planner.graph
    goal = graph.id_of(entity)
    cost = planner.costs[goal]
    steps: tuple[PathStep, ...] = ()
    blocked: tuple[Blocked, ...] = ()
    sources: list[int] = []
    if cost == math.inf:
        blocked, sources = _blocked(planner, goal), _sources(planner, goal)
    else:
        steps = _steps(split, planner.derivation(goal).steps)
    shown = paging(len(steps), page, STEPS_A_PAGE)
    used = [step.part for step in steps]
    return PathView(
        entity=entity,
        base=planner.start,
        outcome="impossible" if cost == math.inf else "made" if steps else "base",
        steps=len(steps),
        layers=max((step.layer for step in steps), default=0),
        cost="" if cost == math.inf else approximate(int(cost)),
        parts={part: used.count(part) for part in PARTS if part in used},
        paging=shown,
        listed=steps[shown.rows],
        drawn=_last(steps),
        recipes=len(graph.recipes_of(goal)),
        blocked=blocked,
        sources=graph.labels(sources[:LISTED]),
        num_sources=len(sources),
    )


def _steps(split: Split, recipes: tuple[Recipe, ...]) -> tuple[PathStep, ...]:
    """Number the recipes of a derivation, and find their parts and layers."""
    earliest: dict[str, int] = {}
    for one, other, result in recipes:
        earliest[result] = 1 + max(earliest.get(one, 0), earliest.get(other, 0))
    layer = dict.fromkeys(earliest, max(earliest.values(), default=0))
    for one, other, result in reversed(recipes):
        for ingredient in (one, other):
            if ingredient in layer:
                layer[ingredient] = min(layer[ingredient], layer[result] - 1)
    return tuple(
        PathStep(number, recipe, _part_of(split, recipe), layer[recipe.result])
        for number, recipe in enumerate(recipes, start=1)
    )


def _part_of(split: Split, recipe: Recipe) -> Part:
    graph = split.graph
    wanted = [graph.id_of(label) for label in recipe]
    (row,) = (row for row in graph.recipes_of(wanted[2]).tolist() if graph.recipes[row].tolist() == wanted)
    return PARTS[split.parts[row]]  # type: ignore[return-value]


def _last(steps: tuple[PathStep, ...]) -> tuple[PathStep, ...]:
    """Return the steps of the last layers, so that what is drawn has no gaps."""
    kept = sorted(steps, key=lambda step: (-step.layer, -step.number))[:DRAWN]
    return tuple(sorted(kept, key=lambda step: step.number))


def _blocked(planner: Planner, goal: int) -> tuple[Blocked, ...]:
    graph = planner.graph
    rows = graph.recipes[graph.recipes_of(goal)[:LISTED]]
    missing = [[i for i in dict.fromkeys(row[:2]) if planner.costs[i] == math.inf] for row in rows.tolist()]
    found = zip(graph.recipe_labels(rows), missing, strict=True)
    return tuple(Blocked(recipe, graph.labels(ids)) for recipe, ids in found)


def _sources(planner: Planner, goal: int) -> list[int]:
    """Return the entities that no recipe makes, of all those that cannot be made and that the goal depends on."""
    graph = planner.graph
    found, seen, stack = [], {goal}, [goal]
    while stack:
        entity = stack.pop()
        recipes = graph.recipes[graph.recipes_of(entity)]
        if not len(recipes):
            found.append(entity)
        needed = {i for i in recipes[:, :2].ravel().tolist() if planner.costs[i] == math.inf} - seen
        seen |= needed
        stack.extend(needed)
    return sorted(found)
