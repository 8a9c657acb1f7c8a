"""The crafting environments for Gymnasium: the batched engine with one environment, or with many.

Read :class:`WordCraftEnv`'s docstring for the rules; ``batch`` computes them, and a slow reference
in the tests checks it. This module draws the starts of episodes from Gymnasium's generator.
"""

import operator
from bisect import bisect_right
from itertools import accumulate
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from wordcraft_kg.base import ActionError, ConfigError, EpisodeError, whole
from wordcraft_kg.envs.batch import OUTCOMES, BatchEngine, State, Step, empty_slot
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import (
    METADATA,
    Info,
    Observation as Observation,
    check_mode,
)
from wordcraft_kg.graphs import GraphLike, Ids
from wordcraft_kg.graphs.tasks import CraftingTask

Arrays = dict[str, NDArray[Any]]
_NAMES = np.array(OUTCOMES, dtype=object)
_DRAWN_AT_ONCE = 1_024  # uniform numbers taken from the generator in one call


def observation_space(world: World) -> spaces.Dict:
    """Return the space of a world's observations: ids and masks."""
    num_ids = world.nothing + 1
    selection: spaces.Space[Any] = spaces.Discrete(num_ids)
    if world.has_combine:
        selection = spaces.MultiDiscrete(np.full(world.graph.most_ingredients, num_ids))
    return spaces.Dict(
        {
            "goal": spaces.Discrete(world.nothing),
            "table": spaces.MultiDiscrete(np.full(world.num_slots, num_ids)),
            "selection": selection,
            "attempts_left": spaces.Discrete(world.config.attempts + 1),
            "action_mask": spaces.MultiBinary(world.num_slots),
        }
    )


class EnvState(NamedTuple):
    """The state of an episode, in ids.

    Attributes:
        task: index into the world's tasks, -1 before the first episode.
        goal: entity to make.
        table: entities in the slots, without empty slots.
        selection: selected entities in order, those of the current attempt.
        attempts_left: attempts left, including the current attempt.
        outcome: ``not_begun``, ``in_progress``, ``goal`` or ``out_of_attempts``.
    """

    task: int
    goal: int
    table: list[int]
    selection: tuple[int, ...]
    attempts_left: int
    outcome: str


