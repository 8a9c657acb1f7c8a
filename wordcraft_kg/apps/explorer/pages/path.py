"""The page for paths: from the base to a goal, and from any entity to another."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import pairwise
from operator import attrgetter
from typing import Literal

import numpy as np
from markupsafe import Markup

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Addresses, Page, PageState, Paging, paging
from wordcraft_kg.apps.explorer.pages.entities import layers_of
from wordcraft_kg.apps.explorer.predictor import recipes_giving
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.base.wording import approximate
from wordcraft_kg.graphs.planner import Planner
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.splits import PARTS, Part, Split
from wordcraft_kg.graphs.triples import COMPONENT_OF
from wordcraft_kg.reports import charts

STEPS_A_PAGE = 200
DRAWN = 60
"""Maximum number of drawn steps: the last ones."""
EXAMPLES = 4
LISTED = 20


class PathState(PageState):
    """Page settings: goal (default: an entity in the last layer), page of the list, start (default: the base)."""

    entity: str = ""
    page: int = 1
    start: str = ""


class PathStep(Record):
    """A craft, numbered in execution order; layers are as late as possible, with the goal in the last layer."""

    number: Count
    recipe: Recipe
    part: Part
    layer: Count


class Chain(Record):
    """The shortest chain of recipes from an entity to another; each recipe uses the result of the one before.

    The chain leads back, from the goal, if none leads to the goal; ``steps`` is empty without any chain.
    """

    start: str
    end: str
    steps: tuple[PathStep, ...]


class Blocked(Record):
    """An impossible recipe and the missing ingredients."""

    recipe: Recipe
    missing: tuple[str, ...]


class PathView(Record):
    """The path from the base to an entity.

    Attributes:
        outcome: ``base`` without a craft, ``impossible`` if the entity cannot be made.
        cost: crafts without reuse, in words, since the number may have thousands of digits.
        drawn: the last steps.
        blocked: some of the ``recipes`` for an impossible goal.
        sources: some missing entities without a recipe; empty if recipes form a cycle.
        chain: the way from another start than the base, if chosen.
    """

    entity: str
    examples: tuple[str, ...]
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
    chain: Chain | None


def _view(explored: Explored, state: PathState) -> PathView:
    split, graph = explored.opened.split, explored.opened.graph
    if not graph.num_entities:
        raise ConfigError("The graph has no entities.")
    furthest = np.argsort(-layers_of(graph), kind="stable")[:EXAMPLES].tolist()
    goal = graph.id_of(state.entity) if state.entity else furthest[0]
    planner = explored.planner()
    cost = planner.costs[goal]
    steps: tuple[PathStep, ...] = ()
    blocked: tuple[Blocked, ...] = ()
    sources: list[int] = []
    if cost == math.inf:
        blocked, sources = _blocked(planner, goal), _sources(planner, goal)
    else:
        steps = _steps(split, planner.derivation(goal).steps)
    shown = paging(len(steps), state.page, STEPS_A_PAGE)
    used = [step.part for step in steps]
    return PathView(
        entity=graph.entities[goal],
        examples=graph.labels(furthest[1:]),
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
        chain=chain_between(explored, graph.id_of(state.start), goal) if state.start else None,
    )


def chain_between(explored: Explored, start: int, goal: int) -> Chain:
    """Return the shortest chain of recipes from an entity to a goal, by ids, or else from the goal; train first."""
    import networkx as nx

    split, graph = explored.opened.split, explored.opened.graph

    def components() -> nx.DiGraph:
        triples = graph.triples[graph.triples[:, 1] == COMPONENT_OF]
        return nx.DiGraph(triples[:, [0, 2]].tolist())

    links = explored.once("components", components)
    for one, other in ((start, goal), (goal, start)):
        if one in links and other in links and nx.has_path(links, one, other):
            ends = pairwise(nx.shortest_path(links, one, other))
            recipes = (recipes_giving(graph, head, COMPONENT_OF, tail) for head, tail in ends)
            rows = [int(rows[split.parts[rows].argmin()]) for rows in recipes]
            steps = _steps(split, tuple(graph.recipe_labels(graph.recipes[rows])))
            return Chain(graph.entities[one], graph.entities[other], steps)
    return Chain(graph.entities[start], graph.entities[goal], ())


def _questions(explored: Explored) -> Iterator[tuple[str, PathState]]:
    graph, layer = explored.opened.graph, layers_of(explored.opened.graph)
    for start in sorted(graph.base_ids.tolist(), key=lambda entity: -graph.use_counts[entity]):
        chain = chain_between(explored, start, goal := int(layer.argmax()))
        if chain.steps and chain.end == graph.entities[goal]:
            yield (
                f"How do I get from {chain.start} to {chain.end}?",
                PathState(chain.end, start=chain.start),
            )
            return


def _steps(split: Split, recipes: tuple[Recipe, ...]) -> tuple[PathStep, ...]:
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
    (row,) = (
        row for row in graph.recipes_of(wanted[2]).tolist() if graph.recipes[row].tolist() == wanted
    )
    return PARTS[split.parts[row]]  # type: ignore[return-value]


def _last(steps: tuple[PathStep, ...]) -> tuple[PathStep, ...]:
    # Whole layers from the end, so that the drawing has no gaps.
    kept = sorted(steps, key=lambda step: (-step.layer, -step.number))[:DRAWN]
    return tuple(sorted(kept, key=lambda step: step.number))


def _blocked(planner: Planner, goal: int) -> tuple[Blocked, ...]:
    graph = planner.graph
    rows = graph.recipes[graph.recipes_of(goal)[:LISTED]]
    missing = [
        [i for i in dict.fromkeys(row[:2]) if planner.costs[i] == math.inf] for row in rows.tolist()
    ]
    blocked = zip(graph.recipe_labels(rows), missing, strict=True)
    return tuple(Blocked(recipe, graph.labels(ids)) for recipe, ids in blocked)


def _sources(planner: Planner, goal: int) -> list[int]:
    graph = planner.graph
    sources, seen, stack = [], {goal}, [goal]
    while stack:
        entity = stack.pop()
        recipes = graph.recipes[graph.recipes_of(entity)]
        if not len(recipes):
            sources.append(entity)
        needed = {i for i in recipes[:, :2].ravel().tolist() if planner.costs[i] == math.inf} - seen
        seen |= needed
        stack.extend(needed)
    return sorted(sources)


def _draw(view: PathView, _: PathState, address: Addresses) -> Mapping[str, Markup]:
    drawn = {"layers": (view.drawn, view.entity, view.base)}
    if view.chain is not None:
        drawn["chain"] = (view.chain.steps, view.chain.end, (view.chain.start,))
    return {name: _drawn(*crafts, address) for name, crafts in drawn.items() if crafts[0]}


def _drawn(
    steps: Sequence[PathStep], goal: str, given: Collection[str], address: Addresses
) -> Markup:
    crafts = []
    for step in steps:
        one, other, result = step.recipe
        styles = {"goal": result == goal, "held": step.part != "train"}
        crafts.append(
            charts.Made(
                label=result,
                href=address(PAGE, PathState(entity=result)),
                layer=step.layer,
                of=(one, other),
                style=" ".join(name for name, applies in styles.items() if applies),
                title=f"{one} + {other} → {result} ({step.part})",
            )
        )
    return charts.layered(crafts, given, f"Crafts that lead to {goal}, in layers")


def _exported(explored: Explored) -> Iterator[PathState]:
    yield from (PathState(entity=label) for label in ("", *explored.opened.graph.entities))


PAGE = Page(
    "path",
    PathState,
    _view,
    title="Paths",
    subject="entity",
    draw=_draw,
    exported=_exported,
    questions=_questions,
    is_there=attrgetter("opened.graph.num_entities"),
)
