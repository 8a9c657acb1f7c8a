"""Trackers log training metrics to local files; subclass :class:`Tracker` for your own."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from wordcraft_kg.base.errors import MissingExtraError
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.base.settings import one_of
from wordcraft_kg.runs.folder import RunFolder
from wordcraft_kg.runs.record import Status

Log = Callable[[int, Mapping[str, float | None]], None]
"""Logging function: takes the number of finished epochs or steps, and metrics by name (None for a missing value)."""


class Tracker(Protocol):
    """Interface of a metric tracker, which receives training metrics.

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
        """Log metrics by name; ``step`` counts finished epochs or steps and only grows, also in a resumed run."""
        ...

    def close(self, status: Status) -> None:
        """Close when the training is ``done``, ``interrupted`` or ``failed``."""
        ...


class TensorBoard:
    """Metric tracker that writes TensorBoard event files to ``tensorboard/`` in the run folder."""

    library = "torch.utils.tensorboard"

    def __init__(self, folder: Path, settings: Mapping[str, Any], step: int):
        """Open the event files; for a resumed run, continue from ``step`` and remove metrics of later steps."""
        writer = import_module(self.library).SummaryWriter
        self._writer = writer(str(folder / "tensorboard"), purge_step=step or None)

    def log(self, step: int, values: Mapping[str, float]) -> None:  # noqa: D102 - see the protocol
        for name, value in values.items():
            self._writer.add_scalar(name, value, step)

    def close(self, status: Status) -> None:  # noqa: D102
        self._writer.close()


class WeightsAndBiases:
    """Tracker that writes an offline Weights & Biases run to ``wandb/``; upload with ``wandb sync``."""

    library = "wandb"

    def __init__(self, folder: Path, settings: Mapping[str, Any], step: int):
        wandb = import_module(self.library)
        disabled = ["disable_code", "disable_git", "disable_job_creation"]
        disabled += ["x_disable_machine_info", "x_disable_meta", "x_disable_stats"]
        empty = dict.fromkeys(("host", "program", "username"), "")
        options = {
            "console": "off",
            "mode": "offline",
            "silent": True,
            "x_save_requirements": False,
        }
        private = wandb.Settings(
            root_dir=str(folder), **options, **empty, **dict.fromkeys(disabled, True)
        )
        self._run = wandb.init(
            project=PROJECT, name=folder.name, config=dict(settings), settings=private
        )

    def log(self, step: int, values: Mapping[str, float]) -> None:  # noqa: D102
        self._run.log(dict(values), step=step)

    def close(self, status: Status) -> None:  # noqa: D102
        self._run.finish(exit_code=0 if status == "done" else 1)


PROJECT = "wordcraft-kg"
TRACKERS: dict[str, type[TensorBoard] | type[WeightsAndBiases]] = {
    "tensorboard": TensorBoard,
    "wandb": WeightsAndBiases,
}
"""Tracker classes by name; each takes the run folder, settings by name, and the number of epochs or steps before."""


def checked_trackers(trackers: Iterable[Tracker | str]) -> list[Tracker | str]:
    """Return trackers without duplicates; ConfigError for unknown names, MissingExtraError without a library."""
    unique: list[Tracker | str] = []
    for tracker in trackers:
        if tracker not in unique:
            unique.append(tracker)
    for name in names_of(unique):
        one_of("trackers", name, tuple(TRACKERS))
        try:
            import_module(TRACKERS[name].library)
        except ImportError:
            raise MissingExtraError(f"`trackers` {name!r}: {missing_extra(name, [name])}") from None
    return unique


def names_of(trackers: Iterable[Tracker | str]) -> tuple[str, ...]:
    """Return all trackers given by name; a resumed run opens these trackers again."""
    return tuple(tracker for tracker in trackers if isinstance(tracker, str))


@contextmanager
def tracking(
    run: RunFolder[Any],
    trackers: Sequence[Tracker | str],
    settings: Mapping[str, Any],
    step: int = 0,
) -> Iterator[Log]:
    """Open checked trackers, yield a function that logs to all, and close; ``step`` is of a resumed run."""
    opened: list[Tracker] = []

    def log(step: int, figures: Mapping[str, float | None]) -> None:
        values = {name: value for name, value in figures.items() if value is not None}
        for tracker in opened:
            tracker.log(step, values)

    status: Status = "failed"
    try:
        for tracker in trackers:
            opened.append(
                TRACKERS[tracker](run.path, settings, step) if isinstance(tracker, str) else tracker
            )
        yield log
        status = run.record.status
    except KeyboardInterrupt:
        status = "interrupted"
        raise
    finally:
        for tracker in opened:
            tracker.close(status)
