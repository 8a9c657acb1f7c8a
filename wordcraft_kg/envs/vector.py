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
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.graph_folder import GraphLike

Arrays = dict[str, NDArray[Any]]
_NAMES = np.array(OUTCOMES, dtype=object)


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
