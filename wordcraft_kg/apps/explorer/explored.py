"""What is looked at: a graph, models of it, and runs of agents on it; and what is computed once for all pages."""

import threading
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

from wordcraft_kg.agents.agent_folder import AGENTS
from wordcraft_kg.base.errors import ConfigError, UnknownEntityError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.evaluation.scores import ScoringModel
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.model import Model
from wordcraft_kg.runs.inputs import check_run_graph
from wordcraft_kg.runs.seeds import run_folders, run_name

T = TypeVar("T")


@dataclass(frozen=True)
class ExploredModel:
    """A model of the graph.

    Attributes:
        name: what pages call it.
        folder: its folder.
        model: the opened folder.
        scoring: its scorer with what the recipes know.
    """

    name: str
    folder: Path
    model: Model
    scoring: ScoringModel


class Explored:
    """A graph with models and runs.

    Attributes:
        opened: the graph and its split.
        models: models of this graph by name, in the order given.
        runs: run folders of agents on this graph by name; they may be unfinished, or training at this moment.
    """

    def __init__(
        self,
        opened: OpenedGraph,
        models: Mapping[str, ExploredModel] | None = None,
        runs: Mapping[str, Path] | None = None,
    ):
        """Take what has been opened."""
        self.opened = opened
        self.models = dict(models or {})
        self.runs = dict(runs or {})
        self._values: dict[Hashable, Any] = {}
        self._locks: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()

    @classmethod
    def open(cls, graph: str | Path, models: Iterable[str | Path] = (), runs: Iterable[str | Path] = ()) -> "Explored":
        """Open a graph, models and runs; nothing is written.

        Args:
            graph: graph folder, recipe book or known book's name.
            models: folders of link predictors.
            runs: run folders of agents, or folders of several seeds.

        Raises:
            ArtefactError: if a folder is not of its kind, unfinished (a model), or damaged.
            GraphMismatchError: if a model or a run belongs to another graph or split.
        """
        opened = open_graph(graph)
        opened_models = {}
        for name, folder in _named(map(Path, models)).items():
            model = open_model(folder, str(graph))
            opened_models[name] = ExploredModel(name, folder, model, ScoringModel(model.scorer, opened.split, model.kg))
        folders = _named(folder for path in runs for folder in run_folders(Path(path)))
        for folder in folders.values():
            check_run_graph(folder, AGENTS.read_record(folder), opened)
        return cls(opened, opened_models, folders)

    def model(self, name: str = "") -> ExploredModel:
        """Return a model; without a name the first.

        Raises:
            ConfigError: if there is none.
            UnknownEntityError: if none has this name.
        """
        if not self.models:
            raise ConfigError("This page needs a model; start with `wordcraft-kg explore GRAPH --model FOLDER`.")
        return self._named("model", self.models, name)

    def run(self, name: str = "") -> tuple[str, Path]:
        """Return the name and folder of a run; without a name the first.

        Raises:
            ConfigError: if there is none.
            UnknownEntityError: if none has this name.
        """
        if not self.runs:
            raise ConfigError("This page needs a run; start with `wordcraft-kg explore GRAPH --run FOLDER`.")
        return self._named("run", {name: (name, folder) for name, folder in self.runs.items()}, name)

    def _named(self, what: str, known: Mapping[str, T], name: str) -> T:
        name = name or next(iter(known))
        if name not in known:
            raise UnknownEntityError(
                f"no {what} '{name[:60]}'; there is {', '.join(known)}.{nearest(name[:60], known)}"
            )
        return known[name]

    def once(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what ``make`` makes; it is made once for each key, while others who ask for it wait.

        What fails is not kept, and fails again for who asks next.
        """
        with self._lock:
            lock = self._locks.setdefault(key, threading.Lock())
        with lock:
            if key not in self._values:
                self._values[key] = make()
            return cast(T, self._values[key])


def _named(folders: Iterable[Path]) -> dict[str, Path]:
    """Name folders after themselves; of equal names, those that come later are named after their parents too."""
    named: dict[str, Path] = {}
    for folder in folders:
        name, above = run_name(folder), folder.resolve().parent
        while name in named and named[name].resolve() != folder.resolve() and above.name:
            name, above = f"{above.name}-{name}", above.parent
        named[name] = folder
    return named
