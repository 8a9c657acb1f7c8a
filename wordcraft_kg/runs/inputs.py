"""The graph and split that a run was made with."""

from pathlib import Path
from typing import Any

from wordcraft_kg.errors import ArtefactError, GraphMismatchError
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph


def open_run_graph(folder: Path, run: dict[str, Any], source: str) -> OpenedGraph:
    """Open a run's graph and make sure that it is the one.

    Raises:
        ArtefactError: if it is not to be found.
        GraphMismatchError: if it is another.
    """
    try:
        opened = open_graph(source)
    except ArtefactError:
        raise
    except ValueError as error:
        raise ArtefactError(
            f"the graph that '{folder}' was trained on is not to be found ({error}) Give it: --graph"
        ) from None
    check_inputs(folder, run, opened)
    return opened


def check_inputs(folder: Path, run: dict[str, Any], opened: OpenedGraph) -> None:
    """Make sure that a graph and its split are those that a run was made with.

    Raises:
        GraphMismatchError: naming both.
    """
    for what, found in (("graph", opened.graph.hash), ("split", opened.split.hash)):
        expected = str(run["inputs"].get(what))
        if found != expected:
            raise GraphMismatchError(
                f"'{folder}' was trained on {what} {expected[:12]} but '{opened.source}' has {found[:12]}. "
                "Give the right one with --graph, or train again."
            )
