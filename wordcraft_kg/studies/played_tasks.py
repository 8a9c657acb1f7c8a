"""The test tasks of a study's agents: their resampling groups, and whether results fit them."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from wordcraft_kg.agents.config import TaskConfig
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.envs.draws import MOST_TASKS, distance_of
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation.reference import PlayedGraph
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.studies.results import RunMetrics


class PlayedTasks:
    """The test tasks of a study's agents, found once for all agents that play the same."""

    def __init__(self, open_address: Callable[[str], OpenedGraph]):
        """Find tasks with a function that opens the graph of an address.

        An address is, for example, ``graphs/2f65aebd52224b51``.
        """
        self._open = open_address
        self._opened: dict[str, OpenedGraph] = {}
        self._groups: dict[tuple[str, int, str], Ids] = {}

    def groups(self, address: str, settings: Mapping[str, Any]) -> Ids:
        """Return the resampling group of each test task of an agent, shape (K,).

        Groups are numbered by first appearance.

        Args:
            address: address of the agent's graph.
            settings: settings of a cell or a task, of which only task settings matter.

        Raises:
            TaskError: if the graph has no test tasks with these settings.
            ConfigError: if a task setting is out of range.
            ArtefactError, RecipeFileError: if the graph cannot be opened.
        """
        of_tasks = {}
        for field in fields(TaskConfig):
            if field.name in settings:
                of_tasks[field.name] = settings[field.name]
        config = TaskConfig(**of_tasks).environment("test")
        key = address, config.depth, config.task_weighting
        if key not in self._groups:
            every = World(self._graph(address), config).groups
            # Of very many tasks, an even sample is played.
            step = distance_of(len(every), MOST_TASKS)
            played = every[::step]
            _, first, number = np.unique(played, return_index=True, return_inverse=True)
            # unique() numbers the groups by their values; the first appearance does not depend on
            # these. The place of a group in the order of first appearances is its new number.
            order = np.argsort(first)
            place = np.argsort(order)
            self._groups[key] = place[number]
        return self._groups[key]

    def check(
        self,
        figures: RunMetrics,
        address: str,
        settings: Mapping[str, Any],
        where: Path | str,
    ) -> None:
        """Check that an agent's results are of its graph, its split and its test tasks.

        Args:
            figures: results of the agent.
            address: address of the agent's graph.
            settings: settings of the agent's cell or task.
            where: file or folder with the results, perhaps in words, for the error.

        Raises:
            ArtefactError: if they are of another graph, split or set of tasks.
            TaskError, ConfigError, RecipeFileError: as :meth:`groups`.
        """
        expected = PlayedGraph.of(self._graph(address))
        if figures.graph != expected:
            raise ArtefactError(
                f"{where} has results of {figures.graph.in_words}; expected {expected.in_words}. "
                "Train again."
            )
        tasks = len(self.groups(address, settings))
        if len(figures.won) != tasks:
            raise ArtefactError(
                f"{where} is damaged: 'won' has {len(figures.won):,} tasks; expected {tasks:,}, "
                "all test tasks. Make it again, or restore a copy."
            )

    def _graph(self, address: str) -> OpenedGraph:
        if address not in self._opened:
            self._opened[address] = self._open(address)
        return self._opened[address]
