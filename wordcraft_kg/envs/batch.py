"""Many crafting environments at once, as arrays: the semantics of :mod:`wordcraft_kg.envs.wordcraft`, in bulk.

:mod:`~wordcraft_kg.envs.draws` draws what episodes begin with, this module computes steps. Both are written once, for
NumPy and torch alike: see :mod:`~wordcraft_kg.envs.arrays`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ActionError, ConfigError, EpisodeError
from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.envs.arrays import Array, Arrays, arrays_of
from wordcraft_kg.envs.draws import Ahead, Draws
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.recipe_graph import RecipeGraph

IN_PROGRESS, GOAL, OUT_OF_ATTEMPTS = 0, 1, 2
OUTCOMES = ("in_progress", "goal", "out_of_attempts")
"""Names of the outcome codes."""

DENSE_LIMIT = 4_096
"""Most entities for which pairs are looked up in a square table, of 4 bytes a cell; larger graphs use a search."""


@dataclass
class Step:
    """The outcome of a step in all environments, shape (N,) each.

    Attributes:
        reward: float32.
        over: whether the episode ended with this step; if so, the observation is the first of the next episode.
        outcome: int8, of the episode that the step belongs to; names in :data:`OUTCOMES`.
        by_plan: whether the last pair of a plan made the goal.
        illegal: whether an empty slot was picked.
        task: index of the task that the step belongs to.
    """

    reward: Array
    over: Array
    outcome: Array
    by_plan: Array
    illegal: Array
    task: Array


@dataclass
class State:
    """The state of N environments; shape (N,), int64, unless stated otherwise.

    Attributes:
        goal: id.
        task: index into the world's tasks.
        selection: id of the entity in hand.
        attempts_left: 0 where the episode is over and no other has begun.
        wide: shape (N, num_slots + 1), ids: the table, and a spare column that is written to when nothing new is made
            and the table is full.
        count: entities on the table.
        episode: number of the next episode.
    """

    goal: Array
    task: Array
    selection: Array
    attempts_left: Array
    wide: Array
    count: Array
    episode: Array


class PairNumbers:
    """The number of the pair of any two entities, from a square table if the graph is small enough, else by search."""

    def __init__(self, graph: RecipeGraph, arrays: Arrays):
        """Number the pairs as the graph does; pairs that make nothing, or contain nothing, get ``num_pairs``."""
        self.xp, self.size, self.no_pair = arrays.xp, graph.num_entities + 1, graph.num_pairs
        a, b, _ = graph.recipes[graph.pair_starts[:-1]].T
        self.is_dense = graph.num_entities <= DENSE_LIMIT
        if self.is_dense:
            table = np.full((self.size, self.size), self.no_pair, dtype=np.int32)
            table[a, b] = table[b, a] = np.arange(self.no_pair)
            self._table = arrays.array(table.reshape(-1))
        else:
            self._keys = arrays.array(np.append(a * self.size + b, np.iinfo("int64").max))

    def __call__(self, one: Array, other: Array) -> Array:
        """Return the numbers of pairs; ids of equal shapes."""
        if self.is_dense:
            return self._table.take(one * self.size + other)
        keys = self.xp.minimum(one, other) * self.size + self.xp.maximum(one, other)
        found = self.xp.searchsorted(self._keys, keys)
        return self.xp.where(self._keys[found] == keys, found, self.no_pair)


class BatchEngine:
    """N environments in step; when an episode ends, the next one begins in the same step.

    Attributes:
        world: graph, tasks and settings.
        num_envs: N.
        num_slots: size of a table.
        nothing: id of nothing.
        arrays: the library and device of all arrays that are taken and returned.
        pairs: the number of the pair of two entities, ``num_pairs`` where they make nothing.
    """

    def __init__(self, world: World, num_envs: int, *, device: str = "cpu", seed: int = 0, first_env: int = 0):
        """Begin the first episode in each of N environments.

        Args:
            world: graph, tasks and settings.
            num_envs: N, 1 or more.
            device: ``cpu``, or a device of torch such as ``cuda``; ``torch:cpu`` runs on the CPU what a device runs.
            seed: see :meth:`reset`.
            first_env: number of the first environment. What an environment draws depends on its number: two engines for
                numbers 0 to 63 and 64 to 127 draw what one engine for all 128 draws.

        Raises:
            ConfigError: for no environments, a negative number, or a device that is not available.
        """
        self.num_envs = whole("num_envs", num_envs, 1, MAX_SIZE)
        self.first_env = whole("first_env", first_env, 0)
        self.world, self.config = world, world.config
        self.nothing, self.num_slots = world.nothing, world.num_slots
        self.arrays = arrays_of(device)
        self.pairs = PairNumbers(world.graph, self.arrays)
        self._draws = Draws(world, self.arrays)
        self._goals, self._made, self._finals, self._results = map(
            self.arrays.array,
            (world.tasks.goals, world.tasks.intermediates, world.tasks.final_pairs, _results(world)),
        )
        self._rows = self.arrays.array(np.arange(self.num_envs))
        self._offsets = self._rows * (self.num_slots + 1)  # of the environments' tables in `State.wide`
        self.reset(seed)

    # --- what is seen ------------------------------------------------------------------------------------------------

    @property
    def goal(self) -> Array:
        """Shape (N,), int64, ids."""
        return self._state.goal

    @property
    def selection(self) -> Array:
        """Shape (N,), int64: id of the entity in hand."""
        return self._state.selection

    @property
    def table(self) -> Array:
        """Shape (N, num_slots), int64, ids; empty slots hold the id of nothing."""
        return self._state.wide[:, : self.num_slots]

    @property
    def attempts_left(self) -> Array:
        """Shape (N,), int64."""
        return self._state.attempts_left

    @property
    def task(self) -> Array:
        """Shape (N,), int64, indices into the world's tasks."""
        return self._state.task

    def action_masks(self) -> Array:
        """Return which slots hold an entity, shape (N, num_slots), bool."""
        return self.table != self.nothing

    def random_actions(self, numbers: Array) -> Array:
        """Return a legal action for each environment, drawn with uniform numbers in [0, 1), shape (N,)."""
        return self.arrays.cast(numbers * self._state.count, "int64")

    # --- episodes ----------------------------------------------------------------------------------------------------

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode in every environment: the first one of a seed, or with None the next one.

        Raises:
            ConfigError: for a negative seed.
        """
        if seed is not None:
            self._env_keys = self._draws.env_keys(seed, self.first_env, self.num_envs)
            self._blank()
        self._look_ahead()
        self._begin(self._rows)

    def pose(self, tasks: Array, episode: int = 0) -> None:
        """Begin a given task in each environment, for evaluation; :meth:`step` then continues with drawn tasks.

        The distractors depend on the seed, the environment's number, ``episode`` and the task only.

        Args:
            tasks: shape (N,), indices into the world's tasks.
            episode: number of the draw.
        """
        self._blank()
        self._state.episode += episode
        tasks = self.arrays.array(np.asarray(tasks, dtype=np.int64)) if isinstance(tasks, list | np.ndarray) else tasks
        keys = self._draws.keys(self._env_keys, self._state.episode)
        self._place(self._rows, self._draws.tables(keys, tasks), tasks)
        self._state.episode += 1
        self._look_ahead()

    def _blank(self) -> None:
        blank = {entry.name: self.arrays.full((self.num_envs,), 0) for entry in fields(State)}
        self._state = State(**blank | {"wide": self.arrays.full((self.num_envs, self.num_slots + 1), self.nothing)})

    def _look_ahead(self) -> None:
        self._ahead = Ahead(self._draws, self._env_keys, self._state.episode)

    def _begin(self, rows: Array) -> None:
        """Begin the next episode of some environments."""
        tables, tasks = self._ahead.take(rows, self._state.episode[rows])
        self._place(rows, tables, tasks)
        self._state.episode[rows] += 1

    def _place(self, rows: Array, tables: Array, tasks: Array) -> None:
        now, width = self._state, tables.shape[1]
        where = slice(None) if len(rows) == self.num_envs else rows  # several times as fast
        now.wide[where, :width] = self.arrays.cast(tables, "int64")
        now.wide[where, width:] = self.nothing
        now.task[where] = tasks
        now.goal[where] = self._goals[tasks]
        now.selection[where] = self.nothing
        now.attempts_left[where] = self.config.attempts
        now.count[where] = self._sizes(tables)

    def _sizes(self, tables: Array) -> Array:
        """Count the entities on tables, of which most are full at depth 1."""
        sizes = self.arrays.full((len(tables),), tables.shape[1])
        rows = self.arrays.rows(tables[:, -1] == self.nothing)
        sizes[rows] = (tables[rows] != self.nothing).sum(1)
        return sizes

    def _begin_where(self, over: Array) -> None:
        """Begin the next episode in environments where one is over."""
        if not self.arrays.on_device:
            rows = over.nonzero()[0]
            if len(rows):
                self._begin(rows)
            return
        # Without reading from the device: every environment is written, with its old state or its next episode.
        where, now = self.arrays.xp.where, self._state
        tables, task = self._ahead.peek()
        table = self.arrays.cast(tables, "int64")
        room = self.arrays.full((self.num_envs, self.num_slots + 1 - table.shape[1]), self.nothing)
        now.wide = where(over[:, None], self.arrays.xp.concatenate([table, room], 1), now.wide)
        now.task = where(over, task, now.task)
        now.goal = where(over, self._goals[task], now.goal)
        now.selection = where(over, self.nothing, now.selection)
        now.attempts_left = where(over, self.config.attempts, now.attempts_left)
        now.count = where(over, self._sizes(table), now.count)
        now.episode = now.episode + over
        self._ahead.skip(over, now.episode)

    # --- resuming ----------------------------------------------------------------------------------------------------

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the state of all environments, for :meth:`restore`: copied NumPy arrays by name."""
        return {entry.name: self.arrays.numpy(getattr(self._state, entry.name)) for entry in fields(State)}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from the :meth:`state` of an engine with the same world, environments and seed.

        Raises:
            ConfigError: if the state is that of another engine.
        """
        names = [entry.name for entry in fields(State)]
        for name in names:
            expected = tuple(getattr(self._state, name).shape)
            if name not in state or tuple(state[name].shape) != expected:
                raise ConfigError(f"this is the state of another engine: '{name}' should have shape {expected}.")
        self._state = State(**{name: self.arrays.array(np.array(state[name], dtype=np.int64)) for name in names})
        # Episodes that were drawn ahead are drawn again: they depend on seed, environment and episode only.
        self._look_ahead()

    # --- steps -------------------------------------------------------------------------------------------------------

    def step(self, actions: Array) -> Step:
        """Pick a slot in every environment; when an episode ends, the next one begins.

        Args:
            actions: shape (N,), integers. On the CPU they are checked against the action space.

        Raises:
            ActionError: if one is outside the action space, or illegal where ``illegal_action`` is ``raise``.
        """
        done = self._step(actions)
        self._begin_where(done.over)
        return done

    def step_once(self, actions: Array) -> Step:
        """Like :meth:`step`, but an environment whose episode has ended stays there; further steps do nothing in it."""
        if not self.arrays.on_device and not (self.attempts_left > 0).any():
            raise EpisodeError("all episodes are over; call pose() or reset().")
        done = self._step(actions)
        self._state.attempts_left = self.arrays.xp.where(done.over, 0, self.attempts_left)
        return done

    def _step(self, actions: Array) -> Step:
        now, nothing, cast = self._state, self.nothing, self.arrays.cast
        if not self.arrays.on_device:
            actions = self._checked(actions)
        running = now.attempts_left > 0
        picked = now.wide.take(self._offsets + actions)
        empty = picked == nothing
        illegal = empty & running
        if self.config.illegal_action == "raise" and bool(illegal.any()):
            self._refuse(actions, illegal)
        second = now.selection != nothing
        # With nothing in hand, or nothing picked, nothing is made: the table of pairs has a row for that.
        pair = self.pairs(now.selection, picked)
        made_goal, by_plan, shaped = self._land(pair, running)
        ended = (second | empty) & running
        now.attempts_left = now.attempts_left - cast(ended, "int64")
        now.selection = self.arrays.xp.where(second | empty, nothing, picked)
        over = running & (made_goal | (now.attempts_left == 0))
        reward = cast(made_goal, "float32")
        if shaped is not None:
            wrong = second & ~empty & running & (pair == self.pairs.no_pair)
            reward = reward + shaped - self.config.rewards.wrong_pair_penalty * cast(wrong, "float32")
        outcome = cast(over, "int8") * OUT_OF_ATTEMPTS - cast(made_goal, "int8")
        # The task is copied, because the next one is written into the same array.
        return Step(cast(reward, "float32"), over, outcome, by_plan, illegal, now.task + 0)

    def _land(self, pair: Array, running: Array) -> tuple[Array, Array, Array | None]:
        """Put results on the tables; return where the goal was made, where by a plan, and the shaped reward."""
        arrays, rewards, now = self.arrays, self.config.rewards, self._state
        makes = (pair != self.pairs.no_pair) & running
        made_goal, by_plan = (arrays.full((self.num_envs,), 0, "bool") for _ in range(2))
        is_shaped = bool(rewards.wrong_pair_penalty or rewards.irrelevant_penalty or rewards.intermediate_reward)
        shaped = arrays.full((self.num_envs,), 0, "float32") if is_shaped else None
        rows = arrays.rows(makes)
        if not len(rows):
            return made_goal, by_plan, shaped
        results, goal, task, makes = self._results[pair[rows]], now.goal[rows], now.task[rows], makes[rows]
        hit = (results == goal[:, None]).any(1) & makes
        made = self._made[task]
        first, relevant = arrays.full((len(rows),), 0), hit
        tables, count = now.wide[rows], now.count[rows]
        for i in range(results.shape[1]):
            result = results[:, i]
            is_new = makes & (result != self.nothing) & ~(tables == result[:, None]).any(1)
            if is_shaped:
                is_made = (made == result[:, None]).any(1) & (result != self.nothing)
                first, relevant = first + (is_made & is_new), relevant | is_made
            # Where nothing is new, the id of nothing is written to the first free slot, which holds it already.
            now.wide[rows, count] = arrays.xp.where(is_new, result, now.wide[rows, count])
            count = count + is_new
        now.count[rows] = count
        made_goal[rows] = hit
        by_plan[rows] = hit & (self._finals[task] == pair[rows][:, None]).any(1)
        if shaped is not None:
            irrelevant = arrays.cast(makes & ~relevant, "float32")
            shaped[rows] = (
                rewards.intermediate_reward * arrays.cast(first, "float32") - rewards.irrelevant_penalty * irrelevant
            )
        return made_goal, by_plan, shaped

    def _checked(self, actions: Array) -> NDArray[Any]:
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

    def _refuse(self, actions: Array, illegal: Array) -> None:
        env = int(illegal.nonzero()[0][0])
        raise ActionError(
            f"action {int(actions[env])} of environment {env}: the slot is empty; slots 0 to "
            f"{int(self._state.count[env]) - 1} hold entities."
        )


def _results(world: World) -> NDArray[np.int64]:
    """Return the results of each pair, padded, and a last row for "no pair": shape (num_pairs + 1, max_results)."""
    graph = world.graph
    starts, sizes = graph.pair_starts[:-1], np.diff(graph.pair_starts)
    results = np.full((graph.num_pairs + 1, world.max_results), world.nothing)
    for i in range(world.max_results):
        rows = starts + (sizes - 1 if world.config.ambiguity == "last" else i)
        has = sizes > i
        results[:-1][has, i] = graph.recipes[rows[has], 2]
    return results
