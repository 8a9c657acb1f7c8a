"""The run folder during training: begin, resume, finish, fail, and replace an earlier folder."""

import logging
import os
import shutil
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Generic, TypeVar

from wordcraft_kg.base.artefacts import (
    check_output,
    drop_temporary,
    has_only_temporary,
    output_target,
    sha256_of,
    what_is,
    with_a_name,
    write_atomically,
)
from wordcraft_kg.base.errors import ArtefactError, TrainingError, reason
from wordcraft_kg.runs.checkpoints import Checkpoints
from wordcraft_kg.runs.config_file import CONFIG_FILE, RunConfig
from wordcraft_kg.runs.interruption import first_interrupt, interruption_message
from wordcraft_kg.runs.record import (
    RUN_FILE,
    RunRecord,
    Status,
    end_run,
    read_run,
    resume_run,
    start_run,
)

_BEGUN = ".begun-by-wordcraft-kg"
"""Marks a new folder until the first record; after an earlier kill, the folder can be removed."""
P = TypeVar("P")
Progress = Callable[[int, int, dict[str, float]], None]
"""Progress callback: takes the number of finished epochs or steps, the total number, and metrics by name."""


@dataclass(frozen=True)
class RunKind(Generic[P]):
    """Constants of all runs with the same trainer class: commands, progress label, unit and record."""

    commands: tuple[str, ...]
    name: str
    unit: str
    progress: type[P]

    def read_record(self, folder: Path) -> RunRecord:
        """Read the run record in a folder; ArtefactError if missing or damaged, or if the run has another kind."""
        expected = f"a run of {' or '.join(self.commands)}"
        record = read_run(folder, expected)
        if record.kind not in self.commands:
            raise ArtefactError(f"'{folder}' {what_is(folder)}; expected {expected}.")
        return record

    def checkpoints(self, folder: Path) -> Checkpoints[P]:
        """Return an object that saves and loads the checkpoints in a run folder."""
        return Checkpoints(folder, self.unit, self.progress)


class RunFolder(Generic[P]):
    """A locked run folder in which this process trains, see :func:`new_run`; Ctrl-C sets ``interrupted``."""

    def __init__(
        self,
        path: Path,
        kind: RunKind[P],
        interrupted: threading.Event,
        record: RunRecord | None = None,
    ):
        self.path, self.kind, self.interrupted = path, kind, interrupted
        self.checkpoints = kind.checkpoints(path)
        self.is_live = False
        self._record = record

    @property
    def record(self) -> RunRecord:
        """The run record as last written to ``run.json``."""
        assert self._record is not None, "begin the run first"
        return self._record

    def begin(
        self,
        config: RunConfig,
        *,
        inputs: Mapping[str, str],
        files: Sequence[str] = (),
        **facts: Any,
    ) -> None:
        """Write ``config.toml``, and write ``run.json`` with the status ``running``.

        ``inputs`` are training data hashes by name; ``files`` names further files that training never changes;
        ``facts`` are optional fields of :class:`~wordcraft_kg.runs.record.RunRecord`.
        """
        config.write(self.path)
        hashes = {name: sha256_of(self.path / name) for name in (CONFIG_FILE, *files)}
        settings = config.values()
        self._record = start_run(
            self.path,
            config.command,
            **{name: settings[name] for name in ("seed", "device", "threads") if name in settings},
            inputs={**inputs, **hashes},
            **facts,
        )
        (self.path / _BEGUN).unlink(missing_ok=True)
        self.is_live = True

    def resume(self, config: RunConfig) -> None:
        """Record an unfinished run as running again, with current input paths in ``config.toml``."""
        began_with, installed = self.record.versions.get("torch"), version("torch")
        if began_with != installed:
            logging.getLogger(__name__).warning(
                "the run began with torch %s and is resumed with %s: the result may differ in the last bits.",
                began_with,
                installed,
            )
        config.write(self.path)
        self._record = resume_run(
            self.path, self.record, {CONFIG_FILE: sha256_of(self.path / CONFIG_FILE)}
        )
        self.is_live = True

    @contextmanager
    def restoring(self) -> Iterator[None]:
        """Turn errors from a checkpoint in this block into an ArtefactError that names the run folder."""
        try:
            yield
        except (
            KeyError,
            RuntimeError,
            TypeError,
            ValueError,
            AttributeError,
            IndexError,
            OSError,
        ) as error:
            raise ArtefactError(
                f"the checkpoint in '{self.path}' does not fit the run ({reason(error)}). Train again."
            ) from None

    def interrupt(self) -> None:
        """Record the run as interrupted in ``run.json``."""
        self._end("interrupted")

    def finish(self, outputs: Sequence[str], card: str) -> None:
        """Write the model card, record the run as done with the ``outputs``' hashes, and remove all checkpoints."""
        write_atomically(self.path / "README.md", card)
        for name in outputs:
            with (self.path / name).open("rb+") as file:
                os.fsync(file.fileno())
        self._end("done", outputs)
        self.checkpoints.drop()

    def fail(self, error: BaseException) -> BaseException:
        """Record the run as failed, or after Ctrl-C as interrupted; return an error that names the last checkpoint."""
        with suppress(OSError):  # the disk may be full
            self._end("interrupted" if isinstance(error, KeyboardInterrupt) else "failed")
        unit, last = self.kind.unit, self.checkpoints.last
        if isinstance(error, OSError) and last is None:
            last = next(iter(self.checkpoints.records()), None)
        if last is None:
            return error
        if isinstance(error, KeyboardInterrupt):
            return KeyboardInterrupt(interruption_message(self.path, unit, last))
        kept = f"The checkpoint of {unit} {last:,} is safe"
        if isinstance(error, TrainingError):
            return TrainingError(f"{error} {kept}, in '{self.path}'.")
        if isinstance(error, OSError):
            return ArtefactError(
                f"'{self.path}' cannot be written ({error.strerror or error}). {kept}; free some space, then repeat "
                "the command to resume from there."
            )
        return error

    def _end(self, status: Status, outputs: Sequence[str] = ()) -> None:
        self.is_live = False
        self._record = end_run(self.path, self.record, status, outputs)


