"""Steps shared by all trainings: begin or resume a run, train, finish; for one seed or several.

Read :func:`train` first. A trainer is a subclass of :class:`Training`.
"""

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.graphs.graph_folder import OpenedGraph, open_graph
from wordcraft_kg.runs.checkpoints import Checkpoint
from wordcraft_kg.runs.config_file import CONFIG_FILE, RunConfig, moved
from wordcraft_kg.runs.progress import ProgressBar
from wordcraft_kg.runs.record import RunFiles, RunRecord, read_run
from wordcraft_kg.runs.run_folder import (
    Progress,
    RunFolder,
    RunKind,
    check_new_run,
    new_run,
    resumed_run,
)
from wordcraft_kg.runs.trackers import Log, Tracker, check_trackers, tracking

_ADVICE = "Choose another `out`, or train again with `force`."
C = TypeVar("C", bound=RunConfig)
P = TypeVar("P")
T = TypeVar("T")


class Training(ABC, Generic[C, P, T]):
    """Base class for trainers: an object is one training.

    Types are the settings ``C``, the progress record of a checkpoint ``P`` and the outcome ``T``.
    :func:`train` calls the methods in the order below; for a resumed run, without :meth:`prepare`
    and :meth:`begin`.

    Attributes:
        kind: constants of all runs of this trainer.
        config_type: type of the settings.
        decided: names of the settings that the training chooses if they are None.
        config: the settings; after :meth:`begin`, with the chosen values.
        opened: the recipe graph and its split.
    """

    kind: ClassVar[RunKind[Any]]
    config_type: ClassVar[type[RunConfig]]
    decided: ClassVar[tuple[str, ...]] = ()

    def __init__(self, config: C, opened: OpenedGraph):
        self.config = config
        self.opened = opened

    @classmethod
    def of(cls, config: C, opened: OpenedGraph) -> "Training[C, Any, Any]":
        """Return a trainer for the settings and the graph; a subclass may choose another class."""
        return cls(config, opened)

    @classmethod
    def settled(cls, config: C, opened: OpenedGraph) -> C:
        """Return the settings with the values that the graph decides; by default all are given."""
        return config

    @classmethod
    def input_hashes(cls, config: C) -> Mapping[str, str | None]:
        """Return the hash of each input except the graph, by setting; None without the input."""
        return {}

    def prepare(self) -> None:
        """Check inputs and do slow work before a new run folder is made."""

    @abstractmethod
    def begin(self, run: RunFolder[P], report: Progress | None) -> Mapping[str, Any]:
        """Write the files that a run keeps from the start.

        Args:
            run: the new run folder.
            report: progress callback; None reports nothing.

        Returns:
            Arguments of :meth:`RunFolder.begin`, by name.
        """

    def restored(self, run: RunFolder[P]) -> Checkpoint[P] | None:
        """Return the last checkpoint of a resumed run.

        None if the trainer saves finished parts, such as folds, instead of epochs or steps.

        Raises:
            ArtefactError: if the run has no checkpoint, or all are damaged.
        """
        return run.checkpoints.load()

    @abstractmethod
    def fit(
        self,
        run: RunFolder[P],
        report: Progress | None,
        log: Log,
        checkpoint: Checkpoint[P] | None,
    ) -> T:
        """Train to the end or the first Ctrl-C.

        Args:
            run: the run folder. Unless ``run.is_live``, this is a resumed run: restore the
                checkpoint, then call ``run.resume(config)``, so that a damaged checkpoint leaves
                the record as it is.
            report: progress callback; None reports nothing.
            log: sends metrics to the trackers.
            checkpoint: state to go on from; None for a new run.

        Raises:
            KeyboardInterrupt: after Ctrl-C, when a checkpoint is saved.
            TrainingError: if the loss becomes infinite or not a number.
        """

    @classmethod
    @abstractmethod
    def outcome(cls, files: RunFiles) -> T:
        """Read the outcome of a finished run from the run's files."""


