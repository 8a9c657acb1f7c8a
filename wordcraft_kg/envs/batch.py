"""The crafting game on arrays, for one environment or many: the only place of its rules.

:mod:`~wordcraft_kg.envs.draws` draws the start of episodes, this module computes steps. Both run on
NumPy and torch, see :mod:`~wordcraft_kg.envs.arrays`.

Read :meth:`BatchEngine.step` first. It is the rules (:meth:`BatchEngine.step_env`, ``_results``,
``_put_on_table`` and ``_shaping``, without new episodes) and then :meth:`BatchEngine.begin_where`,
which replaces finished episodes. Below, N is the number of environments, r the largest number of
results of a pair, R a number of environments in which something happens. On a graph of pairs the
second selection ends an attempt; if recipes have other sizes, an attempt has up to S selections, as
many as the largest recipe has ingredients, and the last action, *combine*, ends it before.

Speed bends the code in three places. On the CPU, rows in which nothing happens are left out, and a
table is not written if its episode ends anyway. On a device, reading a value would wait for all
pending work, so there all rows are computed, and masks select.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base import MAX_SIZE, ActionError, ConfigError, EpisodeError, whole
from wordcraft_kg.envs.arrays import Array, Pairs, Sets, arrays_of
from wordcraft_kg.envs.draws import Ahead, Draws
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import RewardConfig

IN_PROGRESS = 0
GOAL = 1
OUT_OF_ATTEMPTS = 2
OUTCOMES = ("in_progress", "goal", "out_of_attempts")
"""Names of the outcomes of a step; a code is an index into this tuple."""


class Step(NamedTuple):
    """The outcome of one action in each of N environments; all arrays have shape (N,).

    Attributes:
        reward: float32 unless the engine has another type, including shaped rewards.
        over: bool, whether the step ended the episode. If so, the state after the step is the first
            of the next episode, while all arrays here belong to the episode that ended.
        outcome: int8, index into :data:`OUTCOMES`.
        by_plan: bool, whether the goal was made by the last pair of one of the task's plans.
        illegal: bool, whether the action chose an empty slot.
        task: int64, index into the world's tasks.
    """

    reward: Array
    over: Array
    outcome: Array
    by_plan: Array
    illegal: Array
    task: Array


class State(NamedTuple):
    """The state of N environments, never modified by a step. Shape (N,), int64, unless stated.

    Attributes:
        engine: the engine that made this state.
        keys: hashes of seed and environment, from which episodes are drawn.
        ahead: cache of the next episodes, without influence on results.
        age: steps since episodes were last drawn, counted on a device only.
        goal: id of the entity to make.
        task: index into the world's tasks.
        selection: id of the selected entity, or of nothing; for recipes of other sizes than two,
            shape (N, S): ids in the order of selection, padded with nothing.
        attempts_left: attempts left in the episode; 0 after the end.
        wide: shape (N, num_entity_slots + 1), ids: the table, and a spare column for writes without
            effect, when nothing new is made and the table is full. The action *combine* has the
            number of this column.
        count: number of entities on the table; these come first.
        tried: shape (N, attempts, 2 or S): ids of the pairs or sets combined in the episode, padded
            with the id of nothing; not kept for episodes of one attempt.
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
        """Ids of the entities in the slots, (N, num_slots); empty slots hold the id of nothing.

        So does the slot of *combine*.
        """
        return self.wide if self.world.has_combine else self.wide[:, :-1]

    def has_selection(self) -> Array:
        """Return whether something is selected, shape (N,), bool."""
        # Selections fill their places in order.
        first = self.selection[:, 0] if self.world.has_combine else self.selection
        return first != self.engine.nothing

    def picked(self, actions: Array) -> Array:
        """Return what the attempts have picked after actions (N,): ids, shape (N, 2 or S), padded.

        An attempt is not over with *combine* alone, so a place of a selection (N, S) is free.
        """
        entities = self.wide.take(self.engine.offsets + actions)
        if not self.world.has_combine:
            return self.engine.arrays.xp.stack([self.selection, entities], 1)
        arrays = self.engine.arrays
        picks = arrays.copy(self.selection)
        # *Combine* and empty slots hold nothing, the padding.
        picks[self.engine.rows, arrays.row_sums(picks != self.engine.nothing)] = entities
        return picks

    def action_masks(self) -> Array:
        """Return which slots hold an entity, shape (N, num_slots), bool.

        *Combine* is possible once something is selected.
        """
        masks = self.table != self.engine.nothing
        if self.world.has_combine:
            masks[:, -1] = self.has_selection()
        return masks

    def observed(self, rows: Any) -> dict[str, Any]:
        """Return the observations of some environments: their numbers, a slice, or one number."""
        # Copies, because callers may keep observations, and the engine's arrays are shared.
        return {
            "action_mask": self.action_masks()[rows].astype(np.int8),
            "attempts_left": self.attempts_left[rows].copy(),
            "goal": self.goal[rows].copy(),
            "selection": self.selection[rows].copy(),
            "table": self.table[rows].copy(),
        }

    def random_actions(self, numbers: Array) -> Array:
        """Return a legal action for each environment, by uniform numbers in [0, 1), shape (N,)."""
        arrays = self.engine.arrays
        if not self.world.has_combine:
            # Entities fill the first slots, so any slot below the count is legal.
            return arrays.cast(numbers * self.count, "int64")
        actions = arrays.cast(numbers * (self.count + self.has_selection()), "int64")
        return arrays.xp.where(actions == self.count, self.engine.num_slots - 1, actions)

    def saved(self) -> dict[str, NDArray[Any]]:
        """Return the state as NumPy copies by name, for :meth:`restored`."""
        return {name: self.engine.arrays.numpy(getattr(self, name)) for name in _SAVED}

    def restored(self, saved: Mapping[str, NDArray[Any]]) -> "State":
        """Return the environments' state from :meth:`saved` arrays.

        Seed and engine are those of this state, which must have been made in the same way.

        Raises:
            ConfigError: if an array is missing, or its shape differs from this state's.
        """
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
        return self._replace(
            ahead=ahead,
            age=0,
            **copies,
        )


