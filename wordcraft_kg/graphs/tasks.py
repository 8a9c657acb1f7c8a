"""Crafting tasks: a goal and starting ingredients from which a known number of attempts makes it, and no fewer.

An *attempt* combines two entities at hand; all results of the pair are at hand from then on, and nothing is used up. A
*plan* is a set of attempts that makes the goal. A task of depth n has a plan of n attempts whose leaves are exactly the
starting ingredients, and no plan of fewer, whatever the book offers.
"""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.errors import TaskError
from wordcraft_kg.graphs.arrays import Ids, frozen, padded
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.splits import PARTS, Split

MAX_DEPTH = 5
"""Plans of more attempts are not searched: each attempt more makes the search six times longer."""
ENUMERATED_DEPTH = 2
"""Up to this depth all tasks are known; deeper ones are drawn."""
DRAWN_TASKS = 1_000
"""How many tasks are drawn where they are not enumerated."""
_TRIES = 2_000  # draws without a new task after which the rest is given up

TaskPart = Literal["all", "train", "valid", "test"]
TaskWeighting = Literal["task", "goal"]
Rows = tuple[int, ...]


@dataclass(frozen=True)
class Task:
    """A crafting task, by labels; tasks of equal content are equal.

    Attributes:
        goal: what is to be made.
        start: starting ingredients, sorted; never the goal.
        depth: attempts that are necessary and sufficient.
        plans: all plans of ``depth`` attempts, each as recipes in an order in which they can be carried out. Two
            recipes of one plan may belong to one attempt, where both results of its pair are needed.
    """

    goal: str
    start: tuple[str, ...]
    depth: int
    plans: tuple[tuple[Recipe, ...], ...]


@dataclass(frozen=True, eq=False)
class TaskSet:
    """The tasks of one depth and part, as arrays that environments draw from; equal if their content is.

    Attributes:
        graph: their graph.
        depth: of all of them.
        part: whose recipes the plans use, or ``all``.
        goals: shape (N,), entity ids.
        starts: shape (N, depth + 1), entity ids, ascending, padded with ``num_entities``.
        plans: for each task its plans, each a tuple of recipe rows in the order of execution.
        is_complete: whether these are all tasks there are; otherwise they were drawn.
        mixed: tasks that belong to no part, because their plans use recipes of different ones (drawn sets: of those
            that came up).
    """

    graph: RecipeGraph
    depth: int
    part: TaskPart
    goals: Ids
    starts: Ids
    plans: tuple[tuple[Rows, ...], ...]
    is_complete: bool
    mixed: int

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TaskSet):
            return NotImplemented
        # Plans end in their goal, so they and the starts say everything; arrays as bytes, for == of arrays is no bool.
        return self._content() == other._content()

    def __hash__(self) -> int:
        return hash(self._content())

    def _content(self) -> tuple[object, ...]:
        return self.graph, self.depth, self.part, self.starts.tobytes(), self.plans, self.is_complete, self.mixed

    def __len__(self) -> int:
        return len(self.goals)

    def __getitem__(self, index: int) -> Task:
        graph = self.graph
        start = [entity for entity in self.starts[index].tolist() if entity < graph.num_entities]
        plans = tuple(tuple(graph.recipe_labels(graph.recipes[list(rows)])) for rows in self.plans[index])
        return Task(graph.entities[self.goals[index]], graph.labels(start), self.depth, plans)

    def __iter__(self) -> Iterator[Task]:
        return (self[index] for index in range(len(self)))

    @cached_property
    def intermediates(self) -> Ids:
        """What the plans make on the way, shape (N, at most ``depth - 1`` a plan), padded with ``num_entities``."""
        made = self.graph.recipes[:, 2].tolist()
        rows = [sorted({made[row] for plan in plans for row in plan[:-1]}) for plans in self.plans]
        return frozen(padded(rows, self.graph.num_entities))

    @cached_property
    def final_pairs(self) -> Ids:
        """Numbers of the pairs that end the plans, shape (N, F), padded with -1."""
        pair = self.graph.pair_of_recipe.tolist()
        return frozen(padded([sorted({pair[plan[-1]] for plan in plans}) for plans in self.plans], -1))

    def weights(self, weighting: TaskWeighting = "task") -> NDArray[np.float64]:
        """Return the probability of each task: equal for all, or equal for all goals and then for the goal's tasks."""
        if weighting == "task":
            return np.full(len(self), 1 / max(len(self), 1))
        _, goal, count = np.unique(self.goals, return_inverse=True, return_counts=True)
        return 1 / (len(count) * count[goal])


