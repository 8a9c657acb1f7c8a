"""Figures of a training for TensorBoard, an optional extra."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from wordcraft_kg.errors import MissingExtraError


class Board:
    """Writes figures into ``tensorboard/`` of a run's folder; the first one creates the file."""

    def __init__(self, folder: Path, writer_class: Any, step: int):
        """Take the run's folder and the step that it continues from; figures of later steps are removed."""
        self._folder, self._writer_class, self._step = folder / "tensorboard", writer_class, step
        self._writer: Any = None

    def add(self, step: int, figures: Mapping[str, float | None]) -> None:
        """Write the figures that have a value."""
        self._writer = self._writer or self._writer_class(str(self._folder), purge_step=self._step or None)
        for name, value in figures.items():
            if value is not None:
                self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Write what is pending."""
        if self._writer is not None:
            self._writer.close()


@contextmanager
def board(folder: Path, wanted: bool, step: int = 0) -> Iterator[Board | None]:
    """Yield a board for the figures from a step on, or None if not wanted.

    Raises:
        MissingExtraError: if it is wanted and TensorBoard is not installed.
    """
    if not wanted:
        yield None
        return
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise MissingExtraError(
            "`tensorboard` needs the package tensorboard. Install it: pip install 'wordcraft-kg[tensorboard]'"
        ) from None
    opened = Board(folder, SummaryWriter, step)
    try:
        yield opened
    finally:
        opened.close()
