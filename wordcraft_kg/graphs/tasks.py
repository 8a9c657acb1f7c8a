"""Crafting tasks: make a goal from starting ingredients, with a known least number of attempts.

An *attempt* combines two entities at hand, or as many as a recipe has ingredients; all results
become entities at hand, and nothing is used up. A *plan* is a set of attempts that makes the goal.
A task at depth n has a plan with n attempts whose leaves are exactly the starting ingredients, and
no plan with fewer attempts. Plans of train tasks are those of the train recipes, plans of all other
tasks those of all recipes.

The search numbers attempts as in ``graph.pair_of_recipe``. A *way* is a set of attempts that makes
a goal in some order; a plan is a way in order of execution, as rows in ``graph.sets`` with needed
results. :class:`SolutionSearch` finds all shortest ways to a goal, and :func:`make_tasks` lists
candidate tasks and keeps those of one depth and part.
"""

import hashlib
import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base import TaskError, one_of, stage, whole
from wordcraft_kg.graphs.arrays import Ids, frozen, padded
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.splits import PARTS, Split

Rows = tuple[int, ...]
"""A plan: rows in ``graph.sets`` in order of execution."""
TaskPart = Literal["all", "train", "valid", "test"]
"""Part of a split that tasks belong to; all: whatever recipes their plans use."""


@dataclass(frozen=True)
class CraftingTask:
    """A crafting task, by labels.

    Attributes:
        goal: the entity to make.
        start: starting ingredients, sorted.
        depth: fewest attempts that make the goal.
        plans: all plans with ``depth`` attempts, each as recipes in execution order. A plan may
            have more recipes than attempts: one attempt gives two recipes if both results are
            needed.
    """

    goal: str
    start: tuple[str, ...]
    depth: int
    plans: tuple[tuple[Recipe, ...], ...]


@dataclass(frozen=True, eq=False)
class TaskSet:
    """Crafting tasks at one depth in a part of a split, as arrays.

    Attributes:
        graph: the recipe graph of all tasks.
        depth: fewest attempts that make the goal, the same for all tasks.
        part: part of the split that the tasks belong to, or ``all``.
        goals: shape (N,), entity ids.
        starts: shape (N, L), starting ingredient ids, ascending, padded with ``num_entities``; L is
            :meth:`~wordcraft_kg.graphs.recipe_graph.RecipeGraph.most_leaves`, ``depth + 1`` for
            pairs.
        plans: each task's shortest plans, as rows in ``graph.sets``.
        is_complete: whether all tasks are included; otherwise the tasks were drawn at random.
        mixed: number of tasks that are neither train, valid nor test tasks by all recipes, because
            their plans use recipes from several parts (when drawing: among the tasks met so far); 0
            for train tasks.
    """

    graph: RecipeGraph
    depth: int
    part: TaskPart
    goals: Ids
    starts: Ids
    plans: tuple[tuple[Rows, ...], ...]
    is_complete: bool
    mixed: int

    def __len__(self) -> int:
        return len(self.goals)

    def __getitem__(self, index: int) -> CraftingTask:
        graph = self.graph
        # Starting ingredients are padded with num_entities.
        start = [entity for entity in self.starts[index].tolist() if entity < graph.num_entities]
        plans = [graph.recipe_labels(graph.sets[list(rows)]) for rows in self.plans[index]]
        return CraftingTask(
            graph.entities[self.goals[index]],
            graph.labels(start),
            self.depth,
            tuple(map(tuple, plans)),
        )

    def __iter__(self) -> Iterator[CraftingTask]:
        return (self[index] for index in range(len(self)))

    @cached_property
    def hash(self) -> str:
        """SHA-256 hash of the tasks in order, in hexadecimal."""
        head = f"{self.graph.hash} {self.depth} {self.part} {self.plans}"
        digest = hashlib.sha256(head.encode())
        digest.update(self.starts.tobytes())
        return digest.hexdigest()

    @cached_property
    def uses_twice(self) -> NDArray[np.bool_]:
        """Whether all plans of a task use an entity twice, shape (N,): its start is shorter."""
        pair_of = self.graph.pair_of_recipe.tolist()
        # Each attempt but the last puts one entity, its result, in the place of its ingredients.
        num_leaves = (self.graph.sizes - 1).tolist()
        fewest = []
        for plans in self.plans:
            # An attempt may give several recipes of a plan, and takes its ingredients once.
            attempts = [{pair_of[row]: num_leaves[row] for row in plan} for plan in plans]
            fewest.append(1 + min(sum(leaves.values()) for leaves in attempts))
        num_starts = np.sum(self.starts != self.graph.num_entities, axis=1)
        return np.asarray(num_starts < np.array(fewest, dtype=np.int64))

    @cached_property
    def intermediates(self) -> Ids:
        """Ids of intermediate results in each task's plans, shape (N, I), ascending.

        Padded with ``num_entities``, which is no entity.
        """
        result_of = self.graph.sets[:, -1].tolist()
        intermediates = []
        for plans in self.plans:
            # A plan ends in its goal; all results before are intermediate.
            steps = itertools.chain.from_iterable(plan[:-1] for plan in plans)
            intermediates.append(sorted({result_of[row] for row in steps}))
        return frozen(padded(intermediates, self.graph.num_entities))

    @cached_property
    def final_pairs(self) -> Ids:
        """Numbers of the pairs or sets that make each task's goal in a plan, shape (N, F).

        Ascending, padded with -1, which is no pair.
        """
        pair_of = self.graph.pair_of_recipe.tolist()
        final = []
        for plans in self.plans:
            final.append(sorted({pair_of[plan[-1]] for plan in plans}))
        return frozen(padded(final, -1))