@contextmanager
def new_run(out: Path, kind: RunKind[P], *, force: bool = False) -> Iterator[RunFolder[P]]:
    """Make, lock and yield a new run folder.

    An old folder at ``out`` is moved aside first, and restored if the new run ends without checkpoint and result.
    OutputExistsError if ``out`` exists and ``force`` is False, ArtefactError if another process is training in ``out``.
    """
    check_new_run(out, force=force)
    out = output_target(with_a_name(out))
    with locked(out) if out.exists() else nullcontext():
        _put_aside(out)
        try:
            out.mkdir(parents=True)
        except FileExistsError:  # another process has just made the folder
            raise _in_use(out) from None
        except OSError:
            _settle(out)
            raise
        with locked(out):
            (out / _BEGUN).touch()
            try:
                with (
                    first_interrupt() as interrupted,
                    _failing(RunFolder(out, kind, interrupted)) as run,
                ):
                    yield run
            finally:
                if _is_dead(out):
                    shutil.rmtree(out, ignore_errors=True)
                _settle(out)


@contextmanager
def resumed_run(folder: Path, kind: RunKind[P]) -> Iterator[RunFolder[P]]:
    """Lock and yield the folder of an unfinished run; ArtefactError if done, damaged, another kind or in use."""
    folder = output_target(with_a_name(folder))
    kind.read_record(folder)
    with locked(folder):
        record = kind.read_record(folder)  # under the lock, the record cannot change
        if record.status == "done":
            raise ArtefactError(
                f"'{folder}' is finished and cannot be resumed. Choose an unfinished run."
            )
        drop_temporary(folder)
        try:
            with (
                first_interrupt() as interrupted,
                _failing(RunFolder(folder, kind, interrupted, record)) as run,
            ):
                yield run
        finally:
            _settle(folder)


def check_run_output(out: Path, *, force: bool) -> None:
    """Raise OutputExistsError unless ``out`` is free for training, or holds an unfinished run; ``force`` replaces."""
    with suppress(ArtefactError):  # without a run, or damaged
        if read_run(out).status != "done":
            return
        shutil.rmtree(
            out / "checkpoints", ignore_errors=True
        )  # left by a run killed after the last record
    check_new_run(out, force=force)


def check_new_run(out: Path, *, force: bool) -> None:
    """Raise OutputExistsError unless ``out`` is missing, empty, or left by a run killed at the start, or ``force``."""
    target = output_target(with_a_name(out))
    if not _is_beginning(target) or (_aside(target).exists() and not force):
        check_output(out, force=force)


@contextmanager
def _failing(run: RunFolder[P]) -> Iterator[RunFolder[P]]:
    try:
        yield run
    except BaseException as error:
        if not run.is_live:
            raise
        explained = run.fail(error)
        if explained is error:
            raise
        raise explained from None


@contextmanager
def locked(folder: Path, use: str = "trained") -> Iterator[None]:
    """Lock an existing folder in this block; ArtefactError, naming the ``use``, if a process holds the lock."""
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise _in_use(folder, use) from None
        if not os.path.exists(folder) or not os.path.samestat(os.fstat(handle), os.stat(folder)):
            raise _in_use(folder, use)  # another process has just replaced the folder
        yield
    finally:
        os.close(handle)


def _in_use(folder: Path, use: str = "trained") -> ArtefactError:
    return ArtefactError(
        f"'{folder}' is being {use} by another process; wait, or stop the process."
    )


def _aside(out: Path) -> Path:
    """Return the path that holds a replaced folder until the new run has a checkpoint."""
    return out.with_name(f".{out.name}.replaced-by-wordcraft-kg")


def _put_aside(out: Path) -> None:
    """Move ``out`` aside; remove a run killed before its first record, and a replacement without checkpoint."""
    if not out.exists():
        return
    if _is_beginning(out) or (_aside(out).exists() and _is_dead(out)):
        shutil.rmtree(out)
        return
    shutil.rmtree(_aside(out), ignore_errors=True)
    os.rename(out, _aside(out))


def _settle(out: Path) -> None:
    """Remove the replaced folder if the new run is done or resumable, else restore it."""
    if not _aside(out).exists():
        return
    if out.exists() and not _is_dead(out):
        shutil.rmtree(_aside(out), ignore_errors=True)
    else:
        shutil.rmtree(out, ignore_errors=True)
        os.rename(_aside(out), out)


def _is_beginning(folder: Path) -> bool:
    if not folder.is_dir() or (folder / RUN_FILE).exists():
        return False
    return (folder / _BEGUN).exists() or has_only_temporary(folder)


def _is_dead(folder: Path) -> bool:
    with suppress(ArtefactError):
        if read_run(folder).status == "done":
            return False
    return not any((folder / "checkpoints").glob("*.json"))
