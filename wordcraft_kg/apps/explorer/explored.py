"""Content for all pages, values that are computed once, and the worlds in which agents act."""

import os
import threading
from collections.abc import Callable, Hashable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

from wordcraft_kg.agents.agent_config import TaskConfig
from wordcraft_kg.agents.agent_folder import AGENTS
from wordcraft_kg.agents.following import FollowedRun
from wordcraft_kg.apps.explorer.predictor import LinkPredictor
from wordcraft_kg.base import ArtefactError, ConfigError, UnknownEntityError, nearest
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.evaluation.suggestions import is_set_model
from wordcraft_kg.graphs import OpenedGraph, Planner, open_graph
from wordcraft_kg.graphs.splits import TEST
from wordcraft_kg.models.model_folder import open_model
from wordcraft_kg.runs.record import RunFiles, run_folders, run_name

T = TypeVar("T")


AskedPart = Literal["", "all", "train", "valid", "test"]
"""A part of the tasks; by default test tasks, or train tasks without held-out recipes."""
AskedDepth = Literal[0, 1, 2, 3, 4, 5]
"""A depth of tasks; 0 is the agent's training depth."""


class Explored:
    """Content for all pages: a graph, link prediction models, and agents' runs.

    Pages are computed in several threads at the same time; all methods are safe for that.

    Attributes:
        opened: graph and split.
        models: link predictors for this graph by name, in the given order.
        runs: run folders of agents on this graph by name; they may be unfinished, or training at
            this moment.
    """

    def __init__(
        self,
        opened: OpenedGraph,
        models: Mapping[str, LinkPredictor] | None = None,
        runs: Mapping[str, Path] | None = None,
    ):
        """Hold opened folders.

        Args:
            opened: graph and split.
            models: link predictors for this graph by name; None for none.
            runs: run folders of agents on this graph by name; None for none.
        """
        self.opened = opened
        self.models = dict(models or {})
        self.runs = dict(runs or {})
        self._values: dict[Hashable, Any] = {}
        self._locks: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()

    @classmethod
    def open(
        cls,
        graph: str | Path,
        models: Iterable[str | Path] = (),
        runs: Iterable[str | Path] = (),
    ) -> "Explored":
        """Open a graph, models and runs; nothing is written.

        Args:
            graph: graph folder, recipe book file, or built-in book name.
            models: folders of link predictors.
            runs: run folders of agents, or folders with several seeds.

        Returns:
            the content for all pages; equal folder names are told apart by the folders above them.

        Raises:
            ArtefactError: if a folder is of another kind or damaged, or a model is unfinished.
            GraphMismatchError: if a model, run or game belongs to another graph or split.
            RecipeFileError: if there is no such graph, or a book cannot be read.
        """
        opened_graph = open_graph(graph)
        predictors = {
            name: LinkPredictor(name, folder, open_model(folder, str(graph)))
            for name, folder in _named(map(Path, models)).items()
        }
        folders = _named(chain.from_iterable(run_folders(Path(path)) for path in runs))
        for folder in folders.values():
            # Only the check for the graph: unfinished runs have no weights yet.
            RunFiles(folder, AGENTS.read_record(folder)).graph(opened_graph)
        return cls(opened_graph, predictors, folders)

    def predictor(self, name: str = "") -> LinkPredictor:
        """Return a model, by default the first, with all entity similarities of its links computed.

        Raises:
            ConfigError: if there is no model, or a model has too many entities to compare.
            UnknownEntityError: if no model has this name.
        """
        predictor = self.models[self._name("model", self.models, name)]
        # A model of sets scores recipes, whose goals need no similarities.
        if is_set_model(predictor.model):
            return predictor
        # The similarities take seconds and memory: cached_property alone would compute them in two
        # threads at once.
        self.once(("evidence", predictor.name), lambda: predictor.evidence)
        return predictor

    def _name(self, kind: str, known: Mapping[str, object], name: str) -> str:
        if not known:
            raise ConfigError(
                f"This page needs a {kind}; start with "
                f"`wordcraft-kg explore GRAPH --{kind} FOLDER`."
            )
        name = name or next(iter(known))
        if name not in known:
            raise UnknownEntityError(
                f"no {kind} '{name}'; there is {', '.join(known)}.{nearest(name, known)}"
            )
        return name

    def planner(self) -> Planner:
        """Return the planner with the cheapest derivations."""
        return self.once("planner", lambda: Planner(self.opened.graph))

    def once(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the value from ``make``, called once for each key.

        Other threads that need the value wait for it. A failure is not kept: the next call tries
        again.
        """
        # One lock for each key: a thread that searches for tasks must not stop the pages that do
        # not need them.
        with self._lock:
            lock = self._locks.setdefault(key, threading.Lock())
        with lock:
            if key not in self._values:
                self._values[key] = make()
            return cast(T, self._values[key])

    def followed(self, name: str = "") -> tuple[str, FollowedRun]:
        """Return an agent's run, by default the first, as name and reader of its growing files.

        Raises:
            ConfigError: if there is no run.
            UnknownEntityError: if no run has this name.
        """
        name = self._name("run", self.runs, name)
        return name, self.once(("run", name), lambda: FollowedRun(self.runs[name], self.opened))

    def settings_of(
        self,
        run: FollowedRun | None,
        part: AskedPart = "",
        depth: AskedDepth = 0,
        distractors: int | None = None,
    ) -> WordCraftConfig:
        """Return the environment settings of an agent's training tasks, with changes.

        Args:
            run: the agent's run; without a readable one, the settings are the defaults.
            part: part of the tasks; empty for test, or train without test recipes.
            depth: depth of the tasks, in crafts; 0 for the training depth.
            distractors: distractors on the table; None for as many as in training.

        Returns:
            the settings. At another depth than in training there are as many attempts as crafts.

        Raises:
            ConfigError: if a number is out of range.
        """
        tasks = TaskConfig()
        with suppress(ArtefactError):
            if run is not None:
                tasks = run.records().config.tasks
        if depth and depth != tasks.depth:
            # With fewer attempts than crafts, no task could be solved: WordCraftConfig would raise.
            tasks = replace(tasks, depth=depth, max_attempts=None)
        has_test = (self.opened.split.parts == TEST).any()
        return tasks.environment(part or ("test" if has_test else "train"), distractors)

    def plain_world(self, config: WordCraftConfig) -> World:
        """Return the tasks for environment settings, without distractors.

        Any graph has room for them, whatever number of distractors the settings have.

        Raises:
            TaskError: if there is no task.
        """
        # The search for tasks takes seconds, so settings that differ only in rules share one world.
        settings = ("part", "depth", "num_tasks", "task_seed", "pays_held_out")
        plain = WordCraftConfig(
            num_distractors=0, **{name: getattr(config, name) for name in settings}
        )
        return self.once(("world", plain), lambda: World(self.opened, plain))

    def world_of(self, config: WordCraftConfig) -> World:
        """Return the tasks and rules for environment settings, made once.

        Raises:
            TaskError: if there is no task.
            ConfigError: if the graph has too few entities for the distractors.
        """
        return self.once(("world", config), lambda: World.open(self.plain_world(config), config))


def _named(folders: Iterable[Path]) -> dict[str, Path]:
    """Name folders after themselves; later ones of an equal name also after the folders above them.

    A folder that is given twice has one name: paths are compared without links.
    """
    folders_by_name: dict[str, Path] = {}
    for folder in folders:
        # os.path, because Path.resolve raises on a loop of links before Python 3.13.
        real = os.path.realpath(folder)
        name = run_name(folder)
        above = Path(real).parent
        while (
            name in folders_by_name
            and os.path.realpath(folders_by_name[name]) != real
            and above.name
        ):
            name = f"{above.name}-{name}"
            above = above.parent
        folders_by_name[name] = folder
    return folders_by_name