def plans_of(graph: RecipeGraph, goal: Entity, at_hand: Iterable[Entity], attempts: int) -> list[Rows]:
    """Return all plans of the least number of attempts that make a goal, if that is at most ``attempts``.

    Args:
        graph: the recipes that may be used, all of them.
        goal: entity to make.
        at_hand: entities there at the start.
        attempts: how many may be used.

    Returns:
        plans as recipe rows in an order of execution, sorted; empty if there is none, and one empty plan if the goal is
        at hand.
    """
    have = frozenset(graph.id_of(entity) for entity in at_hand)
    target = graph.id_of(goal)
    search = _Recipes.of(graph)
    for budget in range(attempts + 1):
        found = search.ways(target, budget, have, frozenset())
        if found:
            return sorted(search.ordered(way, target, have) for way in found)
    return []


def all_ways(graph: RecipeGraph, goal: int, at_hand: Iterable[int], attempts: int) -> set[frozenset[int]]:
    """Return the sets of at most ``attempts`` pairs, by number, that make a goal from what is at hand."""
    return _Recipes.of(graph).ways(goal, attempts, frozenset(at_hand), frozenset())


def make_tasks(
    graph: RecipeGraph,
    depth: int = 1,
    split: Split | None = None,
    part: TaskPart = "all",
    *,
    weighting: TaskWeighting = "task",
    limit: int = DRAWN_TASKS,
    seed: int = 0,
) -> TaskSet:
    """Return the tasks of a depth: all of them at depth 1 and 2, and a drawn set of them beyond.

    A task belongs to *train* if all its plans use train recipes only, to *test* if each of them uses a test recipe, to
    *valid* if each uses a validation recipe and none a test recipe. Any other belongs to no part and is counted.

    A deeper task is drawn backwards: a recipe at random, for train tasks a train recipe, is the last step (with
    ``weighting="goal"``, a goal and then one of its recipes); then, ``depth - 1`` times, a random leaf that has recipes
    is replaced by the ingredients of a random one of them. What is not a task of this depth and part is drawn again,
    what was drawn before is kept once. So the first task drawn has the probability, up to the share of refused draws,
    of all ways to build one of its plans, each the product of 1 / (number of choices).

    Args:
        graph: the graph; plans may use all its recipes.
        depth: attempts that a task takes, from 1.
        split: whose parts count; needed for any part but ``all``.
        part: ``all``, ``train``, ``valid`` or ``test``.
        weighting: of the last step's recipe where tasks are drawn.
        limit: most tasks to draw.
        seed: of the draw.

    Raises:
        TaskError: if there is no such depth or part, or no such task.
    """
    if not 1 <= depth <= MAX_DEPTH:
        raise TaskError(f"depth {depth}: expected 1 to {MAX_DEPTH} attempts.")
    if part != "all" and part not in PARTS:
        raise TaskError(f"no part '{part}'; there are all, {', '.join(PARTS)}.")
    if split is None and part != "all":
        raise TaskError(f"the part '{part}' needs a split; give one, or take all tasks.")
    if split is not None and split.graph != graph:
        raise TaskError("the split belongs to another graph.")
    made = _make_tasks(graph, depth, split, part, weighting, limit, seed)
    if not len(made):
        where = "" if part == "all" else f" in the {part} part ({made.mixed} belong to no part)"
        raise TaskError(f"{graph.name} has no task of depth {depth}{where}.")
    return made


