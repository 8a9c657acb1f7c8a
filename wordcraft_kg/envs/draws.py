"""Draws of tasks and starting tables for many episodes at once.

Random numbers are not a stream but hashes of (seed, environment, episode, draw). So an environment
sees the same episodes in any process, with NumPy or torch, in any batch, and episodes can be drawn
ahead.

Tables are columns here, shape (K, R) for R tables, because operations go candidate by candidate
over all tables at once. Every constant of the hash is part of the results: with another one, all
results of trained agents change.

:class:`EvaluationTables` fixes the tables that agents, scripted players, text agents and people
share, so that their results can be compared task by task.
"""

import logging

import numpy as np

from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.envs.arrays import STRIDE, Array, Arrays, arrays_of, mixed
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.arrays import Ids

# Episodes drawn at a time, for up to _MANY environments and for more: enough to spread the cost of
# a draw's many calls, and for many environments fewer, which fit the processor's cache.
_AHEAD = 16
_AHEAD_OF_MANY = 8
_MANY = 1_024
# Times as many where a table takes more calls: tasks with sets differ in size, so that most tables
# need more candidates, and an environment alone shares its calls with none.
_MORE = 4
# Tables drawn at a time on the CPU, so that the arrays stay in the processor's cache.
_CHUNK = 8_192
_LAST_31_BITS = 0x7FFFFFFF
# Like STRIDE, an odd number.
_EPISODE_STRIDE = -3335678366873096957
# Number 0 of a key draws the task, numbers from 1 draw candidates, numbers from _PLACES draw
# places.
_PLACES = 1 << 20


