"""Compute crafting rounds until each entity can be made, and the cheapest recipes for an entity."""

import heapq
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from wordcraft_kg.base.errors import GraphError
from wordcraft_kg.base.wording import approximate, counted
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe


def layers(graph: RecipeGraph, start: Iterable[Entity] | None = None) -> Ids:
    """Return each entity's first crafting round, (num_entities,): 0 for ``start`` (the base), -1 if unreachable."""
    starts, order = graph.by_ingredient
    a, b, result = graph.recipes.T
    layer = np.full(graph.num_entities, -1, dtype=np.int64)
    frontier = (
        graph.base_ids if start is None else np.unique([graph.id_of(entity) for entity in start])
    )
    frontier = frontier.astype(np.int64)
    depth = 0
    while len(frontier):
        layer[frontier] = depth
        depth += 1
        # Only recipes with an ingredient that is new can fire for the first time, so each is checked at most twice.
        spans = [order[starts[i] : starts[i + 1]] for i in frontier.tolist()]
        recipes = np.concatenate(spans)
        made = result[recipes[(layer[a[recipes]] >= 0) & (layer[b[recipes]] >= 0)]]
        frontier = np.unique(made[layer[made] < 0])
    return layer


def rounds(layer: Ids) -> list[int]:
    """Count the entities known after 0, 1, 2, ... rounds, from the layers by :func:`layers`."""
    reached = layer[layer >= 0]
    return np.cumsum(np.bincount(reached)).tolist() if len(reached) else []


@dataclass(frozen=True)
class Derivation:
    """Recipes that make an entity, ``goal``, from the starting entities.

    ``steps`` are distinct recipes in execution order, ending in the goal; empty for a starting entity. ``cost`` is the
    number of recipes if an intermediate is made anew for every use; ``len(steps) <= cost`` combinations are enough.
    """

    goal: str
    steps: tuple[Recipe, ...]
    cost: int

    def __repr__(self) -> str:
        return f"Derivation({self.goal!r}, {counted(len(self.steps), 'step')}, cost {approximate(self.cost)})"

    def __str__(self) -> str:
        return "\n".join(derivation_tree(self.goal, self.steps))


def derivation_tree(goal: str, steps: Iterable[Recipe]) -> Iterator[str]:
    """Yield a text tree, line by line: an entity with two ingredients, then each ingredient's tree, none repeated.

    ``goal`` is the entity's label; ``steps`` has a recipe per made entity.

    Example:
        >>> print(Planner(open_graph("kitchen").graph).derivation("flour"))
        flour = field + mill
        ├─ field = earth + person
        └─ mill = stone + stone
    """
    made_by = {recipe.result: recipe for recipe in steps}
    shown: set[str] = set()
    stack = [(goal, "", "")]
    while stack:
        label, own, below = stack.pop()
        if label not in made_by or label in shown:
            yield f"{own}{label}{' (see above)' if label in shown else ''}"
            continue
        shown.add(label)
        one, other, _ = made_by[label]
        yield f"{own}{label} = {one} + {other}"
        made = [part for part in dict.fromkeys((one, other)) if part in made_by]
        for part in reversed(made):
            is_last = part == made[-1]
            stack.append(
                (
                    part,
                    f"{below}{'└─' if is_last else '├─'} ",
                    f"{below}{'   ' if is_last else '│  '}",
                )
            )


class Planner:
    """The cheapest derivations (recipes that make an entity from starting entities) for all entities.

    Making an entity from a and b costs 1 + cost(a) + cost(b). Knuth's generalisation of Dijkstra's algorithm (Knuth, "A
    generalization of Dijkstra's algorithm", 1977) finds the exact minimum for all entities at once; counting shared
    intermediates once would be NP-hard. Ties go to the earlier recipe in the graph.

    Attributes:
        start: labels of the starting entities.
        costs: cost by entity id, ``math.inf`` if unreachable; Python integers, since costs grow exponentially.
    """

    def __init__(self, graph: RecipeGraph, start: Iterable[Entity] | None = None):
        """Compute all costs from the entities in ``start`` (default: the base)."""
        self.graph = graph
        starts, order = (array.tolist() for array in graph.by_ingredient)
        recipes = graph.recipes.tolist()
        initial = (
            graph.base_ids.tolist()
            if start is None
            else sorted({graph.id_of(entity) for entity in start})
        )
        self.start = graph.labels(initial)
        self.costs: list[float] = [math.inf] * graph.num_entities
        self._recipe: list[int] = [-1] * graph.num_entities
        settled = [False] * graph.num_entities
        queue: list[tuple[float, int, int]] = [(0, -1, entity) for entity in initial]
        for entity in initial:
            self.costs[entity] = 0
        while queue:
            _, recipe, entity = heapq.heappop(queue)
            if settled[entity]:
                continue
            settled[entity] = True
            self._recipe[entity] = recipe
            for index in order[starts[entity] : starts[entity + 1]]:
                a, b, result = recipes[index]
                if settled[a] and settled[b] and not settled[result]:
                    candidate = 1 + self.costs[a] + self.costs[b]
                    if candidate <= self.costs[result]:
                        self.costs[result] = candidate
                        heapq.heappush(queue, (candidate, index, result))

    def derivation(self, goal: Entity) -> Derivation:
        """Return the cheapest derivation for an entity; GraphError for an entity that cannot be made."""
        graph = self.graph
        target = graph.id_of(goal)
        if self.costs[target] == math.inf:
            raise GraphError(
                f"'{graph.entities[target]}' cannot be made from {', '.join(self.start) or 'nothing'}."
            )
        steps: list[int] = []
        done: set[int] = set()
        stack = [target]
        while stack:
            entity = stack[-1]
            index = self._recipe[entity]
            missing = (
                []
                if index < 0
                else [part for part in graph.recipes[index, :2].tolist() if part not in done]
            )
            if missing:
                stack.extend(reversed(missing))
                continue
            stack.pop()
            if entity not in done and index >= 0:
                steps.append(index)
            done.add(entity)
        labels = graph.recipe_labels(graph.recipes[steps])
        return Derivation(graph.entities[target], tuple(labels), int(self.costs[target]))
