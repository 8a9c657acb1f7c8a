"""How entities are made from the base: crafting rounds, and the cheapest recipes for an entity."""

import heapq
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base import GraphError, quoted
from wordcraft_kg.graphs.arrays import Ids, different_ingredients, distinct
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe


def layers(
    graph: RecipeGraph,
    start: Iterable[Entity] | None = None,
    usable: NDArray[np.bool_] | None = None,
) -> Ids:
    """Return the round in which each entity can first be made.

    In a round, all entities known before are combined, as pairs and as larger sets.

    Args:
        graph: the recipe graph.
        start: entities known at the start, in round 0; None for the graph's base.
        usable: shape (num_recipes,), True for recipes that make something; None for all.

    Returns:
        Shape (num_entities,), int64; -1 for an entity that is never made.

    Raises:
        UnknownEntityError: if an entity in ``start`` is not in the graph.
    """
    starts, order = graph.by_ingredient
    *ingredients, result = graph.sets.T
    layer = np.full(graph.num_entities, -1, dtype=np.int64)
    frontier = np.array(_ids(graph, start), dtype=np.int64)
    depth = 0
    while len(frontier):
        layer[frontier] = depth
        depth += 1
        # Only recipes with a new ingredient can be used for the first time, so each recipe is
        # checked at most twice, whatever the number of rounds.
        uses = [order[starts[entity] : starts[entity + 1]] for entity in frontier.tolist()]
        recipes = np.concatenate(uses)
        is_known = np.append(layer >= 0, True)  # the padding of small recipes is there, too
        is_possible = np.ones(len(recipes), dtype=bool)
        for column in ingredients:
            is_possible &= is_known[column[recipes]]
        if usable is not None:
            is_possible &= usable[recipes]
        result_ids = result[recipes[is_possible]]
        frontier = distinct(result_ids[layer[result_ids] < 0])
    return layer


def _ids(graph: RecipeGraph, start: Iterable[Entity] | None) -> list[int]:
    """Return the distinct starting entities, ascending; by default the base."""
    if start is None:
        return list(graph.base_ids.tolist())
    return sorted({graph.id_of(entity) for entity in start})


def rounds(layer: Ids) -> list[int]:
    """Count the entities known after 0, 1, 2, ... rounds.

    Args:
        layer: each entity's round, from :func:`layers`.

    Returns:
        Counts, the last for the round after which nothing new is made; empty if nothing is known.
    """
    return np.cumsum(np.bincount(layer[layer >= 0])).tolist()


@dataclass(frozen=True)
class Derivation:
    """Recipes that make an entity from the starting entities.

    Attributes:
        goal: label of the entity.
        steps: distinct recipes in execution order; the last makes the goal. Empty for a starting
            entity.
        cost: number of combinations if an intermediate is made anew for every use (size of the
            derivation tree). Entities are not used up, so ``len(steps) <= cost`` are enough.
    """

    goal: str
    steps: tuple[Recipe, ...]
    cost: int

    def __str__(self) -> str:
        return "\n".join(derivation_tree(self.goal, self.steps))


