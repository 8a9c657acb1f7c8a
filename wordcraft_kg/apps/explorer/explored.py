"""Content for all pages, values that are computed once, and the worlds in which agents act."""

import os
import threading
from collections.abc import Callable, Hashable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

from wordcraft_kg.agents.agent_folder import AGENTS
from wordcraft_kg.agents.config import TaskConfig
from wordcraft_kg.agents.following import FollowedRun
from wordcraft_kg.apps.explorer.predictor import LinkPredictor
from wordcraft_kg.base.errors import ArtefactError, ConfigError, UnknownEntityError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation.result_readers import TableGame, read_table_games
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.graphs.planner import Planner
from wordcraft_kg.graphs.splits import TEST
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.runs.files import RunFiles
from wordcraft_kg.runs.record import run_folders, run_name

T = TypeVar("T")


AskedPart = Literal["", "all", "train", "valid", "test"]
"""A part of the tasks; by default test tasks, or train tasks without held-out recipes."""
AskedDepth = Literal[0, 1, 2, 3, 4, 5]
"""A depth of tasks; 0 is the agent's training depth."""


class Explored:
    """Content for all pages: an opened graph, by name its link prediction models and agents' run folders, and games.

    ``games`` are recorded games of other players by goal and entities on the table.
    """

    def __init__(
        self,
        opened: OpenedGraph,
        models: Mapping[str, LinkPredictor] | None = None,
        runs: Mapping[str, Path] | None = None,
        games: Iterable[TableGame] = (),
    ):
        """Hold opened folders, and recorded games."""
        self.opened = opened
        self.models = dict(models or {})
        self.runs = dict(runs or {})
        self.games: dict[tuple[str, frozenset[str]], list[TableGame]] = {}
        for game in games:
            self.games.setdefault((game.goal, frozenset(game.table)), []).append(game)
        self._values: dict[Hashable, Any] = {}
        self._locks: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()

    @classmethod
    def open(
        cls,
        graph: str | Path,
        models: Iterable[str | Path] = (),
        runs: Iterable[str | Path] = (),
        games: Iterable[Path] = (),
    ) -> "Explored":
        """Open a graph, model folders, run folders (or folders with several seeds), and recorded games.

        A damaged or unfinished folder is an ArtefactError, another graph or split a GraphMismatchError.
        """
        opened = open_graph(graph)
        named = _named(map(Path, models)).items()
        opened_models = {
            name: LinkPredictor(name, folder, open_model(folder, str(graph)))
            for name, folder in named
        }
        folders = _named(folder for path in runs for folder in run_folders(Path(path)))
        for folder in folders.values():
            RunFiles(folder, AGENTS.read_record(folder)).graph(opened)
        return cls(
            opened,
            opened_models,
            folders,
            [one for path in games for one in read_table_games(opened, path)],
        )

    def predictor(self, name: str = "") -> LinkPredictor:
        """Return a model, by default the first, with all entity similarities computed.

        No model, or too many entities to compare, is a ConfigError, an unknown name an UnknownEntityError.
        """
        predictor = self.models[self._name("model", self.models, name)]
        self.once(("evidence", predictor.name), lambda: predictor.evidence)
        return predictor

    def _name(self, kind: str, known: Mapping[str, object], name: str) -> str:
        if not known:
            raise ConfigError(
                f"This page needs a {kind}; start with `wordcraft-kg explore GRAPH --{kind} FOLDER`."
            )
        name = name or next(iter(known))
        if name not in known:
            raise UnknownEntityError(
                f"no {kind} '{name[:60]}'; there is {', '.join(known)}.{nearest(name[:60], known)}"
            )
        return name

    def planner(self) -> Planner:
        """Return the planner with the cheapest derivations."""
        return self.once("planner", lambda: Planner(self.opened.graph))

    def once(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the value from ``make``, called once for each key; failures are not kept."""
        with self._lock:
            lock = self._locks.setdefault(key, threading.Lock())
        with lock:
            if key not in self._values:
                self._values[key] = make()
            return cast(T, self._values[key])

    def followed(self, name: str = "") -> tuple[str, FollowedRun]:
        """Return an agent's run, by default the first, as name and reader of its growing files."""
        name = self._name("run", self.runs, name)
        return name, self.once(
            ("followed run", name), lambda: FollowedRun(self.runs[name], self.opened)
        )

    def is_any_live(self, *names: str) -> bool:
        """Return whether any of these runs has yet to be complete and evaluated."""
        with suppress(ArtefactError):
            return any(self.followed(name)[1].records().run.status != "done" for name in names)
        return True

    @staticmethod
    def tasks_of(run: FollowedRun | None) -> TaskConfig:
        """Return a run's task settings; defaults without a readable run."""
        with suppress(ArtefactError):
            if run is not None:
                return run.records().config.tasks
        return TaskConfig()

    def settings_of(
        self,
        tasks: TaskConfig,
        part: AskedPart = "",
        depth: AskedDepth = 0,
        distractors: int | None = None,
    ) -> WordCraftConfig:
        """Return the environment settings of an agent's training tasks, with another part, depth or distractors."""
        if depth and depth != tasks.depth:
            enough = tasks.max_attempts is not None and tasks.max_attempts >= depth
            tasks = replace(tasks, depth=depth, max_attempts=tasks.max_attempts if enough else None)
        return tasks.environment(part or self.usual_part(), distractors)

    def plain_world(self, config: WordCraftConfig) -> World:
        """Return the tasks for environment settings, without distractors; no task is a TaskError."""
        kept = ("part", "depth", "task_weighting", "num_tasks", "task_seed")
        plain = WordCraftConfig(num_distractors=0, **{name: getattr(config, name) for name in kept})
        return self.once(("world", plain), lambda: World(self.opened, plain))

    def world_of(self, config: WordCraftConfig) -> World:
        """Return the tasks and rules for environment settings, made once."""
        return self.once(("world", config), lambda: World(self.plain_world(config), config))

    def usual_part(self) -> TaskPart:
        """Return the task part shown by default: test, or train if the graph has no test recipes."""
        return "test" if (self.opened.split.parts == TEST).any() else "train"


def _named(folders: Iterable[Path]) -> dict[str, Path]:
    named: dict[str, Path] = {}
    for folder in folders:
        name, above = run_name(folder), Path(os.path.realpath(folder)).parent
        while (
            name in named
            and os.path.realpath(named[name]) != os.path.realpath(folder)
            and above.name
        ):
            name, above = f"{above.name}-{name}", above.parent
        named[name] = folder
    return named