# --- search for tasks and plans ------------------------------------------------------------------

MAX_DEPTH = 5
"""Most attempts in a plan: each further attempt makes the search six times slower."""
DRAWN_TASKS = 1_000
"""Default size of a random set."""
MAX_ENUMERATED = 1_000_000
"""Plans at depth 2 that are enumerated, about 1 kB each; with more of them, tasks are drawn."""
TWICE_SHARE = 0.25
"""Share of the tasks of depth 2 and more whose plans use an entity twice.

In a book it is between a twentieth and a fourth, so that a player does well who never uses an
entity twice. All such tasks stay in a set, and of the others as many as this share allows.
"""
_ENUMERATED_DEPTH = 2  # deeper tasks are drawn at random
_MOST_NEAR = 128  # most entities whose recipes are looked up, about a millisecond
_TRIES = 2_000  # draws without a new task after which drawing stops

_Candidate = tuple[int, Rows]
"""A goal and starting ingredients, ascending: a task if its shortest plan has the right depth."""
Plans = tuple[Rows, ...]
_Way = frozenset[int]


class SolutionSearch:
    """Backward search from a goal for all shortest plans; the oracle for tasks.

    The search is exact and takes time exponential in the number of attempts, which
    :data:`MAX_DEPTH` limits. Python lists and sets, not arrays: a search looks at few recipes,
    very often.

    Attributes:
        graph: the recipe graph.
        rows: all recipes, as lists (ingredients, padding, result) of ids.
        usable: shape (num_recipes,), bool, True for recipes that make something.
        rows_of: by pair number, the rows of its usable recipes; no other pair is a key.
        recipes_of: by entity id, the usable recipes that make the entity, as (pair number,
            different ingredients). None of them uses its own result.
    """

    def __init__(self, graph: RecipeGraph, usable: NDArray[np.bool_] | None = None):
        """Index recipes by result.

        Args:
            graph: the recipe graph.
            usable: shape (num_recipes,), True for recipes that make something; None for all.
        """
        self.graph = graph
        self.rows: list[list[int]] = graph.sets.tolist()
        self.rows_of: dict[int, list[int]] = {}
        self.recipes_of: list[list[tuple[int, Rows]]] = [[] for _ in graph.entities]
        # Usable recipes by their rarest ingredient: a hub's thousands stand under their partners.
        self._by_rarest: list[list[tuple[Rows, int]]] = [[] for _ in graph.entities]
        self.usable = np.ones(graph.num_recipes, dtype=bool) if usable is None else usable
        pair_of = graph.pair_of_recipe.tolist()
        num_uses = graph.use_counts.tolist()
        for row in np.flatnonzero(self.usable).tolist():
            result = self.rows[row][-1]
            pair = pair_of[row]
            self.rows_of.setdefault(pair, []).append(row)
            ingredients = tuple(dict.fromkeys(self.ingredients(pair)))
            # A recipe that needs its own result is part of no shortest plan.
            if result not in ingredients:
                self.recipes_of[result].append((pair, ingredients))
                rarest = min(ingredients, key=num_uses.__getitem__)
                self._by_rarest[rarest].append((ingredients, result))

    def shortest_ways(
        self,
        goal: int,
        have: frozenset[int],
        attempts: int,
    ) -> set[_Way]:
        """Return all ways to make a goal with the fewest attempts.

        Args:
            goal: entity id.
            have: ids of the entities at hand.
            attempts: most attempts.

        Returns:
            Sets of pair numbers, all of the same size; empty if there is no way.
        """
        near = self._near(have, attempts - 1)
        # Iterative deepening: a small budget prunes nearly everything, so most searches are short.
        for budget in range(attempts + 1):
            ways = self._ways(goal, near, budget, frozenset())
            if ways:
                return ways
        return set()

    def _near(self, have: frozenset[int], max_attempts: int) -> list[frozenset[int] | None]:
        """Return the entities within reach of 0, 1, ... ``max_attempts`` attempts.

        An entity that takes n attempts has ingredients that take n - 1 at most. So a search may
        pass over recipes with others, which are nearly all of a hub's thousands. The sets are too
        large, by two ingredients that take an attempt each, and never too small; None stands for
        all entities.

        Args:
            have: ids of the entities at hand.
            max_attempts: most attempts; the set of 0 attempts is there in any case.
        """
        near: list[frozenset[int] | None] = [have]
        within = have
        for _ in range(max_attempts):
            if len(within) > _MOST_NEAR:
                near += [None] * (max_attempts + 1 - len(near))
                break
            new_results: set[int] = set()
            for entity in within:
                for ingredients, result in self._by_rarest[entity]:
                    if within.issuperset(ingredients):
                        new_results.add(result)
            within = within | new_results
            near.append(within)
        return near

    def _ways(
        self,
        goal: int,
        near: Sequence[frozenset[int] | None],
        attempts: int,
        above: frozenset[int],
    ) -> set[_Way]:
        """Return all acyclic ways to make a goal.

        Args:
            goal: entity id.
            near: entities within reach by attempts, from :meth:`_near`; those at hand come first.
            attempts: most attempts in a way.
            above: ids of the entities that need the goal, which no way may go through.
        """
        have = near[0]
        assert have is not None
        if goal in have:
            return {frozenset()}
        recipes = self.recipes_of[goal]
        if attempts <= 0:
            return set()
        if attempts == 1:  # the last attempt: all ingredients are at hand, or it is none
            return {
                frozenset((pair,)) for pair, ingredients in recipes if have.issuperset(ingredients)
            }
        within = near[attempts - 1]
        # A way through an entity that needs this one would go round in a circle.
        above = above | {goal}
        ways: set[_Way] = set()
        for pair, ingredients in recipes:
            if within is not None and not within.issuperset(ingredients):
                continue
            if not above.isdisjoint(ingredients):
                continue
            whole_ways: set[_Way] = {frozenset((pair,))}
            for ingredient in ingredients:
                if ingredient in have:
                    continue
                ingredient_ways = self._ways(ingredient, near, attempts - 1, above)
                way_pairs = itertools.product(whole_ways, ingredient_ways)
                unions = (whole_way | way for whole_way, way in way_pairs)
                # Two ways may share attempts, so that their union is within the number after all.
                whole_ways = {union for union in unions if len(union) <= attempts}
                if not whole_ways:  # then the further ingredients do not matter
                    break
            ways |= whole_ways
        return ways

    def ordered(
        self,
        ways: Iterable[_Way],
        goal: int,
        have: frozenset[int],
    ) -> list[Rows]:
        """Convert ways to plans.

        Args:
            ways: sets of pair numbers that make the goal.
            goal: entity id.
            have: ids of the entities at hand at the start.

        Returns:
            Plans, sorted.
        """
        return sorted(self._plan(way, goal, have) for way in ways)

    def _plan(
        self,
        way: _Way,
        goal: int,
        have: frozenset[int],
    ) -> Rows:
        if len(way) == 1:  # most tasks have depth 1
            (pair,) = way
            return self._rows_for(pair, {goal})
        needed_ids = {goal}
        for pair in way:
            needed_ids.update(self.ingredients(pair))
        at_hand = set(have)
        remaining_pairs = sorted(way)
        plan: list[int] = []
        while remaining_pairs:
            # Of all attempts that are possible now, the pair with the lowest number comes first.
            pair = next(
                pair for pair in remaining_pairs if at_hand.issuperset(self.ingredients(pair))
            )
            remaining_pairs.remove(pair)
            plan += self._rows_for(pair, needed_ids - at_hand)
            at_hand |= self.results(pair)
        # The goal comes last, even among the results of its own pair.
        return tuple(sorted(plan, key=lambda row: self.rows[row][-1] == goal))

    def _rows_for(self, pair: int, result_ids: set[int]) -> Rows:
        """Return the rows of a pair with a wanted result."""
        return tuple(row for row in self.rows_of[pair] if self.rows[row][-1] in result_ids)

    def ingredients(self, pair: int) -> list[int]:
        """Return the ingredient ids for a pair number; one that is needed twice stands twice."""
        *ids, _ = self.rows[self.rows_of[pair][0]]
        padding = self.graph.num_entities
        return [entity for entity in ids if entity != padding]

    def results(self, pair: int) -> set[int]:
        """Return the result ids of the usable recipes for a pair number."""
        return {self.rows[row][-1] for row in self.rows_of[pair]}