def train(
    trainer: type[Training[C, P, T]],
    config: C,
    out: str | Path | None = None,
    *,
    force: bool = False,
    keep: bool | Callable[[Path], bool] = False,
    trackers: Iterable[Tracker | str] = (),
    progress: Progress | bool | None = None,
) -> T:
    """Train into a run folder, or resume an interrupted run with the same settings and data.

    Args:
        trainer: trainer class.
        config: all settings.
        out: run folder. None takes :meth:`RunConfig.default_folder`.
        force: train anew and replace the folder.
        keep: whether to return the outcome of a finished run with the same settings and data, or a
            function that decides this for a folder.
        trackers: metric trackers, by name or as objects.
        progress: progress callback; True shows a bar, None or False nothing.

    Returns:
        The outcome of the training.

    Raises:
        OutputExistsError: if the folder holds other files or a finished run, and ``force`` is
            False.
        ConfigError: if an unfinished run has other settings or data, or the settings do not fit the
            graph or machine.
        MissingExtraError: if a tracker's library is not installed.
        GraphMismatchError: if an input belongs to another graph.
        ArtefactError: if a graph folder or an earlier run is damaged, or another process is
            training in the folder.
        TrainingError: if the loss becomes infinite or not a number.
        RecipeFileError: if there is no such graph or book, or the book cannot be read.
        LeakError: if an agent's scorer has seen all recipes of a train task's plan.
        KeyboardInterrupt: after Ctrl-C; the message names the checkpoint from which the same
            command goes on, if one is saved.
    """
    # What can be wrong is checked before the first file is written: the graph, the trackers, then
    # an earlier run in the folder.
    opened = open_graph(config.graph)
    config = trainer.settled(config, opened)
    config = replace(config, graph=opened.source)
    folder = config.default_folder(opened.graph.name) if out is None else Path(out)
    trackers = list(trackers)
    names = check_trackers(trackers)
    kind = trainer.kind
    record = None if force else _earlier(folder, kind)
    if record is not None:
        is_done = record.status == "done"
        if not is_done or (keep(folder) if callable(keep) else keep):
            files = RunFiles(folder, record)
            recorded = _checked_settings(files, config, opened, trainer)
            if is_done:
                return trainer.outcome(files)
            if kind.checkpoints(folder).records():
                training = trainer.of(recorded, opened)
                resumed = resumed_run(folder, training.kind)
                with shown(progress, training.kind) as report, resumed as run:
                    checkpoint = training.restored(run)
                    # The trackers of the run so far go on, even if they are not named again.
                    earlier = run.record.trackers
                    trackers = [*earlier, *(one for one in trackers if one not in earlier)]
                    check_trackers(earlier)
                    start = 0 if checkpoint is None else checkpoint.number
                    with tracking(run, trackers, start) as log:
                        return training.fit(run, report, log, checkpoint)
            # Killed before the first checkpoint: nothing is lost.
            force = True
    check_new_run(folder, force=force)
    training = trainer.of(config, opened)
    # Preparing may take long or fail, so an old folder is still in its place.
    training.prepare()
    with shown(progress, kind) as report, new_run(folder, kind, force=force) as run:
        begun = {"inputs": {}, **training.begin(run, report)}
        # Hashes of graph and split belong to every run; a trainer adds its own inputs.
        inputs = {"graph": opened.graph.hash, "split": opened.split.hash, **begun.pop("inputs")}
        run.begin(training.config, inputs=inputs, trackers=names, **begun)
        with tracking(run, trackers) as log:
            return training.fit(run, report, log, None)


def _earlier(folder: Path, kind: RunKind[Any]) -> RunRecord | None:
    """Return the record of an earlier run of the same kind in a folder, if there is one."""
    with suppress(ArtefactError):
        record = read_run(folder)
        if record.kind in kind.commands:
            if record.status == "done":
                # Left by a run killed after the last record.
                kind.checkpoints(folder).drop()
            return record
    return None


def _checked_settings(
    files: RunFiles,
    config: C,
    opened: OpenedGraph,
    trainer: type[Training[C, P, T]],
) -> C:
    """Return an earlier run's settings, with the paths of ``config``, if all others are equal."""
    # Read for the check of its hash alone.
    files.bytes(CONFIG_FILE)
    recorded: C = trainer.config_type.read(files.folder)  # type: ignore[assignment]
    if recorded.command != config.command:
        raise ConfigError(
            f"'{files.folder}' was written by {recorded.command}, not {config.command}. {_ADVICE}"
        )
    input_hashes = trainer.input_hashes(config)
    hashes = {"graph": opened.graph.hash, "split": opened.split.hash, **input_hashes}
    for name, expected in hashes.items():
        if files.run.inputs.get(name) != expected:
            raise ConfigError(f"'{files.folder}' was trained with another {name}. {_ADVICE}")
    # Inputs may have moved, since their hashes decide; other paths are compared in full.
    old = moved(recorded.values(), os.path.realpath)
    new = moved(config.values(), os.path.realpath)
    for name in dict.fromkeys([*new, *old]):
        is_input = name == "graph" or name in input_hashes
        is_decided = name not in new and name in trainer.decided
        if not is_input and not is_decided and old.get(name) != new.get(name):
            raise ConfigError(
                f"'{files.folder}' was trained with `{name}` {old.get(name)}, "
                f"and this command has {new.get(name)}. {_ADVICE}"
            )
    # Inputs with equal hashes may have moved: the recorded settings get their current paths.
    paths = {name: getattr(config, name) for name in input_hashes if hasattr(config, name)}
    return replace(recorded, graph=config.graph, **paths)


@contextmanager
def shown(progress: Progress | bool | None, kind: RunKind[Any]) -> Iterator[Progress | None]:
    """Yield a progress callback.

    Args:
        progress: a callback; True for a progress bar in a terminal or notebook, or lines elsewhere;
            None or False for none.
        kind: constants of the trainer, with the label of the bar and its unit.
    """
    if progress is not True:
        yield progress or None
        return
    bar = ProgressBar(kind.name, unit=kind.unit)
    try:
        yield bar
    finally:
        bar.close()