def derivation_tree(goal: str, steps: Iterable[Recipe]) -> Iterator[str]:
    """Yield a derivation as a tree of text, line by line.

    A line has an entity and its ingredients; below are the ingredients' trees. A tree that was
    shown before is not repeated, and a starting entity below the goal has no line.

    Args:
        goal: label of the entity.
        steps: recipes, one for each made entity.

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
        label, prefix, below = stack.pop()
        if label not in made_by or label in shown:
            yield f"{prefix}{label} (see above)" if label in shown else f"{prefix}{label}"
            continue
        shown.add(label)
        ingredients = made_by[label].ingredients
        yield f"{prefix}{label} = {' + '.join(ingredients)}"
        craftable_parts = [part for part in dict.fromkeys(ingredients) if part in made_by]
        for part in reversed(craftable_parts):  # a stack returns the last first
            if part == craftable_parts[-1]:
                stack.append((part, f"{below}└─ ", f"{below}   "))
            else:
                stack.append((part, f"{below}├─ ", f"{below}│  "))


class Planner:
    """The cheapest derivations of all entities from the starting entities.

    Making an entity from a and b costs 1 + cost(a) + cost(b), the size of the derivation tree; the
    costs of more ingredients are added, and those of one that is needed twice count twice. With
    this additive cost the minimum is exact and found for all entities at once, by Knuth's
    generalisation of Dijkstra's algorithm (Knuth, "A generalization of Dijkstra's algorithm",
    1977). Counting shared intermediates once would be NP-hard. Ties go to the earlier recipe in the
    graph.

    Attributes:
        graph: the recipe graph.
        start: labels of the starting entities.
        costs: cost by entity id, ``math.inf`` if unreachable; Python integers, since a tree may
            grow exponentially with its depth.
    """

    def __init__(self, graph: RecipeGraph, start: Iterable[Entity] | None = None):
        """Compute all costs.

        Args:
            graph: the recipe graph.
            start: entities that cost nothing, by id or label; None for the base.

        Raises:
            UnknownEntityError: if an entity in ``start`` is not in the graph.
        """
        self.graph = graph
        # Lists, because single numbers of arrays are slow.
        starts, order = map(np.ndarray.tolist, graph.by_ingredient)
        recipes = graph.sets.tolist()
        # Ingredients of each recipe that are not settled yet.
        users, _ = different_ingredients(graph.sets, graph.num_entities)
        missing = np.bincount(users, minlength=len(recipes)).tolist()
        initial = _ids(graph, start)
        self.start = graph.labels(initial)
        # The padding of small recipes costs nothing.
        costs: list[float] = [*[math.inf] * graph.num_entities, 0]
        cost_of = costs.__getitem__
        self._recipe: list[int] = [-1] * graph.num_entities
        settled = [False] * graph.num_entities
        # Entries (cost, row of the recipe, entity): of equal costs the earlier recipe comes first.
        queue: list[tuple[float, int, int]] = []
        for entity in initial:
            costs[entity] = 0
            queue.append((0, -1, entity))
        while queue:
            _, recipe, entity = heapq.heappop(queue)
            if settled[entity]:
                continue
            # Costs only grow along a derivation, so the first entry of an entity is its cheapest.
            settled[entity] = True
            self._recipe[entity] = recipe
            for index in order[starts[entity] : starts[entity + 1]]:
                missing[index] -= 1
                if missing[index]:
                    continue
                *ingredients, result = recipes[index]
                if settled[result]:
                    continue
                candidate = 1 + sum(map(cost_of, ingredients))
                # Equal costs too, for the tie; an entry that is beaten later stays in the queue
                # and is passed over, because its entity is settled by then.
                if candidate <= costs[result]:
                    costs[result] = candidate
                    heapq.heappush(queue, (candidate, index, result))
        self.costs = costs[:-1]

    def derivation(self, goal: Entity) -> Derivation:
        """Return the cheapest derivation for an entity, with its steps.

        Raises:
            UnknownEntityError: if the graph has no such entity.
            GraphError: if the entity cannot be made from the start.
        """
        graph = self.graph
        target = graph.id_of(goal)
        if self.costs[target] == math.inf:
            start_labels = ", ".join(map(quoted, self.start)) or "nothing"
            raise GraphError(f"'{graph.entities[target]}' cannot be made from {start_labels}.")
        steps: list[int] = []
        available_ids = {graph.num_entities}  # the padding of small recipes
        # Depth first with a stack of its own: chains are longer than Python's recursion limit.
        stack = [target]
        while stack:
            entity = stack[-1]
            index = self._recipe[entity]
            is_start = index < 0
            ingredients = [] if is_start else graph.sets[index, :-1].tolist()
            missing = [part for part in ingredients if part not in available_ids]
            if missing:
                stack.extend(reversed(missing))
                continue
            stack.pop()
            # An entity that two recipes need is on the stack twice, and made once.
            if entity not in available_ids and not is_start:
                steps.append(index)
            available_ids.add(entity)
        labels = graph.recipe_labels(graph.sets[steps])
        return Derivation(graph.entities[target], tuple(labels), int(self.costs[target]))
