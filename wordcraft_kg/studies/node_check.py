"""Whether a node of a cluster fits a study: the same package, results folder and recipe graphs."""

import socket
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from wordcraft_kg.base.artefacts import package_hash
from wordcraft_kg.base.errors import ConfigError, WordCraftKGError

if TYPE_CHECKING:
    from wordcraft_kg.studies.plan import Plan


@dataclass(frozen=True)
class Expected:
    """Requirements of a study for each node, compared with what the node has.

    Attributes:
        marker: a file that the study has just written in the results folder, an absolute path.
        version: version of wordcraft-kg.
        package: hash of the package's files, see
            :func:`~wordcraft_kg.base.artefacts.package_hash`.
        graphs: recipe graph hash by the graph's address.
    """

    marker: Path
    version: str
    package: str
    graphs: dict[str, str]

    @classmethod
    def of(cls, plan: "Plan", marker: Path) -> "Expected":
        """Return a study's requirements: this process's package and the plan's graphs."""
        graphs = {
            address: str(task.settings["graph"])
            for address, task in plan.tasks.items()
            if task.kind == "graphs"
        }
        return cls(marker, version("wordcraft-kg"), _package(), graphs)

    @property
    def root(self) -> Path:
        """The results folder."""
        return self.marker.parent

    def only(self, graphs: Iterable[str]) -> "Expected":
        """Return the same requirements for fewer graphs, by address."""
        return replace(self, graphs={address: self.graphs[address] for address in graphs})

    def check(self) -> None:
        """Compare this process's node with the requirements.

        Raises:
            ConfigError: if something differs.
        """
        node = f"node '{socket.gethostname()}'"
        found = (version("wordcraft-kg"), _package())
        if found != (self.version, self.package):
            raise ConfigError(
                f"{node} has wordcraft-kg {_short(*found)}; expected "
                f"{_short(self.version, self.package)}. Install the same package on all nodes, "
                "start Ray there again, then repeat the command."
            )
        if not self.marker.exists():
            raise ConfigError(
                f"{node} does not see the files of this study in '{self.root}'; expected a folder "
                "that all nodes share under this path. Choose another `out`."
            )
        for address, expected in self.graphs.items():
            graph = _graph_hash(self.root / address)
            if graph != expected:
                raise ConfigError(
                    f"{node} has {graph} in '{self.root / address}'; expected the recipe graph "
                    f"{expected}, of the book with which the study was planned. Remove this "
                    "folder, then repeat the command."
                )


@cache  # a process runs the code that it has loaded, whatever happens to the files later
def _package() -> str:
    return package_hash()


def _graph_hash(folder: Path) -> str:
    from wordcraft_kg.graphs.folder import open_graph

    try:
        return open_graph(str(folder)).graph.hash
    except WordCraftKGError as error:
        return f"no recipe graph ({error})"


def _short(number: str, package: str) -> str:
    return f"{number} (files {package[:12]})"