class Draws:
    """Draws tasks and starting tables for a world's episodes.

    A *key* is the hash of (seed, environment, episode) and determines all draws of the episode; R
    keys draw R tables. Ids have 32 bits, which halves memory traffic.

    Attributes:
        world: graph, tasks and settings.
        arrays: array operations by NumPy or torch.
        repeat: number of different episodes of an environment, which then begin again with the
            first; 0 if all differ.
        width: size of a starting table, the same for all tasks.
        most_drawn: distractors of the task with the fewest starting ingredients.
    """

    def __init__(self, world: World, arrays: Arrays, repeat: int = 0):
        """Prepare look-up tables for a world's tasks and distractors."""
        self.world = world
        self.arrays = arrays
        self.repeat = repeat
        self.width = world.num_given
        tasks = world.tasks
        self.most_drawn = int(world.num_drawn.max())
        self._num_drawn = arrays.array(world.num_drawn)
        # Rows of the distractors that only some tasks have, the last one first.
        before = world.config.num_distractors - 1
        self._further = arrays.array(np.arange(self.most_drawn - 1, before, -1))
        self._starts = arrays.array(tasks.starts.astype(np.int32))
        self._goals = arrays.array(tasks.goals.astype(np.int32))
        self._intermediates = arrays.array(tasks.intermediates.astype(np.int32))
        # A distractor of weight w has w lots, so that a uniform number draws it by weight.
        lots = np.repeat(np.arange(world.nothing, dtype=np.int32), world.distractor_weights)
        self._lots = arrays.array(lots)

    def env_keys(
        self,
        seed: int,
        first: int,
        count: int,
    ) -> Array:
        """Return the hashes of seed and environment that :meth:`keys` needs.

        Args:
            seed: random seed, 0 or more.
            first: number of the first environment.
            count: number of environments.

        Returns:
            shape (count,), int64, for environments ``first``, ``first + 1``, ...

        Raises:
            ConfigError: for a negative seed.
        """
        # NumPy mixes the seed, so that neighbouring seeds have nothing in common.
        sequence = np.random.SeedSequence(whole("seed", seed, 0))
        words = sequence.generate_state(1, np.uint64).view(np.int64)
        environments = np.arange(first, first + count)
        return mixed(self.arrays.array(environments * STRIDE + words))

    def keys(self, env_keys: Array, episodes: Array) -> Array:
        """Return the key of each episode, for :meth:`env_keys` and episode numbers."""
        if self.repeat:
            episodes = episodes % self.repeat
        return mixed(env_keys + episodes * _EPISODE_STRIDE)

    def _numbers(
        self,
        keys: Array,
        first: int,
        count: int,
    ) -> Array:
        """Return 31-bit numbers ``first``, ``first + 1``, ... of R keys, shape (count, R).

        A number does not depend on ``count``.
        """
        # A hash of 64 bits gives two numbers.
        half = (count + 1) // 2
        strides = np.arange(first, first + half) * STRIDE
        hashed = mixed(keys[None, :] + self.arrays.array(strides[:, None]))
        numbers = self.arrays.full((2 * half, len(keys)), 0)
        numbers[::2] = (hashed >> 33) & _LAST_31_BITS
        numbers[1::2] = hashed & _LAST_31_BITS
        return numbers[:count]

    def tasks(self, keys: Array) -> Array:
        """Draw a task index for each of R episode :meth:`keys`, uniformly: shape (R,)."""
        return (self._numbers(keys, 0, 1)[0] * len(self.world.tasks)) >> 31

    def tables(self, keys: Array, tasks: Array) -> Array:
        """Draw starting tables for R episode :meth:`keys` and task indices.

        Returns:
            shape (R, width), int32: ids, shuffled, empty slots last.
        """
        size = len(keys) if self.arrays.on_device else _CHUNK
        chunks = [slice(first, first + size) for first in range(0, len(keys), size)]
        pieces = [self._tables(keys[chunk], tasks[chunk]) for chunk in chunks]
        return self.arrays.xp.concatenate(pieces)

    def _tables(self, keys: Array, tasks: Array) -> Array:
        arrays = self.arrays
        starts = self._starts[tasks].T
        rows = starts
        if self.most_drawn:
            distractors = self._distractors(keys, tasks, starts)
            num_distractors = self.world.config.num_distractors
            # Further distractors take the places of ingredients that a task lacks, from the last
            # one on. So tables of tasks that lack none do not depend on other tasks.
            extra = distractors[self._further]
            num_full = len(starts) - len(extra)
            parts = starts[num_full:]
            filled = arrays.xp.where(parts == self.world.nothing, extra, parts)
            rows = arrays.xp.concatenate([starts[:num_full], filled, distractors[:num_distractors]])
        # Shuffled by sorting random places. Halved, so that an empty slot's place is above all.
        places = self._numbers(keys, _PLACES, len(rows)) >> 1
        order = arrays.xp.where(rows == self.world.nothing, _LAST_31_BITS, places)
        return self._in_order(order, rows)

    def _in_order(self, order: Array, ids: Array) -> Array:
        """Return the ids of each column by ascending ``order``, 31-bit numbers: (R, K) for (K, R).

        One sort of single numbers is faster than a sort of places and a look-up of ids.
        """
        # One number packs the order, with the row in the last bits to break ties, and the id.
        last = (1 << (len(ids) - 1).bit_length()) - 1
        index = self.arrays.array(np.arange(len(ids)))[:, None]
        packed = (((order & ~last) + index) << 32) + ids
        return self.arrays.cast(self.arrays.sorted_rows(packed.T) & _LAST_31_BITS, "int32")

    # --- distractors ------------------------------------------------------------------------------

    def _distractors(
        self,
        keys: Array,
        tasks: Array,
        starts: Array,
    ) -> Array:
        """Draw distractors by weight without replacement: shape (most_drawn, R).

        Candidates are drawn with replacement, and those that are not allowed are skipped. Where no
        allowed entity is left, the id of nothing. Rows beyond a task's number have no meaning.
        """
        goals = self._goals[tasks][None, :]
        excluded = self.arrays.xp.concatenate([goals, starts, self._intermediates[tasks].T])
        if self.arrays.on_device:
            # One round with many candidates, because a check would wait for the device.
            return self._pick(keys, excluded, 8 * self.most_drawn + 16)
        return self._drawn_in_rounds(keys, tasks, excluded)

    def _drawn_in_rounds(
        self,
        keys: Array,
        tasks: Array,
        excluded: Array,
    ) -> Array:
        """Draw distractors with as few candidates as each table needs: (most_drawn, R)."""
        num_distractors = self.world.config.num_distractors
        counts = self._num_drawn[tasks]
        # Most tables take the first candidates; the rest are drawn with more care.
        first = self._candidates(keys, num_distractors)
        clash = self._clashes(first, excluded) | (counts > num_distractors)
        open_tables = clash.nonzero()[0]
        distractors = np.full((self.most_drawn, len(keys)), self.world.nothing, dtype=np.int32)
        distractors[:num_distractors] = first
        amount = self.most_drawn + 4
        while len(open_tables):
            picks = self._pick(keys[open_tables], excluded[:, open_tables], amount)
            distractors[:, open_tables] = picks
            amount *= 4
            if amount >= 2**11 * self.most_drawn:
                break  # entities have run out: the last slots stay empty
            num_chosen = (picks != self.world.nothing).sum(0)
            open_tables = open_tables[num_chosen < counts[open_tables]]
        return distractors

    def _candidates(self, keys: Array, amount: int) -> Array:
        """Return entities drawn by weight, with replacement: shape (amount, R)."""
        # A product with a 31-bit number, shifted by 31, is a uniform number below the factor.
        lots = (self._numbers(keys, 1, amount) * len(self._lots)) >> 31
        return self._lots[lots]

    def _clashes(self, candidates: Array, excluded: Array) -> Array:
        """Return which tables draw an entity twice, or one that is taken; shape (R,), bool."""
        clash = self.arrays.full((candidates.shape[1],), 0, "bool")
        for i, candidate in enumerate(candidates):
            clash |= (candidate == excluded).any(0)
            clash |= (candidate == candidates[:i]).any(0)
        return clash

    def _pick(
        self,
        keys: Array,
        excluded: Array,
        amount: int,
    ) -> Array:
        """Take the first allowed distractors among ``amount`` candidates, in their order.

        Returns:
            shape (most_drawn, R); the id of nothing where too few are allowed.
        """
        arrays = self.arrays
        candidates = self._candidates(keys, amount)
        is_allowed = arrays.full(tuple(candidates.shape), 1, "bool")
        for entity in excluded:
            is_allowed &= candidates != entity[None, :]
        # A repeated candidate is skipped: if refused before, refused again.
        for i in range(1, amount):
            is_repeated = (candidates[:i] == candidates[i][None, :]).any(0)
            is_allowed[i] &= ~is_repeated
        # Allowed candidates come first, in the order of their draw; then nothing.
        order = arrays.xp.where(is_allowed, 0, _LAST_31_BITS)
        ids = arrays.xp.where(is_allowed, candidates, self.world.nothing)
        return self._in_order(order, ids)[:, : self.most_drawn].T