_GOAL = State._fields.index("goal")
_SAVED: tuple[str, ...] = State._fields[_GOAL:]  # fields before follow from engine and seed


class _Picked(NamedTuple):
    """What the actions of N environments pick; all arrays have shape (N,) unless stated.

    Attributes:
        illegal: bool, whether the action chose an empty slot.
        ends_attempt: bool, whether the action ends the attempt.
        is_pair: bool, whether entities are combined; only shaped rewards and later attempts read
            it.
        pair: number of the combined pair or set; ``no_pair`` where nothing is combined.
        selection: as in :class:`State`, after the action.
        picks: shape (N, 2 or S): ids picked in the attempt, padded with nothing; None for episodes
            of one attempt on pairs.
    """

    illegal: Array
    ends_attempt: Array
    is_pair: Array
    pair: Array
    selection: Array
    picks: Array | None


class _Made(NamedTuple):
    """Attempts that make something.

    Attributes:
        rows: shape (R,): indices of the environments; on a device all N environments.
        makes: shape (R,), bool: whether the pair makes something, False on a device only.
        results: shape (R, r): ids of the results, padded with nothing.
        is_goal: shape (R,), bool: whether a result is the goal.
    """

    rows: Array
    makes: Array
    results: Array
    is_goal: Array


class BatchEngine:
    """N crafting environments that step together, as pure functions on a :class:`State`.

    When an episode ends, the environment begins the next episode.

    Attributes:
        world: graph, tasks and settings.
        config: the world's settings.
        num_envs: N.
        num_slots: number of actions: size of a table, and the action *combine* if recipes have
            other sizes than two.
        nothing: the id for an empty slot or no selection, equal to the number of entities.
        arrays: array operations by NumPy or torch.
        rows: numbers of the environments, shape (N,).
        offsets: shape (N,): where each environment's table begins in the flat view of
            :attr:`State.wide`.
        pairs: pair numbers and results; ``num_pairs`` for pairs without a result. Larger sets have
            such numbers, too.

    Example:
        >>> engine = BatchEngine(World.open("kitchen", WordCraftConfig(num_distractors=2)), 4)
        >>> state = engine.reset(seed=0)
        >>> after, step = engine.step(state, np.zeros(4, dtype=np.int64))
        >>> step.over.tolist(), (after.selection == state.table[:, 0]).all()
        ([False, False, False, False], True)
    """

    def __init__(
        self,
        world: World,
        num_envs: int,
        *,
        device: str = "cpu",
        repeat: int = 0,
        reward_dtype: str = "float32",
    ):
        """Prepare N environments.

        Args:
            world: graph, tasks and settings.
            num_envs: N, 1 or more.
            device: ``cpu``, or a torch device such as ``cuda``; ``torch:cpu`` runs the code for
                devices on the CPU, for tests.
            repeat: number of different episodes of an environment, which then begin again with the
                first: tables recur, and scores of tables can be kept. 0 if all differ.
            reward_dtype: data type of rewards, ``float32`` or ``float64``.

        Raises:
            ConfigError: for a number out of range, or a device that is not available.
        """
        self.num_envs = whole("num_envs", num_envs, 1, MAX_SIZE)
        self.world = world
        self.config = world.config
        self.nothing = world.nothing
        self.num_slots = world.num_slots
        self.arrays = arrays_of(device)
        # Shared, because a loop over single environments has an engine for each.
        # One of two look-ups, by two ids or by rows of ids.
        self.pairs: Any = world.shared(
            ("pairs", device),
            lambda: (Sets if world.has_combine else Pairs)(world.graph, world.usable, self.arrays),
        )
        self._draws = Draws(world, self.arrays, whole("repeat", repeat, 0))
        array = self.arrays.array
        self._goals = array(world.tasks.goals)
        self._intermediates = array(world.tasks.intermediates)
        self._final_pairs = array(world.tasks.final_pairs)
        # A function gets whole states, in place of the shaped rewards.
        rewards = self.config.rewards
        self._reward_function = None if isinstance(rewards, RewardConfig) else rewards
        self._rewards = rewards if isinstance(rewards, RewardConfig) else RewardConfig()
        # Shaped rewards depend on what is new on the table, so tables are then always written.
        self._is_shaped = rewards != RewardConfig()
        self._reward_dtype = reward_dtype
        self.rows = array(np.arange(self.num_envs))
        self._attempt_numbers = array(np.arange(self.config.attempts))
        self.offsets = self.rows * (world.num_entity_slots + 1)
        self._most_picks = world.graph.most_ingredients

    # --- episodes ---------------------------------------------------------------------------------

    def reset(self, seed: int = 0) -> State:
        """Begin the first episode of a seed in every environment.

        Raises:
            ConfigError: for a negative seed.
        """
        keys = self._draws.env_keys(seed, 0, self.num_envs)
        episode = self.arrays.full((self.num_envs,), 0)
        ahead = Ahead(self._draws, keys, episode)
        begun = self._begun(*ahead.take(self.rows, episode))
        # The cache has already given its first episode, hence age 1.
        return State._make((self, keys, ahead, 1, *begun, episode + 1))

    def reseed(
        self,
        state: State,
        seeds: Sequence[int | None],
    ) -> State:
        """Give environments seeds of their own, for the episodes that begin next.

        An environment then has the episodes of environment 0 of its seed, so equal seeds give equal
        episodes. The running episodes stay as they are.

        Args:
            state: state of this engine, which stays unchanged.
            seeds: N seeds, 0 or more; None keeps an environment's episodes.

        Raises:
            ConfigError: for a negative seed.
        """
        keys = self.arrays.copy(state.keys)
        episode = self.arrays.copy(state.episode)
        for env, seed in enumerate(seeds):
            if seed is not None:
                keys[env] = self._draws.env_keys(seed, 0, 1)[0]
                episode[env] = 0
        ahead = Ahead(self._draws, keys, episode)
        return state._replace(keys=keys, ahead=ahead, age=0, episode=episode)

    def pose(
        self,
        tasks: Array,
        episode: int = 0,
        *,
        seed: int = 0,
        tables: Array | None = None,
    ) -> State:
        """Begin an episode with a given task in each environment, for evaluation.

        Later episodes have drawn tasks.

        Args:
            tasks: shape (N,): task indices.
            episode: number of the episode. Distractors depend only on seed, environment number,
                episode and task.
            seed: random seed, 0 or more.
            tables: shape (N, at most num_slots): ids in slot order, padded with nothing. None for
                drawn distractors.

        Raises:
            ConfigError: for a negative seed.
        """
        number = self.arrays.full((self.num_envs,), episode)
        if isinstance(tasks, list | np.ndarray):
            tasks = self.arrays.array(np.array(tasks, dtype=np.int64))
        return self._posed(self._draws.env_keys(seed, 0, self.num_envs), number, tasks, tables)

    def pose_next(self, state: State, tasks: Array, tables: Array | None = None) -> State:
        """Begin the next episode of each environment of a state with a given task.

        Args:
            state: state of this engine, which stays unchanged.
            tasks: shape (N,): task indices.
            tables: as for :meth:`pose`.
        """
        return self._posed(state.keys, state.episode, tasks, tables)

    def _posed(self, keys: Array, episode: Array, tasks: Array, tables: Array | None) -> State:
        """Begin episodes of these keys and numbers, both shape (N,)."""
        if tables is None:
            tables = self._draws.tables(self._draws.keys(keys, episode), tasks)
        begun = self._begun(tables, tasks)
        following = episode + 1
        return State._make((self, keys, Ahead(self._draws, keys, following), 0, *begun, following))

    def _begun(self, tables: Array, tasks: Array) -> tuple[Array, ...]:
        """Return the first states of R episodes, from tables (R, at most num_slots) and tasks.

        These are the fields of :class:`State` from ``goal`` to ``tried``, in order.
        """
        full = self.arrays.full
        size = (len(tables),)
        wide = full((len(tables), self.world.num_entity_slots + 1), self.nothing)
        wide[:, : tables.shape[1]] = tables
        # Most tables are full at depth 1, so only the others are counted.
        count = full(size, tables.shape[1])
        rows = self.arrays.rows(tables[:, -1] == self.nothing)
        if len(rows):
            count[rows] = (tables[rows] != self.nothing).sum(1)
        picks = (self._most_picks,)
        selection = full(size + picks if self.world.has_combine else size, self.nothing)
        attempts_left = full(size, self.config.attempts)
        tried = full((*size, self.config.attempts, *picks), self.nothing)
        return self._goals[tasks], tasks, selection, attempts_left, wide, count, tried

    def begin_where(
        self,
        state: State,
        over: Array,
        state_before: State | None = None,
    ) -> State:
        """Begin the next episode in some environments.

        Args:
            state: current state.
            over: shape (N,), bool: True where the next episode begins.
            state_before: the state before a step, which stays unchanged. Arrays of ``state`` that
                are not in ``state_before`` belong to nobody else, and are written to without a
                copy. By default ``state`` itself stays unchanged.
        """
        if self.arrays.on_device:
            return self._begin_where_on_device(state, over)
        rows = over.nonzero()[0]
        if not len(rows):
            return state
        begun = self._begun(*state.ahead.take(rows, state.episode[rows]))
        episode = state.episode + over
        if len(rows) == self.num_envs:
            return State._make((self, state.keys, state.ahead, state.age, *begun, episode))
        current: Any = state[_GOAL:-1]
        earlier: Any = (state_before or state)[_GOAL:-1]
        merged = []
        for new, old, was in zip(begun, current, earlier, strict=True):
            # An array that a step did not replace still belongs to the state before.
            merged_array = old.copy() if old is was else old
            merged_array[rows] = new
            merged.append(merged_array)
        return State._make((self, state.keys, state.ahead, state.age, *merged, episode))

    def _begin_where_on_device(self, state: State, over: Array) -> State:
        """Write every environment, with the old state or the next episode, to read no count."""
        begun = self._begun(*state.ahead.take(self.rows, state.episode))
        current: Any = state[_GOAL:-1]
        merged = []
        for new, old in zip(begun, current, strict=True):
            mask = over.reshape(-1, *[1] * (new.ndim - 1))  # for arrays with further axes
            merged.append(self.arrays.xp.where(mask, new, old))
        episode = state.episode + over
        ahead = state.ahead
        age = state.age + 1
        if age == ahead.size:
            # One environment may have used all its cached episodes by now. Which one, only the
            # device knows, so all are drawn again.
            ahead = Ahead(self._draws, state.keys, episode)
            age = 0
        return State._make((self, state.keys, ahead, age, *merged, episode))

    # --- steps ------------------------------------------------------------------------------------

    def step(self, state: State, actions: Array) -> tuple[State, Step]:
        """Choose a slot in each environment; finished episodes are replaced in the same step.

        Args:
            state: state of this engine, which stays unchanged.
            actions: shape (N,), integers: slots, checked on the CPU only.

        Returns:
            The next state, and the outcome of the actions in the episodes that they belong to.

        Raises:
            ActionError: for a number that is not a slot.
        """
        after, result = self.step_env(state, self._checked(actions), is_replaced=True)
        return self.begin_where(after, result.over, state), result

    def step_once(self, state: State, actions: Array) -> tuple[State, Step]:
        """Like :meth:`step`, but an environment without attempts left stays unchanged.

        No episode is replaced, so a caller plays one episode in each environment.

        Raises:
            EpisodeError: if all episodes are over, on the CPU.
            ActionError: as :meth:`step`.
        """
        if not self.arrays.on_device and not (state.attempts_left > 0).any():
            raise EpisodeError("all episodes are over; call pose() or reset().")
        after, result = self.step_env(state, self._checked(actions))
        # A goal ends the episode with attempts left, and 0 marks the end.
        attempts_left = self.arrays.xp.where(result.over, 0, after.attempts_left)
        return after._replace(attempts_left=attempts_left), result

    # --- rules ------------------------------------------------------------------------------------

    def step_env(
        self, state: State, actions: Array, *, is_replaced: bool = False
    ) -> tuple[State, Step]:
        """Apply the rules, without new episodes.

        Args:
            state: state before the actions.
            actions: shape (N,), int64: slots, which are not checked.
            is_replaced: whether finished episodes are replaced next, so that their tables need not
                be right.

        Returns:
            The state after the actions, and their outcome. Attempts stay as they are when a goal
            ends an episode.
        """
        cast = self.arrays.cast
        # One index into the flat tables: faster than an index along two axes.
        entities = state.wide.take(self.offsets + actions)
        running = state.attempts_left > 0
        pick = self._pick_sets if self.world.has_combine else self._pick_pairs
        picked = pick(state, actions, entities, running)
        attempts_left = state.attempts_left - cast(picked.ends_attempt & running, "int64")
        made_goal, by_plan, wide, count, shaped = self._results(
            state, picked.pair, running, is_replaced=is_replaced
        )
        over = running & (made_goal | (attempts_left == 0))
        # A goal is also over: 2 - 1 is GOAL, 2 - 0 is OUT_OF_ATTEMPTS, 0 is IN_PROGRESS.
        outcome = cast(over, "int8") * OUT_OF_ATTEMPTS - cast(made_goal, "int8")
        reward = cast(made_goal, self._reward_dtype)
        if shaped is not None:
            makes_nothing = picked.is_pair & (picked.pair == self.pairs.no_pair)
            is_wrong = cast(makes_nothing, self._reward_dtype)
            reward = reward + shaped - self._rewards.wrong_pair_penalty * is_wrong
        # Not by `_replace`, which takes as long as three operations on short arrays.
        after = State(
            self,
            state.keys,
            state.ahead,
            state.age,
            state.goal,
            state.task,
            picked.selection,
            attempts_left,
            wide,
            count,
            self._noted(state, picked),
            state.episode,
        )
        step = Step(reward, over, outcome, by_plan, picked.illegal, state.task)
        if self._reward_function is not None:
            reward = self._reward_function(state, after, step)
            if getattr(reward, "shape", None) != step.reward.shape:
                raise ConfigError(
                    f"`reward` {self.config.reward} gives {type(reward).__name__} of shape "
                    f"{getattr(reward, 'shape', 'none')}; expected an array of shape "
                    f"{step.reward.shape}, as `step.reward`."
                )
            if not bool(self.arrays.xp.isfinite(reward).all()):
                raise ConfigError(
                    f"`reward` {self.config.reward} gives NaN or infinity; expected finite numbers."
                )
            step = step._replace(reward=cast(reward, self._reward_dtype))
        return after, step

    def _pick_pairs(self, state: State, actions: Array, entities: Array, running: Array) -> _Picked:
        """Return what actions pick on a graph of pairs; ``entities`` are in the chosen slots."""
        is_empty = entities == self.nothing
        # The second action of an attempt, and any choice of an empty slot, ends the attempt.
        is_second = state.selection != self.nothing
        ends_attempt = is_second | is_empty
        # Without a selection or with an empty slot nothing is made: pairs with nothing have no
        # results.
        pair = self.pairs(state.selection, entities)
        selection = self.arrays.xp.where(ends_attempt, self.nothing, entities)
        picks = None
        is_pair = is_second
        if self._is_shaped or self.config.attempts > 1:
            is_pair = is_second & ~is_empty & running
            picks = self.arrays.xp.stack([state.selection, entities], 1)
        return _Picked(is_empty & running, ends_attempt, is_pair, pair, selection, picks)

    def _pick_sets(self, state: State, actions: Array, entities: Array, running: Array) -> _Picked:
        """Return what actions pick if recipes have other sizes than two."""
        arrays = self.arrays
        is_empty = entities == self.nothing
        combines = (actions == self.num_slots - 1) & state.has_selection()
        picks = state.picked(actions)
        # A largest set is complete without *combine*.
        is_full = picks[:, -1] != self.nothing
        is_complete = (combines | is_full) & running
        pair = arrays.full((self.num_envs,), self.pairs.no_pair)
        rows = arrays.rows(is_complete)
        pair[rows] = arrays.xp.where(is_complete[rows], self.pairs(picks[rows]), self.pairs.no_pair)
        ends_attempt = is_empty | is_full
        selection = arrays.copy(picks)
        rows = arrays.rows(ends_attempt)
        selection[rows] = arrays.xp.where(ends_attempt[rows, None], self.nothing, picks[rows])
        illegal = is_empty & ~combines & running
        return _Picked(illegal, ends_attempt, is_complete, pair, selection, picks)

    def _results(
        self, state: State, pair: Array, running: Array, *, is_replaced: bool
    ) -> tuple[Array, Array, Array, Array, Array | None]:
        """Return what pairs make: goals, new tables and shaped rewards.

        Args:
            state: the state before the action, of N environments.
            pair: number of the pair or set that is combined, shape (N,); ``no_pair`` without.
            running: whether the episode goes on, shape (N,), bool.
            is_replaced: whether the next call begins new episodes where these end, so that nobody
                sees the tables of an end, and they need not be made.

        Returns:
            Whether the goal was made, and whether a plan's last pair made it, shape (N,), bool; the
            tables after the action and the numbers of entities on them, as in :class:`State`; and
            the shaped rewards for results, shape (N,), or None without shaped rewards.
        """
        made_goal = self.arrays.full((self.num_envs,), 0, "bool")
        by_plan = self.arrays.full((self.num_envs,), 0, "bool")
        shaped = None
        if self._is_shaped:
            shaped = self.arrays.full((self.num_envs,), 0, self._reward_dtype)
        makes = (pair != self.pairs.no_pair) & running
        rows = self.arrays.rows(makes)
        if not len(rows):  # as after most actions
            return made_goal, by_plan, state.wide, state.count, shaped
        results = self.pairs.results[pair[rows]]
        is_goal = (results == state.goal[rows][:, None]).any(1) & makes[rows]
        final_pairs = self._final_pairs[state.task[rows]]
        is_final = (final_pairs == pair[rows][:, None]).any(1)
        made_goal[rows] = is_goal
        by_plan[rows] = is_goal & is_final
        attempts = _Made(rows, makes[rows], results, is_goal)
        # With one attempt in an episode, the default at depth 1, all episodes with results end in
        # every step: their tables are never seen, which saves the copy of all tables. Shaped
        # rewards depend on the tables, and on a device asking would wait.
        if is_replaced and not (self._is_shaped or self.arrays.on_device):
            is_last = state.attempts_left[rows] == 1
            if (is_goal | is_last).all():
                return made_goal, by_plan, state.wide, state.count, shaped
        wide, count, news = self._put_on_table(state, attempts)
        if shaped is not None:
            shaped[rows] = self._shaping(state, attempts, news)
        return made_goal, by_plan, wide, count, shaped

    def _put_on_table(self, state: State, attempts: _Made) -> tuple[Array, Array, list[Array]]:
        """Put new results into the first free slots.

        Returns:
            Tables with the spare column, (N, num_entity_slots + 1), and their counts, (N,), as
            copies; and for each of r results whether it is new, (R,), bool.
        """
        rows = attempts.rows
        tables = state.wide[rows]
        wide = self.arrays.copy(state.wide)
        count = state.count[rows]
        news = []
        # All results of a pair differ, so each is compared with the table before the attempt.
        for i in range(attempts.results.shape[1]):
            result = attempts.results[:, i]
            is_on_table = (tables == result[:, None]).any(1)
            is_new = attempts.makes & (result != self.nothing) & ~is_on_table
            # Where nothing is new, the first free slot, or the spare column of a full table, gets
            # the id of nothing, which it holds already.
            wide[rows, count] = self.arrays.xp.where(is_new, result, wide[rows, count])
            count = count + is_new
            news.append(is_new)
        counts = self.arrays.copy(state.count)
        counts[rows] = count
        return wide, counts, news

    def _shaping(
        self,
        state: State,
        attempts: _Made,
        news: Sequence[Array],
    ) -> Array:
        """Return the shaped rewards of attempts that make something, shape (R,).

        An intermediate is rewarded when it is new, but is relevant whenever it is made.
        """
        cast = self.arrays.cast
        intermediates = self._intermediates[state.task[attempts.rows]]
        num_first = self.arrays.full((len(attempts.rows),), 0)
        is_relevant = attempts.is_goal
        for i, is_new in enumerate(news):
            result = attempts.results[:, i]
            is_listed = (intermediates == result[:, None]).any(1)
            is_intermediate = is_listed & (result != self.nothing)  # both are padded with nothing
            num_first = num_first + (is_intermediate & is_new)
            is_relevant = is_relevant | is_intermediate
        reward = self._rewards.intermediate_reward * cast(num_first, self._reward_dtype)
        is_irrelevant = cast(attempts.makes & ~is_relevant, self._reward_dtype)
        return reward - self._rewards.irrelevant_penalty * is_irrelevant

    def _noted(self, state: State, picked: _Picked) -> Array:
        """Return the tried pairs with those of this step, shape (N, attempts, 2 or S)."""
        attempts = self.config.attempts
        if attempts == 1 or picked.picks is None:
            return state.tried  # no later attempt could read them
        number = attempts - state.attempts_left  # of the current attempt, from 0
        is_now = picked.is_pair[:, None] & (self._attempt_numbers == number[:, None])
        return self.arrays.xp.where(is_now[:, :, None], picked.picks[:, None], state.tried)

    def pair_numbers(self, picks: Array) -> Array:
        """Return the numbers of picked pairs or sets (N, 2 or S): ``num_pairs`` without results."""
        return self.pairs(picks) if self.world.has_combine else self.pairs(*picks.T)

    # --- checks -----------------------------------------------------------------------------------

    def _checked(self, actions: Array) -> Array:
        """Return the actions; on the CPU, where reading them is free, checked."""
        if self.arrays.on_device:
            return actions
        actions = np.asarray(actions)
        if actions.shape != (self.num_envs,) or actions.dtype.kind not in "iu":
            raise ActionError(
                f"actions of shape {actions.shape}, {actions.dtype}: "
                f"expected ({self.num_envs},), whole numbers."
            )
        if len(actions) and (actions.min() < 0 or actions.max() >= self.num_slots):
            wrong = int(((actions < 0) | (actions >= self.num_slots)).argmax())
            raise ActionError(
                f"action {int(actions[wrong])} of environment {wrong}: "
                f"expected 0 to {self.num_slots - 1}."
            )
        return actions
