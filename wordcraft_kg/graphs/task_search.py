"""Finding the tasks of a graph by the part of their plans: all of them while they are few enough, else a random set."""

from collections.abc import Iterator

import numpy as np

from wordcraft_kg.base.errors import TaskError
from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.settings import one_of, whole
from wordcraft_kg.graphs.arrays import frozen, padded
from wordcraft_kg.graphs.plan_search import PlanSearch, Rows
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import PARTS, Split
from wordcraft_kg.graphs.tasks import TaskPart, TaskSet, TaskWeighting

MAX_DEPTH = 5
"""Longer plans are not searched: each further attempt makes the search six times slower."""
ENUMERATED_DEPTH = 2
"""Up to this depth all tasks are enumerated; deeper ones are drawn at random."""
MAX_ENUMERATED = 1_000_000
"""Most plans of depth 2 that are enumerated, each in about 1 kB; of a graph with more, tasks are drawn there too."""
DRAWN_TASKS = 1_000
"""How many tasks are drawn where they are not enumerated."""
_TRIES = 2_000  # draws without a new task after which drawing stops

Posed = tuple[int, Rows]
"""A task as it is posed: its goal and its starting ingredients, ascending."""
Plans = tuple[Rows, ...]


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
    """Return the tasks of a depth: all of them at depth 1 and 2, a random set of them beyond.

    A graph with more than :data:`MAX_ENUMERATED` plans of depth 2, a book of tens of thousands of entities, gets a
    random set at that depth too.

    A task belongs to *train* if all its plans use train recipes only, to *test* if each of them uses a test recipe, to
    *valid* if each uses a validation recipe and none a test recipe. Any other belongs to no part and is counted.

    A deeper task is drawn backwards. A random recipe is the last step (for train tasks, a train recipe; with
    ``weighting="goal"``, a random recipe of a random goal). Then, ``depth - 1`` times, a random leaf that has recipes
    is replaced by the ingredients of one of them, at random. The draw is repeated if the result is not a task of this
    depth and part, or was drawn before. The probability that task t is drawn first is

    ``P(t) = W(t) / sum_t' W(t')``, ``W(t) = sum over the ways to build t of q * prod_i 1 / (l_i * r_i)``

    where q is the probability of the last step (1 / number of allowed recipes; or 1 / number of goals / number of the
    goal's recipes), l_i the number of leaves that have recipes at the i-th replacement, and r_i the number of recipes
    of the leaf replaced.

    Args:
        graph: the graph; plans may use all its recipes.
        depth: attempts that a task takes, from 1.
        split: split that defines the parts; needed for any part but ``all``.
        part: ``all``, ``train``, ``valid`` or ``test``.
        weighting: how the last step of a drawn task is chosen: among all recipes (task) or by goal first (goal).
        limit: maximum number of tasks to draw.
        seed: seed of the draw.
        search: the graph's plan search, if there is one already.

    Raises:
        ConfigError: for a depth or part outside its range.
        TaskError: if there is no such task, or the split does not fit.
    """
    whole("depth", depth, 1, MAX_DEPTH)
    one_of("part", part, ("all", *PARTS))
    if split is None and part != "all":
        raise TaskError(f"`part` {part!r} needs a split; give one, or take all tasks.")
    if split is not None and split.graph != graph:
        raise TaskError("the split belongs to another graph.")
    sieve = _Sieve(search or PlanSearch(graph), depth, split, part)
    is_complete = depth <= ENUMERATED_DEPTH and (depth == 1 or _num_plans_of_two(graph) <= MAX_ENUMERATED)
    if is_complete:
        tasks = {posed: plans for posed in sorted(set(_enumerated(sieve.search, depth))) if (plans := sieve(posed))}
    else:
        tasks = _drawn(sieve, _Draw(sieve, weighting, seed), limit)
    if not tasks:
        where = "" if part == "all" else f" in the {part} part ({len(sieve.mixed)} belong to no part)"
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


def _num_plans_of_two(graph: RecipeGraph) -> int:
    """Return how many plans of two attempts there are at most: a recipe, and a recipe of one of its ingredients."""
    return int(graph.recipe_counts[graph.recipes[:, :2]].sum())


class _Sieve:
    """Accepts only the tasks of one depth and part.

    Attributes:
        mixed: tasks of the depth that were met and belong to no part.
    """

    def __init__(self, search: PlanSearch, depth: int, split: Split | None, part: TaskPart):
        self.search, self.depth, self.part = search, depth, part
        self.parts: list[int] | None = None if split is None or part == "all" else split.parts.tolist()
        self.mixed: set[Posed] = set()

    def __call__(self, posed: Posed) -> Plans:
        """Return the plans of a task; none for anything else."""
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

    def may_end(self, row: int) -> bool:
        """Whether a recipe may be the last step of a plan."""
        # Each test plan uses a test recipe somewhere, not necessarily at its end.
        return self.parts is None or self.part != "train" or self.parts[row] == PARTS.index("train")


def _enumerated(search: PlanSearch, depth: int) -> Iterator[Posed]:
    """Yield the goals and leaves of all plans of ``depth`` attempts, 1 or 2, some of which need fewer."""
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
    """Draws the goals and leaves of plans, backwards from the last step; see :func:`make_tasks`."""

    def __init__(self, sieve: _Sieve, weighting: TaskWeighting, seed: int):
        self.recipes_of, self.depth, self.weighting = sieve.search.recipes_of, sieve.depth, weighting
        self.rng = np.random.default_rng(seed)
        last: dict[int, list[tuple[int, int]]] = {}
        for row, (a, b, result) in enumerate(sieve.search.rows):
            if sieve.may_end(row) and result not in (a, b):
                last.setdefault(result, []).append((a, b))
        self.by_goal = list(last.items())
        self.last_steps = [(goal, pair) for goal, pairs in self.by_goal for pair in pairs]

    def __call__(self) -> Posed | None:
        """Draw once; None if the draw leads to no plan."""
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
        """Draw a goal and the ingredients that make it."""
        if self.weighting == "task":
            return self.last_steps[self.rng.integers(len(self.last_steps))]
        goal, pairs = self.by_goal[self.rng.integers(len(self.by_goal))]
        return goal, pairs[self.rng.integers(len(pairs))]


def _drawn(sieve: _Sieve, draw: _Draw, limit: int) -> dict[Posed, Plans]:
    """Return distinct tasks in the order in which they were drawn."""
    tasks: dict[Posed, Plans] = {}
    tries = 0
    while draw.last_steps and len(tasks) < limit and tries < _TRIES:
        tries += 1
        posed = draw()
        if posed is not None and posed not in tasks and (plans := sieve(posed)):
            tasks[posed] = plans
            tries = 0
    return tasks
