"""Pages from the package's templates, which need no network, and reports: a page with its numbers and tables."""

import base64
import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import jinja2
from markupsafe import Markup

from wordcraft_kg.base.artefacts import dump_json, staged_folder, write_atomically
from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.records import Record, checked_values
from wordcraft_kg.reports.charts import plot
from wordcraft_kg.reports.charts.standalone import resolved
from wordcraft_kg.reports.glossary import Term, find_term

if TYPE_CHECKING:
    import pandas as pd


class Outline:
    """Headings (titles by anchor, in order) and glossary terms that a page collects while it is rendered."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self.headings: dict[str, str] = {}
        self.terms: dict[str, Term] = {}

    def heading(self, title: str, note: str = "") -> Markup:
        """Return the heading of a section, with an anchor made from its title and a note beside it."""
        slug = anchor = re.sub(r"\W+", "-", title.lower()).strip("-") or "section"
        while anchor in self.headings:
            anchor += f"-{slug}"
        self.headings[anchor] = title
        beside = Markup(' <span class="ci">{}</span>').format(note) if note else ""
        return Markup('<h2 id="{}"><a href="#{}">{}</a>{}</h2>').format(anchor, anchor, title, beside)

    def term(self, key: str, text: str | None = None) -> Markup:
        """Return a word of the glossary, or another text for it, with its meaning as a tooltip.

        Raises:
            KeyError: if neither the glossary nor a source has it.
        """
        term = self.terms[key] = find_term(key)
        shown = text or (f"{term.name} ({term.symbol})" if term.symbol else term.name)
        return Markup('<abbr title="{}">{}</abbr>').format(term.meaning, shown)


def render_page(template: str, *, data: Sequence[str] = (), **values: Any) -> str:
    """Return a page; labels and names are escaped, and a value that the template misses is an error.

    Args:
        template: file name of a template that extends ``page.html.j2``; ``heading(title)`` begins a section there,
            ``term(key)`` explains a word of :data:`~wordcraft_kg.reports.glossary.GLOSSARY`.
        data: files beside the page to link to.
        values: values of the template.
    """
    outline = Outline()
    shown = {"outline": outline, "heading": outline.heading, "term": outline.term, "data": data}
    package, _, name = template.rpartition("/")
    return _environment(package).get_template(name).render(**shown, **values)


def chart_style() -> str:
    """Return the style sheet's rules for charts, for figures that are files of their own."""
    return resolved(_environment("").get_template("chart.css.j2").render())


def make_environment(*packages: str) -> jinja2.Environment:
    """Return what renders the templates of packages, for all kinds of pages; those that come first take precedence.

    Whatever a label holds stays text, and a name that a template misspells is an error.
    """
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(package) for package in packages]),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.globals["palette"] = plot
    environment.filters["thousands"] = lambda number: f"{number:,}"
    return environment


@cache
def _environment(package: str) -> jinja2.Environment:
    environment = make_environment(*([package] if package else []), "wordcraft_kg.reports")
    script = (files("wordcraft_kg.reports") / "templates" / "page.js").read_text(encoding="utf-8")
    environment.globals |= {
        "script": Markup(script),
        # The page's policy lets this script run and no other, whatever a label may hold.
        "script_hash": base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
    }
    return environment


V = TypeVar("V", bound=Record)


@dataclass(frozen=True)
class Report(Generic[V]):
    """Content of a report.

    Attributes:
        view: its numbers.
        pictures: pictures by the names that the template uses.
        shown: other values of the template.
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
