"""The open-ended environment: discover entities, with limited attempts and without a goal."""

import operator
from collections.abc import Iterable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from wordcraft_kg.base import (
    MAX_SIZE,
    ActionError,
    ConfigError,
    EpisodeError,
    UnknownEntityError,
    quoted,
    whole,
)
from wordcraft_kg.envs.world_config import (
    METADATA,
    Info,
    Observation,
    check_mode,
)
from wordcraft_kg.graphs import GraphLike, layers, open_graph
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph, outcomes_of


class Discovery:
    """The state of an open-ended game: known entities and tried pairs.

    Combining two known entities makes all results of the pair known; nothing is used up.

    Attributes:
        base: ids known at the start, ascending.
        reachable: number of entities that can become known, including the base.
        known: all known ids in order of discovery, as the keys of a dictionary without values.
        tried: the combined pairs ``(a, b)`` with ``a <= b``.
    """

    def __init__(self, graph: RecipeGraph, base: Iterable[Entity] | None = None):
        """Prepare a game on a graph.

        Args:
            graph: recipe graph.
            base: known ids or labels instead of the graph's base entities.

        Raises:
            ConfigError: if an entity of the base is unknown, or nothing can be made from the base.
            GraphError: if a recipe has more than two ingredients, or one.
        """
        # A GraphError for a graph of larger sets: an action names two entities.
        self._outcomes = outcomes_of(graph.recipes, graph.num_entities)
        try:
            if base is None:
                base = graph.base_ids.tolist()
            ids = {graph.id_of(entity) for entity in base}
        except UnknownEntityError as error:
            raise ConfigError(f"`base`: {error}") from None
        self.base: tuple[int, ...] = tuple(sorted(ids))
        # Layer -1 stands for entities that no sequence of attempts can make.
        self.reachable = int((layers(graph, self.base) >= 0).sum())
        if self.reachable == len(self.base):
            labels = ", ".join(map(quoted, graph.labels(self.base))) or "(empty)"
            raise ConfigError(
                f"`base` {labels}: nothing new can be made from these entities in {graph.name}."
            )
        self.restart()

    def restart(self) -> None:
        """Forget everything except the base entities."""
        self.known: dict[int, None] = dict.fromkeys(self.base)
        self.tried: set[tuple[int, int]] = set()

    @property
    def is_complete(self) -> bool:
        """Whether all reachable entities are known."""
        return len(self.known) == self.reachable

    def combine(self, first: int, second: int) -> tuple[tuple[int, ...], bool]:
        """Combine two known entities.

        Returns:
            Ids of results that were unknown, and whether the pair was tried before.
        """
        # The order of ingredients has no meaning; pairs are kept in ascending order.
        pair = (first, second) if first <= second else (second, first)
        repeated = pair in self.tried
        self.tried.add(pair)
        # A pair may have several results, and all of them become known.
        new = tuple(result for result in self._outcomes.get(pair, ()) if result not in self.known)
        self.known.update(dict.fromkeys(new))
        return new, repeated


