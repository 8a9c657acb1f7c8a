"""Checkpoints: the whole state of a training, in files that survive a power failure.

A checkpoint is complete when its JSON record exists: the record is written after the tensors, has
their hash, and both are on the disk before they get their names. Parts of a training, such as
folds, have a checkpoint each, and run in parallel processes by joblib's executor.
"""

import hashlib
import logging
import shutil
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from wordcraft_kg.base import (
    ArtefactError,
    Record,
    TrainingError,
    WordCraftKGError,
    as_values,
    cores,
    dump_json,
    read_large_file,
    read_record,
    reason,
    write_atomically,
)

if TYPE_CHECKING:
    from torch import Tensor


KEPT = 2
"""Default number of checkpoints to keep: if the last is damaged, the one before is used."""
P = TypeVar("P")


class CheckpointRecord(Record, Generic[P], frozen=True, kw_only=True):
    """JSON record for a checkpoint.

    Attributes:
        sha256: hash of the tensor file.
        progress: the trainer's state besides tensors, such as random generators and metrics.
    """

    sha256: str
    progress: P


@dataclass(frozen=True)
class Checkpoint(Generic[P]):
    """A loaded checkpoint.

    Attributes:
        number: last finished epoch or step.
        tensors: tensors by name.
        progress: the trainer's state besides tensors.
    """

    number: int
    tensors: dict[str, "Tensor"]
    progress: P


