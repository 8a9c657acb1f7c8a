"""Checkpoints: the whole state of a training, in files that survive a power failure."""

import hashlib
import logging
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from wordcraft_kg.base.artefacts import dump_json, read_large_file, write_atomically
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Record, as_values, read_record

if TYPE_CHECKING:
    from torch import Tensor

KEPT = 2
"""Default number of checkpoints to keep: if the last is damaged, training resumes from the checkpoint before."""
P = TypeVar("P")


class CheckpointRecord(Record, Generic[P], frozen=True, kw_only=True):
    """JSON record for a checkpoint: SHA-256 of the tensor file, and the trainer's progress record."""

    sha256: str
    progress: P


@dataclass(frozen=True)
class Checkpoint(Generic[P]):
    """A loaded checkpoint: number (last finished epoch or step), tensors by name, and progress record."""

    number: int
    tensors: dict[str, "Tensor"]
    progress: P


class Checkpoints(Generic[P]):
    """A run's tensors ``checkpoints/epoch-N.safetensors`` and records ``.json``; ``last`` is a number, if any."""

    def __init__(self, run_folder: Path, unit: str, progress: type[P], *, kept: int | None = KEPT):
        """Set run folder, file prefix ``unit`` (epoch or step), progress class, and number to keep (None: all)."""
        self.run_folder, self.unit, self.progress, self.kept = run_folder, unit, progress, kept
        self.folder = run_folder / "checkpoints"
        self.last: int | None = None

    def records(self) -> dict[int, Path]:
        """Return the JSON record paths by checkpoint number, latest first."""
        matches = (
            (re.fullmatch(rf"{self.unit}-(\d+)", path.stem), path)
            for path in self.folder.glob("*.json")
        )
        return dict(
            sorted(((int(match[1]), path) for match, path in matches if match), reverse=True)
        )

    def save(self, number: int, tensors: Mapping[str, "Tensor"], progress: P) -> None:
        """Write a checkpoint and the JSON record, then remove all but the last ``kept`` checkpoints."""
        import safetensors.torch

        self.folder.mkdir(exist_ok=True)
        data = safetensors.torch.save(dict(tensors))
        path = self.folder / f"{self.unit}-{number}.safetensors"
        write_atomically(path, data, durable=True)
        record = CheckpointRecord(sha256=hashlib.sha256(data).hexdigest(), progress=progress)
        write_atomically(path.with_suffix(".json"), dump_json(as_values(record)), durable=True)
        self.last = number
        if self.kept is None:
            return
        known = self.records()
        # Checkpoints with a higher number were damaged: the run was resumed from an earlier one.
        kept = [other for other in known if other <= number][: self.kept]
        for other, old in known.items():
            if other not in kept:
                old.unlink()
                old.with_suffix(".safetensors").unlink(missing_ok=True)

    def load(self) -> Checkpoint[P]:
        """Return the last intact checkpoint, with warnings about damaged later ones; ArtefactError if none."""
        damaged: list[ArtefactError] = []
        for number, path in self.records().items():
            try:
                checkpoint = self.read(number)
            except ArtefactError as error:
                damaged.append(error)
                continue
            for problem in damaged:
                logging.getLogger(__name__).warning(
                    "%s Resuming from the checkpoint before, %s.", problem, path.stem
                )
            self.last = number
            return checkpoint
        if damaged:
            raise ArtefactError(
                f"all checkpoints of '{self.run_folder}' are damaged: {damaged[0]} Train again."
            )
        raise ArtefactError(
            f"'{self.run_folder}' has no checkpoint yet. Wait, or train again with `force`."
        )

    def drop(self) -> None:
        """Remove all checkpoints."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def read(self, number: int) -> Checkpoint[P]:
        """Load the checkpoint with the given number; ArtefactError if missing or damaged."""
        from wordcraft_kg.base.tensors import read_tensors

        path = self.folder / f"{self.unit}-{number}.json"
        record: CheckpointRecord[P] = read_record(path, CheckpointRecord[self.progress])  # type: ignore[name-defined]
        tensors = path.with_suffix(".safetensors")
        data = read_large_file(tensors)
        if hashlib.sha256(data).hexdigest() != record.sha256:
            raise ArtefactError(f"{tensors} is damaged: the SHA-256 differs from the record.")
        return Checkpoint(number, read_tensors(tensors, data), record.progress)
