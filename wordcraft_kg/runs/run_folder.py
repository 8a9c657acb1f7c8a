"""The run folder during training: begin, resume, interrupt, finish, fail, replace an earlier one.

An earlier folder is moved aside and lost only when the new run has a checkpoint or a result, so
that an error in the first minute costs nothing. A lock keeps a second process out. Ctrl-C is a
request to save and stop.
"""

import logging
import os
import shutil
import signal
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
    in_use,
    locked as locked,
    made_folder,
    output_target,
    sha256_of,
    what_is,
    with_a_name,
    write_atomically,
)
from wordcraft_kg.base.errors import ArtefactError, TrainingError, reason
from wordcraft_kg.runs.checkpoints import KEPT, Checkpoints
from wordcraft_kg.runs.config_file import CONFIG_FILE, RunConfig
from wordcraft_kg.runs.record import (
    RUN_FILE,
    RunRecord,
    Status,
    end_run,
    read_run,
    resume_run,
    start_run,
)


@contextmanager
def first_interrupt(action: Callable[[], None] | None = None) -> Iterator[threading.Event]:
    """Yield an event that the first Ctrl-C sets; the second Ctrl-C stops at once.

    The training looks at the event after each step or epoch, where its state is whole.

    Args:
        action: called by the first Ctrl-C, for a wait that looks at no event.
    """
    requested = threading.Event()
    before = signal.getsignal(signal.SIGINT)

    def request(signum: int, frame: Any) -> None:
        requested.set()
        if action is not None:
            action()
        signal.signal(signal.SIGINT, before)

    with _handling(signal.SIGINT, request):
        yield requested


@contextmanager
def sigterm_as_interrupt() -> Iterator[None]:
    """Treat SIGTERM (the stop signal of cluster and service managers) as Ctrl-C in this block."""

    def interrupt(signum: int, frame: Any) -> None:
        signal.raise_signal(signal.SIGINT)

    with _handling(signal.SIGTERM, interrupt):
        yield


