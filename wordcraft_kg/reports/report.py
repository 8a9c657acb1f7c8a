"""A report: a view, its pictures, and the folder with its page, its numbers and its tables."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from wordcraft_kg.base.artefacts import dump_json, staged_folder, write_atomically
from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.records import Record, checked_values
from wordcraft_kg.reports.pages import render_page

if TYPE_CHECKING:
    import pandas as pd

V = TypeVar("V", bound=Record)


@dataclass(frozen=True)
class Report(Generic[V]):
    """Content of a report.

    Attributes:
        view: its numbers.
        template: template of its page.
        pictures: pictures by the names that the template uses.
        shown: other values that the template uses.
        tables: further tables by file name.
        files: further files by name, such as figures.
    """

    view: V
    template: str
    pictures: Mapping[str, Any]
    shown: Mapping[str, Any] = field(default_factory=dict)
    tables: "Mapping[str, pd.DataFrame]" = field(default_factory=dict)
    files: Mapping[str, str | bytes] = field(default_factory=dict)


def render(report: Report[Any]) -> str:
    """Return a report as one self-contained HTML page."""
    data = ("report.json", *report.tables, *report.files)
    return render_page(report.template, data=data, report=report.view, pictures=report.pictures, **report.shown)


@stage("writing the report")
def write_report(report: Report[Any], out: Path, *, force: bool = False) -> None:
    """Write ``index.html``, ``report.json`` the tables and further files into a folder.

    Raises:
        ValueError: if a number of the view is not finite or out of its bounds; nothing is written then.
        OutputExistsError: if ``out`` exists and ``force`` is False.
    """
    with staged_folder(out, force=force) as folder:
        write_atomically(folder / "report.json", dump_json(checked_values(report.view)))
        write_atomically(folder / "index.html", render(report))
        for name, table in report.tables.items():
            write_atomically(folder / name, table.to_csv(index=False, lineterminator="\n", float_format="%.6g"))
        for name, content in report.files.items():
            write_atomically(folder / name, content)
