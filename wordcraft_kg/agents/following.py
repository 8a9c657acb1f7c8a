"""Live view of an agent's run folder, during or after training.

Everything that was read or made is kept with a *stamp*, the times and sizes of the files that it
comes from, and made again when the stamp changes.
"""

import threading
from collections.abc import Hashable
from functools import lru_cache
from pathlib import Path

from wordcraft_kg.agents.agent_folder import (
    AGENTS,
    METRICS_FILE,
    AgentRun,
    OpenedAgent,
    open_agent,
    read_agent_run,
)
from wordcraft_kg.agents.agent_records import EPISODES_FILE, PlayedTask, read_episodes
from wordcraft_kg.agents.explanation import Explainer
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import OpenedGraph, TaskPart
from wordcraft_kg.runs.config_file import CONFIG_FILE
from wordcraft_kg.runs.record import RUN_FILE

EXPLAINERS = 8
"""Maximum number of cached explainers, one per agent and world; each copies the policy."""
MAX_ACTIONS = 20
"""Maximum number of explained actions per episode; an episode may have 2,000."""


class FollowedRun:
    """An agent's run folder, read again when the files change; thread-safe.

    All methods raise ArtefactError if the run does not exist or a file is damaged.

    Attributes:
        folder: run folder.
        opened: the graph and split of the training.

    Example:
        >>> run = FollowedRun(Path("runs/kitchen"), open_graph("kitchen"))
        >>> run.records().run.status, run.agent() is run.agent()
        ('done', True)
    """

    def __init__(self, folder: Path, opened: OpenedGraph):
        """Follow a folder; nothing is read yet."""
        self.folder = folder
        self.opened = opened
        self._lock = threading.RLock()
        # Each keeps what was made last, as long as its stamp is the same.
        self._records = lru_cache(1)(lambda *stamp: read_agent_run(folder))
        self._agent = lru_cache(1)(self._opened)
        self._episodes = lru_cache(1)(
            lambda *stamp: {
                (task.part, task.goal, task.start): task for task in read_episodes(folder)
            }
        )
        self._explainer = lru_cache(EXPLAINERS)(_explainer)

    def records(self) -> AgentRun:
        """Return the run's settings, status, learning curves and checkpoints, as they are now.

        Raises:
            ArtefactError: if the run does not exist or a file is damaged.
        """
        files = self._stamp(RUN_FILE, CONFIG_FILE, METRICS_FILE)
        with self._lock:
            return self._records(*files, *AGENTS.checkpoints(self.folder).records())

    def agent(self) -> OpenedAgent:
        """Return the agent with the latest weights.

        Raises:
            ArtefactError: if the run does not exist or has no checkpoint yet, or a file is damaged.
            GraphMismatchError: if the graph or split differs from training.
        """
        # Weights change with a checkpoint, or with the record at the end of training.
        with self._lock:
            return self._agent(*self._stamp(RUN_FILE), *AGENTS.checkpoints(self.folder).records())

    def _opened(self, *stamp: Hashable) -> OpenedAgent:
        # Explainers of earlier weights: each holds an agent, of gigabytes for a large graph.
        self._explainer.cache_clear()
        return open_agent(self.folder, self.opened)

    def explainer(self, world: World) -> Explainer:
        """Return an explainer for the latest weights, for :data:`MAX_ACTIONS` of an episode.

        Raises:
            ArtefactError: if the run does not exist or has no checkpoint yet, or a file is damaged.
            LeakError: if a task would be scored by a model trained on the task's recipes.
            GraphMismatchError: if the graph or split differs from training.
        """
        with self._lock:
            return self._explainer(self.agent(), world)

    def episodes(self) -> dict[tuple[TaskPart, str, tuple[str, ...]], PlayedTask]:
        """Return the final evaluation's episodes by part, goal and starting ingredients.

        Empty before the end of training.

        Raises:
            ArtefactError: if the run does not exist or a file is damaged.
        """
        if self.records().evaluation is None:
            return {}
        with self._lock:
            return self._episodes(*self._stamp(EPISODES_FILE))

    def _stamp(self, *names: str) -> tuple[Hashable, ...]:
        """Return a value that changes when one of some files does; a missing file counts, too."""
        stamps: list[Hashable] = []
        for name in names:
            try:
                status = (self.folder / name).stat()
            except OSError:
                stamps.append(None)
            else:
                stamps.append((status.st_mtime_ns, status.st_size))
        return tuple(stamps)


def _explainer(agent: OpenedAgent, world: World) -> Explainer:
    return Explainer(
        agent.policy,
        world,
        max_actions=MAX_ACTIONS,
        trained_on=agent.trained_on,
        outside=agent.outside,
    )