@contextmanager
def _handling(number: signal.Signals, handler: Callable[[int, Any], None]) -> Iterator[None]:
    """Handle a signal in this block; only the main thread can, others change nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)


_BEGUN = ".begun-by-wordcraft-kg"
"""Marks a new folder until the first record; after an earlier kill, the folder can be removed."""
P = TypeVar("P")
Progress = Callable[[int, int, dict[str, float]], None]
"""Progress callback: takes finished epochs or steps, their total number, and metrics by name."""


@dataclass(frozen=True)
class RunKind(Generic[P]):
    """Constants of all runs with the same trainer class.

    Attributes:
        commands: commands that start such a run; the ``kind`` in ``run.json`` is one of them.
        name: label of the progress bar.
        unit: unit of progress, such as epoch or step.
        progress: type of the progress record in a checkpoint.
        kept: number of checkpoints to keep; None keeps all, of parts that a run needs to its end.
    """

    commands: tuple[str, ...]
    name: str
    unit: str
    progress: type[P]
    kept: int | None = KEPT

    def read_record(self, folder: Path) -> RunRecord:
        """Read the run record in a folder.

        Raises:
            ArtefactError: if it is missing or damaged, or the run has another kind.
        """
        expected = f"a run of {' or '.join(self.commands)}"
        record = read_run(folder, expected)
        if record.kind not in self.commands:
            raise ArtefactError(f"'{folder}' {what_is(folder)}; expected {expected}.")
        return record

    def checkpoints(self, folder: Path) -> Checkpoints[P]:
        """Return an object that saves and loads the checkpoints in a run folder."""
        return Checkpoints(folder, self.unit, self.progress, kept=self.kept)


class RunFolder(Generic[P]):
    """A locked run folder in which this process trains.

    Made by :func:`new_run` and :func:`resumed_run`.

    Attributes:
        path: the folder.
        kind: constants of its trainer.
        interrupted: set by the first Ctrl-C; the trainer then saves a checkpoint and stops.
        checkpoints: checkpoints of the run.
        is_live: whether this process has recorded the run as running.
    """

    def __init__(
        self,
        path: Path,
        kind: RunKind[P],
        interrupted: threading.Event,
        record: RunRecord | None = None,
    ):
        self.path = path
        self.kind = kind
        self.interrupted = interrupted
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

        Args:
            config: all settings.
            inputs: hashes of the training data, by name.
            files: files already in the folder that training never changes; their hashes are
                recorded.
            facts: optional fields of :class:`~wordcraft_kg.runs.record.RunRecord`.
        """
        # First the configuration, whose hash stands in the record.
        config.write(self.path)
        hashes = {name: sha256_of(self.path / name) for name in (CONFIG_FILE, *files)}
        settings = config.values()
        # A missing setting leaves the default of the record.
        facts |= {
            name: settings[name] for name in ("seed", "device", "threads") if name in settings
        }
        self._record = start_run(self.path, config.command, inputs={**inputs, **hashes}, **facts)
        # From here on the record tells that this folder is a run.
        (self.path / _BEGUN).unlink(missing_ok=True)
        self.is_live = True

    def resume(self, config: RunConfig) -> None:
        """Record an unfinished run as running again, with its inputs' current paths."""
        # Kernels of another torch may add in another order.
        began_with = self.record.versions.get("torch")
        installed = version("torch")
        if began_with != installed:
            logging.getLogger(__name__).warning(
                "the run began with torch %s and is resumed with %s: "
                "the result may differ in the last bits.",
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
        """Turn errors in this block, which come from a checkpoint, into one that names the run.

        Raises:
            ArtefactError: if the checkpoint does not fit the objects that it is restored into.
        """
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
                f"the checkpoint in '{self.path}' does not fit the run ({reason(error)}). "
                "Train again."
            ) from None

    def finish(self, outputs: Sequence[str], card: str) -> None:
        """Record the run as done, and remove all checkpoints.

        Args:
            outputs: names of all files that the training has written; their hashes are recorded.
            card: content of the model card, ``README.md``.
        """
        write_atomically(self.path / "README.md", card)
        # The outputs are on the disk before the record says so, and the checkpoints go after it: a
        # power failure at any point leaves a checkpoint or a complete result.
        for name in outputs:
            with (self.path / name).open("rb+") as file:
                os.fsync(file.fileno())
        self._end("done", outputs)
        self.checkpoints.drop()

    def fail(self, error: BaseException) -> BaseException:
        """Record the run as failed, or after Ctrl-C as interrupted.

        Returns:
            The error to raise: it names the last checkpoint, if there is one.
        """
        with suppress(OSError):  # the disk may be full
            self._end("interrupted" if isinstance(error, KeyboardInterrupt) else "failed")
        unit = self.kind.unit
        last = self.checkpoints.last
        # This process has written none, but one of an earlier process may be there.
        if last is None:
            last = next(iter(self.checkpoints.records()), None)
        if last is None:
            return error
        if isinstance(error, KeyboardInterrupt):
            return KeyboardInterrupt(
                f"interrupted; {unit} {last:,} is saved in '{self.path}'. Repeat the command to "
                "resume from there."
            )
        safe = f"The checkpoint of {unit} {last:,} is safe"
        if isinstance(error, TrainingError):
            return TrainingError(f"{error} {safe}, in '{self.path}'.")
        if isinstance(error, OSError):
            return ArtefactError(
                f"'{self.path}' cannot be written ({error.strerror or error}). {safe}; "
                "free some space, then repeat the command to resume from there."
            )
        return error

    def _end(self, status: Status, outputs: Sequence[str] = ()) -> None:
        self.is_live = False
        self._record = end_run(self.path, self.record, status, outputs)


