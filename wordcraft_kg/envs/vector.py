"""The batched engine as a gymnasium vector environment."""

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError, EpisodeError
from wordcraft_kg.envs.batch import OUTCOMES, BatchEngine, State, Step
from wordcraft_kg.envs.wordcraft import WordCraftEnv, observation_space
from wordcraft_kg.envs.world import GraphLike, World

Arrays = dict[str, NDArray[Any]]


class WordCraftVectorEnv(VectorEnv[Arrays, Any, Any]):
    """N crafting environments at once: ``gym.make_vec("WordCraft-v0", vectorization_mode="vector_entry_point", ...)``.

    Observations are as in :class:`~wordcraft_kg.envs.wordcraft.WordCraftEnv` with a first axis of length N, fresh
    arrays each time. ``autoreset_mode`` is one of Gymnasium's modes. SAME_STEP, the default: where ``terminated`` is
    True, the observation is the first of the next episode, while reward, flags and infos belong to the step that ended.
    NEXT_STEP: the next step begins the new episode without acting. DISABLED: ``reset(options={"reset_mask": mask})``
    begins it.

    Infos are arrays of length N: ``outcome`` (names), ``by_plan``, ``illegal_action``, ``task``. ``final_obs`` is
    missing, since episodes only terminate and nothing is bootstrapped.
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
        self.single_observation_space = observation_space(
            world.nothing, world.num_slots, self.config.attempts
        )
        self.single_action_space = spaces.Discrete(world.num_slots)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._state: State | None = None

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Arrays, dict[str, Any]]:
        """Restart all environments; a seed gives each environment a separate random stream, None continues these.

        The option ``reset_mask``, booleans of shape (N,), restarts only the environments where it is True.
        """
        if isinstance(seed, list | tuple | np.ndarray):
            raise ConfigError(
                "`seed`: expected one integer, which seeds a separate stream for each environment."
            )
        if others := {*(options or {})} - {"reset_mask"}:
            raise ConfigError(
                f"unknown reset option '{min(others)}': expected reset_mask; set tasks with the engine's pose()."
            )
        mask = None if not options else np.asarray(options["reset_mask"])
        if mask is not None and (
            seed is not None or mask.dtype != bool or mask.shape != (self.num_envs,)
        ):
            raise ConfigError(
                f"`reset_mask`: expected booleans of shape ({self.num_envs},), and no seed."
            )
        if seed is None and self._state is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        if mask is not None:
            state = self.engine.begin_where(self.state, mask)
        else:
            state = self.engine.restart(self.state) if seed is None else self.engine.reset(seed)
        self._state, zeros = state, np.zeros(self.num_envs, dtype=bool)
        return self._observations(), self._infos(
            np.zeros(self.num_envs, np.int8), zeros, zeros, state.task
        )

    def step(
        self, actions: NDArray[np.int64]
    ) -> tuple[Arrays, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Choose a slot in each environment; ``actions`` has shape (N,)."""
        zeros, ended = np.zeros(self.num_envs, dtype=bool), self.state.attempts_left == 0
        if self._mode is AutoresetMode.SAME_STEP:
            self._state, done = self.engine.step(self.state, actions)
        elif self._mode is AutoresetMode.DISABLED and ended.any():
            raise EpisodeError(
                f"environment {int(ended.argmax())} has ended; call reset() with a `reset_mask`."
            )
        elif ended.all():
            done = Step(
                zeros.astype(np.float32),
                zeros,
                zeros.astype(np.int8),
                zeros,
                zeros,
                self.state.task,
            )
        else:
            self._state, done = self.engine.step_once(self.state, actions)
        if self._mode is AutoresetMode.NEXT_STEP:
            self._state = self.engine.begin_where(self.state, ended)
        infos = self._infos(
            done.outcome, done.by_plan, done.illegal, self.state.task if ended.any() else done.task
        )
        return self._observations(), done.reward.astype(np.float64), done.over, zeros, infos

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
        return {
            "outcome": names,
            "by_plan": by_plan,
            "illegal_action": illegal,
            "task": np.array(task),
        }
