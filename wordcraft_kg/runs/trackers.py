"""Trackers: where the figures of a training also go while it runs, beside the files of its folder.

All of them write files and send nothing. A tracker of your own is any object with two methods, see :class:`Tracker`.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from wordcraft_kg.base.errors import MissingExtraError
from wordcraft_kg.base.settings import one_of
from wordcraft_kg.runs.folder import RunFolder
from wordcraft_kg.runs.record import Status

Log = Callable[[int, Mapping[str, float | None]], None]
"""Takes the number of epochs or steps done, and figures by name; None stands for no value."""


class Tracker(Protocol):
    """Takes the figures of a training.

    Example:
        >>> class Printer:
        ...     def log(self, step, values):
        ...         print(step, sorted(values))
        ...
        ...     def close(self, status):
        ...         print(status)
        >>> config = LinksConfig("kitchen", ComplExConfig(dim=4, epochs=2))
        >>> trained = train_links(config, "models/tracked", trackers=[Printer()])
        1 ['loss', 'seconds']
        2 ['loss', 'seconds']
        done
    """

    def log(self, step: int, values: Mapping[str, float]) -> None:
        """Take figures by name, after a number of epochs or steps; numbers only grow, also over a resumed run."""
        ...

    def close(self, status: Status) -> None:
        """End: the training is ``done``, ``interrupted`` or ``failed``."""
        ...


class TensorBoard:
    """Event files in ``tensorboard/`` of the run's folder."""

    library = "torch.utils.tensorboard"

    def __init__(self, folder: Path, settings: Mapping[str, Any], step: int):
        """Continue from a step: figures of later ones are removed."""
        writer = import_module(self.library).SummaryWriter
        self._writer = writer(str(folder / "tensorboard"), purge_step=step or None)

    def log(self, step: int, values: Mapping[str, float]) -> None:  # noqa: D102 - of the protocol
        for name, value in values.items():
            self._writer.add_scalar(name, value, step)

    def close(self, status: Status) -> None:  # noqa: D102
        self._writer.close()


class WeightsAndBiases:
    """A run of Weights & Biases in ``wandb/`` of the run's folder, offline, with no record of the machine.

    ``wandb sync`` would upload it. A run that goes on is a run of its own there.
    """

    library = "wandb"

    def __init__(self, folder: Path, settings: Mapping[str, Any], step: int):
        """Begin a run."""
        wandb = import_module(self.library)
        private = wandb.Settings(
            console="off",
            disable_code=True,
            disable_git=True,
            disable_job_creation=True,
            host="",
            mode="offline",
            program="",
            root_dir=str(folder),
            silent=True,
            username="",
            x_disable_machine_info=True,
            x_disable_meta=True,
            x_disable_stats=True,
            x_save_requirements=False,
        )
        self._run = wandb.init(project=PROJECT, name=folder.name, config=dict(settings), settings=private)

    def log(self, step: int, values: Mapping[str, float]) -> None:  # noqa: D102
        self._run.log(dict(values), step=step)

    def close(self, status: Status) -> None:  # noqa: D102
        self._run.finish(exit_code=0 if status == "done" else 1)


class MLflow:
    """A run in ``mlflow.db`` beside the run's folder, shared by all runs there.

    A run that goes on is a run of its own there.
    """

    library = "mlflow"

    def __init__(self, folder: Path, settings: Mapping[str, Any], step: int):
        """Begin a run."""
        store = folder.resolve().parent
        # With a client nothing is global, and no tags with the user and the program are made up.
        self._client = import_module(self.library).MlflowClient(tracking_uri=f"sqlite:///{store / 'mlflow.db'}")
        found = self._client.get_experiment_by_name(PROJECT)
        experiment = found.experiment_id if found else self._client.create_experiment(PROJECT, store.as_uri())
        self._run = self._client.create_run(experiment, run_name=folder.name).info.run_id
        for name, value in settings.items():
            self._client.log_param(self._run, name, value)

    def log(self, step: int, values: Mapping[str, float]) -> None:  # noqa: D102
        for name, value in values.items():
            self._client.log_metric(self._run, name, value, step=step)

    def close(self, status: Status) -> None:  # noqa: D102
        known = {"done": "FINISHED", "interrupted": "KILLED", "failed": "FAILED"}
        self._client.set_terminated(self._run, known[status])


PROJECT = "wordcraft-kg"
TRACKERS: dict[str, type[TensorBoard] | type[WeightsAndBiases] | type[MLflow]] = {
    "tensorboard": TensorBoard,
    "wandb": WeightsAndBiases,
    "mlflow": MLflow,
}
"""Trackers by name. Each takes a run's folder, its settings by name, and the epoch or step that it continues from."""


def checked_trackers(trackers: Iterable[Tracker | str]) -> list[Tracker | str]:
    """Return trackers, each once, after checking that those given by name can be had.

    Raises:
        ConfigError: for an unknown name, with the nearest known ones.
        MissingExtraError: if the library that one needs is not installed.
    """
    found: list[Tracker | str] = []
    for tracker in trackers:
        if tracker not in found:
            found.append(tracker)
    for name in names_of(found):
        one_of("trackers", name, tuple(TRACKERS))
        if name == "mlflow":  # else it reports on itself over the network
            os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
        try:
            import_module(TRACKERS[name].library)
        except ImportError:
            raise MissingExtraError(
                f"`trackers` {name!r} needs a package that is not installed. Install it: "
                f"pip install 'wordcraft-kg[{name}]'"
            ) from None
    return found


def names_of(trackers: Iterable[Tracker | str]) -> tuple[str, ...]:
    """Return the names of trackers that are given by name; a run that goes on finds only these again."""
    return tuple(tracker for tracker in trackers if isinstance(tracker, str))


@contextmanager
def tracking(
    run: RunFolder[Any], trackers: Sequence[Tracker | str], settings: Mapping[str, Any], step: int = 0
) -> Iterator[Log]:
    """Open the trackers of a run that is live, yield what logs figures to all of them, and close them.

    Args:
        run: the run.
        trackers: from :func:`checked_trackers`.
        settings: all settings of the run by name.
        step: number of epochs or steps that were done before.
    """
    opened: list[Tracker] = []

    def log(step: int, figures: Mapping[str, float | None]) -> None:
        values = {name: value for name, value in figures.items() if value is not None}
        for tracker in opened:
            tracker.log(step, values)

    status: Status = "failed"
    try:
        for tracker in trackers:
            opened.append(TRACKERS[tracker](run.path, settings, step) if isinstance(tracker, str) else tracker)
        yield log
        status = run.record.status
    except KeyboardInterrupt:
        status = "interrupted"
        raise
    finally:
        for tracker in opened:
            tracker.close(status)
