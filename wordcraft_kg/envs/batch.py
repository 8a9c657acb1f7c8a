"""Many crafting environments at once, as arrays: the semantics of :mod:`wordcraft_kg.envs.wordcraft`, in bulk.

The engine is written once, in the operators and the indexing that NumPy and torch share. On the CPU its arrays are
NumPy's, because a step is some thirty calls on short arrays and a call costs NumPy half of what it costs torch; the
agent sees the same memory through ``torch.from_numpy``. On a CUDA device they are torch tensors and never leave it.

Random numbers are a function of (seed, environment, episode, draw), hashed, not a stream: so an environment sees the
same episodes however many run beside it, on either kind of array, and episodes can be prepared ahead in bulk.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import GraphLike, World
from wordcraft_kg.errors import ActionError, ConfigError, EpisodeError
from wordcraft_kg.settings import whole

Array = Any
"""A NumPy array, or a torch tensor on a CUDA device."""

IN_PROGRESS, GOAL, OUT_OF_ATTEMPTS = 0, 1, 2
OUTCOMES = ("in_progress", "goal", "out_of_attempts")
"""Names of the outcome codes."""

AHEAD, AHEAD_OF_MANY, MANY = 16, 8, 1_024
"""Episodes that are prepared at a time for each environment; fewer where more than ``MANY`` run side by side."""
DENSE_LIMIT = 4_096
"""Entities up to which the pair of two entities is looked up in a square table, 4 bytes a cell; above it by search."""
CHUNK = 8_192
"""Tables that are drawn in one piece on the CPU."""
LAST_31_BITS = 0x7FFFFFFF
GUARD_BITS = 15
_LOW = (1 << GUARD_BITS) - 1
_HIDDEN = ("wide", "count", "episode")
_STATE = ("goal", "task", "selection", "attempts_left", *_HIDDEN)
_STRIDE = -7046029254386353131  # 2**64 / golden ratio: keys that far apart hash independently


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

    goal: Array
    selection: Array
    attempts_left: Array
    task: Array
    table: Array
    _wide: Array
    _count: Array
    _episode: Array
    _next: Array

    def __init__(self, graph: GraphLike, config: WordCraftConfig, num_envs: int, *, device: str = "cpu", seed: int = 0):
        """Prepare N environments; :meth:`reset` begins.

        Args:
            graph: see :class:`~wordcraft_kg.envs.wordcraft.WordCraftEnv`.
            config: settings, the same for all.
            num_envs: N, from 1.
            device: ``cpu``, or a device of torch such as ``cuda``; ``torch:cpu`` runs what a device runs on the CPU.
            seed: see :meth:`reset`.

        Raises:
            ConfigError: for no environments, or a device that is not there.
        """
        self.num_envs = whole("num_envs", num_envs, 1)
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
        self._rows = self._array(np.arange(self.num_envs))
        self._ahead = AHEAD if self.num_envs <= MANY else AHEAD_OF_MANY
        self.reset(seed)

    # --- arrays of either kind ---------------------------------------------------------------------------------------

    def _array(self, values: np.ndarray) -> Array:
        """Bring a NumPy array to the engine's side."""
        if self.xp is np:
            return np.ascontiguousarray(values)
        return self.xp.tensor(values, device=self.device.removeprefix("torch:"))

    def _full(self, shape: tuple[int, ...], value: int, dtype: str = "int64") -> Array:
        if self.xp is np:
            return np.full(shape, value, dtype=dtype)
        return self.xp.full(shape, value, dtype=getattr(self.xp, dtype), device=self.device.removeprefix("torch:"))

    def _cast(self, values: Array, dtype: str) -> Array:
        return values.astype(dtype) if self.xp is np else values.to(getattr(self.xp, dtype))

    def _prepare_tables(self) -> None:
        world = self.world
        graph, tasks, nothing = world.graph, world.tasks, world.nothing
        self.nothing = nothing
        self.num_slots = world.num_slots
        self._goals = self._array(tasks.goals)
        # Tables are drawn in 32 bits, which halves what has to be moved.
        self._starts = self._array(tasks.starts.astype(np.int32))
        self._goals_short = self._array(tasks.goals.astype(np.int32))
        made = tasks.intermediates if tasks.intermediates.shape[1] else np.full((len(tasks), 1), nothing)
        self._made = self._array(made)
        self._made_short = self._array(made.astype(np.int32))
        self._near_short = self._array(np.concatenate([tasks.starts, world.makeable], axis=1).astype(np.int32))
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
        self._lots = self._array(np.repeat(np.arange(nothing, dtype=np.int32), weights))
        self._task_ends = self._array(np.cumsum(tasks.weights(self.config.task_weighting)))
        self._prepare_guards()

    def _prepare_guards(self) -> None:
        """Prepare the recipes that no distractor may complete: for each goal and entity, in which of them it stands.

        Bit k of a cell (goal, entity) says that the entity is the first ingredient of the goal's k-th guarded recipe,
        bit k + 15 that it is the second. A goal with more than 15 of them has further tables. Rows are there for
        guarded goals only; row 0 is empty.
        """
        world = self.world
        recipes = world.graph.recipes[world.guarded_recipes]
        goals, counts = np.unique(recipes[:, 2], return_counts=True)
        tables = -(-int(counts.max()) // GUARD_BITS) if len(goals) else 0
        row_of = np.zeros(self.nothing + 1, dtype=np.int64)
        row_of[goals] = np.arange(1, len(goals) + 1)
        masks = np.zeros((tables, len(goals) + 1, self.nothing + 1), dtype=np.int32)
        seen = np.zeros(len(goals) + 1, dtype=np.int64)
        for a, b, goal in recipes.tolist():
            row = row_of[goal]
            table, bit = divmod(int(seen[row]), GUARD_BITS)
            seen[row] += 1
            masks[table, row, a] |= 1 << bit
            masks[table, row, b] |= 1 << (bit + GUARD_BITS)
        self._guard_base = self._array(row_of[world.tasks.goals] * (self.nothing + 1))
        self._guards = [self._array(mask.reshape(-1)) for mask in masks]

    # --- random numbers ----------------------------------------------------------------------------------------------

    def _mixed(self, x: Array) -> Array:
        """Hash 64-bit integers: the finaliser of SplitMix64 (Steele et al. 2014); products wrap around."""
        x = x ^ ((x >> 30) & 0x3FFFFFFFF)
        x *= -4658895280553007687
        x ^= (x >> 27) & 0x1FFFFFFFFF
        x *= -7723592293110705685
        x ^= (x >> 31) & 0x1FFFFFFFF
        return x

    def _numbers(self, keys: Array, first: int, count: int) -> Array:
        """Return 31-bit numbers, shape (count, len(keys)); more of them begin with the same ones."""
        half = -(-count // 2)
        draws = self._array((np.arange(first, first + half) * _STRIDE)[:, None])
        mixed = self._mixed(keys[None, :] + draws)
        numbers = self._full((2 * half, len(keys)), 0)
        numbers[::2] = (mixed >> 33) & LAST_31_BITS
        numbers[1::2] = mixed & LAST_31_BITS
        return numbers[:count]

    # --- episodes ----------------------------------------------------------------------------------------------------

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode in every environment: number 0 of a seed's, or with None the next one.

        Raises:
            ConfigError: for a negative seed.
        """
        if seed is not None:
            words = np.random.SeedSequence(whole("seed", seed, 0)).generate_state(1, np.uint64)
            self._env_keys = self._mixed(self._array(np.arange(self.num_envs) * _STRIDE + words.view(np.int64)))
            self._blank()
        self._prepare(self._rows)
        self._begin(self._rows)
        self._steps_since = 1

    def pose(self, tasks: Array, episode: int = 0) -> None:
        """Begin given tasks, one in each environment, for evaluation; :meth:`step` goes on with drawn ones.

        The distractors depend on the seed, the environment's number, ``episode`` and the task only.

        Args:
            tasks: shape (N,), indices into the world's tasks.
            episode: number of the draw.
        """
        self._blank()
        self._episode = self._full((self.num_envs,), episode)
        tasks = self._array(np.asarray(tasks, dtype=np.int64)) if isinstance(tasks, list | np.ndarray) else tasks
        self._place(self._rows, self._tables(self._keys(self._rows, self._episode), tasks), tasks)
        self._episode += 1
        # What comes next is drawn when it is needed; on a device, where nobody asks whether, at once.
        self._next = self._full((self.num_envs,), self._ahead)
        if self.xp is not np:
            self._prepare(self._rows)

    def _blank(self) -> None:
        # One column more than slots: where a result that is not new goes when the table is full.
        self._wide = self._full((self.num_envs, self.num_slots + 1), self.nothing)
        self.table = self._wide[:, : self.num_slots]
        names = ("goal", "task", "selection", "attempts_left", "_count", "_episode", "_next")
        for name in names:
            setattr(self, name, self._full((self.num_envs,), 0))
        width = self.config.depth + 1 + self.config.num_distractors
        self._ahead_table = self._full((self.num_envs, self._ahead, width), 0, "int32")
        self._ahead_task = self._full((self.num_envs, self._ahead), 0, "int32")

    def _keys(self, rows: Array, episodes: Array) -> Array:
        return self._mixed(self._env_keys[rows] + episodes * -3335678366873096957)

    def _prepare(self, rows: Array) -> None:
        """Draw the next episodes of some environments."""
        episodes = self._episode[rows][:, None] + self._array(np.arange(self._ahead))[None, :]
        keys = self._keys(rows[:, None], episodes).reshape(-1)
        number = self._numbers(keys, 0, 1)[0]
        if self.config.task_weighting == "task":
            tasks = (number * len(self.world.tasks)) >> 31
        else:
            share = self._cast(number, "float64") / 2**31 * self._task_ends[-1]
            tasks = self.xp.searchsorted(self._task_ends, share, side="right").clip(max=len(self.world.tasks) - 1)
        # In pieces, so that their arrays stay in the processor's cache.
        size = CHUNK if self.xp is np else len(keys)
        pieces = [self._tables(keys[i : i + size], tasks[i : i + size]) for i in range(0, len(keys), size)]
        tables = self.xp.concatenate(pieces)
        self._ahead_table[rows] = tables.reshape(len(rows), self._ahead, -1)
        self._ahead_task[rows] = self._cast(tasks, "int32").reshape(len(rows), self._ahead)
        self._next[rows] = 0
        self._steps_since = 0

    def _begin(self, rows: Array) -> None:
        """Begin the next prepared episode of some environments."""
        which = self._next[rows]
        if self.xp is np and (spent := which == self._ahead).any():
            self._prepare(rows[spent])
            which = self._next[rows]
        tables, tasks = self._ahead_table[rows, which], self._ahead_task[rows, which]
        self._place(rows, tables, self._cast(tasks, "int64"))
        self._next[rows] += 1
        self._episode[rows] += 1

    def _place(self, rows: Array, tables: Array, tasks: Array) -> None:
        width = tables.shape[1]
        self._wide[rows, :width] = self._cast(tables, "int64")
        self._wide[rows, width:] = self.nothing
        self.task[rows] = tasks
        self.goal[rows] = self._goals[tasks]
        self.selection[rows] = self.nothing
        self.attempts_left[rows] = self.config.attempts
        self._count[rows] = (tables != self.nothing).sum(1)

    def _tables(self, keys: Array, tasks: Array) -> Array:
        """Draw the entities of tables: shape (R, depth + 1 + distractors), shuffled, the empty slots last."""
        starts = self._starts[tasks].T
        rows = starts
        if self.config.num_distractors:
            rows = self.xp.concatenate([starts, self._distractors(keys, tasks, starts)])
        # Sort by random numbers with the row's index in the last bits; what is nothing gets larger ones.
        last = (1 << (len(rows) - 1).bit_length()) - 1
        index = self._array(np.arange(len(rows)))[:, None]
        order = self.xp.where(rows == self.nothing, LAST_31_BITS, self._numbers(keys, 1 << 20, len(rows)) >> 1)
        order = self._cast((order & ~last) + index, "int32").T
        if self.xp is np:
            return np.take_along_axis(rows.T, np.sort(order, axis=1) & last, axis=1)
        return rows.T.gather(1, self._cast(self.xp.sort(order, dim=1).values & last, "int64"))

    def _distractors(self, keys: Array, tasks: Array, starts: Array) -> Array:
        """Draw distractors by weight without replacement: candidates one after the other, skipping what may not be.

        Returns:
            shape (num_distractors, R); the padding id where no entity is left that may lie there.
        """
        wanted = self.config.num_distractors
        taken = self.xp.concatenate([self._goals_short[tasks][None, :], starts, self._made_short[tasks].T])
        if self.xp is not np:
            # One round of many candidates, because asking whether it was enough would wait for the device.
            drawn = self._pick(keys, tasks, taken, 8 * wanted + 16)
        else:
            # Most tables take the first candidates as they come; the rest is looked at more closely.
            drawn = self._candidates(keys, wanted)
            again = self._clashes(drawn, tasks, taken).nonzero()[0]
            amount = wanted + 4
            while len(again):
                picked = self._pick(keys[again], tasks[again], taken[:, again], amount)
                drawn[:, again] = picked
                amount *= 4
                again = again[picked[-1] == self.nothing] if amount < 2**11 * wanted else again[:0]
        if self.config.distractor_policy == "no_shortcut" and self.config.attempts > 1:
            self._avoid_shortcuts(keys, tasks, taken, drawn)
        return drawn

    def _candidates(self, keys: Array, amount: int) -> Array:
        """Return entities drawn by weight, with replacement: shape (amount, R)."""
        return self._lots[(self._numbers(keys, 1, amount) * len(self._lots)) >> 31]

    def _clashes(self, candidates: Array, tasks: Array, taken: Array) -> Array:
        """Return which rows of candidates may not lie on the table as they are, shape (R,); some may after all."""
        clash = self._full((candidates.shape[1],), 0, "bool")
        for i in range(len(candidates)):
            for j in range(len(taken)):
                clash |= candidates[i] == taken[j]
            for j in range(i):
                clash |= candidates[i] == candidates[j]
        return clash | self._at_risk(candidates, tasks)

    def _at_risk(self, candidates: Array, tasks: Array) -> Array:
        """Return which rows could complete a guarded recipe if all their candidates lay there, shape (R,)."""
        risk = self._full((candidates.shape[1],), 0, "bool")
        base, near = self._guard_base[tasks], self._near_short[tasks].T
        for guard in self._guards:
            stands = guard[base + candidates[0]]
            for i in range(1, len(candidates)):
                stands |= guard[base + candidates[i]]
            there = stands != 0
            for j in range(len(near)):
                stands |= guard[base + near[j]]
            risk |= there & ((stands & (stands >> GUARD_BITS) & _LOW) != 0)
        return risk

    def _guarded(self, candidates: Array, allowed: Array, tasks: Array) -> Array:
        """Refuse candidates that complete a guarded recipe of the goal with the start or what can be made of it."""
        base, near = self._guard_base[tasks], self._near_short[tasks].T
        for guard in self._guards:
            stands = guard[base + near[0]]
            for j in range(1, len(near)):
                stands = stands | guard[base + near[j]]
            for i in range(len(candidates)):
                both = stands | guard[base + candidates[i]]
                # Recipes that are complete with this candidate and were not without it.
                closes = both & (both >> GUARD_BITS) & _LOW & ~(stands & (stands >> GUARD_BITS))
                allowed[i] &= closes == 0
                stands = self.xp.where(allowed[i], both, stands)
        return allowed

    def _pick(self, keys: Array, tasks: Array, taken: Array, amount: int) -> Array:
        """Take the first distractors among ``amount`` candidates that may lie on the table, in their order."""
        xp, wanted = self.xp, self.config.num_distractors
        candidates = self._candidates(keys, amount)
        allowed = self._full(tuple(candidates.shape), 1, "bool")
        for j in range(len(taken)):
            allowed &= candidates != taken[j][None, :]
        # An entity that came before is skipped, whether it was allowed or not: it would not be allowed now either.
        for i in range(1, amount):
            allowed[i] &= ~(candidates[:i] == candidates[i][None, :]).any(0)
        # Few rows can complete a guarded recipe at all; only those are followed candidate by candidate.
        rows = self._at_risk(candidates, tasks)
        rows = rows.nonzero()[0] if xp is np else self._array(np.arange(len(keys)))
        if self._guards and len(rows):
            allowed[:, rows] = self._guarded(candidates[:, rows], allowed[:, rows], tasks[rows])
        place = xp.cumsum(self._cast(allowed, "int64"), 0) - 1
        place = xp.where(allowed & (place < wanted), place, wanted)
        drawn = self._full((wanted + 1, len(keys)), self.nothing, "int32")
        columns = self._array(np.arange(len(keys)))
        for i in range(amount):
            drawn[place[i], columns] = candidates[i]
        return drawn[:wanted]

    def _avoid_shortcuts(self, keys: Array, tasks: Array, taken: Array, drawn: Array) -> None:
        """Draw again, one table after the other, where distractors open a shortcut of several attempts."""
        for i in range(len(keys)):
            key, turn = keys[i : i + 1], 0
            while self.world.has_shortcut(int(tasks[i]), [int(x) for x in drawn[:, i] if int(x) < self.nothing]):
                turn += 1
                self.world.check_tries(turn, int(tasks[i]))
                more = self._pick(self._mixed(key + turn), tasks[i : i + 1], taken[:, i : i + 1], 256)
                drawn[:, i] = more[:, 0]

    # --- going on later ----------------------------------------------------------------------------------------------

    def state(self) -> dict[str, np.ndarray]:
        """Return where all environments stand, for :meth:`restore`: NumPy arrays by name, copied."""
        arrays = {name: getattr(self, f"_{name}" if name in _HIDDEN else name) for name in _STATE}
        return {name: np.array(array if self.xp is np else array.cpu().numpy()) for name, array in arrays.items()}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from a :meth:`state` of an engine with the same graph, settings, number of environments and seed.

        Raises:
            ConfigError: if it is of another engine.
        """
        for name in _STATE:
            mine = self._wide.shape if name == "wide" else (self.num_envs,)
            if name not in state or tuple(state[name].shape) != tuple(mine):
                raise ConfigError(f"this state is of another engine: '{name}' should have shape {tuple(mine)}.")
        for name in _STATE:
            setattr(self, f"_{name}" if name in _HIDDEN else name, self._array(np.array(state[name], dtype=np.int64)))
        self.table = self._wide[:, : self.num_slots]
        # What was drawn ahead is drawn again: it depends on seed, environment and episode only.
        self._next = self._full((self.num_envs,), self._ahead)
        if self.xp is not np:
            self._prepare(self._rows)

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
        xp, nothing = self.xp, self.nothing
        actions = self._checked(actions) if xp is np else actions
        running = self.attempts_left > 0
        picked = self._wide[self._rows, actions]
        empty = picked == nothing
        if self.config.illegal_action == "raise" and bool((empty & running).any()):
            env = int((empty & running).nonzero()[0][0])
            raise ActionError(
                f"action {int(actions[env])} of environment {env}: the slot is empty; slots 0 to "
                f"{int(self._count[env]) - 1} hold entities."
            )
        second = self.selection != nothing
        # Nothing in hand, or nothing picked, makes nothing: the tables have a row for that.
        pair = self.pairs(self.selection, picked)
        made_goal, by_plan, shaped = self._land(pair, running)
        ended = (second | empty) & running
        self.attempts_left = self.attempts_left - self._cast(ended, "int64")
        self.selection = xp.where(second | empty, nothing, picked)
        over = running & (made_goal | (self.attempts_left == 0))
        reward = self._cast(made_goal, "float32")
        if shaped is not None:
            wrong = second & ~empty & running & (pair == self._no_pair)
            reward = reward + shaped - self.config.rewards.wrong_pair_penalty * self._cast(wrong, "float32")
        outcome = self._cast(over, "int8") * OUT_OF_ATTEMPTS - self._cast(made_goal, "int8")
        done = Step(self._cast(reward, "float32"), over, outcome, by_plan, empty & running, self.task + 0)
        if begin:
            self._begin_over(over)
        else:
            self.attempts_left = xp.where(made_goal, 0, self.attempts_left)
        return done

    def _land(self, pair: Array, running: Array) -> tuple[Array, Array, Array | None]:
        """Put the results of pairs on the tables; return who made the goal, who by a plan, and the shaped reward."""
        rewards = self.config.rewards
        makes = (pair != self._no_pair) & running
        made_goal, by_plan = (self._full((self.num_envs,), 0, "bool") for _ in range(2))
        is_shaped = bool(rewards.wrong_pair_penalty or rewards.irrelevant_penalty or rewards.intermediate_reward)
        shaped = self._full((self.num_envs,), 0, "float32") if is_shaped else None
        # On the CPU only those that make something are looked at; a device looks at all rather than ask which.
        rows = makes.nonzero()[0] if self.xp is np else self._rows
        if not len(rows):
            return made_goal, by_plan, shaped
        results, goal, makes = self._results[pair[rows]], self.goal[rows], makes[rows]
        hit = (results == goal[:, None]).any(1) & makes
        made = self._made[self.task[rows]]
        first, relevant = self._full((len(rows),), 0), hit
        for i in range(results.shape[1]):
            result = results[:, i]
            is_new = makes & (result != self.nothing) & ~(self._wide[rows] == result[:, None]).any(1)
            if is_shaped:
                is_made = (made == result[:, None]).any(1) & (result != self.nothing)
                first, relevant = first + (is_made & is_new), relevant | is_made
            # Where nothing is new, "nothing" goes into the first free slot, where it is already.
            count = self._count[rows]
            self._wide[rows, count] = self.xp.where(is_new, result, self._wide[rows, count])
            self._count[rows] = count + is_new
        made_goal[rows] = hit
        by_plan[rows] = hit & (self._finals[self.task[rows]] == pair[rows][:, None]).any(1)
        if shaped is not None:
            irrelevant = self._cast(makes & ~relevant, "float32")
            shaped[rows] = (
                rewards.intermediate_reward * self._cast(first, "float32") - rewards.irrelevant_penalty * irrelevant
            )
        return made_goal, by_plan, shaped

    def _begin_over(self, over: Array) -> None:
        if self.xp is np:
            rows = over.nonzero()[0]
            if len(rows):
                self._begin(rows)
        else:
            self._begin_masked(over)

    def _begin_masked(self, over: Array) -> None:
        """Begin anew without asking the device who: every environment is written, with what it had or the next."""
        xp = self.xp
        table = self._cast(self._ahead_table[self._rows, self._next], "int64")
        task = self._cast(self._ahead_task[self._rows, self._next], "int64")
        room = self._full((self.num_envs, self.num_slots + 1 - table.shape[1]), self.nothing)
        self._wide = xp.where(over[:, None], xp.concatenate([table, room], 1), self._wide)
        self.table = self._wide[:, : self.num_slots]
        self.task = xp.where(over, task, self.task)
        self.goal = xp.where(over, self._goals[task], self.goal)
        self.selection = xp.where(over, self.nothing, self.selection)
        self.attempts_left = xp.where(over, self.config.attempts, self.attempts_left)
        self._count = xp.where(over, (table != self.nothing).sum(1), self._count)
        self._next = self._next + over
        self._episode = self._episode + over
        self._steps_since += 1
        if self._steps_since == self._ahead:  # no environment can have used up more than one episode a step
            self._prepare(self._rows)

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