@lru_cache(maxsize=16)
def _make_tasks(
    graph: RecipeGraph,
    depth: int,
    split: Split | None,
    part: TaskPart,
    weighting: TaskWeighting,
    limit: int,
    seed: int,
) -> TaskSet:
    search = _Recipes.of(graph)
    parts = None if split is None else split.parts.tolist()
    mixed: set[tuple[int, Rows]] = set()

    def plans(goal: int, start: Rows) -> tuple[Rows, ...] | None:
        """The plans of a task of this depth and part; None for anything else."""
        have = frozenset(start)
        if any(search.ways(goal, budget, have, frozenset()) for budget in range(1, depth)):
            return None
        found = sorted(search.ordered(way, goal, have) for way in search.ways(goal, depth, have, frozenset()))
        if part == "all" or parts is None:
            return tuple(found)
        of_plans = {max(parts[row] for row in plan) for plan in found}
        if len(of_plans) > 1:
            mixed.add((goal, start))
        return tuple(found) if of_plans == {PARTS.index(part)} else None

    tasks: dict[tuple[int, Rows], tuple[Rows, ...]] = {}
    if depth <= ENUMERATED_DEPTH:
        for key in sorted(set(search.candidates(depth))):
            found = plans(*key)
            if found:
                tasks[key] = found
    else:
        rng = np.random.default_rng(seed)
        last = search.last_steps(None if part == "all" or split is None else split, part)
        tries = 0
        while last and len(tasks) < limit and tries < _TRIES:
            tries += 1
            key_or_none = search.draw(depth, last, weighting, rng)
            if key_or_none is not None and key_or_none not in tasks:
                found = plans(*key_or_none)
                if found:
                    tasks[key_or_none] = found
                    tries = 0
    return TaskSet(
        graph,
        depth,
        part,
        frozen(np.array([goal for goal, _ in tasks], dtype=np.int64)),
        frozen(padded([start for _, start in tasks], graph.num_entities, depth + 1)),
        tuple(tasks.values()),
        depth <= ENUMERATED_DEPTH,
        len(mixed),
    )


