"""The batched engine as a gymnasium vector environment."""

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError, EpisodeError
from wordcraft_kg.envs.batch import OUTCOMES, BatchEngine, State
from wordcraft_kg.envs.wordcraft import WordCraftEnv, observation_space
from wordcraft_kg.envs.world import GraphLike, World

Arrays = dict[str, NDArray[Any]]


class WordCraftVectorEnv(VectorEnv[Arrays, Any, Any]):
    """N crafting environments at once: ``gym.make_vec("WordCraft-v0", vectorization_mode="vector_entry_point", ...)``.

    Observations are as in :class:`~wordcraft_kg.envs.wordcraft.WordCraftEnv` with a first axis of length N, fresh
    arrays each time. A new episode begins in the same step (``AutoresetMode.SAME_STEP``): where ``terminated`` is True,
    the observation is the first of the next episode, while reward, flags and infos belong to the step that ended.

    Infos are arrays of length N: ``outcome`` (names), ``by_plan``, ``illegal_action``, ``task``. ``final_obs`` is
    missing, since episodes only terminate and nothing is bootstrapped.
    """

    def __init__(self, num_envs: int, graph: GraphLike | World, *, render_mode: str | None = None, **settings: Any):
        if render_mode is not None:
            raise ConfigError(f"`render_mode` {render_mode!r}: expected None; many environments are not rendered.")
        self.render_mode = None
        self.world = world = World.of(graph, settings)
        self.config = world.config
        self.engine = BatchEngine(world, num_envs)
        self.num_envs = self.engine.num_envs
        self.metadata = {**WordCraftEnv.metadata, "autoreset_mode": AutoresetMode.SAME_STEP}
        self.single_observation_space = observation_space(world.nothing, world.num_slots, self.config.attempts)
        self.single_action_space = spaces.Discrete(world.num_slots)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._state: State | None = None

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Arrays, dict[str, Any]]:
        """Restart all environments; a seed gives each environment a separate random stream, None continues these."""
        if isinstance(seed, list | tuple | np.ndarray):
            raise ConfigError("`seed`: expected one integer, which seeds a separate stream for each environment.")
        if options:
            raise ConfigError(
                f"unknown reset option '{min(options)}': expected no options; set tasks with the engine's pose()."
            )
        if seed is None and self._state is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        state = self._state = self.engine.restart(self.state) if seed is None else self.engine.reset(seed)
        zeros = np.zeros(self.num_envs, dtype=bool)
        return self._observations(), self._infos(np.zeros(self.num_envs, np.int8), zeros, zeros, state.task)

    def step(
        self, actions: NDArray[np.int64]
    ) -> tuple[Arrays, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Choose a slot in each environment; ``actions`` has shape (N,)."""
        self._state, done = self.engine.step(self.state, actions)
        infos = self._infos(done.outcome, done.by_plan, done.illegal, done.task)
        over = np.zeros(self.num_envs, dtype=bool)
        return self._observations(), done.reward.astype(np.float64), done.over, over, infos

    def action_masks(self) -> NDArray[np.bool_]:
        """Return which slots hold an entity, shape (N, num_slots)."""
        return np.asarray(self.state.action_masks())

    @property
    def state(self) -> State:
        """The batched state; an EpisodeError before the first :meth:`reset`."""
        if self._state is None:
            raise EpisodeError("call reset() before step().")
        return self._state

    def _observations(self) -> Arrays:
        state = self.state
        return {
            "action_mask": state.action_masks().astype(np.int8),
            "attempts_left": state.attempts_left.copy(),
            "goal": state.goal.copy(),
            "selection": state.selection.copy(),
            "table": state.table.copy(),
        }

    @staticmethod
    def _infos(outcome: Any, by_plan: Any, illegal: Any, task: Any) -> dict[str, Any]:
        names = np.array(OUTCOMES)[outcome]
        return {"outcome": names, "by_plan": by_plan, "illegal_action": illegal, "task": np.array(task)}