class Checkpoints(Generic[P]):
    """The checkpoints of a run: ``checkpoints/epoch-N.safetensors``, each with a record ``.json``.

    Attributes:
        run_folder: the run folder.
        folder: the folder with the checkpoints; it exists after the first.
        unit: prefix of the file names: epoch or step.
        progress: type of the progress record.
        kept: number of checkpoints to keep; None keeps all.
        last: number of the checkpoint last saved or loaded; None before.
    """

    def __init__(
        self,
        run_folder: Path,
        unit: str,
        progress: type[P],
        *,
        kept: int | None = KEPT,
    ):
        """Bind the checkpoints to a run folder; nothing is read or written yet.

        Args:
            run_folder: the run folder.
            unit: prefix of the file names: epoch or step.
            progress: type of the progress record.
            kept: number of checkpoints to keep; None keeps all, for parts that are saved in any
                order.
        """
        self.run_folder = run_folder
        self.unit = unit
        self.progress = progress
        self.kept = kept
        self.folder = run_folder / "checkpoints"
        self.last: int | None = None

    def records(self) -> dict[int, Path]:
        """Return the JSON record paths by checkpoint number, latest first."""
        # Temporary files of a killed write have other names.
        paths = self.folder.glob(f"{self.unit}-*.json")
        path_of = {path.stem.removeprefix(f"{self.unit}-"): path for path in paths}
        numbers = {int(name): path for name, path in path_of.items() if name.isdecimal()}
        return dict(sorted(numbers.items(), reverse=True))

    def save(
        self,
        number: int,
        tensors: Mapping[str, "Tensor"],
        progress: P,
    ) -> None:
        """Write a checkpoint, then remove all but the last ``kept`` checkpoints.

        Args:
            number: last finished epoch or step.
            tensors: contiguous tensors by name that share no memory.
            progress: the trainer's state besides tensors.

        Raises:
            TypeError: if a value in ``progress`` has no JSON form.
            ValueError: if a number in ``progress`` is not finite, or a tensor not contiguous.
            RuntimeError: if tensors share memory.
        """
        import safetensors.torch

        self.folder.mkdir(exist_ok=True)
        data = safetensors.torch.save(dict(tensors))
        path = self.folder / f"{self.unit}-{number}.safetensors"
        # The record comes last: without it, the tensors of a killed write count as absent.
        write_atomically(path, data, durable=True)
        record = CheckpointRecord(sha256=hashlib.sha256(data).hexdigest(), progress=progress)
        write_atomically(path.with_suffix(".json"), dump_json(as_values(record)), durable=True)
        # Only now: a message after a failed write names the checkpoint before.
        self.last = number
        # Without a number to keep, every part is needed until the end.
        if self.kept is None:
            return
        paths = self.records()
        # Checkpoints with a higher number were damaged: the run was resumed from an earlier one.
        newest = [saved_number for saved_number in paths if saved_number <= number][: self.kept]
        for saved_number, old in paths.items():
            if saved_number not in newest:
                # The record first, for the same reason.
                old.unlink()
                old.with_suffix(".safetensors").unlink(missing_ok=True)

    def load(self) -> Checkpoint[P]:
        """Return the last intact checkpoint, with a warning for each damaged later one.

        Raises:
            ArtefactError: if there is no checkpoint, or all are damaged.
        """
        damaged: list[ArtefactError] = []
        # The last intact one: later checkpoints may be damaged, such as by a full disk.
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
                f"all checkpoints of '{self.run_folder}' are damaged, or another version of "
                f"wordcraft-kg wrote them: {damaged[0]} Train again."
            )
        raise ArtefactError(
            f"'{self.run_folder}' has no checkpoint yet. Wait, or train again with `force`."
        )

    def drop(self) -> None:
        """Remove all checkpoints; a finished run has results instead."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def read(self, number: int) -> Checkpoint[P]:
        """Load the checkpoint with the given number.

        Raises:
            ArtefactError: if it is missing or damaged.
        """
        from wordcraft_kg.base.tensors import read_tensors

        path = self.folder / f"{self.unit}-{number}.json"
        kind = CheckpointRecord[self.progress]  # type: ignore[name-defined]
        record: CheckpointRecord[P] = read_record(path, kind)
        tensors = path.with_suffix(".safetensors")
        # Read once: the bytes that are hashed are those that are used.
        data = read_large_file(tensors)
        if hashlib.sha256(data).hexdigest() != record.sha256:
            raise ArtefactError(f"{tensors} is damaged: the SHA-256 differs from the record.")
        # An optimiser's numbers may be larger than a model's.
        values = read_tensors(tensors, data, largest_value=sys.float_info.max)
        return Checkpoint(number, values, record.progress)


_TICK = 0.2
"""Seconds between calls of ``note``: Ctrl-C is noticed within this time."""


class Job(Protocol):
    """A part of a training, such as the model for one fold, with a checkpoint for its result."""

    @property
    def fold(self) -> int:
        """Number of the fold (or other part) that this job trains, and of its checkpoint."""

    @property
    def done(self) -> Any:
        """Progress record of the finished job; a checkpoint with another record is trained anew."""

    def train(self, after: Callable[[int], None]) -> None:
        """Train and save the result; call ``after`` with the number of finished steps or epochs."""


J = TypeVar("J", bound=Job)


def not_done(jobs: Iterable[J], kept: Checkpoints[Any]) -> list[J]:
    """Return all jobs that have no intact result among the checkpoints ``kept``."""

    def is_done(job: J) -> bool:
        try:
            return job.fold in kept.records() and bool(kept.read(job.fold).progress == job.done)
        except ArtefactError as error:
            logging.getLogger(__name__).warning("%s Training fold %s again.", error, job.fold)
            return False

    return [job for job in jobs if not is_done(job)]


def train_jobs(
    jobs: Sequence[Job],
    threads: int,
    note: Callable[..., None],
    *,
    is_long: bool,
) -> None:
    """Run all jobs, in parallel if they are long and there are enough CPU cores.

    Args:
        jobs: the jobs; their results do not depend on the order or the process.
        threads: CPU threads with which each job computes.
        note: called with a job's fold and its number of finished steps or epochs; in parallel, with
            those of the last one, and also regularly without arguments. It may raise, such as after
            Ctrl-C, to end all jobs.
        is_long: whether the jobs take longer than the start of a process, some seconds.

    Raises:
        WordCraftKGError: raised by a job; any other exception, too, if the jobs run in this
            process.
        TrainingError: in parallel, if a job raises another exception or its process dies.
    """
    workers = min(len(jobs), max(cores() // threads, 1))
    # A process takes seconds to start, which short jobs would not win back.
    if is_long and workers > 1:
        train_in_processes(jobs, workers, note)
        return
    for job in jobs:
        job.train(partial(note, job.fold))


def train_in_processes(
    jobs: Sequence[Job],
    workers: int,
    note: Callable[..., None],
) -> None:
    """Run jobs in processes; an error, or one that ``note`` raises, ends all at once.

    Processes and not threads, because threads would share PyKEEN's global random generators.

    Args:
        jobs: the jobs, see :func:`train_jobs`.
        workers: number of processes, from 1.
        note: see :func:`train_jobs`.

    Raises:
        WordCraftKGError: raised by a job.
        TrainingError: if a job raises another exception or its process dies.
    """
    from joblib.externals.loky import ProcessPoolExecutor
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    executor = ProcessPoolExecutor(workers)
    try:
        fold_of = {executor.submit(_last_number, job): job.fold for job in jobs}
        waiting = set(fold_of)
        while waiting:
            # First: after Ctrl-C, jobs fail in their own ways.
            note()
            ended, waiting = wait(waiting, timeout=_TICK, return_when=FIRST_COMPLETED)
            for future in ended:
                note(fold_of[future], future.result())
    except TerminatedWorkerError as error:
        raise TrainingError(
            f"a process that trained folds ended ({reason(error)}); perhaps the memory is too "
            "small for several at once. Use more `threads`, or fewer `folds`."
        ) from error
    finally:
        executor.shutdown(kill_workers=True)


def _last_number(job: Job) -> int:
    """Train a job; return its number of finished steps or epochs."""
    numbers = [0]
    try:
        job.train(numbers.append)
    except WordCraftKGError:
        raise
    except Exception as error:
        raise TrainingError(f"a fold could not be trained ({reason(error)}).") from error
    return numbers[-1]