@contextmanager
def new_run(
    out: Path,
    kind: RunKind[P],
    *,
    force: bool = False,
) -> Iterator[RunFolder[P]]:
    """Make, lock and yield a new run folder.

    An old folder at ``out`` is moved aside first, and restored if the new run ends with neither a
    checkpoint nor a result.

    Args:
        out: the folder.
        kind: constants of the trainer.
        force: whether to replace an existing ``out``.

    Raises:
        OutputExistsError: if ``out`` exists and ``force`` is False, or a link leads nowhere; with
            ``force``, for what :func:`~wordcraft_kg.base.artefacts.check_output` never replaces.
        ArtefactError: if another process is training in ``out``.
    """
    out = output_target(with_a_name(out))
    # Two locks: on the old folder while it is moved, then on the new one, which has the same name.
    with locked(out) if out.exists() else nullcontext(), made_folder(out.parent):
        # Under the lock: another process may have finished a run meanwhile.
        check_new_run(out, force=force)
        _put_aside(out)
        try:
            out.mkdir()
        except FileExistsError:  # another process has just made the folder
            raise in_use(out) from None
        except OSError:  # such as a full disk: the old folder comes back
            _settle(out)
            raise
        with locked(out):
            try:
                (out / _BEGUN).touch()
                with _in_training(out, kind) as run:
                    yield run
            finally:
                # A run that failed in its first minutes leaves nothing behind.
                if _is_dead(out):
                    shutil.rmtree(out, ignore_errors=True)
                _settle(out)


@contextmanager
def resumed_run(folder: Path, kind: RunKind[P]) -> Iterator[RunFolder[P]]:
    """Lock and yield the folder of an unfinished run.

    Raises:
        ArtefactError: if the run is done, damaged or of another kind, or another process is
            training in the folder.
        OutputExistsError: if the folder is a device, or a link that leads nowhere.
    """
    folder = output_target(with_a_name(folder))
    with locked(folder):
        # Under the lock, the record cannot change.
        record = kind.read_record(folder)
        if record.status == "done":
            raise ArtefactError(
                f"'{folder}' is finished and cannot be resumed. Choose an unfinished run."
            )
        # Half-written files of a killed process.
        drop_temporary(folder)
        try:
            with _in_training(folder, kind, record) as run:
                yield run
        finally:
            _settle(folder)


def check_new_run(out: Path, *, force: bool) -> None:
    """Check that a new run may use ``out``: missing, empty, or left by a run killed at the start.

    Raises:
        OutputExistsError: if it holds anything else and ``force`` is False, or anything that
            :func:`~wordcraft_kg.base.artefacts.check_output` never replaces.
    """
    target = output_target(with_a_name(out))
    if not _is_beginning(target) or (_aside(target).exists() and not force):
        check_output(out, force=force)


@contextmanager
def _in_training(
    path: Path, kind: RunKind[P], record: RunRecord | None = None
) -> Iterator[RunFolder[P]]:
    """Yield a run folder, and record the run as failed or interrupted if an error ends this block.

    Args:
        path: the folder, which this process has locked.
        kind: constants of the trainer.
        record: the run record of a resumed run.
    """
    with first_interrupt() as interrupted:
        run = RunFolder(path, kind, interrupted, record)
        try:
            yield run
        except BaseException as error:
            # Before the first record, and before a resumed run is restored, nothing has happened.
            if not run.is_live:
                raise
            explained = run.fail(error)
            if explained is error:
                raise
            raise explained from None


@contextmanager
def locked_folder(folder: Path, use: str) -> Iterator[None]:
    """Make a folder, and keep other processes from working there, see :func:`locked`.

    If the block fails before it has written anything, the folder disappears.
    """
    with made_folder(folder), locked(folder, use):
        yield


def _aside(out: Path) -> Path:
    """Return the path that holds a replaced folder until the new run has a checkpoint."""
    # A sibling: a rename on the same disk is atomic.
    return out.with_name(f".{out.name}.replaced-by-wordcraft-kg")


def _put_aside(out: Path) -> None:
    """Move ``out`` aside, or remove it if nothing in it is worth keeping.

    That is a run killed before its first record, or the replacement of a folder that still lies
    aside, without a checkpoint.
    """
    if not out.exists():
        return
    if _is_beginning(out) or (_aside(out).exists() and _is_dead(out)):
        shutil.rmtree(out)
    else:
        # An older folder aside was replaced by ``out``, which has a checkpoint or a result.
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
    """Return whether a folder was left by a run that was killed before its first record."""
    if not folder.is_dir() or (folder / RUN_FILE).exists():
        return False
    return (folder / _BEGUN).exists() or has_only_temporary(folder)


def _is_dead(folder: Path) -> bool:
    """Return whether a folder holds neither a result nor a checkpoint."""
    with suppress(ArtefactError):
        if read_run(folder).status == "done":
            return False
    return not any((folder / "checkpoints").glob("*.json"))
