"""Batched crafting environments: the rules in :mod:`wordcraft_kg.envs.wordcraft`, on arrays for N environments.

:mod:`~wordcraft_kg.envs.draws` draws the start of episodes, this module computes steps. Both run on NumPy and torch,
see :mod:`~wordcraft_kg.envs.arrays`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

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
"""Names of the outcomes of a step; a code is an index into this tuple."""

_DENSE_LIMIT = (
    4_096  # entities up to which pairs are looked up in a square table, of 4 bytes a cell
)


class Step(NamedTuple):
    """The outcome of one action in each of N environments; all arrays have shape (N,).

    Attributes:
        reward: float32, including shaped rewards.
        over: whether the step ended the episode.
        outcome: int8, index into :data:`OUTCOMES`.
        by_plan: whether the goal was made by the last pair of one of the task's plans.
        illegal: whether the action chose an empty slot.
        task: index into the world's tasks.
    """

    reward: Array
    over: Array
    outcome: Array
    by_plan: Array
    illegal: Array
    task: Array


class State(NamedTuple):
    """The state of N environments, never modified by a step. Shape (N,), int64, unless stated otherwise.

    Attributes:
        engine: the engine that made this state.
        keys: hashes of seed and environment, from which episodes are drawn.
        ahead: cache of the next episodes, without influence on results.
        age: steps since episodes were last drawn, counted on a device only.
        goal: id of the entity to make.
        task: index into the world's tasks.
        selection: id of the selected entity, or of nothing.
        attempts_left: attempts left in the episode; 0 after the end.
        wide: shape (N, num_slots + 1), ids: the table, and a spare column for writes without effect.
        count: number of entities on the table, int64.
        tried: shape (N, attempts, 2): ids of the pairs combined in the episode, padded with the id of nothing; not
            kept for episodes of one attempt.
        episode: number of the next episode.
    """

    engine: "BatchEngine"
    keys: Array
    ahead: Ahead
    age: int
    goal: Array
    task: Array
    selection: Array
    attempts_left: Array
    wide: Array
    count: Array  # type: ignore[assignment] # hides the method of tuples
    tried: Array
    episode: Array

    @property
    def world(self) -> World:
        """The engine's world: graph, tasks and settings."""
        return self.engine.world

    @property
    def num_envs(self) -> int:
        """Number of environments, N."""
        return self.engine.num_envs

    @property
    def nothing(self) -> int:
        """The id for an empty slot or no selection, equal to the number of entities."""
        return self.engine.nothing

    @property
    def table(self) -> Array:
        """The entity in each slot, shape (N, num_slots), int64, ids; empty slots hold the id of nothing."""
        return self.wide[:, :-1]

    def action_masks(self) -> Array:
        """Return which slots hold an entity, shape (N, num_slots), bool."""
        return self.table != self.engine.nothing

    def random_actions(self, numbers: Array) -> Array:
        """Return a legal action for each environment, drawn with uniform numbers in [0, 1), shape (N,)."""
        return self.engine.arrays.cast(numbers * self.count, "int64")

    def saved(self) -> dict[str, NDArray[Any]]:
        """Return the state as NumPy copies by name, for :meth:`restored`."""
        return {name: self.engine.arrays.numpy(getattr(self, name)) for name in _SAVED}

    def restored(self, saved: Mapping[str, NDArray[Any]]) -> "State":
        """Return the environments' state from :meth:`saved` arrays; ConfigError if shapes differ from this state's."""
        for name in _SAVED:
            expected = tuple(getattr(self, name).shape)
            if name not in saved or tuple(saved[name].shape) != expected:
                raise ConfigError(
                    f"this is the state of another engine: '{name}' should have shape {expected}."
                )
        array = self.engine.arrays.array
        copies: dict[str, Any] = {
            name: array(np.array(saved[name], dtype=np.int64)) for name in _SAVED
        }
        # Episodes drawn ahead are drawn again: they depend only on seed, environment and episode.
        ahead = Ahead(self.ahead.draws, self.keys, copies["episode"])
        return self._replace(ahead=ahead, age=0, **copies)


_GOAL = State._fields.index("goal")
_SAVED: tuple[str, ...] = State._fields[_GOAL:]


