"""Reading the files and the graph of a run, checked against the hashes in ``run.json``."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from wordcraft_kg.base.artefacts import read_large_file
from wordcraft_kg.base.errors import ArtefactError, GraphMismatchError
from wordcraft_kg.base.records import parse_lines, parse_record
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.runs.record import RunRecord

if TYPE_CHECKING:
    from torch import Tensor

T = TypeVar("T")


@dataclass(frozen=True)
class RunFiles:
    """The files of a run; every method raises ArtefactError if a file is missing, changed or damaged.

    Attributes:
        folder: folder of the run.
        run: content of ``run.json``.
    """

    folder: Path
    run: RunRecord

    def bytes(self, name: str) -> bytes:
        """Return the bytes of an input or output file."""
        path = self.folder / name
        data = read_large_file(path)
        if hashlib.sha256(data).hexdigest() != self.run.outputs.get(name, self.run.inputs.get(name)):
            raise ArtefactError(
                f"{path} is damaged or was changed: its SHA-256 is not the one that run.json records. "
                "Train again, or restore a copy."
            )
        return data

    def record(self, name: str, kind: type[T]) -> T:
        """Return the record of a JSON file."""
        return parse_record(self.bytes(name), kind, self.folder / name)

    def lines(self, name: str, kind: type[T]) -> list[T]:
        """Return the records of a JSON Lines file."""
        return parse_lines(self.bytes(name), kind, self.folder / name)

    def tensors(self, name: str) -> "dict[str, Tensor]":
        """Return the tensors of a safetensors file."""
        from wordcraft_kg.base.tensors import read_tensors

        return read_tensors(self.folder / name, self.bytes(name))

    def graph(self, source: str | OpenedGraph) -> OpenedGraph:
        """Return the graph and split of the training.

        Args:
            source: the opened graph, or its path or name.

        Raises:
            ArtefactError: if the graph is not found.
            GraphMismatchError: if the hash of graph or split differs.
        """
        try:
            opened = open_graph(source) if isinstance(source, str) else source
        except ArtefactError:
            raise
        except ValueError as error:
            raise ArtefactError(
                f"the graph that '{self.folder}' was trained on was not found ({error}) Give its path as `graph`."
            ) from None
        for name, actual in (("graph", opened.graph.hash), ("split", opened.split.hash)):
            expected = self.run.inputs.get(name, "")
            if actual != expected:
                raise GraphMismatchError(
                    f"'{self.folder}' was trained on {name} {expected[:12]} but '{opened.source}' has {actual[:12]}. "
                    "Give the right one as `graph`, or train again."
                )
        return opened
