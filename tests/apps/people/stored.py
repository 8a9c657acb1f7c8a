"""The answers of a study, as its export has them."""

from pathlib import Path
from types import SimpleNamespace

from wordcraft_kg.apps.people.study import read_study


def lines_of(folder: Path) -> list[SimpleNamespace]:
    """Return the lines of a study's export as objects, with tuples for lists."""
    return [
        SimpleNamespace(**{name: tuple(value) if isinstance(value, list) else value for name, value in line.items()})
        for line in read_study(folder).lines()
    ]