class Ahead:
    """A cache with the next episodes for N environments: ``size`` tasks and starting tables each.

    On the CPU, missing episodes are drawn on demand. On a device, control flow may not depend on
    data: episodes are drawn at once, and a caller requests only cached episodes.

    Attributes:
        draws: draws of the episodes.
        keys: shape (N,): :meth:`Draws.env_keys`.
        size: episodes drawn at a time for each environment.
    """

    def __init__(
        self,
        draws: Draws,
        keys: Array,
        episodes: Array,
    ):
        """Begin the cache.

        Args:
            draws: draws of the episodes.
            keys: :meth:`Draws.env_keys` of N environments.
            episodes: shape (N,): number of each environment's next episode.
        """
        arrays = draws.arrays
        count = len(keys)
        self.draws = draws
        self.keys = keys
        self.size = _AHEAD if count <= _MANY else _AHEAD_OF_MANY
        if not arrays.on_device and (draws.world.has_combine or count == 1):
            self.size *= _MORE
        self._tables = arrays.full((count, self.size, draws.width), 0, "int32")
        self._tasks = arrays.full((count, self.size), 0, "int32")
        # Number of the first cached episode; so low at first that nothing counts as cached.
        self._first = arrays.full((count,), -self.size)
        self._offsets = arrays.array(np.arange(self.size))[None, :]
        if arrays.on_device:
            self._draw(arrays.array(np.arange(count)), episodes)

    def _draw(self, rows: Array, episodes: Array) -> None:
        """Draw episodes of the environments ``rows``, (R,), from the numbers ``episodes``, (R,)."""
        draws = self.draws
        shape = (len(rows), self.size)
        # All episodes of all environments in one draw of R * size tables.
        numbers = episodes[:, None] + self._offsets
        keys = draws.keys(self.keys[rows][:, None], numbers).reshape(-1)
        tasks = draws.tasks(keys)
        self._tables[rows] = draws.tables(keys, tasks).reshape(*shape, -1)
        self._tasks[rows] = draws.arrays.cast(tasks, "int32").reshape(shape)
        self._first[rows] = episodes

    def take(self, rows: Array, episodes: Array) -> tuple[Array, Array]:
        """Return starting tables (R, width) and task indices (R,) of environments ``rows``.

        ``episodes``, shape (R,), are the numbers of the episodes, which the cache need not hold on
        the CPU.
        """
        arrays = self.draws.arrays
        index = episodes - self._first[rows]
        if not arrays.on_device:
            # Outside of 0 to size - 1: used up, or a restored state from before.
            missing = (index != index % self.size).nonzero()[0]
            if len(missing):
                self._draw(rows[missing], episodes[missing])
                index[missing] = 0
        # Rows of flat views: one look-up each instead of an index along two axes.
        flat_rows = rows * self.size + index
        tables = arrays.take_rows(self._tables.reshape(-1, self.draws.width), flat_rows)
        tasks = arrays.take_rows(self._tasks.reshape(-1), flat_rows)
        return tables, arrays.cast(tasks, "int64")


