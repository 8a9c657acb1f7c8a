"""Draws of tasks and starting tables for many episodes at once.

Random numbers are hashes of (seed, environment, episode, draw). So an environment sees the same episodes in any
process, with NumPy or torch, in any batch, and episodes can be drawn ahead.
"""

import numpy as np

from wordcraft_kg.base.settings import whole
from wordcraft_kg.envs.arrays import Array, Arrays
from wordcraft_kg.envs.guards import Guards
from wordcraft_kg.envs.world import World

_AHEAD, _AHEAD_OF_MANY, _MANY = (
    16,
    8,
    1_024,
)  # episodes drawn at a time; fewer from _MANY environments on
_CHUNK = (
    8_192  # tables drawn at a time on the CPU, so that the arrays stay in the processor's cache
)
_LAST_31_BITS = 0x7FFFFFFF
# Keys that differ by multiples of these hash independently; both are odd, the first is 2**64 / golden ratio.
_STRIDE = -7046029254386353131
_EPISODE_STRIDE = -3335678366873096957
# Number 0 of a key draws the task, numbers from 1 draw candidates, numbers from _PLACES draw places.
_PLACES = 1 << 20


def mixed(x: Array) -> Array:
    """Hash 64-bit integers with the finaliser of SplitMix64 (Steele et al. 2014); products wrap around at 64 bits."""
    x = x ^ ((x >> 30) & 0x3FFFFFFFF)
    x *= -4658895280553007687
    x ^= (x >> 27) & 0x1FFFFFFFFF
    x *= -7723592293110705685
    x ^= (x >> 31) & 0x1FFFFFFFF
    return x


