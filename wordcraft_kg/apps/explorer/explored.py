"""Content for all pages, and values that are computed once."""

import os
import threading
from collections.abc import Callable, Hashable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

from wordcraft_kg.agents.agent_folder import AGENTS
from wordcraft_kg.apps.explorer.predictor import LinkPredictor
from wordcraft_kg.base.errors import ConfigError, UnknownEntityError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.graphs.planner import Planner
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.runs.files import RunFiles
from wordcraft_kg.runs.record import run_folders, run_name

T = TypeVar("T")


class Explored:
    """Content for all pages: an opened graph, and by name its link prediction models and agents' run folders."""

    def __init__(
        self,
        opened: OpenedGraph,
        models: Mapping[str, LinkPredictor] | None = None,
        runs: Mapping[str, Path] | None = None,
    ):
        """Hold opened folders."""
        self.opened = opened
        self.models = dict(models or {})
        self.runs = dict(runs or {})
        self._values: dict[Hashable, Any] = {}
        self._locks: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()

    @classmethod
    def open(cls, graph: str | Path, models: Iterable[str | Path] = (), runs: Iterable[str | Path] = ()) -> "Explored":
        """Open a graph, model folders, and run folders (or folders with several seeds).

        Raises:
            ArtefactError: if a folder is damaged or has another kind, or a model is unfinished.
            GraphMismatchError: if a model or a run belongs to another graph or split.
        """
        opened = open_graph(graph)
        named = _named(map(Path, models)).items()
        opened_models = {name: LinkPredictor(name, folder, open_model(folder, str(graph))) for name, folder in named}
        folders = _named(folder for path in runs for folder in run_folders(Path(path)))
        for folder in folders.values():
            RunFiles(folder, AGENTS.read_record(folder)).graph(opened)
        return cls(opened, opened_models, folders)

    def predictor(self, name: str = "") -> LinkPredictor:
        """Return a model, by default the first, with all entity similarities computed.

        Raises:
            ConfigError: without a model, or with too many entities to compare them all.
            UnknownEntityError: if no model has this name.
        """
        predictor = self._by_name("model", self.models, name)
        self.once(("evidence", predictor.name), lambda: predictor.evidence)
        return predictor

    def run(self, name: str = "") -> tuple[str, Path]:
        """Return the name and folder of an agent's run, by default the first; errors as in :meth:`predictor`."""
        return self._by_name("run", {name: (name, folder) for name, folder in self.runs.items()}, name)

    def _by_name(self, kind: str, known: Mapping[str, T], name: str) -> T:
        if not known:
            raise ConfigError(f"This page needs a {kind}; start with `wordcraft-kg explore GRAPH --{kind} FOLDER`.")
        name = name or next(iter(known))
        if name not in known:
            raise UnknownEntityError(
                f"no {kind} '{name[:60]}'; there is {', '.join(known)}.{nearest(name[:60], known)}"
            )
        return known[name]

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


def _named(folders: Iterable[Path]) -> dict[str, Path]:
    named: dict[str, Path] = {}
    for folder in folders:
        name, above = run_name(folder), Path(os.path.realpath(folder)).parent
        while name in named and os.path.realpath(named[name]) != os.path.realpath(folder) and above.name:
            name, above = f"{above.name}-{name}", above.parent
        named[name] = folder
    return named
