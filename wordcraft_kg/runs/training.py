"""The course of every training: begin a run or go on with it, train, finish; for one seed or several."""

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
from wordcraft_kg.runs.folder import Progress, RunFolder, RunKind, check_new_run, new_run, resumed_run
from wordcraft_kg.runs.record import RUN_FILE, RunRecord, read_run
from wordcraft_kg.runs.trackers import Log, Tracker, checked_trackers, names_of, tracking

TOLD_BY_THE_BAR = ("epoch", "seconds", "steps_per_second")
C = TypeVar("C", bound=RunConfig)
P = TypeVar("P")
T = TypeVar("T")


class Training(ABC, Generic[C, P, T]):
    """One training of a trainer; ``C`` are its settings, ``P`` the progress of a checkpoint, ``T`` the outcome.

    A trainer is a subclass. :func:`train` calls its methods in the order in which they stand here; when it goes on with
    a run, it leaves out :meth:`prepare` and :meth:`begin`.

    Attributes:
        kind: kind of its runs.
        config_type: type of its settings.
        decided: names of settings that, if they are None, the training decides for itself.
        config: settings; those that are decided replace the given ones.
        opened: graph and split.
    """

    kind: ClassVar[RunKind[Any]]
    config_type: ClassVar[type[RunConfig]]
    decided: ClassVar[tuple[str, ...]] = ()

    def __init__(self, config: C, opened: OpenedGraph):
        """Take settings and graph; subclasses refuse what does not fit the graph or the machine."""
        self.config, self.opened = config, opened

    @classmethod
    def given(cls, config: C) -> Mapping[str, str | None]:
        """Return hashes of the inputs, other than the graph, that settings of the same name point to."""
        return {}

    def prepare(self) -> None:
        """Do what may be refused, or takes long, before the folder of a new run is made."""

    @abstractmethod
    def begin(self, run: RunFolder[P], report: Progress | None) -> Mapping[str, Any]:
        """Write the first files of a new run; return arguments of :meth:`RunFolder.begin`, such as ``inputs``."""

    def restored(self, run: RunFolder[P]) -> Checkpoint[P] | None:
        """Return the checkpoint that a run goes on from; None for a training that keeps finished parts instead."""
        return run.checkpoints.load()

    @abstractmethod
    def go(self, run: RunFolder[P], report: Progress | None, log: Log, checkpoint: Checkpoint[P] | None) -> T:
        """Train to the end or to the first Ctrl-C, from a checkpoint if there is one, and return the outcome.

        If ``run`` is not live yet, it calls ``run.go_on(config)`` as soon as all is restored.
        """

    @classmethod
    @abstractmethod
    def outcome(cls, files: RunFiles) -> T:
        """Return the outcome of a run that is done."""


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
    """Train into a folder; if it holds an interrupted run of the same settings and data, go on with that one.

    Args:
        trainer: the trainer.
        config: all settings.
        out: the folder. Default: that of the settings.
        force: train anew and replace the folder if it exists.
        keep: return the outcome of a finished run of the same settings and data instead of refusing the folder, always
            or if this is true of the folder.
        trackers: where figures go too, by name or as objects.
        progress: called with what is done, the total and figures; True shows a bar.

    Raises:
        OutputExistsError: if the folder holds something else, or a finished run, and ``force`` is False.
        ConfigError: if it holds an unfinished run of other settings or data, naming them; or if the settings do not
            fit the graph or the machine.
        MissingExtraError: if the library of a tracker is not installed.
        GraphMismatchError: if an input belongs to another graph.
        ArtefactError: if a file of an interrupted run is damaged, or another process is training there.
        TrainingError: if the loss is no longer finite.
    """
    opened = open_graph(config.graph)
    folder = config.default_folder(opened.graph.name) if out is None else Path(out)
    trackers = checked_trackers(trackers)
    record = None if force else _earlier(folder, trainer.kind)
    if record is not None and (record.status != "done" or (keep(folder) if callable(keep) else keep)):
        files = RunFiles(folder, record)
        found = _same(files, config, opened, trainer)
        if record.status == "done":
            return trainer.outcome(files)
        if trainer.kind.checkpoints(folder).records():
            return _go_on(trainer(found, opened), folder, trackers, progress)
        force = True  # it was killed before its first checkpoint
    check_new_run(folder, force=force)
    training = trainer(config, opened)
    training.prepare()
    kind = trainer.kind
    with shown(progress, kind.name, kind.unit) as report, new_run(folder, kind, force=force) as run:
        begun = {"inputs": {}, **training.begin(run, report)}
        inputs = {"graph": opened.graph.hash, "split": opened.split.hash, **begun.pop("inputs")}
        run.begin(training.config, inputs=inputs, trackers=names_of(trackers), **begun)
        with tracking(run, trackers, training.config.values()) as log:
            return training.go(run, report, log, None)


