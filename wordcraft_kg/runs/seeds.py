"""Several seeds of one training: a folder with a run for each, ``seed-0``, ``seed-1``, ..."""

import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from wordcraft_kg.base.errors import ConfigError, OutputExistsError
from wordcraft_kg.runs.config_file import moved
from wordcraft_kg.runs.folder import RunKind
from wordcraft_kg.runs.record import RUN_FILE, RunRecord

_SEED = re.compile(r"seed-(\d+)")
C = TypeVar("C")
T = TypeVar("T")


def run_folders(path: Path) -> list[Path]:
    """Return the runs of a folder of seeds by ascending seed; any other path is returned alone, as a run would be."""
    if (path / RUN_FILE).exists() or not path.is_dir():
        return [path]
    seeds = {int(match[1]): run for run in path.iterdir() if (match := _SEED.fullmatch(run.name))}
    return [seeds[seed] for seed in sorted(seeds)] or [path]


def run_name(folder: Path) -> str:
    """Return what reports call a run: its folder's name, for a seed after the name of the folder of seeds."""
    folder = folder.resolve()
    return f"{folder.parent.name}-{folder.name}" if _SEED.fullmatch(folder.name) else folder.name


@dataclass(frozen=True)
class SeededTraining(Generic[C, T]):
    """How one trainer begins, continues and reads a run; ``C`` are its settings, ``T`` is the outcome.

    Attributes:
        kind: kind of its runs.
        inputs: hashes of the training data, by name, that a run which is continued or kept must have begun with.
        train: trains into a folder, replacing it if the flag is set.
        resume: resumes the run of a folder.
        finished: reads the outcome of a run that is done.
        settings: reads the settings of a run.
        values: names the settings to compare; those whose names are in ``inputs`` are judged by them instead.
    """

    kind: RunKind[Any]
    inputs: Mapping[str, str | None]
    train: Callable[[C, Path, bool], T]
    resume: Callable[[Path], T]
    finished: Callable[[Path, RunRecord], T]
    settings: Callable[[Path, RunRecord], C]
    values: Callable[[C], Mapping[str, Any]]


def train_seeds(
    parent: Path, configs: Mapping[int, C], training: SeededTraining[C, T], *, force: bool = False
) -> Iterator[tuple[int, T]]:
    """Train each seed in a folder of its own; one that is done is kept, and an interrupted one is resumed.

    Args:
        parent: folder of the folders.
        configs: settings by seed.
        training: the trainer.
        force: train all again.

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
    for seed, config in configs.items():
        folder = parent / f"seed-{seed}"
        yield seed, _train_seed(folder, config, training, force)


def _train_seed(folder: Path, config: C, training: SeededTraining[C, T], force: bool) -> T:
    if force or not (folder / RUN_FILE).exists():  # without a record it was killed before it had begun
        return training.train(config, folder, force)
    record = training.kind.read_record(folder)
    _check_same(folder, config, record, training)
    if record.status == "done":
        return training.finished(folder, record)
    if training.kind.checkpoints(folder).records():
        return training.resume(folder)
    return training.train(config, folder, True)  # it was killed before its first checkpoint


def _check_same(folder: Path, config: C, record: RunRecord, training: SeededTraining[C, T]) -> None:
    advice = "Choose another `out`, or train all seeds again with `force`."
    for name, wanted in training.inputs.items():
        if record.inputs.get(name) != wanted:
            raise ConfigError(f"'{folder}' was trained with another {name}. {advice}")
    wanted_values, found_values = (
        moved(training.values(settings), os.path.realpath) for settings in (config, training.settings(folder, record))
    )
    for name in (name for name in wanted_values if name not in training.inputs):
        found, wanted = found_values.get(name), wanted_values.get(name)
        if found != wanted:
            raise ConfigError(f"'{folder}' was trained with `{name}` {found}, and this command has {wanted}. {advice}")
