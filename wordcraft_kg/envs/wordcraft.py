"""The crafting environments for Gymnasium: the batched engine with one environment, or with many.

Read :class:`WordCraftEnv`'s docstring for the rules; ``batch`` computes them, and a slow reference
in the tests checks it.
"""

import operator
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from wordcraft_kg.base import ActionError, ConfigError, EpisodeError, whole
from wordcraft_kg.envs.batch import OUTCOMES, BatchEngine, State
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import (
    METADATA,
    Info,
    Observation as Observation,
    check_mode,
)
from wordcraft_kg.graphs import GraphLike

Arrays = dict[str, NDArray[Any]]
_NAMES = np.array(OUTCOMES, dtype=object)


def _unbegun(engine: BatchEngine) -> State:
    """Return a state without episodes, from which those of a seed of the system follow."""
    seed = int(np.random.SeedSequence().generate_state(1)[0])
    nothing = np.full((engine.num_envs, 1), engine.nothing)
    return engine.pose(np.zeros(engine.num_envs, dtype=np.int64), seed=seed, tables=nothing)


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
    """The state of an episode, in ids, without meaning before the first episode.

    Attributes:
        task: index into the world's tasks.
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
    set. A number outside the space raises an error. *Combine*, if there, is the last action, whose
    slot holds no entity; it is masked, and as illegal as an empty slot, until an entity is chosen.

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
    +1 when the goal is made. ``reward`` may add shaped rewards; success never depends on shaping.

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
        # The engine takes an array of actions, here of length 1.
        self._actions = np.arange(self.num_slots)[:, None]
        self._batch = _unbegun(self.engine)
        self._outcome = "not_begun"

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Begin an episode.

        Args:
            seed: begins the first episode of a seed, the same as in a vector environment of one;
                None goes on to the next, or at first draws a seed from the system.
            options: ``task`` and ``table``, see "Starting state"; None draws both.

        Returns:
            The observation and the info.

        Raises:
            ConfigError: for an unknown option, task or table.
        """
        super().reset(seed=seed)
        options = options or {}
        unknown = set(options) - {"task", "table"}
        if unknown:
            raise ConfigError(f"unknown reset option '{min(unknown)}'; expected task or table.")
        state = self._batch if seed is None else self.engine.reseed(self._batch, [seed])
        if "task" in options:
            task = whole("task", options["task"], 0, len(self.tasks) - 1)
        else:
            state = self.engine.begin_where(state, np.ones(1, dtype=bool))
            task = int(state.task[0])
        tables = None
        if "table" in options:
            # All results of all attempts must fit behind the given entities.
            tables = np.array([self.world.checked_table(options["table"], self.world.num_given)])
        if options:
            state = self.engine.pose_next(state, np.array([task]), tables)
        self._batch = state
        self._outcome = "in_progress"
        return state.observed(0), self._info(illegal=False, by_plan=False)

    def step(self, action: int) -> tuple[Observation, float, bool, bool, Info]:
        """Choose the entity in a slot; every second action, or *combine*, completes an attempt.

        Returns:
            Observation, reward, whether the episode is over, False (never truncated), and info.

        Raises:
            ActionError: for anything but the number of a slot.
            EpisodeError: before :meth:`reset`, or after the end of the episode.
        """
        if self._outcome != "in_progress":
            raise EpisodeError("no episode is running; call reset() before step().")
        try:
            slot = operator.index(action)
        except TypeError:
            slot = -1
        if not 0 <= slot < self.num_slots:
            raise ActionError(
                f"action {action!r}: expected a whole number, 0 to {self.num_slots - 1}: a slot of "
                "the table."
            )
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
        if self.render_mode is None:
            return None
        if self._outcome == "not_begun":
            raise EpisodeError("call reset() before render().")
        names = self.world.graph.entities
        state = self.state
        selected = " + ".join(map(names.__getitem__, state.selection)) or "nothing"
        table = "  ".join(f"{slot}:{names[entity]}" for slot, entity in enumerate(state.table))
        return (
            f"goal: {names[state.goal]}   selection: {selected}   "
            f"attempts left: {state.attempts_left}\ntable: {table}"
        )

    @property
    def state(self) -> EnvState:
        """The state of the episode."""
        batch = self._batch
        return EnvState(
            int(batch.task[0]),
            int(batch.goal[0]),
            batch.wide[0, : batch.count[0]].tolist(),
            tuple(self.world.without_nothing(np.atleast_1d(batch.selection[0]).tolist())),
            int(batch.attempts_left[0]),
            self._outcome,
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
    length N, fresh arrays each time. Autoreset is Gymnasium's SAME_STEP: where ``terminated`` is
    True, observation and infos are the first of the next episode; reward and flags belong to the
    step that ended, and so do ``final_obs`` and ``final_info``. For its other modes take
    ``vectorization_mode="sync"``, Gymnasium's loop over single environments.

    Infos are arrays of length N: ``outcome`` (names), ``by_plan``, ``illegal_action``, ``task``. As
    in Gymnasium, a step that ends episodes adds ``final_obs``, an array of objects with the last
    observation of each ended episode (None elsewhere), ``final_info`` with arrays of the infos
    above, and the masks ``_final_obs`` and ``_final_info``. Episodes only terminate, so nothing is
    bootstrapped from them.
    """

    def __init__(
        self,
        num_envs: int,
        graph: GraphLike | World,
        *,
        render_mode: str | None = None,
        **settings: Any,
    ):
        """Prepare N environments.

        Args:
            num_envs: N, 1 or more.
            graph: as for the single environment.
            render_mode: None; many environments are not rendered.
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
        self.render_mode = None
        self.world = world = World.of(graph, settings)
        self.config = world.config
        self.engine = BatchEngine(world, num_envs)
        self.num_envs = self.engine.num_envs
        self.metadata = {**WordCraftEnv.metadata, "autoreset_mode": AutoresetMode.SAME_STEP}
        self.single_observation_space = observation_space(world)
        self.single_action_space = spaces.Discrete(world.num_slots)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._batch = _unbegun(self.engine)
        self._has_begun = False

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
            options: None; tasks are set with the engine's ``pose``.

        Returns:
            Observations and infos of all environments.

        Raises:
            ConfigError: for a wrong number of seeds, or an option.
        """
        if options:
            raise ConfigError(
                f"unknown reset option '{min(options)}': this environment takes none; set tasks "
                "with the engine's pose()."
            )
        if seed is None:
            seed = [None] * self.num_envs
        if isinstance(seed, list | tuple | np.ndarray):
            if len(seed) != self.num_envs:
                raise ConfigError(
                    f"`seed`: {len(seed)} seeds for {self.num_envs} environments; expected one "
                    "for each, or one integer for all."
                )
            state = self.engine.reseed(self._batch, seed)
            state = self.engine.begin_where(state, np.ones(self.num_envs, dtype=bool))
        else:
            state = self.engine.reset(seed)
        self._batch = state
        self._has_begun = True
        none = np.zeros(self.num_envs, dtype=bool)
        infos = self._infos(none.astype(np.int8), none, none, state.task)
        return state.observed(slice(None)), infos

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
            ActionError: for a number that is not a slot.
            EpisodeError: before :meth:`reset`.
        """
        last, result = self.engine.step_once(self.state, actions)
        over = result.over
        self._batch = self.engine.begin_where(last, over)
        # Where an episode is over, infos are those of the new one, which has no outcome yet.
        infos = self._infos(
            result.outcome * ~over, result.by_plan & ~over, result.illegal & ~over, self._batch.task
        )
        if over.any():
            ended = self._infos(result.outcome, result.by_plan, result.illegal, result.task)
            infos |= {
                "final_obs": _final_obs(last, over),
                "final_info": _final_info(ended, over),
                "_final_obs": over.copy(),
                "_final_info": over.copy(),
            }
        never = np.zeros(self.num_envs, dtype=bool)
        reward = result.reward.astype(np.float64)
        return self._batch.observed(slice(None)), reward, over, never, infos

    def action_masks(self) -> NDArray[np.bool_]:
        """Return which slots hold an entity, shape (N, num_slots)."""
        return np.asarray(self.state.action_masks())

    @property
    def state(self) -> State:
        """The batched state.

        Raises:
            EpisodeError: before the first :meth:`reset`.
        """
        if not self._has_begun:
            raise EpisodeError("call reset() before step().")
        return self._batch

    @staticmethod
    def _infos(outcome: Any, by_plan: Any, illegal: Any, task: Any) -> dict[str, Any]:
        return {
            "outcome": _NAMES[outcome],
            "by_plan": by_plan,
            "illegal_action": illegal,
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


def _final_info(infos: dict[str, Any], over: NDArray[np.bool_]) -> dict[str, Any]:
    """Return the infos of the episodes that a step has ended, in Gymnasium's form."""
    final_info: dict[str, Any] = {}
    for name, column in infos.items():
        # Zeros, or None for names, where no episode has ended.
        empty = np.full_like(column, None if column.dtype == object else 0)
        final_info[name] = np.where(over, column, empty)
        final_info[f"_{name}"] = over.copy()
    return final_info
