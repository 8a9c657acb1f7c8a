"""Search for crafting tasks (a goal and starting ingredients) and for plans that make the goal."""

import itertools
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.errors import TaskError
from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.settings import one_of, whole
from wordcraft_kg.graphs.arrays import frozen, padded
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph
from wordcraft_kg.graphs.splits import PARTS, Split
from wordcraft_kg.graphs.tasks import Rows, TaskPart, TaskSet, TaskWeighting

MAX_DEPTH = 5
"""Most attempts in a plan: each further attempt makes the search six times slower."""
DRAWN_TASKS = 1_000
"""Default size of a random set."""
_ENUMERATED_DEPTH = 2  # deeper tasks are drawn at random
MAX_ENUMERATED = (
    1_000_000  # plans at depth 2 that are enumerated, about 1 kB each; otherwise tasks are drawn
)
_TRIES = 2_000  # draws without a new task after which drawing stops

_Posed = tuple[int, Rows]  # a goal and starting ingredients, ascending
Plans = tuple[Rows, ...]
_Way = frozenset[int]  # numbers of pairs


class PlanSearch:
    """Backward search from a goal for all shortest plans.

    An attempt combines an ingredient pair, numbered as in ``graph.pair_of_recipe``. A *way* is a set of attempts, as
    pair numbers, that makes a goal in some order. A *plan* is a way in order of execution: the rows in
    ``graph.recipes`` with needed results. ``recipes_of`` has the usable recipes by result as (pair number, ingredient,
    ingredient), none that uses its own result.
    """

    def __init__(self, graph: RecipeGraph, usable: NDArray[np.bool_] | None = None):
        """Index the recipes of ``graph`` by result, or only those in the mask ``usable``, shape (num_recipes,)."""
        self.graph = graph
        self.rows: list[list[int]] = graph.recipes.tolist()
        self._starts: list[int] = graph.pair_starts.tolist()
        self.recipes_of: list[list[tuple[int, int, int]]] = [[] for _ in range(graph.num_entities)]
        marks = itertools.repeat(True, len(self.rows)) if usable is None else usable.tolist()
        for pair, (a, b, result), mark in zip(
            graph.pair_of_recipe.tolist(), self.rows, marks, strict=True
        ):
            if mark and result not in (a, b):
                self.recipes_of[result].append((pair, a, b))

    def plans(self, goal: Entity, at_hand: Iterable[Entity], attempts: int) -> list[Rows]:
        """Return the shortest plans with at most ``attempts`` attempts, sorted; a goal at hand has an empty plan."""
        have = frozenset(map(self.graph.id_of, at_hand))
        target = self.graph.id_of(goal)
        return self.ordered(self.shortest_ways(target, have, attempts), target, have)

    def shortest_ways(self, goal: int, have: frozenset[int], attempts: int) -> set[_Way]:
        """Return all ways to make a goal from the entities ``have`` with the fewest attempts, at most ``attempts``."""
        by_budget = (self.ways(goal, have, budget) for budget in range(attempts + 1))
        return next(filter(None, by_budget), set())

    def ways(self, goal: int, have: frozenset[int], attempts: int) -> set[_Way]:
        """Return all acyclic ways to make a goal from the entities ``have`` with at most ``attempts`` attempts."""
        return self._ways(goal, attempts, have, frozenset())

    def _ways(
        self, entity: int, budget: int, have: frozenset[int], above: frozenset[int]
    ) -> set[_Way]:
        """Return the ways to make ``entity`` without the entities ``above``, which need ``entity``."""
        if entity in have:
            return {frozenset()}
        recipes = self.recipes_of[entity]
        if budget <= 1:
            return {
                frozenset((pair,)) for pair, a, b in recipes if budget and a in have and b in have
            }
        above = above | {entity}
        ways = set()
        for pair, a, b in recipes:
            if above.isdisjoint((a, b)) and (one := self._ways(a, budget - 1, have, above)):
                other = one if a == b else self._ways(b, budget - 1, have, above)
                both = zip(one, one, strict=True) if a == b else itertools.product(one, other)
                ways |= {
                    way for way_a, way_b in both if len(way := way_a | way_b | {pair}) <= budget
                }
        return ways

    def ordered(self, ways: Iterable[_Way], goal: int, have: frozenset[int]) -> list[Rows]:
        """Convert ways to make ``goal`` from the entities ``have`` to plans, sorted."""
        return sorted(self._plan(way, goal, have) for way in ways)

    def _plan(self, way: _Way, goal: int, have: frozenset[int]) -> Rows:
        if len(way) == 1:  # most tasks have depth 1
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
        """Return the rows in ``graph.recipes`` for a pair number."""
        return range(self._starts[pair], self._starts[pair + 1])

    def ingredients(self, pair: int) -> list[int]:
        """Return the two ingredient ids for a pair number."""
        return self.rows[self._starts[pair]][:2]

    def results(self, pair: int) -> set[int]:
        """Return all result ids for a pair number."""
        return {self.rows[row][2] for row in self.rows_of(pair)}