class _Recipes:
    """Recipes by result as Python tuples, for searches that look at a few of them very often."""

    def __init__(self, graph: RecipeGraph):
        rows, pairs = graph.recipes.tolist(), graph.pair_of_recipe.tolist()
        self.rows: list[list[int]] = rows
        self.pair: list[int] = pairs
        self.starts: list[int] = graph.pair_starts.tolist()
        self.by_result: list[list[tuple[int, int, int]]] = [[] for _ in range(graph.num_entities)]
        for pair, (a, b, result) in zip(pairs, rows, strict=True):
            if result not in (a, b):
                self.by_result[result].append((pair, a, b))

    @staticmethod
    @lru_cache(maxsize=4)
    def of(graph: RecipeGraph) -> "_Recipes":
        return _Recipes(graph)

    def ways(self, entity: int, budget: int, have: frozenset[int], above: frozenset[int]) -> set[frozenset[int]]:
        """Return the sets of at most ``budget`` pairs that make ``entity``, without going in circles."""
        if entity in have:
            return {frozenset()}
        if budget == 0:
            return set()
        if budget == 1:
            return {frozenset((pair,)) for pair, a, b in self.by_result[entity] if a in have and b in have}
        above = above | {entity}
        found = set()
        for pair, a, b in self.by_result[entity]:
            if a in above or b in above:
                continue
            one = self.ways(a, budget - 1, have, above)
            if not one:
                continue
            other = one if a == b else self.ways(b, budget - 1, have, above)
            for way_a, way_b in itertools.product(one, other) if a != b else ((way, way) for way in one):
                way = way_a | way_b | {pair}
                if len(way) <= budget:
                    found.add(way)
        return found

    def ordered(self, way: frozenset[int], goal: int, have: frozenset[int]) -> Rows:
        """Return the recipe rows that carry out a set of pairs, in an order in which they can be carried out."""
        if len(way) == 1:  # most tasks are of depth 1
            (pair,) = way
            rows = range(self.starts[pair], self.starts[pair + 1])
            return tuple(row for row in rows if self.rows[row][2] == goal)
        needed = {goal}.union(*(self.rows[self.starts[pair]][:2] for pair in way))
        at_hand, left, plan = set(have), sorted(way), []
        while left:
            pair = next(pair for pair in left if at_hand.issuperset(self.rows[self.starts[pair]][:2]))
            left.remove(pair)
            for row in range(self.starts[pair], self.starts[pair + 1]):
                result = self.rows[row][2]
                if result in needed and result not in at_hand:
                    plan.append(row)
            at_hand.update(self.rows[row][2] for row in range(self.starts[pair], self.starts[pair + 1]))
        # The goal comes last, also among the results of its own pair.
        return tuple(sorted(plan, key=lambda row: self.rows[row][2] == goal))

    def candidates(self, depth: int) -> Iterator[tuple[int, Rows]]:
        """Yield the goals and leaves of all plans of ``depth`` attempts, some of which need fewer."""
        for goal, recipes in enumerate(self.by_result):
            for _, x, y in recipes:
                if depth == 1:
                    yield goal, tuple(sorted({x, y}))
                    continue
                for made, other in {(x, y), (y, x)}:
                    for pair, a, b in self.by_result[made]:
                        leaves = {a, b} | ({other} - {made})
                        if goal not in leaves and made not in leaves:
                            yield goal, tuple(sorted(leaves))
                            results = {self.rows[row][2] for row in range(self.starts[pair], self.starts[pair + 1])}
                            if other in results and goal not in (a, b):
                                yield goal, tuple(sorted({a, b}))

    def last_steps(self, split: Split | None, part: TaskPart) -> dict[int, list[tuple[int, int]]]:
        """Return the ingredients of the recipes that may end a plan, by goal."""
        last: dict[int, list[tuple[int, int]]] = {}
        for row, (a, b, result) in enumerate(self.rows):
            # Each test plan uses a test recipe somewhere, not necessarily at its end.
            allowed = split is None or part != "train" or split.parts[row] == PARTS.index("train")
            if allowed and result not in (a, b):
                last.setdefault(result, []).append((a, b))
        return last

    def draw(
        self,
        depth: int,
        last: dict[int, list[tuple[int, int]]],
        weighting: TaskWeighting,
        rng: np.random.Generator,
    ) -> tuple[int, Rows] | None:
        """Draw a goal and leaves of a plan of ``depth`` attempts, or None where the draw leads nowhere."""
        goals = list(last)
        if weighting == "goal":
            goal = goals[rng.integers(len(goals))]
            a, b = last[goal][rng.integers(len(last[goal]))]
        else:
            ends = np.cumsum([len(last[goal]) for goal in goals])
            number = int(rng.integers(ends[-1]))
            index = int(np.searchsorted(ends, number, side="right"))
            goal = goals[index]
            a, b = last[goal][number - int(ends[index]) + len(last[goal])]
        made, leaves = {goal}, {a, b}
        for _ in range(depth - 1):
            open_leaves = sorted(leaf for leaf in leaves if self.by_result[leaf])
            if not open_leaves:
                return None
            leaf = open_leaves[rng.integers(len(open_leaves))]
            _, a, b = self.by_result[leaf][rng.integers(len(self.by_result[leaf]))]
            made.add(leaf)
            leaves = (leaves | {a, b}) - made
            if made & {a, b}:
                return None  # a circle, or something that is made already
        return goal, tuple(sorted(leaves))


def replay(graph: RecipeGraph, start: Iterable[Entity], plan: Iterable[Recipe]) -> frozenset[str]:
    """Carry out a plan and return what is at hand then.

    Raises:
        TaskError: if a recipe needs what is not at hand, or the graph does not have it.
    """
    at_hand = {graph.entities[graph.id_of(entity)] for entity in start}
    for recipe in plan:
        missing = {recipe.ingredient_a, recipe.ingredient_b} - at_hand
        results = graph.labels(graph.results(recipe.ingredient_a, recipe.ingredient_b))
        if missing or recipe.result not in results:
            reason = f"{', '.join(sorted(missing))} is not at hand" if missing else "there is no such recipe"
            raise TaskError(f"{recipe.ingredient_a} + {recipe.ingredient_b} -> {recipe.result}: {reason}.")
        at_hand.update(results)
    return frozenset(at_hand)
