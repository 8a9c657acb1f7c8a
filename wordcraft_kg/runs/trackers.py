"""Trackers: metrics of a training for other tools, beside the files of the run folder.

All of them write local files and send nothing. A tracker of your own is any object with the two
methods of :class:`Tracker`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from wordcraft_kg.base import MissingExtraError, one_of
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.runs.record import Status
from wordcraft_kg.runs.run_folder import RunFolder

Log = Callable[[int, Mapping[str, float | None]], None]
"""Logging function: takes finished epochs or steps, and metrics by name (None: no value)."""


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
        """Log metrics by name.

        Args:
            step: number of finished epochs or steps; it only grows, also in a resumed run.
            values: metrics by name.
        """

    def close(self, status: Status) -> None:
        """Close when the training is ``done``, ``interrupted`` or ``failed``."""


class TensorBoard:
    """Metric tracker that writes TensorBoard event files to ``tensorboard/`` in the run folder."""

    library = "torch.utils.tensorboard"

    def __init__(
        self,
        folder: Path,
        settings: Mapping[str, Any],
        step: int,
    ):
        """Open the event files.

        Args:
            folder: the run folder.
            settings: settings of the run, which this tracker does not keep.
            step: finished epochs or steps of a resumed run. Metrics of later steps, which an
                interrupted process logged after its last checkpoint, are removed.
        """
        writer = import_module(self.library).SummaryWriter
        self._writer = writer(str(folder / "tensorboard"), purge_step=step or None)

    def log(self, step: int, values: Mapping[str, float]) -> None:  # noqa: D102 - see the protocol
        for name, value in values.items():
            self._writer.add_scalar(name, value, step)

    def close(self, status: Status) -> None:  # noqa: D102
        self._writer.close()


class WeightsAndBiases:
    """Tracker that writes an offline Weights & Biases run to ``wandb/`` in the run folder.

    All that wandb would record of the machine is switched off; ``wandb sync`` would upload the
    rest. A resumed run is another run there.
    """

    library = "wandb"

    def __init__(
        self,
        folder: Path,
        settings: Mapping[str, Any],
        step: int,
    ):
        """Open the run; ``step`` is not needed, since each call of :meth:`log` has one."""
        wandb = import_module(self.library)
        private = wandb.Settings(
            root_dir=str(folder),
            mode="offline",
            silent=True,
            console="off",
            # Nothing about the machine, its user and its programs.
            host="",
            program="",
            username="",
            disable_code=True,
            disable_git=True,
            disable_job_creation=True,
            x_disable_machine_info=True,
            x_disable_meta=True,
            x_disable_stats=True,
            x_save_requirements=False,
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
"""Tracker classes by name; each takes run folder, settings by name, and finished steps."""


def check_trackers(trackers: Iterable[Tracker | str]) -> None:
    """Check that the trackers given by name can be opened.

    Raises:
        ConfigError: for an unknown name.
        MissingExtraError: if a tracker's library is not installed.
    """
    for name in names_of(trackers):
        one_of("trackers", name, tuple(TRACKERS))
        try:
            import_module(TRACKERS[name].library)
        except ImportError:
            raise MissingExtraError(f"`trackers` {name!r}: {missing_extra(name, [name])}") from None


def names_of(trackers: Iterable[Tracker | str]) -> tuple[str, ...]:
    """Return the trackers given by name; only these can be opened again by a resumed run."""
    return tuple(tracker for tracker in trackers if isinstance(tracker, str))


@contextmanager
def tracking(
    run: RunFolder[Any],
    trackers: Sequence[Tracker | str],
    settings: Mapping[str, Any],
    step: int = 0,
) -> Iterator[Log]:
    """Open trackers, yield a function that logs to all, and close them with the run's status.

    Args:
        run: the run, which is live.
        trackers: those that :func:`check_trackers` has checked.
        settings: all settings of the run, by name.
        step: finished epochs or steps of a resumed run.
    """
    opened: list[Tracker] = []

    def log(step: int, figures: Mapping[str, float | None]) -> None:
        # A metric may be missing at first, such as a success rate before the first episode.
        values = {name: value for name, value in figures.items() if value is not None}
        for tracker in opened:
            tracker.log(step, values)

    status: Status = "failed"  # unless the block ends
    try:
        for tracker in trackers:
            if isinstance(tracker, str):
                tracker = TRACKERS[tracker](run.path, settings, step)
            opened.append(tracker)
        yield log
        status = run.record.status
    except KeyboardInterrupt:
        status = "interrupted"
        raise
    finally:
        for tracker in opened:
            tracker.close(status)
