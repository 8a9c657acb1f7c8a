"""Rows of a long computation, saved beside the output, so that an interrupted command continues."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import safetensors.torch
from torch import Tensor

from wordcraft_kg.base.artefacts import TEMPORARY, read_large_file, write_atomically
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.tensors import read_tensors
from wordcraft_kg.runs.run_folder import locked_folder


@contextmanager
def saved_rows(out: Path, key: str) -> Iterator[Path]:
    """Yield the locked, hidden folder beside ``out`` for the rows with this key.

    Args:
        out: output of the command.
        key: everything that decides about the rows: another model, prompt or graph has another
            key, and so never takes these rows.

    Raises:
        ArtefactError: if another process writes there.
    """
    digest = hashlib.sha256(key.encode()).hexdigest()[:16]
    folder = out.parent / f".{out.name}.{digest}{TEMPORARY}"
    with locked_folder(folder, "written"):
        yield folder


def read_rows(folder: Path, number: int) -> Tensor | None:
    """Return the rows of a part; None if they are not saved, or damaged."""
    file = folder / f"{number}.safetensors"
    if not file.exists():
        return None
    try:
        return read_tensors(file, read_large_file(file))["rows"]
    except ArtefactError:  # cut short by a power failure
        return None


def save_rows(folder: Path, number: int, rows: Tensor) -> None:
    """Save the rows of a part; atomic: a part is either saved or not, even after a kill.

    Args:
        folder: folder of the saved parts, from :func:`saved_rows`.
        number: number of the part, from 0.
        rows: shape (rows of the part, any width).
    """
    content = safetensors.torch.save({"rows": rows})
    write_atomically(folder / f"{number}.safetensors", content)
