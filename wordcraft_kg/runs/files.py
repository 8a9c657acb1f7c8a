"""Verified reading: files and training graph of a run must match the hashes in ``run.json``.

So a result cannot come from a file that was changed, mixed up or half copied after the training.
"""

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
    """Verified access to a run's files; a missing or changed file is an ArtefactError.

    Attributes:
        folder: the run folder.
        run: the run record, with the hashes.
    """

    folder: Path
    run: RunRecord

    def bytes(self, name: str) -> bytes:
        """Return the content of an input or output file as it was written, after a SHA-256 check.

        Git on Windows gives text files other line ends (CRLF) by default. Such a file is taken if
        its SHA-256 is right with the line ends that were written (LF); so no other change passes.

        Args:
            name: the file's name, as ``run.json`` lists it.

        Raises:
            ArtefactError: if the file is missing, damaged or was changed.
        """
        path = self.folder / name
        data = read_large_file(path)
        expected = self.run.outputs.get(name, self.run.inputs.get(name))
        if hashlib.sha256(data).hexdigest() == expected:
            return data
        written = data.replace(b"\r\n", b"\n")
        if hashlib.sha256(written).hexdigest() == expected:
            return written
        raise ArtefactError(
            f"{path} is damaged or was changed: the SHA-256 differs from run.json. "
            "Train again, or restore a copy."
        )

    def record(self, name: str, kind: type[T]) -> T:
        """Read a JSON file, such as ``metrics.json``, into an instance of the class ``kind``.

        Raises:
            ArtefactError: if the file is missing, was changed, or does not fit ``kind``.
        """
        return parse_record(self.bytes(name), kind, self.folder / name, is_verified=True)

    def lines(self, name: str, kind: type[T]) -> list[T]:
        """Read a JSON Lines file, a JSON object per line, as instances of the class ``kind``.

        Raises:
            ArtefactError: if the file is missing, was changed, or a line does not fit ``kind``.
        """
        return parse_lines(self.bytes(name), kind, self.folder / name)

    def tensors(self, name: str) -> "dict[str, Tensor]":
        """Read all tensors in a safetensors file, by tensor name.

        Raises:
            ArtefactError: if the file is missing, damaged or was changed, or a tensor holds NaN or
                infinity.
        """
        # Imported here, because torch takes long and most files hold no tensors.
        from wordcraft_kg.base.tensors import read_tensors

        return read_tensors(self.folder / name, self.bytes(name))

    def graph(self, source: str | OpenedGraph) -> OpenedGraph:
        """Return the run's graph and split.

        Args:
            source: where they are: a folder, a file or a book name; or the opened graph.

        Raises:
            ArtefactError: if there is no such graph.
            GraphMismatchError: if graph or split are not those of the training.
        """
        try:
            opened = open_graph(source) if isinstance(source, str) else source
        except ArtefactError:  # a damaged graph folder is not a missing one
            raise
        except ValueError as error:
            raise ArtefactError(
                f"the graph that '{self.folder}' was trained on was not found ({error}) "
                "Give the path as `graph`."
            ) from None
        hashes = {"graph": opened.graph.hash, "split": opened.split.hash}
        for name, actual in hashes.items():
            expected = self.run.inputs.get(name, "")
            if actual != expected:
                raise GraphMismatchError(
                    f"'{self.folder}' was trained on {name} {expected[:12]} "
                    f"but '{opened.source}' has {actual[:12]}. "
                    "Give the right graph as `graph`, or train again."
                )
        return opened