@stage("finding tasks")
def make_tasks(
    graph: RecipeGraph,
    depth: int = 1,
    split: Split | None = None,
    part: TaskPart = "all",
    *,
    limit: int = DRAWN_TASKS,
    seed: int = 0,
    search: SolutionSearch | None = None,
    twice_share: float | None = TWICE_SHARE,
) -> TaskSet:
    """Return crafting tasks at a depth, the number of attempts in the shortest plan.

    The set has all tasks at depth 1 and, for fewer than :data:`MAX_ENUMERATED` plans, as many of
    all tasks of depth 2 as ``twice_share`` allows; otherwise it is random, see
    :func:`_drawn_candidates` for the distribution.

    *Train* tasks are those of a book of the train recipes alone: depth and plans know nothing of
    held-out recipes. With all recipes, a task belongs to *test* if each plan uses a test recipe, to
    *valid* if each plan uses a validation recipe and none a test recipe. Any other task can be
    solved with and without held-out recipes; it belongs to neither and is counted.

    Args:
        graph: the recipe graph.
        depth: attempts that a task takes, 1 to :data:`MAX_DEPTH`.
        split: defines the parts; required for any part but ``all``.
        part: ``all``, ``train``, ``valid`` or ``test``.
        limit: largest size of a random set.
        seed: random seed of a random set.
        search: an existing search for the graph; None makes one by the recipes that the part knows.
        twice_share: share of the tasks of depth 2 and more whose plans use an entity twice, above 0
            and below 1; None for the share in the book, as always if a recipe is larger than a
            pair.

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
    if search is None:
        usable = split.is_in("train") if part == "train" and split is not None else None
        search = SolutionSearch(graph, usable)
    accept = _Filter(search, depth, split, part)
    if not graph.has_pairs_only:
        twice_share = None
    # At depth 2 a plan is a recipe, and a recipe for an ingredient; nothing makes the padding.
    recipes = graph.sets[search.usable]
    counts = np.bincount(recipes[:, -1], minlength=graph.num_entities + 1)
    most_plans = counts[recipes[:, :-1]].sum()
    are_few = depth == 1 or bool(most_plans <= MAX_ENUMERATED)
    is_complete = depth <= _ENUMERATED_DEPTH and are_few
    if is_complete:
        every_task: dict[_Candidate, Plans] = {}
        for candidate in sorted(set(_enumerated(accept.search, depth))):
            plans = accept(candidate)
            if plans:
                every_task[candidate] = plans
        tasks = _with_share(every_task, depth, twice_share, np.random.default_rng(seed))
        is_complete = len(tasks) == len(every_task)
    else:
        tasks = _drawn(accept, seed, limit, twice_share)
    if not tasks:
        suffix = f" in the {part} part ({len(accept.mixed)} belong to no part)"
        part_note = "" if part == "all" else suffix
        raise TaskError(f"{graph.name} has no task of depth {depth}{part_note}.")
    goals = np.array([goal for goal, _ in tasks], dtype=np.int64)
    starts = padded([start for _, start in tasks], graph.num_entities, graph.most_leaves(depth))
    return TaskSet(
        graph,
        depth,
        part,
        goals=frozen(goals),
        starts=frozen(starts),
        plans=tuple(tasks.values()),
        is_complete=is_complete,
        mixed=len(accept.mixed),
    )


class _Filter:
    """Accepts the candidates that are tasks of one depth and part.

    Attributes:
        search: finds the plans.
        depth: attempts that a task takes.
        part: part of an accepted task.
        parts: each recipe's part, in the order of the recipes; None if tasks of all parts count.
        mixed: tasks of the depth that were met and belong to no part.
    """

    def __init__(
        self,
        search: SolutionSearch,
        depth: int,
        split: Split | None,
        part: TaskPart,
    ):
        self.search = search
        self.depth = depth
        self.part = part
        self.parts: list[int] | None = None
        if split is not None and part != "all":
            self.parts = split.parts.tolist()
        self.mixed: set[_Candidate] = set()

    def __call__(self, candidate: _Candidate) -> Plans:
        """Return an accepted task's plans, otherwise an empty tuple."""
        goal, start = candidate
        have = frozenset(start)
        ways = self.search.shortest_ways(goal, have, self.depth)
        if any(len(way) < self.depth for way in ways):
            return ()
        plans = tuple(self.search.ordered(ways, goal, have))
        if self.parts is None:
            return plans
        # Parts are numbered train, valid, test: a plan belongs to the highest part of its recipes.
        part_of = self.parts.__getitem__
        parts = {max(map(part_of, plan)) for plan in plans}
        if len(parts) > 1:
            self.mixed.add(candidate)
        return plans if parts == {PARTS.index(self.part)} else ()


