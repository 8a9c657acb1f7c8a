"""Steps shared by all trainings: begin or resume a run, train, finish; for one seed or several."""

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from wordcraft_kg.base.errors import ArtefactError, ConfigError, OutputExistsError
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.runs.checkpoints import Checkpoint
from wordcraft_kg.runs.config_file import CONFIG_FILE, RunConfig, moved
from wordcraft_kg.runs.files import RunFiles
from wordcraft_kg.runs.folder import (
    Progress,
    RunFolder,
    RunKind,
    check_new_run,
    new_run,
    resumed_run,
)
from wordcraft_kg.runs.record import RUN_FILE, RunRecord, read_run
from wordcraft_kg.runs.trackers import Log, Tracker, checked_trackers, names_of, tracking

_SHOWN_BY_TQDM = ("epoch", "seconds", "steps_per_second")
C = TypeVar("C", bound=RunConfig)
P = TypeVar("P")
T = TypeVar("T")


class Training(ABC, Generic[C, P, T]):
    """Base class for trainers: one training, with settings ``C``, checkpoint progress ``P`` and outcome ``T`` (types).

    :func:`train` calls the methods in definition order; for a resumed run, without :meth:`prepare` and :meth:`begin`.
    ``decided`` names the settings that the training chooses if None; ``config`` includes the chosen values.
    """

    kind: ClassVar[RunKind[Any]]
    config_type: ClassVar[type[RunConfig]]
    decided: ClassVar[tuple[str, ...]] = ()

    def __init__(self, config: C, opened: OpenedGraph):
        self.config, self.opened = config, opened

    @classmethod
    def input_hashes(cls, config: C) -> Mapping[str, str | None]:
        """Return the hash of each input except the graph, by setting name."""
        return {}

    def prepare(self) -> None:
        """Check inputs and do slow work before a new run folder is made."""

    @abstractmethod
    def begin(self, run: RunFolder[P], report: Progress | None) -> Mapping[str, Any]:
        """Write the files that a run keeps from the start; return arguments of :meth:`RunFolder.begin`."""

    def restored(self, run: RunFolder[P]) -> Checkpoint[P] | None:
        """Return the last checkpoint of a resumed run; None if the trainer saves finished parts instead of epochs."""
        return run.checkpoints.load()

    @abstractmethod
    def fit(
        self, run: RunFolder[P], report: Progress | None, log: Log, checkpoint: Checkpoint[P] | None
    ) -> T:
        """Train to the end or the first Ctrl-C; unless ``run.is_live``, restore, and call ``run.resume(config)``."""

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
    """Train into a run folder, or resume an interrupted run with the same settings and data; return the outcome.

    Args:
        trainer: trainer class.
        config: all settings.
        out: run folder. Default: :meth:`RunConfig.default_folder`.
        force: train anew and replace the folder.
        keep: whether to return the outcome of a finished run with the same settings and data, or a function that
            decides this for a folder.
        trackers: metric trackers, by name or as objects.
        progress: progress callback; True shows a bar.

    Raises:
        OutputExistsError: if the folder holds other files or a finished run, and ``force`` is False.
        ConfigError: if an unfinished run has other settings or data, or the settings do not fit the graph or machine.
        MissingExtraError: if a tracker's library is not installed.
        GraphMismatchError: if an input belongs to another graph.
        ArtefactError: if an interrupted run is damaged, or another process is training in the folder.
        TrainingError: if the loss becomes infinite or not a number.
    """
    opened = open_graph(config.graph)
    folder = config.default_folder(opened.graph.name) if out is None else Path(out)
    trackers = checked_trackers(trackers)
    record = None if force else _earlier(folder, trainer.kind)
    if record is not None and (
        record.status != "done" or (keep(folder) if callable(keep) else keep)
    ):
        files = RunFiles(folder, record)
        recorded = _checked_settings(files, config, opened, trainer)
        if record.status == "done":
            return trainer.outcome(files)
        if trainer.kind.checkpoints(folder).records():
            return _resume(trainer(recorded, opened), folder, trackers, progress)
        force = True  # killed before the first checkpoint
    check_new_run(folder, force=force)
    training = trainer(config, opened)
    training.prepare()
    kind = trainer.kind
    with shown(progress, kind.name, kind.unit) as report, new_run(folder, kind, force=force) as run:
        begun = {"inputs": {}, **training.begin(run, report)}
        inputs = {"graph": opened.graph.hash, "split": opened.split.hash, **begun.pop("inputs")}
        run.begin(training.config, inputs=inputs, trackers=names_of(trackers), **begun)
        with tracking(run, trackers, training.config.values()) as log:
            return training.fit(run, report, log, None)


