"""The graph and split that a run was made with."""

from pathlib import Path

from wordcraft_kg.errors import ArtefactError, GraphMismatchError
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.runs.record import RunRecord


def open_run_graph(folder: Path, run: RunRecord, source: str) -> OpenedGraph:
    """Open a run's graph and make sure that it is the one.

    Raises:
        ArtefactError: if it cannot be found.
        GraphMismatchError: if it is another, or its split is.
    """
    try:
        opened = open_graph(source)
    except ArtefactError:
        raise
    except ValueError as error:
        raise ArtefactError(
            f"the graph that '{folder}' was trained on was not found ({error}) Give it: --graph"
        ) from None
    for what, found in (("graph", opened.graph.hash), ("split", opened.split.hash)):
        expected = run.inputs.get(what, "")
        if found != expected:
            raise GraphMismatchError(
                f"'{folder}' was trained on {what} {expected[:12]} but '{opened.source}' has {found[:12]}. "
                "Give the right one with --graph, or train again."
            )
    return opened