def _earlier(folder: Path, kind: RunKind[Any]) -> RunRecord | None:
    """Return the record of a run of a kind; None if there is something else or nothing."""
    with suppress(ArtefactError):
        record = read_run(folder)
        return record if record.kind in kind.commands else None
    return None


def _go_on(
    training: Training[C, P, T], folder: Path, trackers: Iterable[Tracker | str], progress: Progress | bool | None
) -> T:
    kind = training.kind
    with shown(progress, kind.name, kind.unit) as report, resumed_run(folder, kind) as run:
        checkpoint = training.restored(run)
        everywhere = checked_trackers([*run.record.trackers, *trackers])
        start = 0 if checkpoint is None else checkpoint.number
        with tracking(run, everywhere, training.config.values(), start) as log:
            return training.go(run, report, log, checkpoint)


def _same(files: RunFiles, config: C, opened: OpenedGraph, trainer: type[Training[C, P, T]]) -> C:
    """Return the settings of a run, with its inputs where they are now.

    Raises:
        ConfigError: if they are not those asked for, or its inputs have changed.
    """
    files.bytes(CONFIG_FILE)
    found: C = trainer.config_type.read(files.folder)  # type: ignore[assignment]
    if found.command != config.command:
        raise ConfigError(f"'{files.folder}' was written by {found.command}, not {config.command}. {_ADVICE}")
    given = trainer.given(config)
    for name, expected in {"graph": opened.graph.hash, "split": opened.split.hash, **given}.items():
        if files.run.inputs.get(name) != expected:
            raise ConfigError(f"'{files.folder}' was trained with another {name}. {_ADVICE}")
    there, asked = (moved(one.values(), os.path.realpath) for one in (found, config))
    for name in dict.fromkeys([*asked, *there]):
        is_open = name not in asked and name in trainer.decided
        if name != "graph" and name not in given and not is_open and there.get(name) != asked.get(name):
            raise ConfigError(
                f"'{files.folder}' was trained with `{name}` {there.get(name)}, and this command has "
                f"{asked.get(name)}. {_ADVICE}"
            )
    return replace(
        found, graph=config.graph, **{name: getattr(config, name) for name in given if hasattr(config, name)}
    )


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
    """Train each seed in a folder of its own; keep one that is done, and go on with an interrupted one.

    Args:
        trainer: the trainer.
        configs: settings by seed.
        parent: folder of the folders.
        force: train all again.
        trackers: as for :func:`train`.
        progress: returns that of :func:`train` for a seed.

    Yields:
        Each seed and its outcome.

    Raises:
        OutputExistsError: if ``parent`` is itself a run.
        ConfigError: if a seed was trained with other settings or on other data.
    """
    if (parent / RUN_FILE).exists():
        raise OutputExistsError(
            f"'{parent}' is a single run, and seeds need a folder around them. Choose another `out`."
        )
    trackers = list(trackers)
    for seed, config in configs.items():
        folder = parent / f"seed-{seed}"
        yield seed, train(trainer, config, folder, force=force, keep=True, trackers=trackers, progress=progress(seed))


@contextmanager
def shown(progress: Progress | bool | None, what: str, unit: str) -> Iterator[Progress | None]:
    """Yield the function that reports progress: the caller's own, a bar in a terminal or notebook for True, or None."""
    if progress is not True:
        yield progress or None
        return
    from tqdm.auto import tqdm

    with tqdm(desc=what, unit=unit, unit_scale=unit == "step") as bar:

        def show(done: int, total: int, figures: dict[str, float]) -> None:
            bar.total = total
            told = {name: f"{value:.4g}" for name, value in figures.items() if name not in TOLD_BY_THE_BAR}
            bar.set_postfix(told, refresh=False)
            bar.update(done - bar.n)

        yield show