def _with_share(
    tasks: dict[_Candidate, Plans],
    depth: int,
    share: float | None,
    rng: np.random.Generator,
) -> dict[_Candidate, Plans]:
    """Return tasks of which a share use an entity twice, in the same order.

    Of those that are too many, some are drawn; a set without the others stays as it is.

    Args:
        tasks: plans by task.
        depth: attempts that a task takes; at depth 1 all tasks stay.
        share: share of the tasks that use an entity twice; None for that of ``tasks``.
        rng: draws the tasks that stay.
    """
    is_twice = np.array([len(start) <= depth for _, start in tasks], dtype=bool)
    num_twice = int(is_twice.sum())
    num_others = len(tasks) - num_twice
    if depth == 1 or share is None or not num_twice or not num_others:
        return tasks
    size = min(num_twice / share, num_others / (1 - share))
    most_twice = round(size * share)
    stays = np.zeros(len(tasks), dtype=bool)
    for kind, max_tasks in ((is_twice, most_twice), (~is_twice, round(size) - most_twice)):
        stays[rng.permutation(np.flatnonzero(kind))[:max_tasks]] = True
    return dict(itertools.compress(tasks.items(), stays))


def _enumerated(search: SolutionSearch, depth: int) -> Iterator[_Candidate]:
    """Yield goals and leaves of all plans with ``depth`` attempts, 1 or 2; some not shortest.

    A candidate may come several times, in no fixed order.
    """
    for goal, recipes in enumerate(search.recipes_of):
        for _, ingredients in recipes:
            if depth == 1:
                yield goal, tuple(sorted(ingredients))
                continue
            # Of the last set, any ingredient may be made; the others are at hand or made too.
            for crafted in ingredients:
                partners = {*ingredients} - {crafted}
                for pair, crafted_ingredients in search.recipes_of[crafted]:
                    leaves = partners.union(crafted_ingredients)
                    if goal in leaves or crafted in leaves:
                        continue
                    # One attempt may make several ingredients of the last set.
                    made = sorted(partners & search.results(pair))
                    for spared in _subsets(made):
                        starts = (partners - {*spared}).union(crafted_ingredients)
                        yield goal, tuple(sorted(starts))