class OpenEndedEnv(gym.Env[Observation, Any]):
    """Discover entities without a goal: the paper's outlook, ``WordCraft-OpenEnded-v0``.

    ## Description
    The agent starts with the base entities and combines two known entities in each attempt. All
    results become known for good; nothing is used up. Episodes have no goal.

    ## Action space
    ``MultiDiscrete([E, E])``: the ids of the two entities to combine, in any order, possibly equal.
    An unknown entity wastes the attempt and sets ``info["illegal_action"]``. An action outside the
    space raises an error. ``action_masks`` returns the known entities for both choices.

    ## Observation space
    ``Dict`` of masks by entity id, fresh arrays each time.

    | key | shape | meaning |
    |---|---|---|
    | known | (E,) | 1 for known entities |
    | last_results | (E,) | 1 for entities that the last attempt made known |
    | attempts_left | () | attempts left, including the current attempt |

    ## Rewards
    The number of entities that the attempt made known.

    ## Starting state
    The base entities are known; nothing is random. ``reset`` takes no options.

    ## Episode end
    *Terminated* when no attempt is left (the budget is observed, so nothing is bootstrapped) or all
    reachable entities are known. ``info["outcome"]`` is ``in_progress``, ``out_of_attempts`` or
    ``all_known``. Never truncated.

    ``info`` also holds ``known`` (number of known entities), ``new_entities`` (ids that the attempt
    made known) and ``repeated`` (whether the pair was combined earlier in the episode).

    ## Arguments
    ``graph`` is a graph folder, a book's name or file, a RecipeGraph or an OpenedGraph;
    ``max_attempts`` is the number of attempts in an episode; ``base`` holds ids or labels known at
    the start, by default the graph's base.

    ## Version history
    v0: first version.
    """

    metadata = METADATA

    def __init__(
        self,
        graph: GraphLike,
        *,
        max_attempts: int = 100,
        base: Iterable[Entity] | None = None,
        render_mode: str | None = None,
    ):
        """Open the graph; see "Arguments".

        Raises:
            ConfigError: for a value out of range, or a base from which nothing can be made.
            RecipeFileError: if ``graph`` names no graph folder, file or known book, or the book
                cannot be read.
            ArtefactError: if ``graph`` is a folder without a graph, or a damaged one.
        """
        check_mode(render_mode)
        self.render_mode = render_mode
        self.graph = graph if isinstance(graph, RecipeGraph) else open_graph(graph).graph
        self.max_attempts = whole("max_attempts", max_attempts, 1, MAX_SIZE)
        self.discovery = Discovery(self.graph, base)
        size = self.graph.num_entities
        self.action_space = spaces.MultiDiscrete([size, size])
        self.observation_space = spaces.Dict(
            {
                "known": spaces.MultiBinary(size),
                "last_results": spaces.MultiBinary(size),
                "attempts_left": spaces.Discrete(self.max_attempts + 1),
            }
        )
        self._attempts_left = 0
        self._last = "nothing tried yet"

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Begin an episode with the base entities; no option exists, and the seed has no effect.

        Raises:
            ConfigError: for an option.
        """
        super().reset(seed=seed)
        if options:
            raise ConfigError(
                f"unknown reset option '{min(options)}'; this environment takes none."
            )
        self.discovery.restart()
        self._attempts_left = self.max_attempts
        self._last = "nothing tried yet"
        return self._shown((), repeated=False, illegal=False)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, Info]:
        """Combine two entities, given by id.

        Returns:
            Observation, number of new entities, whether the episode is over, False, and info.

        Raises:
            ActionError: for an action outside the space.
            EpisodeError: before :meth:`reset`, or after the end of the episode.
        """
        if self._outcome != "in_progress":
            raise EpisodeError("no episode is running; call reset() before step().")
        ids = range(self.graph.num_entities)
        try:
            first, second = map(operator.index, action)
        except (TypeError, ValueError):  # not two, or no whole numbers
            first = second = -1
        if first not in ids or second not in ids:
            raise ActionError(f"action {action!r}: expected two entity ids, 0 to {ids[-1]}.")
        is_legal = {first, second} <= self.discovery.known.keys()
        new: tuple[int, ...] = ()
        repeated = False
        if is_legal:
            new, repeated = self.discovery.combine(first, second)
        # A repeated pair and an unknown entity use up an attempt, too.
        self._attempts_left -= 1
        results = ", ".join(self.graph.labels(new)) or "nothing new"
        self._last = f"{' + '.join(self.graph.labels((first, second)))} -> {results}"
        observation, info = self._shown(new, repeated=repeated, illegal=not is_legal)
        return observation, float(len(new)), self._outcome != "in_progress", False, info

    def action_masks(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return the mask of known entities, shape (E,), bool, for each of the two choices."""
        mask = self._mask(self.discovery.known).astype(bool)
        return mask, mask.copy()

    def render(self) -> str | None:
        """Return the state in words; None without a ``render_mode``."""
        if self.render_mode is None:
            return None
        known_ids = self.discovery.known
        return (
            f"known: {len(known_ids)} of {self.discovery.reachable}   "
            f"attempts left: {self._attempts_left}   {self._last}\n"
            f"{', '.join(self.graph.labels(known_ids))}"
        )

    @property
    def _outcome(self) -> str:
        # With nothing left to discover, further attempts would only add zeros to the return.
        if self.discovery.is_complete:
            return "all_known"
        return "in_progress" if self._attempts_left else "out_of_attempts"

    def _mask(self, entities: Iterable[int]) -> NDArray[np.int8]:
        # int8 and not bool, as Gymnasium's MultiBinary space demands.
        mask = np.zeros(self.graph.num_entities, dtype=np.int8)
        mask[list(entities)] = 1
        return mask

    def _shown(
        self, new: tuple[int, ...], *, repeated: bool, illegal: bool
    ) -> tuple[Observation, Info]:
        """Return the observation and the info after an attempt."""
        observation = {
            "known": self._mask(self.discovery.known),
            "last_results": self._mask(new),
            "attempts_left": np.int64(self._attempts_left),
        }
        info = {
            "outcome": self._outcome,
            "known": len(self.discovery.known),
            "new_entities": new,
            "repeated": repeated,
            "illegal_action": illegal,
        }
        return observation, info
