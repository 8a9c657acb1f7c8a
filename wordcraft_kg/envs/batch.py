"""Many crafting environments at once, as arrays: the semantics of :mod:`wordcraft_kg.envs.wordcraft`, in bulk.

The engine is written once, in the operators and the indexing that NumPy and torch share. On the CPU its arrays are
NumPy's, because a step is some thirty calls on short arrays and a call costs NumPy half of what it costs torch; the
agent sees the same memory through ``torch.from_numpy``. On a CUDA device they are torch tensors and never leave it.

Random numbers are a function of (seed, environment, episode, draw), hashed, not a stream: so an environment sees the
same episodes however many run beside it, on either kind of array, and episodes can be prepared ahead in bulk.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import GraphLike, World
from wordcraft_kg.errors import ActionError, ConfigError, EpisodeError

Array = Any
"""A NumPy array, or a torch tensor on a CUDA device."""

IN_PROGRESS, GOAL, OUT_OF_ATTEMPTS = 0, 1, 2
OUTCOMES = ("in_progress", "goal", "out_of_attempts")
"""Names of the outcome codes."""

AHEAD = 8
"""Episodes that are prepared at a time for each environment."""
DENSE_LIMIT = 4_096
"""Entities up to which the pair of two entities is looked up in a square table, 4 bytes a cell; above it by search."""
MASK_BITS = 62
_SPARE = 4  # distractor candidates drawn beyond those needed, so that few rows need a second round


@dataclass
class Step:
    """What a step of all environments gives, shape (N,) each.

    Attributes:
        reward: float32.
        over: whether the episode ended with this step; where it did, the observation is of the next one.
        outcome: int8, of the episode that the step belongs to: see :data:`OUTCOMES`.
        by_plan: whether the goal was made by the last pair of a plan.
        illegal: whether an empty slot was picked.
        task: index of the task that the step belongs to.
    """

    reward: Array
    over: Array
    outcome: Array
    by_plan: Array
    illegal: Array
    task: Array


class BatchEngine:
    """N environments in step, with episodes that begin anew inside the step.

    Attributes:
        goal, selection, attempts_left, task: shape (N,), int64.
        table: shape (N, num_slots), int64, ids; ``num_entities`` where empty.
        num_envs: N.
    """

    def __init__(self, graph: GraphLike, config: WordCraftConfig, num_envs: int, *, device: str = "cpu", seed: int = 0):
        """Prepare N environments; :meth:`reset` begins.

        Args:
            graph: see :class:`~wordcraft_kg.envs.wordcraft.WordCraftEnv`.
            config: settings, the same for all.
            num_envs: N, from 1.
            device: ``cpu``, or a device of torch such as ``cuda``.
            seed: see :meth:`reset`.

        Raises:
            ConfigError: for no environments, or a device that is not there.
        """
        if num_envs < 1:
            raise ConfigError(f"num_envs {num_envs}: expected 1 or more.")
        self.num_envs = num_envs
        self.world = World(graph, config)
        self.config = config
        self.xp: Any = np
        self.device = device
        if device != "cpu":
            import torch

            if device.startswith("cuda") and not torch.cuda.is_available():
                raise ConfigError(f"device '{device}': torch finds no CUDA device here; use cpu.")
            self.xp = torch
        self._prepare_tables()
        self._rows = self._array(np.arange(num_envs))
        self._first_table: Array = None
        self.reset(seed)

    # --- arrays of either kind ---------------------------------------------------------------------------------------

    def _array(self, values: np.ndarray) -> Array:
        """Bring a NumPy array to the engine's side."""
        if self.xp is np:
            return np.ascontiguousarray(values)
        return self.xp.from_numpy(np.ascontiguousarray(values)).to(self.device.removeprefix("torch:"))

    def _full(self, shape: tuple[int, ...], value: int, dtype: str = "int64") -> Array:
        if self.xp is np:
            return np.full(shape, value, dtype=dtype)
        return self.xp.full(shape, value, dtype=getattr(self.xp, dtype), device=self.device.removeprefix("torch:"))

    def _cast(self, values: Array, dtype: str) -> Array:
        return values.astype(dtype) if self.xp is np else values.to(getattr(self.xp, dtype))

    def _prepare_tables(self) -> None:
        world = self.world
        graph, tasks, nothing = world.graph, world.tasks, world.padding
        self.nothing = nothing
        self.num_slots = world.num_slots
        self._goals = self._array(tasks.goals)
        self._starts = self._array(tasks.starts)
        made = tasks.intermediates if tasks.intermediates.shape[1] else np.full((len(tasks), 1), nothing)
        self._made = self._array(made)
        self._finals = self._array(tasks.final_pairs)
        # Results of each pair, and of no pair in a last row.
        starts, sizes = graph.pair_starts[:-1], np.diff(graph.pair_starts)
        results = np.full((graph.num_pairs + 1, world.max_results), nothing)
        for i in range(world.max_results):
            rows = starts + (sizes - 1 if self.config.ambiguity == "last" else i)
            has = sizes > i
            results[:-1][has, i] = graph.recipes[rows[has], 2]
        self._results = self._array(results)
        firsts = graph.recipes[starts]
        self._no_pair = graph.num_pairs
        self._dense = nothing <= DENSE_LIMIT
        if self._dense:
            table = np.full((nothing + 1, nothing + 1), graph.num_pairs, dtype=np.int32)
            table[firsts[:, 0], firsts[:, 1]] = table[firsts[:, 1], firsts[:, 0]] = np.arange(graph.num_pairs)
            self._pair_table = self._array(table.reshape(-1))
        else:
            self._pair_keys = self._array(np.append(firsts[:, 0] * (nothing + 1) + firsts[:, 1], np.iinfo("int64").max))
        weights = world.distractor_weights
        self._lots = self._array(np.repeat(np.arange(nothing), weights))
        self._weights = self._array(weights.astype(np.float64))
        self._task_ends = self._array(np.cumsum(tasks.weights(self.config.task_weighting)))
        self._prepare_guards()

    def _prepare_guards(self) -> None:
        """Prepare the recipes that no distractor may complete: for each goal and entity, in which of them it stands.

        Bit k of ``_as_one[goal, entity]`` says that the entity is the first ingredient of the goal's k-th guarded
        recipe, ``_as_other`` the second. Rows exist for guarded goals only; row 0 is empty.
        """
        world = self.world
        rows = world.graph.recipes[world.guarded_recipes]
        self._has_guards = bool(len(rows))
        if not self._has_guards:
            return
        goals, counts = np.unique(rows[:, 2], return_counts=True)
        words = -(-int(counts.max()) // MASK_BITS)
        row_of = np.zeros(world.padding + 1, dtype=np.int64)
        row_of[goals] = np.arange(1, len(goals) + 1)
        masks = np.zeros((2, words, len(goals) + 1, world.padding + 1), dtype=np.int64)
        seen = np.zeros(len(goals) + 1, dtype=np.int64)
        for a, b, goal in rows.tolist():
            row = row_of[goal]
            word, bit = divmod(int(seen[row]), MASK_BITS)
            seen[row] += 1
            masks[0, word, row, a] |= 1 << bit
            masks[1, word, row, b] |= 1 << bit
        self._guard_row = self._array(row_of)
        self._guards = [
            (self._array(masks[0, word].reshape(-1)), self._array(masks[1, word].reshape(-1))) for word in range(words)
        ]

    # --- random numbers ----------------------------------------------------------------------------------------------

    def _mixed(self, x: Array) -> Array:
        """Hash 64-bit integers: the finaliser of SplitMix64 (Steele et al. 2014); products wrap around."""
        x = (x ^ ((x >> 30) & 0x3FFFFFFFF)) * -4658895280553007687
        x = (x ^ ((x >> 27) & 0x1FFFFFFFFF)) * -7723592293110705685
        return x ^ ((x >> 31) & 0x1FFFFFFFF)

    def _numbers(self, keys: Array, first: int, count: int) -> Array:
        """Return two 31-bit numbers a hash: shape (count, len(keys)), rows by draw number from ``first`` on."""
        half = -(-count // 2)
        draws = self._array((np.arange(first, first + half) * -7046029254386353131)[:, None])
        mixed = self._mixed(keys[None, :] + draws)
        both = self.xp.concatenate([(mixed >> 33) & 0x7FFFFFFF, mixed & 0x7FFFFFFF])
        return both[:count]

    # --- episodes ----------------------------------------------------------------------------------------------------

    def reset(self, seed: int | None = None) -> None:
        """Begin episode 0 of every environment; ``seed`` None keeps the last one."""
        if seed is not None:
            words = np.random.SeedSequence(seed).generate_state(1, np.uint64)
            key = np.array([words[0]], dtype=np.uint64).view(np.int64)
            envs = np.arange(self.num_envs, dtype=np.int64) * -7046029254386353131 + key
            self._env_keys = self._mixed(self._array(envs))
        self._episode = self._full((self.num_envs,), 0)
        self._next = self._full((self.num_envs,), 0)
        self._prepare(self._rows)
        self.table = self._full((self.num_envs, self.num_slots + 1), self.nothing)[:, : self.num_slots]
        self._wide = self._full((self.num_envs, self.num_slots + 1), self.nothing)
        self.table = self._wide[:, : self.num_slots]
        self.goal, self.task, self.selection, self.attempts_left, self._count = (
            self._full((self.num_envs,), 0) for _ in range(5)
        )
        self._begin(self._rows)

    def pose(self, tasks: Array, first_episode: int = 0) -> None:
        """Begin given tasks, one for each environment, with the distractors of a given episode number.

        For evaluation: the table depends on the seed, the environment's number, the episode and the task only.
        """
        tasks = self._array(np.asarray(tasks)) if isinstance(tasks, np.ndarray) else tasks
        self._episode = self._full((self.num_envs,), first_episode)
        tables = self._tables(self._keys(self._rows, self._episode), tasks)
        width = tables.shape[1]
        self._wide[:] = self.nothing
        self._wide[:, :width] = tables
        self.task = tasks + 0
        self.goal = self._goals[tasks]
        self.selection = self._full((self.num_envs,), self.nothing)
        self.attempts_left = self._full((self.num_envs,), self.config.attempts)
        self._count = (self._wide != self.nothing).sum(1)

    def _keys(self, rows: Array, episodes: Array) -> Array:
        return self._mixed(self._env_keys[rows] + episodes * -3335678366873096957)

    def _prepare(self, rows: Array) -> None:
        """Draw the next episodes of some environments."""
        episodes = self._episode[rows][:, None] + self._array(np.arange(AHEAD))[None, :]
        keys = self._keys(rows[:, None], episodes).reshape(-1)
        number = self._numbers(keys, 0, 1)[0]
        if self.config.task_weighting == "task":
            tasks = (number * len(self.world.tasks)) >> 31
        else:
            total = self._task_ends[-1]
            tasks = self.xp.searchsorted(self._task_ends, self._cast(number, "float64") / 2**31 * total, side="right")
            tasks = tasks.clip(max=len(self.world.tasks) - 1)
        tables = self._tables(keys, tasks)
        if self._first_table is None or self._first_table.shape[0] != self.num_envs:
            self._first_table = self._full((self.num_envs, AHEAD, tables.shape[1]), 0, "int32")
            self._first_task = self._full((self.num_envs, AHEAD), 0, "int32")
        self._first_table[rows] = self._cast(tables, "int32").reshape(len(rows), AHEAD, -1)
        self._first_task[rows] = self._cast(tasks, "int32").reshape(len(rows), AHEAD)
        self._next[rows] = 0

    def _begin(self, rows: Array) -> None:
        """Begin the next prepared episode of some environments."""
        which = self._next[rows]
        if self.xp is np:
            spent = which == AHEAD
            if spent.any():
                self._prepare(rows[spent])
                which = self._next[rows]
        table = self._first_table[rows, which]
        width = table.shape[1]
        task = self._cast(self._first_task[rows, which], "int64")
        self._wide[rows, :width] = self._cast(table, "int64")
        self._wide[rows, width:] = self.nothing
        self.task[rows] = task
        self.goal[rows] = self._goals[task]
        self.selection[rows] = self.nothing
        self.attempts_left[rows] = self.config.attempts
        self._count[rows] = (table != self.nothing).sum(1)
        self._next[rows] += 1
        self._episode[rows] += 1

    def _tables(self, keys: Array, tasks: Array) -> Array:
        """Draw the entities of tables: shape (R, depth + 1 + distractors), the empty slots last."""
        xp, wanted = self.xp, self.config.num_distractors
        starts = self._starts[tasks].T
        filled = starts != self.nothing
        if wanted == 0:
            columns = [starts[i] for i in range(len(starts))]
        else:
            drawn = self._distractors(keys, tasks, starts)
            columns = [*(starts[i] for i in range(len(starts))), *(drawn[i] for i in range(wanted))]
        rows = xp.stack(columns)
        # Shuffle what is there: sort by random numbers, empty slots last.
        order = self._numbers(keys, 1_000_000, len(rows)) * 64 + self._array(np.arange(len(rows)))[:, None]
        if not bool(filled.all()) or bool((rows == self.nothing).any()):
            order = xp.where(rows == self.nothing, order + (1 << 40), order)
        if xp is np:
            order = np.sort(order.T, axis=1) & 63
            return rows.T[np.arange(order.shape[0])[:, None], order]
        order = xp.sort(order.T.contiguous(), dim=1).values & 63
        return rows.T.gather(1, order)

    def _distractors(self, keys: Array, tasks: Array, starts: Array) -> Array:
        """Draw distractors by weight without replacement: candidates one after the other, skipping what may not be.

        Returns:
            shape (num_distractors, R); the padding id where no entity is left that may lie there.
        """
        wanted = self.config.num_distractors
        rounds, first = 0, 1
        drawn = self._pick(keys, tasks, starts, first, wanted + _SPARE)
        missing = (drawn[-1] == self.nothing).nonzero()
        missing = missing[0] if self.xp is np else missing[:, 0]
        amount = wanted + _SPARE
        while len(missing) and rounds < 6:
            rounds += 1
            amount *= 4
            again = self._pick(keys[missing], tasks[missing], starts[:, missing], first, amount)
            drawn[:, missing] = again
            still = again[-1] == self.nothing
            missing = missing[still]
        if self.config.distractor_policy == "no_shortcut" and self.config.depth > 1:
            self._without_shortcuts(keys, tasks, starts, drawn)
        return drawn

    def _without_shortcuts(self, keys: Array, tasks: Array, starts: Array, drawn: Array) -> None:
        """Draw again, one by one, where distractors open a shortcut of several attempts."""
        for i in range(len(keys)):
            key, turn = keys[i : i + 1], 0
            while self.world.has_shortcut(int(tasks[i]), [int(x) for x in drawn[:, i] if int(x) < self.nothing]):
                turn += 1
                fresh = self._mixed(key + turn)
                amount = 8 * (self.config.num_distractors + _SPARE)
                drawn[:, i] = self._pick(fresh, tasks[i : i + 1], starts[:, i : i + 1], 1, amount)[:, 0]

    def _pick(self, keys: Array, tasks: Array, starts: Array, first: int, amount: int) -> Array:
        """Take the first distractors among ``amount`` candidates that may lie on the table."""
        xp, wanted = self.xp, self.config.num_distractors
        numbers = self._numbers_of_candidates(keys, first, amount)
        candidates = self._lots[(numbers * len(self._lots)) >> 31]
        allowed = candidates != self._goals[tasks][None, :]
        made = self._made[tasks].T
        for i in range(len(starts)):
            allowed &= candidates != starts[i][None, :]
        for i in range(len(made)):
            allowed &= candidates != made[i][None, :]
        # An entity that came before is skipped, whether it was allowed or not: it would not be allowed now either.
        for i in range(1, amount):
            allowed[i] &= ~(candidates[:i] == candidates[i][None, :]).any(0)
        if self._has_guards:
            self._guard(candidates, allowed, tasks, starts, made)
        place = xp.cumsum(self._cast(allowed, "int64"), 0) - 1
        drawn = self._full((wanted + 1, len(keys)), self.nothing)
        place = xp.where(allowed & (place < wanted), place, wanted)
        columns = self._array(np.arange(len(keys)))
        for i in range(amount):
            drawn[place[i], columns] = candidates[i]
        return drawn[:wanted]

    def _numbers_of_candidates(self, keys: Array, first: int, amount: int) -> Array:
        """Return 31-bit numbers such that more candidates begin with the same ones: shape (amount, R)."""
        half = -(-amount // 2)
        draws = self._array((np.arange(first, first + half) * -7046029254386353131)[:, None])
        mixed = self._mixed(keys[None, :] + draws)
        numbers = self.xp.stack([(mixed >> 33) & 0x7FFFFFFF, mixed & 0x7FFFFFFF], 1)
        return numbers.reshape(2 * half, -1)[:amount]

    def _guard(self, candidates: Array, allowed: Array, tasks: Array, starts: Array, made: Array) -> None:
        """Refuse candidates that complete a guarded recipe of the goal with what lies there or will be made."""
        wide = self.nothing + 1
        base = self._guard_row[self._goals[tasks]] * wide
        for as_one, as_other in self._guards:
            one = as_one[base + starts[0]]
            other = as_other[base + starts[0]]
            for column in [*(starts[i] for i in range(1, len(starts))), *(made[i] for i in range(len(made)))]:
                one |= as_one[base + column]
                other |= as_other[base + column]
            new_one, new_other = as_one[base[None, :] + candidates], as_other[base[None, :] + candidates]
            for i in range(len(candidates)):
                closes = (new_one[i] & (other | new_other[i])) | (one & new_other[i])
                allowed[i] &= closes == 0
                one |= self.xp.where(allowed[i], new_one[i], 0)
                other |= self.xp.where(allowed[i], new_other[i], 0)

    # --- steps -------------------------------------------------------------------------------------------------------

    def action_masks(self) -> Array:
        """Return which slots hold an entity, shape (N, num_slots), bool."""
        return self.table != self.nothing

    def random_actions(self, numbers: Array) -> Array:
        """Return a random legal action of each environment from uniform numbers in [0, 1), shape (N,)."""
        return self._cast(numbers * self._count, "int64")

    def pairs(self, one: Array, other: Array) -> Array:
        """Return the number of the pair of two entities, ``num_pairs`` where they make nothing."""
        if self._dense:
            return self._pair_table[one * (self.nothing + 1) + other]
        low, high = self.xp.minimum(one, other), self.xp.maximum(one, other)
        keys = low * (self.nothing + 1) + high
        found = self.xp.searchsorted(self._pair_keys, keys)
        return self.xp.where(self._pair_keys[found] == keys, found, self._no_pair)

    def step(self, actions: Array) -> Step:
        """Pick a slot in every environment; where an episode ends, the next one begins.

        Args:
            actions: shape (N,), integers. On the CPU they are checked against the action space.

        Raises:
            ActionError: if one is outside the action space, or illegal where ``illegal_action`` is ``raise``.
        """
        return self._step(actions, begin=True)

    def step_once(self, actions: Array) -> Step:
        """Like :meth:`step`, but environments whose episode ends stay there; their further steps do nothing."""
        if self.xp is np and not (self.attempts_left > 0).any():
            raise EpisodeError("all episodes are over; call pose() or reset().")
        return self._step(actions, begin=False)

    def _step(self, actions: Array, begin: bool) -> Step:
        xp, nothing, rows = self.xp, self.nothing, self._rows
        if xp is np:
            actions = self._checked(actions)
        running = self.attempts_left > 0
        picked = self._wide[rows, actions]
        legal = picked != nothing
        if self.config.illegal_action == "raise" and not bool((legal | ~running).all()):
            env = int((~legal & running).nonzero()[0][0])
            raise ActionError(f"action {int(actions[env])} of environment {env}: the slot is empty.")
        held = self.selection
        second = (held != nothing) & legal
        pair = self.pairs(held, picked)
        results = self._results[pair]
        made_goal = (results[:, 0] == self.goal) & running
        fresh = []
        for i in range(results.shape[1]):
            result = results[:, i]
            if i:
                made_goal |= (result == self.goal) & running
            is_new = (result != nothing) & running & ~(self._wide == result[:, None]).any(1)
            fresh.append(is_new)
            # Where nothing is new, "nothing" goes into the first free slot, where it is already.
            self._wide[rows, self._count] = xp.where(is_new, result, nothing)
            self._count += is_new
        ended = (held != nothing) | ~legal
        self.attempts_left = self.attempts_left - (ended & running)
        self.selection = xp.where(ended, nothing, picked)
        over = running & (made_goal | (self.attempts_left == 0))
        self.attempts_left = xp.where(made_goal, 0, self.attempts_left) if not begin else self.attempts_left
        reward = self._cast(made_goal, "float32")
        rewards = self.config.rewards
        if rewards.wrong_pair_penalty or rewards.irrelevant_penalty or rewards.intermediate_reward:
            reward = reward + self._shaping(pair, results, fresh, second & running, made_goal)
        by_plan = made_goal & (self._finals[self.task] == pair[:, None]).any(1)
        outcome = self._cast(made_goal, "int8") + self._cast(over & ~made_goal, "int8") * OUT_OF_ATTEMPTS
        done = Step(reward, over, outcome, by_plan, ~legal & running, self.task + 0)
        if begin:
            self._begin_over(over)
        return done

    def _begin_over(self, over: Array) -> None:
        if self.xp is np:
            rows = over.nonzero()[0]
            if len(rows):
                self._begin(rows)
            return
        self._begin_masked(over)

    def _begin_masked(self, over: Array) -> None:
        """Begin anew without asking the device how many episodes ended: every environment is written, or kept."""
        xp = self.xp
        self._since = getattr(self, "_since", 0) + 1
        which = self._next.clip(max=AHEAD - 1)
        table = self._cast(self._first_table[self._rows, which], "int64")
        task = self._cast(self._first_task[self._rows, which], "int64")
        spare = self._full((self.num_envs, self.num_slots + 1 - table.shape[1]), self.nothing)
        self._wide = xp.where(over[:, None], xp.concatenate([table, spare], 1), self._wide)
        self.table = self._wide[:, : self.num_slots]
        self.task = xp.where(over, task, self.task)
        self.goal = xp.where(over, self._goals[task], self.goal)
        self.selection = xp.where(over, self.nothing, self.selection)
        self.attempts_left = xp.where(over, self.config.attempts, self.attempts_left)
        self._count = xp.where(over, (table != self.nothing).sum(1), self._count)
        self._next = self._next + over
        self._episode = self._episode + over
        if self._since >= AHEAD - 1:
            self._since = 0
            self._prepare(self._rows)

    def _shaping(self, pair: Array, results: Array, fresh: list[Array], attempt: Array, made_goal: Array) -> Array:
        xp, rewards = self.xp, self.config.rewards
        made = self._made[self.task]
        first = self._full((self.num_envs,), 0)
        relevant = made_goal
        for i in range(results.shape[1]):
            is_made = (made == results[:, i][:, None]).any(1) & (results[:, i] != self.nothing)
            first = first + (is_made & fresh[i])
            relevant = relevant | is_made
        wrong = attempt & (pair == self._no_pair)
        irrelevant = attempt & (pair != self._no_pair) & ~relevant
        shaped = (
            rewards.intermediate_reward * self._cast(first, "float32")
            - rewards.wrong_pair_penalty * self._cast(wrong, "float32")
            - rewards.irrelevant_penalty * self._cast(irrelevant, "float32")
        )
        return self._cast(xp.where(attempt, shaped, 0), "float32")

    def _checked(self, actions: Array) -> Array:
        actions = np.asarray(actions)
        if actions.shape != (self.num_envs,) or actions.dtype.kind not in "iu":
            raise ActionError(
                f"actions of shape {actions.shape}, {actions.dtype}: expected ({self.num_envs},), whole numbers."
            )
        if len(actions) and (actions.min() < 0 or actions.max() >= self.num_slots):
            wrong = int(((actions < 0) | (actions >= self.num_slots)).argmax())
            raise ActionError(
                f"action {int(actions[wrong])} of environment {wrong}: expected 0 to {self.num_slots - 1}."
            )
        return actions