@stage("finding tasks")
def make_tasks(
    graph: RecipeGraph,
    depth: int = 1,
    split: Split | None = None,
    part: TaskPart = "all",
    *,
    weighting: TaskWeighting = "task",
    limit: int = DRAWN_TASKS,
    seed: int = 0,
    search: PlanSearch | None = None,
) -> TaskSet:
    """Return crafting tasks at a depth, the number of attempts in the shortest plan.

    The set has all tasks at depth 1 and (for fewer than a million plans) 2; otherwise the set is random. A task belongs
    to *train* if all plans use train recipes only, to *test* if each plan uses a test recipe, to *valid* if each plan
    uses a validation recipe and no test recipe. Mixed tasks belong to no part and are counted.

    Args:
        graph: the recipe graph; plans may use all recipes.
        depth: 1 to 5.
        split: defines the parts; required for any part but ``all``.
        part: ``all``, ``train``, ``valid`` or ``test``.
        weighting: draw a task's last recipe among all recipes (task), or by goal first (goal).
        limit: largest size of a random set.
        seed: random seed.
        search: an existing plan search for the graph.

    Raises:
        ConfigError: for a depth or part outside the range.
        TaskError: if no such task exists, or the split is missing or for another graph.
    """
    whole("depth", depth, 1, MAX_DEPTH)
    one_of("part", part, ("all", *PARTS))
    if split is None and part != "all":
        raise TaskError(f"`part` {part!r} needs a split; give a `split`, or take all tasks.")
    if split is not None and split.graph != graph:
        raise TaskError("the split belongs to another graph.")
    sieve = _Sieve(search or PlanSearch(graph), depth, split, part)
    # At depth 2 a plan is a recipe, and a recipe for an ingredient.
    most_plans = graph.recipe_counts[graph.recipes[:, :2]].sum()
    is_complete = depth <= _ENUMERATED_DEPTH and (depth == 1 or bool(most_plans <= MAX_ENUMERATED))
    if is_complete:
        tasks = {
            posed: plans
            for posed in sorted(set(_enumerated(sieve.search, depth)))
            if (plans := sieve(posed))
        }
    else:
        tasks = _drawn(sieve, _Draw(sieve, weighting, seed), limit)
    if not tasks:
        where = (
            "" if part == "all" else f" in the {part} part ({len(sieve.mixed)} belong to no part)"
        )
        raise TaskError(f"{graph.name} has no task of depth {depth}{where}.")
    return TaskSet(
        graph,
        depth,
        part,
        goals=frozen(np.array([goal for goal, _ in tasks], dtype=np.int64)),
        starts=frozen(padded([start for _, start in tasks], graph.num_entities, depth + 1)),
        plans=tuple(tasks.values()),
        is_complete=is_complete,
        mixed=len(sieve.mixed),
    )