def _earlier(folder: Path, kind: RunKind[Any]) -> RunRecord | None:
    with suppress(ArtefactError):
        record = read_run(folder)
        if record.kind in kind.commands:
            if record.status == "done":
                kind.checkpoints(folder).drop()  # left by a run killed after the last record
            return record
    return None


def _resume(
    training: Training[C, P, T],
    folder: Path,
    trackers: Iterable[Tracker | str],
    progress: Progress | bool | None,
) -> T:
    kind = training.kind
    with shown(progress, kind.name, kind.unit) as report, resumed_run(folder, kind) as run:
        checkpoint = training.restored(run)
        everywhere = checked_trackers([*run.record.trackers, *trackers])
        start = 0 if checkpoint is None else checkpoint.number
        with tracking(run, everywhere, training.config.values(), start) as log:
            return training.fit(run, report, log, checkpoint)


def _checked_settings(
    files: RunFiles, config: C, opened: OpenedGraph, trainer: type[Training[C, P, T]]
) -> C:
    files.bytes(CONFIG_FILE)
    recorded: C = trainer.config_type.read(files.folder)  # type: ignore[assignment]
    if recorded.command != config.command:
        raise ConfigError(
            f"'{files.folder}' was written by {recorded.command}, not {config.command}. {_ADVICE}"
        )
    given = trainer.input_hashes(config)
    for name, expected in {"graph": opened.graph.hash, "split": opened.split.hash, **given}.items():
        if files.run.inputs.get(name) != expected:
            raise ConfigError(f"'{files.folder}' was trained with another {name}. {_ADVICE}")
    old, new = (moved(settings.values(), os.path.realpath) for settings in (recorded, config))
    for name in dict.fromkeys([*new, *old]):
        is_open = name not in new and name in trainer.decided
        if name != "graph" and name not in given and not is_open and old.get(name) != new.get(name):
            raise ConfigError(
                f"'{files.folder}' was trained with `{name}` {old.get(name)}, and this command has {new.get(name)}. "
                f"{_ADVICE}"
            )
    paths = {name: getattr(config, name) for name in given if hasattr(config, name)}
    return replace(recorded, graph=config.graph, **paths)


_ADVICE = "Choose another `out`, or train again with `force`."


def train_seeds(
    trainer: type[Training[C, P, T]],
    configs: Mapping[int, C],
    parent: Path,
    *,
    force: bool = False,
    trackers: Iterable[Tracker | str] = (),
    progress: Callable[[int], Progress | bool | None] = lambda seed: None,
) -> Iterator[tuple[int, T]]:
    """Train once per seed, in the run folders ``parent/seed-N``; keep finished runs and resume interrupted runs.

    ``configs`` are the settings by seed; ``progress`` returns the progress callback for a seed; the other arguments and
    the errors are those of :func:`train`.

    Yields:
        Each seed with the outcome.

    OutputExistsError if ``parent`` is a run.
    """
    if (parent / RUN_FILE).exists():
        raise OutputExistsError(
            f"'{parent}' is a single run; several seeds need a folder for all runs. Choose another `out`."
        )
    trackers = list(trackers)
    for seed, config in configs.items():
        folder = parent / f"seed-{seed}"
        yield (
            seed,
            train(
                trainer,
                config,
                folder,
                force=force,
                keep=True,
                trackers=trackers,
                progress=progress(seed),
            ),
        )


@contextmanager
def shown(progress: Progress | bool | None, name: str, unit: str) -> Iterator[Progress | None]:
    """Yield the given progress callback; for True, a callback for a progress bar in a terminal or notebook."""
    if progress is not True:
        yield progress or None
        return
    from tqdm.auto import tqdm

    with tqdm(desc=name, unit=unit, unit_scale=unit == "step") as bar:

        def show(done: int, total: int, figures: dict[str, float]) -> None:
            bar.total = total
            shown = {
                name: f"{value:.4g}"
                for name, value in figures.items()
                if name not in _SHOWN_BY_TQDM
            }
            bar.set_postfix(shown, refresh=False)
            bar.update(done - bar.n)

        yield show
