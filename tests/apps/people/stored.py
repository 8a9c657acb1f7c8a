"""The answers of a study, as its export has them; and what tests of studies do again and again."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

from wordcraft_kg.apps.people.study import read_study


def lines_of(folder: Path) -> list[SimpleNamespace]:
    """Return the lines of a study's export as objects, with tuples for lists."""
    return [
        SimpleNamespace(**{name: tuple(value) if isinstance(value, list) else value for name, value in line.items()})
        for line in read_study(folder).lines()
    ]


def at_once(work: Callable[[], object], threads: int) -> None:
    """Do some work in several threads at once, and wait for them."""
    running = [threading.Thread(target=work) for _ in range(threads)]
    for thread in running:
        thread.start()
    for thread in running:
        thread.join()


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder by their names."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}


@contextmanager
def unchanged(folder: Path) -> Iterator[None]:
    """Check that a block changes no file of a folder."""
    before = contents(folder)
    yield
    assert contents(folder) == before