class _Sieve:
    def __init__(self, search: PlanSearch, depth: int, split: Split | None, part: TaskPart):
        self.search, self.depth, self.part = search, depth, part
        self.parts: list[int] | None = (
            None if split is None or part == "all" else split.parts.tolist()
        )
        self.mixed: set[_Posed] = set()

    def __call__(self, posed: _Posed) -> Plans:
        """Return an accepted task's plans, otherwise an empty tuple."""
        goal, start = posed
        have = frozenset(start)
        ways = self.search.shortest_ways(goal, have, self.depth)
        if any(len(way) < self.depth for way in ways):
            return ()
        plans = tuple(self.search.ordered(ways, goal, have))
        if self.parts is None:
            return plans
        of_plans = {max(self.parts[row] for row in plan) for plan in plans}
        if len(of_plans) > 1:
            self.mixed.add(posed)
        return plans if of_plans == {PARTS.index(self.part)} else ()


def _enumerated(search: PlanSearch, depth: int) -> Iterator[_Posed]:
    """Yield goals and leaves of all plans with ``depth`` attempts, 1 or 2; some have shorter plans."""
    for goal, recipes in enumerate(search.recipes_of):
        for _, x, y in recipes:
            if depth == 1:
                yield goal, tuple(sorted({x, y}))
                continue
            for made, other in {(x, y), (y, x)}:
                for pair, a, b in search.recipes_of[made]:
                    leaves = {a, b} | ({other} - {made})
                    if goal not in leaves and made not in leaves:
                        yield goal, tuple(sorted(leaves))
                        if other in search.results(pair) and goal not in (a, b):
                            yield goal, tuple(sorted({a, b}))


class _Draw:
    """Draws goals and leaves of plans, backwards.

    The last step is a random recipe (for train tasks, a train recipe). Then, ``depth - 1`` times, a random leaf with
    recipes is replaced by a random recipe's ingredients. Draws outside the depth and part, and repeated draws, do
    not count. So task t is drawn first with probability

    ``P(t) = W(t) / sum_t' W(t')``, ``W(t) = sum over the ways to build t of q * prod_i 1 / (l_i * r_i)``

    where q is the probability of the last step, l_i the number of leaves with recipes at the i-th replacement, and r_i
    the number of recipes for the replaced leaf.
    """

    def __init__(self, sieve: _Sieve, weighting: TaskWeighting, seed: int):
        self.recipes_of, self.depth, self.weighting = (
            sieve.search.recipes_of,
            sieve.depth,
            weighting,
        )
        self.rng = np.random.default_rng(seed)
        last: dict[int, list[tuple[int, int]]] = {}
        for row, (a, b, result) in enumerate(sieve.search.rows):
            # A test plan may use a test recipe anywhere, but a train plan ends in a train recipe.
            may_end = (
                sieve.parts is None
                or sieve.part != "train"
                or sieve.parts[row] == PARTS.index("train")
            )
            if may_end and result not in (a, b):
                last.setdefault(result, []).append((a, b))
        self.by_goal = list(last.items())
        self.last_steps = [(goal, pair) for goal, pairs in self.by_goal for pair in pairs]

    def __call__(self) -> _Posed | None:
        """Draw once; None without a plan."""
        goal, (a, b) = self._last_step()
        made, leaves = {goal}, {a, b}
        for _ in range(self.depth - 1):
            open_leaves = sorted(leaf for leaf in leaves if self.recipes_of[leaf])
            if not open_leaves:
                return None
            leaf = open_leaves[self.rng.integers(len(open_leaves))]
            _, a, b = self.recipes_of[leaf][self.rng.integers(len(self.recipes_of[leaf]))]
            made.add(leaf)
            leaves = (leaves | {a, b}) - made
            if made & {a, b}:
                return None  # a circle, or an entity that is made already
        return goal, tuple(sorted(leaves))

    def _last_step(self) -> tuple[int, tuple[int, int]]:
        if self.weighting == "task":
            return self.last_steps[self.rng.integers(len(self.last_steps))]
        goal, pairs = self.by_goal[self.rng.integers(len(self.by_goal))]
        return goal, pairs[self.rng.integers(len(pairs))]


def _drawn(sieve: _Sieve, draw: _Draw, limit: int) -> dict[_Posed, Plans]:
    tasks: dict[_Posed, Plans] = {}
    tries = 0
    while draw.last_steps and len(tasks) < limit and tries < _TRIES:
        tries += 1
        posed = draw()
        if posed is not None and posed not in tasks and (plans := sieve(posed)):
            tasks[posed] = plans
            tries = 0
    return tasks
