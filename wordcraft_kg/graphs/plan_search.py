"""Which attempts make a goal from the entities at hand: a search backwards from the goal, for all plans at once."""

import itertools
from collections.abc import Iterable

from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph

Rows = tuple[int, ...]
Way = frozenset[int]


class PlanSearch:
    """The plans of one graph.

    A *way* is a set of attempts, given as numbers of pairs, that makes a goal in some order. A *plan* is a way in the
    order of execution: the rows of the recipes whose results are needed.

    Attributes:
        graph: the graph; all its recipes may be used.
        rows: its recipes, as Python lists, because a search looks at a few of them very often.
        recipes_of: for each entity, the recipes that make it and do not need it, as (pair, ingredient, ingredient).
    """

    def __init__(self, graph: RecipeGraph):
        """Sort the recipes by result."""
        self.graph = graph
        self.rows: list[list[int]] = graph.recipes.tolist()
        self._starts: list[int] = graph.pair_starts.tolist()
        self.recipes_of: list[list[tuple[int, int, int]]] = [[] for _ in range(graph.num_entities)]
        for pair, (a, b, result) in zip(graph.pair_of_recipe.tolist(), self.rows, strict=True):
            if result not in (a, b):
                self.recipes_of[result].append((pair, a, b))

    def plans(self, goal: Entity, at_hand: Iterable[Entity], attempts: int) -> list[Rows]:
        """Return all plans that make a goal in as few attempts as possible, if ``attempts`` are enough.

        Args:
            goal: entity to make.
            at_hand: entities at hand at the start.
            attempts: number of attempts allowed.

        Returns:
            plans, sorted; empty if there is none, and one empty plan if the goal is at hand.
        """
        have = frozenset(map(self.graph.id_of, at_hand))
        target = self.graph.id_of(goal)
        return self.ordered(self.shortest_ways(target, have, attempts), target, have)

    def shortest_ways(self, goal: int, have: frozenset[int], attempts: int) -> set[Way]:
        """Return all ways with as few attempts as possible, if ``attempts`` are enough."""
        found = (self.ways(goal, have, budget) for budget in range(attempts + 1))
        return next(filter(None, found), set())

    def ways(self, goal: int, have: frozenset[int], attempts: int) -> set[Way]:
        """Return all ways of at most ``attempts`` attempts without circles."""
        return self._ways(goal, attempts, have, frozenset())

    def _ways(self, entity: int, budget: int, have: frozenset[int], above: frozenset[int]) -> set[Way]:
        """Return the ways to make ``entity``, which is needed for the entities ``above``, without needing those."""
        if entity in have:
            return {frozenset()}
        if budget == 0:
            return set()
        if budget == 1:
            return {frozenset((pair,)) for pair, a, b in self.recipes_of[entity] if a in have and b in have}
        above = above | {entity}
        found = set()
        for pair, a, b in self.recipes_of[entity]:
            if a in above or b in above:
                continue
            one = self._ways(a, budget - 1, have, above)
            if not one:
                continue
            other = one if a == b else self._ways(b, budget - 1, have, above)
            for way_a, way_b in itertools.product(one, other) if a != b else ((way, way) for way in one):
                way = way_a | way_b | {pair}
                if len(way) <= budget:
                    found.add(way)
        return found

    def ordered(self, ways: Iterable[Way], goal: int, have: frozenset[int]) -> list[Rows]:
        """Return ways as plans, sorted."""
        return sorted(self._plan(way, goal, have) for way in ways)

    def _plan(self, way: Way, goal: int, have: frozenset[int]) -> Rows:
        if len(way) == 1:  # most tasks are of depth 1
            (pair,) = way
            return tuple(row for row in self.rows_of(pair) if self.rows[row][2] == goal)
        needed = {goal}.union(*(self.ingredients(pair) for pair in way))
        at_hand, left, plan = set(have), sorted(way), []
        while left:
            pair = next(pair for pair in left if at_hand.issuperset(self.ingredients(pair)))
            left.remove(pair)
            plan += [row for row in self.rows_of(pair) if self.rows[row][2] in needed - at_hand]
            at_hand |= self.results(pair)
        # The goal comes last, even among the results of its own pair.
        return tuple(sorted(plan, key=lambda row: self.rows[row][2] == goal))

    def rows_of(self, pair: int) -> range:
        """Return the rows of a pair's recipes."""
        return range(self._starts[pair], self._starts[pair + 1])

    def ingredients(self, pair: int) -> list[int]:
        """Return the two ingredients of a pair."""
        return self.rows[self._starts[pair]][:2]

    def results(self, pair: int) -> set[int]:
        """Return everything that a pair makes."""
        return {self.rows[row][2] for row in self.rows_of(pair)}