def _subsets(items: Sequence[int]) -> Iterator[Rows]:
    """Yield all subsets of items, the empty one first."""
    for size in range(len(items) + 1):
        yield from itertools.combinations(items, size)


def _drawn_candidates(
    search: SolutionSearch,
    depth: int,
    rng: np.random.Generator,
) -> Iterator[_Candidate | None]:
    """Yield goals and leaves of plans, drawn backwards, without end; None for a draw of no plan.

    The last step is a random usable recipe. Then, ``depth - 1`` times, a random leaf with recipes
    is replaced by a random recipe's ingredients. Draws outside the depth and part, and repeated
    draws, do not count. So task t is drawn first with probability

    ``P(t) = W(t) / sum_t' W(t')``,
    ``W(t) = sum over the ways to build t of q * prod_i 1 / (l_i * r_i)``

    where q is 1 / number of allowed recipes, l_i the number of leaves with recipes at the i-th
    replacement, and r_i the number of recipes for the replaced leaf.
    """
    rows = [search.rows[row] for row in np.flatnonzero(search.usable).tolist()]
    # Goals in the order of their first recipe: the order decides what a seed draws.
    goals = list(dict.fromkeys(row[-1] for row in rows if row[-1] not in row[:-1]))
    last_steps: list[tuple[int, Rows]] = []
    for goal in goals:
        last_steps += [(goal, ingredients) for _, ingredients in search.recipes_of[goal]]
    while last_steps:
        goal, ingredients = last_steps[rng.integers(len(last_steps))]
        leaves = _drawn_leaves(search, goal, ingredients, depth, rng)
        yield None if leaves is None else (goal, tuple(sorted(leaves)))