class WordCraftEnv(gym.Env[Observation, Any]):
    """Make a goal by combining entities on a table: the paper's task, ``WordCraft-v0``.

    ## Description
    An episode poses a goal, an entity to make, and puts the starting ingredients on the table,
    shuffled among distractors, which no plan needs. An action chooses an entity; two actions make
    an attempt. All results of the pair join the table (each once), and nothing is used up. In the
    train part train recipes apply, in all other parts all recipes.

    If recipes of the graph have other sizes than two, an attempt ends with the action *combine*, or
    when as many entities are chosen as the largest recipe has ingredients (S). Their order does not
    matter, and an entity that is needed twice is chosen twice.

    ## Action space
    ``Discrete(num_slots)``: the slot to choose; a slot may be chosen twice. Choosing an empty slot
    wastes the attempt: nothing is made, the selection is cleared, ``info["illegal_action"]`` is
    set; with ``illegal_action="raise"`` an error is raised. A number outside the space always
    raises an error. *Combine*, if there, is the last action, whose slot holds no entity; it is
    masked, and as illegal as an empty slot, until an entity is chosen.

    ## Observation space
    ``Dict`` of ids and masks, fresh arrays each time; ``num_entities`` is the id of nothing.

    | key | shape | meaning |
    |---|---|---|
    | goal | () | entity to make |
    | table | (num_slots,) | entity in each slot |
    | selection | () | selected entity, the first action of the current attempt |
    | attempts_left | () | attempts left, including the current attempt |
    | action_mask | (num_slots,) | 1 for slots with an entity |

    ``num_slots = (depth + 1) + num_distractors + r * attempts``, where a pair has at most r
    results. With *combine*, ``num_slots = (depth * (S - 1) + 1) + num_distractors + r * attempts +
    1``, and the selection has shape (S,).

    ## Rewards
    +1 when the goal is made. A :class:`~wordcraft_kg.envs.world_config.RewardConfig` may add shaped
    rewards; success never depends on shaping.

    ## Starting state
    A task from the chosen part of the split, and distractors drawn without replacement. Goal,
    starting ingredients and intermediates of the task's plans are never distractors. All tables
    begin with ``depth + 1 + num_distractors`` entities (``depth * (S - 1) + 1`` ingredients with
    *combine*): a task with fewer starting ingredients, such as one whose plan uses an entity twice,
    has more distractors.
    ``reset(options={"task": 3})`` poses a given task of ``tasks``; ``"table"`` sets the entities in
    the first slots, by id or label.

    ## Episode end
    *Terminated* when the goal is made or no attempt is left: the budget is observed, so nothing is
    bootstrapped. ``info["outcome"]`` is ``in_progress``, ``goal`` or ``out_of_attempts``;
    ``info["by_plan"]`` is true if the last pair of a plan made the goal; ``info["goal"]`` is the
    goal's label. Never truncated; add ``gymnasium.wrappers.TimeLimit`` for truncation.

    ## Arguments
    ``graph`` is a graph folder, a book's name or file, a RecipeGraph or an OpenedGraph; further
    arguments are the settings in :class:`~wordcraft_kg.envs.world_config.WordCraftConfig`. If
    ``graph`` is a :class:`~wordcraft_kg.envs.world.World`, which has settings and may be shared
    between environments, further settings are refused.

    ## Version history
    v0: first version. docs/rules.md lists the differences from the environment of Jiang et
    al. 2020.
    """

    metadata = METADATA

    def __init__(
        self,
        graph: GraphLike | World,
        *,
        render_mode: str | None = None,
        **settings: Any,
    ):
        """Open the graph and prepare the tasks; see "Arguments".

        Raises:
            ConfigError: for an unknown setting, a value out of range, or settings next to a world.
            TaskError: if the graph has no such task.
            RecipeFileError: if ``graph`` names no graph folder, file or known book, or the book
                cannot be read.
            ArtefactError: if ``graph`` is a folder without a graph, or a damaged one.
        """
        check_mode(render_mode)
        self.render_mode = render_mode
        self.world = World.of(graph, settings)
        self.config = self.world.config
        self.tasks = self.world.tasks
        self.num_slots = self.world.num_slots
        self.action_space = spaces.Discrete(self.num_slots)
        self.observation_space = observation_space(self.world)
        self.engine = BatchEngine(self.world, 1, reward_dtype="float64")
        self._nothing = self.world.nothing
        # The engine takes an array of actions, here of length 1.
        self._actions = np.arange(self.num_slots)[:, None]
        # Plain lists, because single look-ups in arrays are slow.
        self._weight_ends = list(accumulate(self.world.distractor_weights.tolist()))
        self._task_ends = list(accumulate(self.tasks.weights(self.config.task_weighting).tolist()))
        self._uniform: list[float] = []
        self._shortcuts: set[tuple[int, int, int]] = set()
        self._goals: list[int] = self.tasks.goals.tolist()
        self._starts = self._unpadded(self.tasks.starts)
        self._num_drawn: list[int] = self.world.num_drawn.tolist()
        self._intermediates = self._unpadded(self.tasks.intermediates)
        self._makeable: list[list[int]] = [[] for _ in self._starts]
        avoids_shortcuts = self.config.distractor_policy != "any"
        # Longer shortcuts, and those by larger sets, take a search.
        has_larger_sets = self.world.has_combine
        self._searches = avoids_shortcuts and (self.config.attempts > 1 or has_larger_sets)
        if avoids_shortcuts and not has_larger_sets:
            is_shortcut = self.world.shortcut_search.usable
            self._shortcuts.update(map(tuple, self.world.graph.recipes[is_shortcut].tolist()))
            self._makeable = self._unpadded(self.world.makeable)
        start = np.full((1, 1), self._nothing)
        self._batch = self.engine.pose(np.zeros(1, dtype=np.int64), tables=start)
        self._outcome = "not_begun"

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Begin an episode.

        Args:
            seed: seeds the generator of tasks and tables; None continues it.
            options: ``task`` and ``table``, see "Starting state"; None draws both.

        Returns:
            The observation and the info.

        Raises:
            ConfigError: for an unknown option, task or table.
        """
        super().reset(seed=seed)
        if seed is not None:
            self._uniform = []  # numbers of the generator before
        options = options or {}
        unknown = set(options) - {"task", "table"}
        if unknown:
            raise ConfigError(f"unknown reset option '{min(unknown)}'; expected task or table.")
        last = len(self.tasks) - 1
        task = whole("task", options["task"], 0, last) if "task" in options else self._draw_task()
        if "table" in options:
            # All results of all attempts must fit behind the given entities.
            table = self.world.checked_table(options["table"], self.world.num_given)
        else:
            table = [*self._starts[task], *self._draw_distractors(task)]
            self._shuffle(table)
        self._batch = self.engine.posed(self._batch, np.array([task]), np.array([table]))
        self._outcome = "in_progress"
        return self._batch.observed(0), self._info(illegal=False, by_plan=False)

    def step(self, action: int) -> tuple[Observation, float, bool, bool, Info]:
        """Choose the entity in a slot; every second action, or *combine*, completes an attempt.

        Returns:
            Observation, reward, whether the episode is over, False (never truncated), and info.

        Raises:
            ActionError: for a number that is not a slot, or for an empty slot if
                ``illegal_action`` is ``raise``.
            EpisodeError: before :meth:`reset`, or after the end of the episode.
        """
        if self._outcome != "in_progress":
            is_new = self._outcome == "not_begun"
            raise EpisodeError(
                "call reset() before step()." if is_new else "the episode is over; call reset()."
            )
        slot = self._checked_action(action)
        self._batch, result = self.engine.step_env(self._batch, self._actions[slot])
        self._outcome = OUTCOMES[result.outcome[0]]
        return (
            self._batch.observed(0),
            float(result.reward[0]),
            self._outcome != "in_progress",
            False,
            self._info(illegal=bool(result.illegal[0]), by_plan=bool(result.by_plan[0])),
        )

    def action_masks(self) -> NDArray[np.bool_]:
        """Return which slots hold an entity, shape (num_slots,)."""
        return np.asarray(self._batch.action_masks()[0])

    def render(self) -> str | None:
        """Return the state in words; None without a ``render_mode``.

        Raises:
            EpisodeError: before :meth:`reset`.
        """
        if self._outcome == "not_begun" and self.render_mode is not None:
            raise EpisodeError("call reset() before render().")
        return None if self.render_mode is None else self._words()

    @property
    def state(self) -> EnvState:
        """The state of the episode."""
        if self._outcome == "not_begun":
            return EnvState(-1, self._nothing, [], (), 0, self._outcome)
        batch = self._batch
        return EnvState(
            int(batch.task[0]),
            int(batch.goal[0]),
            batch.wide[0, : batch.count[0]].tolist(),
            tuple(self.world.without_nothing(np.atleast_1d(batch.selection[0]).tolist())),
            int(batch.attempts_left[0]),
            self._outcome,
        )

    @property
    def task(self) -> CraftingTask:
        """The task of the current episode."""
        return self.tasks[self.state.task]

    def _checked_action(self, action: Any) -> int:
        try:
            slot = operator.index(action)
        except TypeError:
            raise ActionError(
                f"action {action!r}: expected a whole number, a slot of the table."
            ) from None
        if not 0 <= slot < self.num_slots:
            raise ActionError(
                f"action {slot}: expected 0 to {self.num_slots - 1}, a slot of the table."
            )
        if self.config.illegal_action == "raise" and not self.action_masks()[slot]:
            raise empty_slot(f"action {slot}", self._batch.count[0] - 1)
        return slot

    # --- starting state ---------------------------------------------------------------------------

    def _random(self) -> float:
        """Draw a uniform number; many at once, because a call of the generator is slow."""
        if not self._uniform:
            self._uniform = self.np_random.random(_DRAWN_AT_ONCE).tolist()
        return self._uniform.pop()

    def _draw_task(self) -> int:
        if self.config.task_weighting == "task":
            return int(self._random() * len(self.tasks))
        index = bisect_right(self._task_ends, self._random() * self._task_ends[-1])
        return min(index, len(self.tasks) - 1)  # a product may be rounded up to the end

    def _shuffle(self, items: list[int]) -> None:
        """Shuffle in place (Fisher and Yates)."""
        for last in range(len(items) - 1, 0, -1):
            place = int(self._random() * (last + 1))
            items[last], items[place] = items[place], items[last]

    def _draw_distractors(self, task: int) -> list[int]:
        """Draw distractors, again and again while they open a longer shortcut to the goal."""
        distractors = self._draw_once(task)
        if self._searches:
            tries = 0
            while self.world.has_shortcut(task, distractors):
                tries += 1
                self.world.check_tries(tries, task)
                distractors = self._draw_once(task)
        return distractors

    def _draw_once(self, task: int) -> list[int]:
        """Draw distractors by weight, skipping those that are not allowed on this table."""
        goal = self._goals[task]
        start = self._starts[task]
        excluded = {goal, self._nothing, *start, *self._intermediates[task]}
        # On the table, or to be made; only a distractor policy reads it.
        near = {*start, *self._makeable[task]} if self._shortcuts else set()
        distractors: list[int] = []
        total = self._weight_ends[-1]
        # With all entities and the id of nothing taken, entities have run out.
        count = self._num_drawn[task]
        while len(distractors) < count and len(excluded) <= self._nothing:
            entity = bisect_right(self._weight_ends, int(self._random() * total))
            if entity in excluded:
                continue
            excluded.add(entity)
            if self._shortcuts:
                if self._is_shortcut(entity, near, goal):
                    continue
                near.add(entity)
            distractors.append(entity)
        return distractors

    def _is_shortcut(self, entity: int, near: set[int], goal: int) -> bool:
        """Return whether a distractor makes the goal with itself or an entity near it."""
        pairs = [(min(entity, partner), max(entity, partner)) for partner in (*near, entity)]
        return any((*pair, goal) in self._shortcuts for pair in pairs)

    def _unpadded(self, ids: Ids) -> list[list[int]]:
        """Return padded rows of ids as lists of entities."""
        return [self.world.without_nothing(row) for row in ids.tolist()]

    # --- observations -----------------------------------------------------------------------------

    def _words(self) -> str:
        names = self.world.graph.entities
        state = self.state
        selected = " + ".join(map(names.__getitem__, state.selection)) or "nothing"
        table = "  ".join(f"{slot}:{names[entity]}" for slot, entity in enumerate(state.table))
        return (
            f"goal: {names[state.goal]}   selection: {selected}   "
            f"attempts left: {state.attempts_left}\ntable: {table}"
        )

    def _info(self, *, illegal: bool, by_plan: bool) -> Info:
        return {
            "outcome": self._outcome,
            "by_plan": by_plan,
            "illegal_action": illegal,
            "task": int(self._batch.task[0]),
            "goal": self.world.graph.entities[self._batch.goal[0]],
        }


class WordCraftVectorEnv(VectorEnv[Arrays, Any, Any]):
    """N crafting environments at once, by the batched engine.

    Made by ``gym.make_vec("WordCraft-v0", vectorization_mode="vector_entry_point", ...)``.

    Observations are as in :class:`~wordcraft_kg.envs.wordcraft.WordCraftEnv` with a first axis of
    length N, fresh arrays each time. ``autoreset_mode`` is one of Gymnasium's modes. SAME_STEP, the
    default: where ``terminated`` is True, observation and infos are the first of the next episode;
    reward and flags belong to the step that ended, and so do ``final_obs`` and ``final_info``.
    NEXT_STEP: the next step begins the new episode without acting. DISABLED:
    ``reset(options={"reset_mask": mask})`` begins it.

    Infos are arrays of length N: ``outcome`` (names), ``by_plan``, ``illegal_action``, ``task``. As
    in Gymnasium, a step in the mode SAME_STEP that ends episodes adds ``final_obs``, an array of
    objects with the last observation of each ended episode (None elsewhere), ``final_info`` with
    arrays of the infos above, and the masks ``_final_obs`` and ``_final_info``. Episodes only
    terminate, so nothing is bootstrapped from them.
    """

    def __init__(
        self,
        num_envs: int,
        graph: GraphLike | World,
        *,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **settings: Any,
    ):
        """Prepare N environments.

        Args:
            num_envs: N, 1 or more.
            graph: as for the single environment.
            render_mode: None; many environments are not rendered.
            autoreset_mode: when a new episode begins, see above.
            **settings: settings of :class:`~wordcraft_kg.envs.world_config.WordCraftConfig`.

        Raises:
            ConfigError: for an unknown setting, or a value out of range.
            TaskError: if the graph has no such task.
            RecipeFileError: if ``graph`` names no graph folder, file or known book, or the book
                cannot be read.
            ArtefactError: if ``graph`` is a folder without a graph, or a damaged one.
        """
        if render_mode is not None:
            raise ConfigError(
                f"`render_mode` {render_mode!r}: expected None; many environments are not rendered."
            )
        try:
            self._mode = AutoresetMode(autoreset_mode)
        except ValueError:
            modes = ", ".join(mode.value for mode in AutoresetMode)
            raise ConfigError(
                f"`autoreset_mode` {autoreset_mode!r}: expected one of {modes}."
            ) from None
        self.render_mode = None
        self.world = world = World.of(graph, settings)
        self.config = world.config
        self.engine = BatchEngine(world, num_envs)
        self.num_envs = self.engine.num_envs
        self.metadata = {**WordCraftEnv.metadata, "autoreset_mode": self._mode}
        self.single_observation_space = observation_space(world)
        self.single_action_space = spaces.Discrete(world.num_slots)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._state: State | None = None

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Arrays, dict[str, Any]]:
        """Begin the next episodes.

        Args:
            seed: begins the first episode of a seed, whose random stream is separate in each
                environment; or N seeds, one for each environment, where None continues a stream. An
                environment with a seed of its own has the episodes of a single environment
                (``num_envs=1``) with this seed. None continues all streams, or at first draws a
                seed from the system.
            options: ``reset_mask``, booleans of shape (N,), restarts only the environments where it
                is True, and takes no seed but a list.

        Returns:
            Observations and infos of all environments.

        Raises:
            ConfigError: for a wrong number of seeds, another option, or a mask of another shape or
                type.
        """
        unknown = {*(options or {})} - {"reset_mask"}
        if unknown:
            raise ConfigError(
                f"unknown reset option '{min(unknown)}': expected reset_mask; "
                "set tasks with the engine's pose()."
            )
        seeds: list[int | None] | None = None
        if isinstance(seed, list | tuple | np.ndarray):
            seeds = list(seed)
            seed = None
            if len(seeds) != self.num_envs:
                raise ConfigError(
                    f"`seed`: {len(seeds)} seeds for {self.num_envs} environments; expected one "
                    "for each, or one integer for all."
                )
        mask = None if not options else np.asarray(options["reset_mask"])
        if mask is not None and (
            seed is not None or mask.dtype != bool or mask.shape != (self.num_envs,)
        ):
            raise ConfigError(
                f"`reset_mask`: expected booleans of shape ({self.num_envs},), and no seed or "
                f"{self.num_envs} seeds."
            )
        state = self._state
        is_continued = seed is None and state is not None
        if state is None or seed is not None:
            # Without a seed, the first reset draws one, and all later resets go on from there.
            drawn = int(np.random.SeedSequence().generate_state(1)[0])
            state = self.engine.reset(drawn if seed is None else seed)
        if seeds is not None:
            state = self.engine.reseed(state, seeds, mask)
        if seeds is not None or is_continued:
            # A mask resets finished episodes in place, in the mode DISABLED.
            everywhere = np.ones(self.num_envs, dtype=bool)
            state = self.engine.begin_where(state, everywhere if mask is None else mask)
        self._state = state
        return state.observed(slice(None)), self._infos(self._no_step(), state.task)

    def step(
        self, actions: NDArray[np.int64]
    ) -> tuple[
        Arrays,
        NDArray[np.float64],
        NDArray[np.bool_],
        NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Choose a slot in each environment; ``actions`` has shape (N,).

        Returns:
            Observations, rewards (float64), terminated, truncated (always False) and infos.

        Raises:
            ActionError: for a number that is not a slot, or for an empty slot if
                ``illegal_action`` is ``raise``.
            EpisodeError: before :meth:`reset`, or in the mode DISABLED after an episode's end.
        """
        before = self.state
        ended = before.attempts_left == 0  # never in the mode SAME_STEP
        if self._mode is AutoresetMode.DISABLED and ended.any():
            raise EpisodeError(
                f"environment {int(ended.argmax())} has ended; call reset() with a `reset_mask`."
            )
        if ended.all():
            result = self._no_step()  # the engine refuses a step without a running episode
        else:
            self._state, result = self.engine.step_once(before, actions)
        shown = result
        ends: dict[str, Any] = {}
        if self._mode is AutoresetMode.SAME_STEP and result.over.any():
            ended = result.over
            # Without ended episodes, whose places are taken by new ones.
            shown = result._replace(
                outcome=result.outcome * ~ended,
                by_plan=result.by_plan & ~ended,
                illegal=result.illegal & ~ended,
            )
            ends = {
                "final_obs": _final_obs(self.state, ended),
                "final_info": self._final_info(result),
                "_final_obs": ended.copy(),
                "_final_info": ended.copy(),
            }
        if self._mode is not AutoresetMode.DISABLED:
            self._state = self.engine.begin_where(self.state, ended)
        # Where a new episode began, infos name its task.
        task = self.state.task if ended.any() else result.task
        never = np.zeros(self.num_envs, dtype=bool)
        reward = result.reward.astype(np.float64)
        infos = self._infos(shown, task) | ends
        return self.state.observed(slice(None)), reward, result.over, never, infos

    def action_masks(self) -> NDArray[np.bool_]:
        """Return which slots hold an entity, shape (N, num_slots)."""
        return np.asarray(self.state.action_masks())

    @property
    def state(self) -> State:
        """The batched state.

        Raises:
            EpisodeError: before the first :meth:`reset`.
        """
        if self._state is None:
            raise EpisodeError("call reset() before step().")
        return self._state

    def _no_step(self) -> Step:
        """Return the outcome of no action in any environment."""
        no = np.zeros(self.num_envs, dtype=bool)
        return Step(
            reward=no.astype(np.float32),
            over=no,
            outcome=no.astype(np.int8),
            by_plan=no,
            illegal=no,
            task=self.state.task,
        )

    def _final_info(self, result: Step) -> dict[str, Any]:
        """Return the infos of the episodes that a step has ended, in Gymnasium's form."""
        info: dict[str, Any] = {}
        for name, column in self._infos(result, result.task).items():
            # Zeros, or None for names, where no episode has ended.
            empty = np.full_like(column, None if column.dtype == object else 0)
            info[name] = np.where(result.over, column, empty)
            info[f"_{name}"] = result.over.copy()
        return info

    @staticmethod
    def _infos(result: Step, task: Any) -> dict[str, Any]:
        return {
            "outcome": _NAMES[result.outcome],
            "by_plan": result.by_plan,
            "illegal_action": result.illegal,
            "task": np.array(task),
        }


def _final_obs(last: State, over: NDArray[np.bool_]) -> NDArray[Any]:
    """Return an array of objects: an observation where an episode is over, None elsewhere."""
    rows = np.flatnonzero(over)
    columns = last.observed(rows)
    final_obs = np.full(len(over), None, dtype=object)
    # Rows of arrays are iterated faster than indexed.
    for env, *values in zip(rows.tolist(), *columns.values(), strict=True):
        final_obs[env] = dict(zip(columns, values, strict=True))
    return final_obs