MOST_TASKS = 50_000
"""Most tasks to play by default; of more, evenly spaced tasks are played."""
EVALUATION_SEED = 0
"""Seed for distractors in evaluation, independent of an agent's seed."""
MANY_TASKS = 6_000
"""Most tasks that are played on several tables by default.

For more tasks, further tables hardly change an interval.
"""


def default_seeds(num_tasks: int) -> int:
    """Return the default number of distractor seeds (tables per task).

    5, or 1 above :data:`MANY_TASKS` tasks.
    """
    return 5 if num_tasks <= MANY_TASKS else 1


def distance_of(amount: int, limit: int | None) -> int:
    """Return the step between evaluated tasks, 1 for all tasks.

    With it, at most ``limit`` out of ``amount`` tasks are evaluated; None is no limit.
    """
    if limit is None:
        return 1
    return (amount + limit - 1) // limit  # rounded up


def sampled_tasks(world: World, limit: int | None = MOST_TASKS) -> Ids:
    """Return the numbers of the evaluated tasks: all, or at most ``limit`` evenly spaced ones."""
    num_tasks = len(world.tasks)
    return np.arange(0, num_tasks, distance_of(num_tasks, limit))


def warn_of_sample(world: World, tasks: Ids, limit: int | None) -> None:
    """Log a warning that only some tasks are evaluated, unless the user has set the limit.

    Args:
        world: graph, tasks and settings.
        tasks: numbers of the evaluated tasks, shape (N,), from :func:`sampled_tasks`.
        limit: the limit of which the sample comes; only the default one is worth a warning.
    """
    if len(tasks) < len(world.tasks) and limit == MOST_TASKS:
        logging.getLogger(__name__).warning(
            "%s %s tasks are too many: evaluating a sample of %s tasks.",
            f"{len(world.tasks):,}",
            world.config.part,
            f"{len(tasks):,}",
        )


class EvaluationTables:
    """The fixed starting table for each task and distractor seed in a world.

    Attributes:
        world: graph, tasks and settings.

    Example:
        >>> world = World.open("kitchen", WordCraftConfig(part="test", num_distractors=2))
        >>> tables = EvaluationTables(world)
        >>> len(tables.table(0)), tables.table(0) == tables.table(0, distractor_seed=1)
        (4, False)
    """

    def __init__(self, world: World, limit: int | None = MOST_TASKS):
        """Prepare the draws of a world's tables, in an evaluation of at most ``limit`` tasks."""
        self.world = world
        self._limit = limit
        self._draws = Draws(world, arrays_of("cpu"))

    def table(self, task: int, distractor_seed: int = 0) -> list[int]:
        """Return the ids on a task's starting table in slot order.

        Args:
            task: task index.
            distractor_seed: number of the table, 0 or more.

        Raises:
            ConfigError: if there is no such task or seed.
        """
        amount = len(self.world.tasks)
        whole("task", task, 0, amount - 1)
        whole("distractor_seed", distractor_seed, 0, MAX_SIZE)
        # An evaluator plays every n-th task, each in an environment of its own, and the environment
        # seeds the distractors. A task outside the sample has separate tables.
        place, remainder = divmod(task, distance_of(amount, self._limit))
        environment = task if remainder else place
        env_keys = self._draws.env_keys(EVALUATION_SEED, environment, 1)
        keys = self._draws.keys(env_keys, np.array([distractor_seed]))
        (table,) = self._draws.tables(keys, np.array([task]))
        return self.world.without_nothing(table.tolist())
