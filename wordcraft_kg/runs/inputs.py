"""The graph and split that a run was trained on."""

from pathlib import Path

from wordcraft_kg.base.errors import ArtefactError, GraphMismatchError
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.runs.record import RunRecord


def open_run_graph(folder: Path, run: RunRecord, source: str) -> OpenedGraph:
    """Open the graph of a run and check that it is the one that the run was trained on.

    Raises:
        ArtefactError: if it cannot be found.
        GraphMismatchError: if the graph or its split is another one.
    """
    try:
        opened = open_graph(source)
    except ArtefactError:
        raise
    except ValueError as error:
        raise ArtefactError(
            f"the graph that '{folder}' was trained on was not found ({error}) Give its path as `graph`."
        ) from None
    check_run_graph(folder, run, opened)
    return opened


def check_run_graph(folder: Path, run: RunRecord, opened: OpenedGraph) -> None:
    """Check that a graph and its split are those that a run was trained on.

    Raises:
        GraphMismatchError: if the graph or its split is another one.
    """
    for what, found in (("graph", opened.graph.hash), ("split", opened.split.hash)):
        expected = run.inputs.get(what, "")
        if found != expected:
            raise GraphMismatchError(
                f"'{folder}' was trained on {what} {expected[:12]} but '{opened.source}' has {found[:12]}. "
                "Give the right one as `graph`, or train again."
            )