def _drawn_leaves(
    search: SolutionSearch,
    goal: int,
    ingredients: Rows,
    depth: int,
    rng: np.random.Generator,
) -> set[int] | None:
    """Draw the leaves of a plan by its last step; None if the steps are no plan of this depth."""
    crafted_ids = {goal}
    leaves = {*ingredients}
    for _ in range(depth - 1):
        # Sorted, because no promise of Python fixes the order of a set.
        open_leaves = sorted(leaf for leaf in leaves if search.recipes_of[leaf])
        if not open_leaves:
            return None
        leaf = open_leaves[rng.integers(len(open_leaves))]
        recipes = search.recipes_of[leaf]
        _, ingredients = recipes[rng.integers(len(recipes))]
        crafted_ids.add(leaf)
        leaves = leaves.union(ingredients) - crafted_ids
        if not crafted_ids.isdisjoint(ingredients):
            return None  # a circle, or an entity that is made already
    return leaves


def _drawn(
    accept: _Filter,
    seed: int,
    limit: int,
    share: float | None,
) -> dict[_Candidate, Plans]:
    """Return distinct tasks in the order in which they were drawn, at most ``limit``.

    Once the set has its share of tasks that use an entity twice, or of the others, further ones of
    the kind count as draws without a new task.
    """
    rng = np.random.default_rng(seed)
    tasks: dict[_Candidate, Plans] = {}
    tries = 0
    room = {True: limit, False: limit}
    if share is not None:
        room[True] = round(limit * share)
        room[False] = limit - room[True]
    candidates = _drawn_candidates(accept.search, accept.depth, rng)
    # Most draws of a deep task fail, and a small part has few tasks: stop after many failures.
    while len(tasks) < limit and tries < _TRIES:
        tries += 1
        candidate = next(candidates, None)
        if candidate is None or candidate in tasks:
            continue
        is_twice = len(candidate[1]) <= accept.depth
        if not room[is_twice]:
            continue
        plans = accept(candidate)
        if plans:
            tasks[candidate] = plans
            room[is_twice] -= 1
            tries = 0
    if len(tasks) == limit:
        return tasks
    return _with_share(tasks, accept.depth, share, rng)
