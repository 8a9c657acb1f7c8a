"""Trackers: metrics of a training for other tools, beside the files of the run folder.

TensorBoard's writes local files and sends nothing. A tracker of your own is any object with the two
methods of :class:`Tracker`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from wordcraft_kg.base import one_of
from wordcraft_kg.base.extras import check_extra
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

    def __init__(self, folder: Path, step: int):
        """Open the event files.

        Args:
            folder: the run folder.
            step: finished epochs or steps of a resumed run. Metrics of later steps, which an
                interrupted process logged after its last checkpoint, are removed.
        """
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder / "tensorboard"), purge_step=step or None)

    def log(self, step: int, values: Mapping[str, float]) -> None:  # noqa: D102 - see the protocol
        for name, value in values.items():
            self._writer.add_scalar(name, value, step)

    def close(self, status: Status) -> None:  # noqa: D102
        self._writer.close()


TRACKERS = {"tensorboard": TensorBoard}
"""Tracker classes by name; each takes run folder and finished steps."""


def check_trackers(trackers: Iterable[Tracker | str]) -> tuple[str, ...]:
    """Check that the trackers given by name can be opened.

    Returns:
        Their names; only these can be opened again by a resumed run.

    Raises:
        ConfigError: for an unknown name.
        MissingExtraError: if a tracker's library is not installed.
    """
    names = tuple(tracker for tracker in trackers if isinstance(tracker, str))
    for name in names:
        one_of("trackers", name, tuple(TRACKERS))
        check_extra(name)
    return names


@contextmanager
def tracking(
    run: RunFolder[Any],
    trackers: Sequence[Tracker | str],
    step: int = 0,
) -> Iterator[Log]:
    """Open trackers, yield a function that logs to all, and close them with the run's status.

    Args:
        run: the run, which is live.
        trackers: those that :func:`check_trackers` has checked.
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
                tracker = TRACKERS[tracker](run.path, step)
            opened.append(tracker)
        yield log
        status = run.record.status
    except KeyboardInterrupt:
        status = "interrupted"
        raise
    finally:
        for tracker in opened:
            tracker.close(status)