class _PairNumbers:
    """Pair numbers by entity ids: from a square table for a small graph, otherwise by search."""

    def __init__(self, graph: RecipeGraph, arrays: Arrays):
        self.xp, self.size, self.no_pair = arrays.xp, graph.num_entities + 1, graph.num_pairs
        a, b, _ = graph.recipes[graph.pair_starts[:-1]].T
        self.is_dense = graph.num_entities <= _DENSE_LIMIT
        if self.is_dense:
            table = np.full((self.size, self.size), self.no_pair, dtype=np.int32)
            table[a, b] = table[b, a] = np.arange(self.no_pair)
            self._table = arrays.array(table.reshape(-1))
        else:
            self._keys = arrays.array(np.append(a * self.size + b, np.iinfo("int64").max))

    def __call__(self, one: Array, other: Array) -> Array:
        """Return pair numbers, for ids of equal shapes."""
        if self.is_dense:
            return self._table.take(one * self.size + other)
        keys = self.xp.minimum(one, other) * self.size + self.xp.maximum(one, other)
        places = self.xp.searchsorted(self._keys, keys)
        return self.xp.where(self._keys[places] == keys, places, self.no_pair)


class BatchEngine:
    """N crafting environments that step together, as pure functions on a :class:`State`.

    When an episode ends, the environment begins the next episode.

    Attributes:
        nothing: the id for an empty slot or no selection, equal to the number of entities.
        arrays: array operations by NumPy or torch.
        pairs: function from two arrays of ids to pair numbers; ``num_pairs`` for pairs without a result.

    Example:
        >>> engine = BatchEngine(World("kitchen", WordCraftConfig(num_distractors=2)), 4)
        >>> state = engine.reset(seed=0)
        >>> after, step = engine.step(state, np.zeros(4, dtype=np.int64))
        >>> step.over.tolist(), (after.selection == state.table[:, 0]).all()
        ([False, False, False, False], True)
    """

    def __init__(self, world: World, num_envs: int, *, device: str = "cpu", first_env: int = 0):
        """Prepare N environments.

        ``device`` is ``cpu``, or a torch device such as ``cuda``; ``torch:cpu`` runs the code for devices on the CPU.
        ``first_env``, the number of the first environment, seeds the random draws: two engines for environments 0 to 63
        and 64 to 127 draw the same episodes as one engine for 128.
        """
        self.num_envs = whole("num_envs", num_envs, 1, MAX_SIZE)
        self.first_env = whole("first_env", first_env, 0)
        self.world, self.config = world, world.config
        self.nothing, self.num_slots = world.nothing, world.num_slots
        self.arrays = arrays_of(device)
        self.pairs = _PairNumbers(world.graph, self.arrays)
        self._draws = Draws(world, self.arrays)
        self._goals, self._made, self._finals, self._results = map(
            self.arrays.array,
            (
                world.tasks.goals,
                world.tasks.intermediates,
                world.tasks.final_pairs,
                _results(world),
            ),
        )
        self._rows = self.arrays.array(np.arange(self.num_envs))
        self._numbers = self.arrays.array(np.arange(self.config.attempts))
        self._offsets = self._rows * (
            self.num_slots + 1
        )  # of the environments' tables in `State.wide`

    # --- episodes ----------------------------------------------------------------------------------------------------

    def reset(self, seed: int = 0) -> State:
        """Begin the first episode of a seed in every environment; a negative seed raises a :class:`ConfigError`."""
        return self._begin(self._keys(seed), self.arrays.full((self.num_envs,), 0))

    def restart(self, state: State) -> State:
        """Begin the next episode in every environment."""
        return self._begin(state.keys, state.episode)

    def pose(
        self, tasks: Array, episode: int = 0, *, seed: int = 0, tables: Array | None = None
    ) -> State:
        """Begin an episode with a given task in each environment, for evaluation.

        ``tasks`` are task indices, shape (N,). Later episodes have drawn tasks. Distractors depend only on seed,
        environment number, ``episode`` and task, unless ``tables`` are given: ids in slot order, padded with nothing,
        shape (N, at most num_slots).
        """
        keys, number = self._keys(seed), self.arrays.full((self.num_envs,), episode)
        tasks = (
            self.arrays.array(np.array(tasks, dtype=np.int64))
            if isinstance(tasks, list | np.ndarray)
            else tasks
        )
        if tables is None:
            tables = self._draws.tables(self._draws.keys(keys, number), tasks)
        begun = self._begun(tables, tasks)
        return State._make(
            (self, keys, Ahead(self._draws, keys, number + 1), 0, *begun, number + 1)
        )

    def _keys(self, seed: int) -> Array:
        return self._draws.env_keys(seed, self.first_env, self.num_envs)

    def _begin(self, keys: Array, episode: Array) -> State:
        ahead = Ahead(self._draws, keys, episode)
        return State._make(
            (self, keys, ahead, 1, *self._begun(*ahead.take(self._rows, episode)), episode + 1)
        )

    def _begun(self, tables: Array, tasks: Array) -> Sequence[Array]:
        full, size = self.arrays.full, (len(tables),)
        wide = full((len(tables), self.num_slots + 1), self.nothing)
        wide[:, : tables.shape[1]] = tables
        # Most tables are full at depth 1.
        count = full(size, tables.shape[1])
        rows = self.arrays.rows(tables[:, -1] == self.nothing)
        count[rows] = (tables[rows] != self.nothing).sum(1)
        tried = full((*size, self.config.attempts, 2), self.nothing)
        return (
            self._goals[tasks],
            tasks,
            full(size, self.nothing),
            full(size, self.config.attempts),
            wide,
            count,
            tried,
        )

    def begin_where(self, now: State, over: Array, before: State | None = None) -> State:
        """Begin the next episode where ``over``, shape (N,), is True; arrays not in ``before`` may be written to."""
        on_device = self.arrays.on_device
        rows = self._rows if on_device else over.nonzero()[0]
        if not len(rows):
            return now
        begun = self._begun(*now.ahead.take(rows, now.episode[rows]))
        current: Any = now[_GOAL:-1]
        earlier: Any = (before or now)[_GOAL:-1]
        episode, ahead, age = now.episode + over, now.ahead, now.age
        if on_device:
            # Without reading from the device: every environment is written, with the old state or the next episode.
            masks = (over.reshape(-1, *[1] * (new.ndim - 1)) for new in begun)
            begun = list(map(self.arrays.xp.where, masks, begun, current))
            age += 1
            if age == ahead.size:
                ahead, age = Ahead(self._draws, now.keys, episode), 0
        elif len(rows) < self.num_envs:
            own = [
                old.copy() if old is was else old for old, was in zip(current, earlier, strict=True)
            ]
            for array, new in zip(own, begun, strict=True):
                array[rows] = new
            begun = own
        return State._make((self, now.keys, ahead, age, *begun, episode))

    # --- steps -------------------------------------------------------------------------------------------------------

    def step(self, state: State, actions: Array) -> tuple[State, Step]:
        """Choose a slot in each environment; the next episode begins in the step that ends an episode.

        ``actions`` are slots, integers of shape (N,), checked on the CPU only. ``state`` stays unchanged. ActionError
        for a number that is not a slot, or for an empty slot if ``illegal_action`` is ``raise``.
        """
        now, done = self._step(state, actions, is_replaced=True)
        return self.begin_where(now, done.over, state), done

    def step_once(self, state: State, actions: Array) -> tuple[State, Step]:
        """Like :meth:`step`, but an environment without attempts left stays unchanged."""
        if not self.arrays.on_device and not (state.attempts_left > 0).any():
            raise EpisodeError("all episodes are over; call pose() or reset().")
        now, done = self._step(state, actions, is_replaced=False)
        return now._replace(
            attempts_left=self.arrays.xp.where(done.over, 0, now.attempts_left)
        ), done

    def _step(self, state: State, actions: Array, *, is_replaced: bool) -> tuple[State, Step]:
        """Step without new episodes; with ``is_replaced``, tables of finished episodes may be skipped."""
        nothing, cast = self.nothing, self.arrays.cast
        if not self.arrays.on_device:
            actions = self._checked(actions)
        running = state.attempts_left > 0
        chosen = state.wide.take(self._offsets + actions)
        empty = chosen == nothing
        illegal = empty & running
        if self.config.illegal_action == "raise" and bool(illegal.any()):
            env = int(illegal.nonzero()[0][0])
            raise ActionError(
                f"action {int(actions[env])} of environment {env}: the slot is empty; slots 0 to "
                f"{int(state.count[env]) - 1} hold entities."
            )
        second = state.selection != nothing
        # An empty selection or an empty slot makes nothing: the table of pairs has a row for nothing.
        pair = self.pairs(state.selection, chosen)
        wide, count, made_goal, by_plan, shaped = self._land(state, pair, running, is_replaced)
        attempts_left = state.attempts_left - cast((second | empty) & running, "int64")
        selection = self.arrays.xp.where(second | empty, nothing, chosen)
        over = running & (made_goal | (attempts_left == 0))
        reward = cast(made_goal, "float32")
        if shaped is not None:
            wrong = second & ~empty & running & (pair == self.pairs.no_pair)
            reward = (
                reward + shaped - self.config.rewards.wrong_pair_penalty * cast(wrong, "float32")
            )
        outcome = cast(over, "int8") * OUT_OF_ATTEMPTS - cast(made_goal, "int8")
        kept = self, state.keys, state.ahead, state.age, state.goal, state.task
        tried = self._noted(state, chosen, second & ~empty & running)
        now = State(*kept, selection, attempts_left, wide, count, tried, state.episode)
        return now, Step(cast(reward, "float32"), over, outcome, by_plan, illegal, state.task)

    def _noted(self, state: State, chosen: Array, is_tried: Array) -> Array:
        attempts, xp = self.config.attempts, self.arrays.xp
        if attempts == 1:
            return state.tried
        number = attempts - state.attempts_left
        is_now = is_tried[:, None] & (self._numbers == number[:, None])
        return xp.where(
            is_now[:, :, None], xp.stack([state.selection, chosen], 1)[:, None], state.tried
        )

    def _land(
        self, state: State, pair: Array, running: Array, is_replaced: bool
    ) -> tuple[Array, Array, Array, Array, Array | None]:
        """Return tables with results, table sizes, masks for goals and for goals by plan, and shaped rewards."""
        arrays, rewards = self.arrays, self.config.rewards
        makes = (pair != self.pairs.no_pair) & running
        made_goal, by_plan = (arrays.full((self.num_envs,), 0, "bool") for _ in range(2))
        is_shaped = bool(
            rewards.wrong_pair_penalty or rewards.irrelevant_penalty or rewards.intermediate_reward
        )
        shaped = arrays.full((self.num_envs,), 0, "float32") if is_shaped else None
        rows = arrays.rows(makes)
        if not len(rows):
            return state.wide, state.count, made_goal, by_plan, shaped
        results, goal, task, makes = (
            self._results[pair[rows]],
            state.goal[rows],
            state.task[rows],
            makes[rows],
        )
        hit = (results == goal[:, None]).any(1) & makes
        made_goal[rows] = hit
        by_plan[rows] = hit & (self._finals[task] == pair[rows][:, None]).any(1)
        if (
            is_replaced
            and shaped is None
            and not arrays.on_device
            and (hit | (state.attempts_left[rows] == 1)).all()
        ):
            return state.wide, state.count, made_goal, by_plan, shaped
        made = self._made[task]
        first, relevant = arrays.full((len(rows),), 0), hit
        tables, count, wide = state.wide[rows], state.count[rows], arrays.copy(state.wide)
        for i in range(results.shape[1]):
            result = results[:, i]
            is_new = makes & (result != self.nothing) & ~(tables == result[:, None]).any(1)
            if is_shaped:
                is_made = (made == result[:, None]).any(1) & (result != self.nothing)
                first, relevant = first + (is_made & is_new), relevant | is_made
            # Where nothing is new, the id of nothing is written to the first free slot, which holds this id already.
            wide[rows, count] = arrays.xp.where(is_new, result, wide[rows, count])
            count = count + is_new
        counts = arrays.copy(state.count)
        counts[rows] = count
        if shaped is not None:
            irrelevant = arrays.cast(makes & ~relevant, "float32")
            shaped[rows] = (
                rewards.intermediate_reward * arrays.cast(first, "float32")
                - rewards.irrelevant_penalty * irrelevant
            )
        return wide, counts, made_goal, by_plan, shaped

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


def _results(world: World) -> NDArray[np.int64]:
    graph = world.graph
    starts, sizes = graph.pair_starts[:-1], np.diff(graph.pair_starts)
    results = np.full((graph.num_pairs + 1, world.max_results), world.nothing)
    for i in range(world.max_results):
        rows = starts + (sizes - 1 if world.config.ambiguity == "last" else i)
        has = sizes > i
        results[:-1][has, i] = graph.recipes[rows[has], 2]
    return results