class Draws:
    """Draws tasks and starting tables for a world's episodes.

    A *key* is the hash of (seed, environment, episode) and determines all draws of the episode; R keys draw R tables.
    Ids have 32 bits, which halves memory traffic, and tables are columns; ``width`` is the size of the largest starting
    table.
    """

    def __init__(self, world: World, arrays: Arrays):
        self.world, self.arrays, tasks = world, arrays, world.tasks
        self.width = world.config.depth + 1 + world.config.num_distractors
        self._starts, self._goals, self._made = (
            arrays.array(ids.astype(np.int32))
            for ids in (tasks.starts, tasks.goals, tasks.intermediates)
        )
        # A distractor of weight w has w lots.
        self._lots = arrays.array(
            np.repeat(np.arange(world.nothing, dtype=np.int32), world.distractor_weights)
        )
        self._task_ends = arrays.array(np.cumsum(tasks.weights(world.config.task_weighting)))
        self._guards = Guards(world, arrays)

    def env_keys(self, seed: int, first: int, count: int) -> Array:
        """Return hashes of seed and environment for environments ``first``, ``first + 1``, ..., shape (count,)."""
        words = (
            np.random.SeedSequence(whole("seed", seed, 0))
            .generate_state(1, np.uint64)
            .view(np.int64)
        )
        return mixed(self.arrays.array(np.arange(first, first + count) * _STRIDE + words))

    def keys(self, env_keys: Array, episodes: Array) -> Array:
        """Return each episode's random seed, a hash of :meth:`env_keys` and episode numbers in equal shapes."""
        return mixed(env_keys + episodes * _EPISODE_STRIDE)

    def _numbers(self, keys: Array, first: int, count: int) -> Array:
        """Return 31-bit numbers ``first``, ``first + 1``, ... of each key, shape (count, R); ``count`` changes none."""
        half = -(-count // 2)
        draws = self.arrays.array((np.arange(first, first + half) * _STRIDE)[:, None])
        hashed = mixed(keys[None, :] + draws)
        numbers = self.arrays.full((2 * half, len(keys)), 0)
        numbers[::2] = (hashed >> 33) & _LAST_31_BITS
        numbers[1::2] = hashed & _LAST_31_BITS
        return numbers[:count]

    def tasks(self, keys: Array) -> Array:
        """Draw a task index for each of R episode :meth:`keys`, by task weights: shape (R,)."""
        number, amount = self._numbers(keys, 0, 1)[0], len(self.world.tasks)
        if self.world.config.task_weighting == "task":
            return (number * amount) >> 31
        share = self.arrays.cast(number, "float64") / 2**31 * self._task_ends[-1]
        return self.arrays.xp.searchsorted(self._task_ends, share, side="right").clip(
            max=amount - 1
        )

    def tables(self, keys: Array, tasks: Array) -> Array:
        """Draw starting tables for R episode :meth:`keys` and tasks: ids, (R, width), shuffled, empty slots last."""
        size = len(keys) if self.arrays.on_device else _CHUNK
        pieces = [
            self._tables(keys[i : i + size], tasks[i : i + size]) for i in range(0, len(keys), size)
        ]
        return self.arrays.xp.concatenate(pieces)

    def _tables(self, keys: Array, tasks: Array) -> Array:
        arrays, starts = self.arrays, self._starts[tasks].T
        rows = starts
        if self.world.config.num_distractors:
            rows = arrays.xp.concatenate([starts, self._distractors(keys, tasks, starts)])
        places = self._numbers(keys, _PLACES, len(rows)) >> 1
        return self._in_order(
            arrays.xp.where(rows == self.world.nothing, _LAST_31_BITS, places), rows
        )

    def _in_order(self, order: Array, ids: Array) -> Array:
        """Return the ids of each column by ascending ``order``, 31-bit numbers: shape (R, K) for (K, R)."""
        # One number packs the order, with the row in the last bits to break ties, and the id.
        last = (1 << (len(ids) - 1).bit_length()) - 1
        index = self.arrays.array(np.arange(len(ids)))[:, None]
        packed = (((order & ~last) + index) << 32) + ids
        return self.arrays.cast(self.arrays.sorted_rows(packed.T) & _LAST_31_BITS, "int32")

    # --- distractors -------------------------------------------------------------------------------------------------

    def _distractors(self, keys: Array, tasks: Array, starts: Array) -> Array:
        """Draw distractors by weight without replacement, (num_distractors, R); nothing if entities run out."""
        config = self.world.config
        wanted = config.num_distractors
        taken = self.arrays.xp.concatenate(
            [self._goals[tasks][None, :], starts, self._made[tasks].T]
        )
        if self.arrays.on_device:
            # One round with many candidates, because a check would wait for the device.
            drawn = self._pick(keys, tasks, taken, 8 * wanted + 16)
        else:
            # Most tables take the first candidates; the rest are drawn with more care.
            drawn = self._candidates(keys, wanted)
            again = self._clashes(drawn, tasks, taken).nonzero()[0]
            amount = wanted + 4
            while len(again):
                chosen = self._pick(keys[again], tasks[again], taken[:, again], amount)
                drawn[:, again] = chosen
                amount *= 4
                again = (
                    again[chosen[-1] == self.world.nothing]
                    if amount < 2**11 * wanted
                    else again[:0]
                )
        if config.distractor_policy != "any" and config.attempts > 1:
            self._avoid_shortcuts(keys, tasks, taken, drawn)
        return drawn

    def _candidates(self, keys: Array, amount: int) -> Array:
        return self._lots[(self._numbers(keys, 1, amount) * len(self._lots)) >> 31]

    def _clashes(self, candidates: Array, tasks: Array, taken: Array) -> Array:
        clash = self._guards.at_risk(candidates, tasks)
        for i in range(len(candidates)):
            for entity in taken:
                clash |= candidates[i] == entity
            for j in range(i):
                clash |= candidates[i] == candidates[j]
        return clash

    def _pick(self, keys: Array, tasks: Array, taken: Array, amount: int) -> Array:
        arrays, wanted = self.arrays, self.world.config.num_distractors
        candidates = self._candidates(keys, amount)
        allowed = arrays.full(tuple(candidates.shape), 1, "bool")
        for entity in taken:
            allowed &= candidates != entity[None, :]
        # A repeated candidate is skipped: if refused before, refused again.
        for i in range(1, amount):
            allowed[i] &= ~(candidates[:i] == candidates[i][None, :]).any(0)
        if self._guards:
            # Few tables can complete a guarded recipe at all; only these are checked candidate by candidate.
            rows = arrays.rows(self._guards.at_risk(candidates, tasks))
            if len(rows):
                allowed[:, rows] = self._guards.refuse(
                    candidates[:, rows], allowed[:, rows], tasks[rows]
                )
        order = arrays.xp.where(allowed, 0, _LAST_31_BITS)
        return self._in_order(order, arrays.xp.where(allowed, candidates, self.world.nothing))[
            :, :wanted
        ].T

    def _avoid_shortcuts(self, keys: Array, tasks: Array, taken: Array, drawn: Array) -> None:
        """Draw again, one table at a time, while distractors open a longer shortcut."""
        world = self.world
        for i in range(len(keys)):
            key, turn = keys[i : i + 1], 0
            while world.has_shortcut(
                int(tasks[i]), [int(x) for x in drawn[:, i] if int(x) < world.nothing]
            ):
                turn += 1
                world.check_tries(turn, int(tasks[i]))
                more = self._pick(mixed(key + turn), tasks[i : i + 1], taken[:, i : i + 1], 256)
                drawn[:, i] = more[:, 0]


class Ahead:
    """A cache with the next episodes for N environments: ``size`` tasks and starting tables each.

    On the CPU, missing episodes are drawn on demand. On a device, control flow may not depend on data: episodes are
    drawn at once, and a caller requests only cached episodes.
    """

    def __init__(self, draws: Draws, keys: Array, episodes: Array):
        """Begin the cache at the given episode numbers, shape (N,); ``keys`` are :meth:`Draws.env_keys`."""
        arrays, count = draws.arrays, len(keys)
        self.draws, self.keys, self.size = draws, keys, _AHEAD if count <= _MANY else _AHEAD_OF_MANY
        self._tables = arrays.full((count, self.size, draws.width), 0, "int32")
        self._tasks = arrays.full((count, self.size), 0, "int32")
        self._first = arrays.full((count,), -self.size)  # number of the first cached episode
        self._offsets = arrays.array(np.arange(self.size))[None, :]
        if arrays.on_device:
            self._draw(arrays.array(np.arange(count)), episodes)

    def _draw(self, rows: Array, episodes: Array) -> None:
        draws, shape = self.draws, (len(rows), self.size)
        keys = draws.keys(self.keys[rows][:, None], episodes[:, None] + self._offsets).reshape(-1)
        tasks = draws.tasks(keys)
        self._tables[rows] = draws.tables(keys, tasks).reshape(*shape, -1)
        self._tasks[rows] = draws.arrays.cast(tasks, "int32").reshape(shape)
        self._first[rows] = episodes

    def take(self, rows: Array, episodes: Array) -> tuple[Array, Array]:
        """Return starting tables (R, width) and task indices (R,) for R environments and their episode numbers."""
        arrays, index = self.draws.arrays, episodes - self._first[rows]
        if not arrays.on_device and len(spent := (index != index % self.size).nonzero()[0]):
            self._draw(rows[spent], episodes[spent])
            index[spent] = 0
        which = rows * self.size + index
        tasks = arrays.take_rows(self._tasks.reshape(-1), which)
        return arrays.take_rows(self._tables.reshape(-1, self.draws.width), which), arrays.cast(
            tasks, "int64"
        )
