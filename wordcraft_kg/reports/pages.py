"""HTML pages from the package's templates, readable offline, and reports: a page with files."""

import base64
import hashlib
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

import jinja2
from markupsafe import Markup

from wordcraft_kg.base import (
    Record,
    checked_values,
    drop_temporary,
    dump_json,
    for_html,
    stage,
    staged_folder,
    write_atomically,
)
from wordcraft_kg.models.policies.sources import ALPHA, BUILT_IN, Label, label_of, with_letters
from wordcraft_kg.reports.charts import DARK, LIGHT, Chart
from wordcraft_kg.runs.record import RUN_FILE
from wordcraft_kg.runs.run_folder import locked

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Topic = Literal["Graphs", "Links", "Play", "Agents"]


class Term(Record):
    """A glossary term.

    Attributes:
        topic: section of the glossary.
        name: the term.
        meaning: definition in one to three sentences.
        symbol: symbol in formulas, or empty.
    """

    topic: Topic
    name: str
    meaning: str
    symbol: str = ""


def _term(label: Label) -> Term:
    meaning = label.meaning or label.about
    if label is not ALPHA:
        # A reader of a report meets the letter, and needs the name that commands take.
        meaning = f"{meaning} In commands and settings: {with_letters([label.name])}."
    return Term("Agents", label.words, meaning, label.symbol)


_TERMS: dict[Any, dict[str, list[str]]] = tomllib.loads(
    Path(__file__).with_name("glossary.toml").read_text("utf-8")
)
# Score sources define their own words, so that a term and a column never differ.
GLOSSARY = {label.name: _term(label) for label in (ALPHA, *BUILT_IN.values())}
for _topic, _terms in _TERMS.items():
    for _key, _words in _terms.items():
        GLOSSARY[_key] = Term(_topic, *_words)


class Outline:
    """The section headings and glossary terms of a page, collected while the page is rendered.

    Attributes:
        headings: titles by anchor, in order.
        terms: explained terms by key.
    """

    def __init__(self) -> None:
        self.headings: dict[str, str] = {}
        self.terms: dict[str, Term] = {}

    def heading(self, title: str, note: str = "") -> Markup:
        """Record a section title; return the heading as HTML, with an anchor and perhaps a note."""
        # A title without a letter, such as an emoji, needs an anchor, too.
        slug = re.sub(r"\W+", "-", title.lower()).strip("-") or "section"
        anchor = slug
        # An anchor names one place, so equal titles get longer ones.
        while anchor in self.headings:
            anchor += f"-{slug}"
        self.headings[anchor] = title
        remark = Markup(' <span class="ci">{}</span>').format(note) if note else ""
        return Markup('<h2 id="{}"><a href="#{}">{}</a>{}</h2>').format(
            anchor, anchor, title, remark
        )

    def term(self, key: str, text: str | None = None) -> Markup:
        """Record a glossary term; return its name or ``text``, with the meaning as a tooltip.

        Args:
            key: a glossary entry, or the name of a registered score source.
            text: text instead of the term's name.

        Raises:
            KeyError: if the term is unknown.
        """
        # Sources of other packages may be registered after this module was imported.
        term = GLOSSARY[key] if key in GLOSSARY else _term(label_of(key))
        self.terms[key] = term
        name = f"{term.name} ({term.symbol})" if term.symbol else term.name
        return Markup('<abbr title="{}">{}</abbr>').format(term.meaning, text or name)


def render_page(template: str, *, data: Sequence[str] = (), **values: Any) -> str:
    """Render a page from a template file that extends ``page.html.j2``.

    In the template, ``heading(title)`` begins a section and ``term(key)`` explains a term in
    :data:`~wordcraft_kg.reports.pages.GLOSSARY`. Labels and names are escaped, and a missing
    value is an error.

    Args:
        template: file name of the template; ``package/name`` for one in another package.
        data: files in the page's folder to link to.
        **values: values for the template.

    Returns:
        The page as HTML.
    """
    outline = Outline()
    shown = {"outline": outline, "heading": outline.heading, "term": outline.term, "data": data}
    package, _, name = template.rpartition("/")
    return _environment(package).get_template(name).render(**shown, **values)


def make_environment(*packages: str) -> jinja2.Environment:
    """Return a Jinja environment for the templates of Python packages.

    Text is escaped, so labels stay text, and an undefined name is an error.

    Args:
        *packages: packages with templates; the first package that has a template counts.
    """
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(package) for package in packages]),
        autoescape=True,
        finalize=lambda value: for_html(value) if isinstance(value, str) else value,
        trim_blocks=True,
        lstrip_blocks=True,
        # A misspelt name in a template is an error, and not an empty place on the page.
        undefined=jinja2.StrictUndefined,
    )
    environment.globals["palette"] = {"LIGHT": LIGHT, "DARK": DARK}
    environment.filters["thousands"] = lambda number: f"{number:,}"
    return environment


def policy_hash(text: str) -> str:
    """Return a script's or style's SHA-256 as a content security policy writes it, in base64."""
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


@cache
def _environment(package: str) -> jinja2.Environment:
    # Templates of other packages extend the page of this one.
    packages = [package] if package else []
    environment = make_environment(*packages, "wordcraft_kg.reports")
    templates = files("wordcraft_kg.reports") / "templates"
    script = (templates / "page.js").read_text(encoding="utf-8")
    environment.globals |= {
        "script": Markup(script),
        # The page's content security policy admits this script only.
        "script_hash": policy_hash(script),
    }
    return environment


V = TypeVar("V", bound=Record)


@dataclass(frozen=True)
class Report(Generic[V]):
    """A report before writing.

    Attributes:
        view: the report's numbers, for ``report.json``.
        template: file name of the page's template.
        pictures: charts by the template's names, some in mappings.
        shown: further values by the template's names.
        files: further files by name, such as pictures and tables.
    """

    view: V
    template: str
    pictures: Mapping[str, Any]
    shown: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, str | bytes] = field(default_factory=dict)

    @property
    def figures(self) -> "dict[str, Figure]":
        """The charts as figures of Matplotlib, to change them or to save them for a paper.

        A chart in a mapping has the names on the way to it, such as ``slices/layer``.

        Example:
            ``report.figures["success"].savefig("success.pdf")``
        """
        return {name: chart.figure() for name, chart in _charts_in(self.pictures)}


def _charts_in(pictures: Any, name: str = "") -> Iterator[tuple[str, Chart]]:
    """Yield the charts in nested mappings, each with the names on the way to it."""
    if isinstance(pictures, Chart):
        yield name, pictures
        return
    for key, picture in pictures.items():
        yield from _charts_in(picture, f"{name}/{key}".lstrip("/"))


def render(report: Report[Any]) -> str:
    """Return a report's page as self-contained HTML."""
    data = ("report.json", *report.files)
    return render_page(
        report.template, data=data, report=report.view, pictures=report.pictures, **report.shown
    )


@stage("writing the report")
def write_report(report: Report[Any], out: Path, *, force: bool = False) -> None:
    """Write a report's page, numbers and further files into a folder.

    Args:
        report: the report.
        out: the folder. In a run folder, the run is locked while the report is written.
        force: replace an existing folder.

    Raises:
        ValueError: if a number is not finite or out of bounds; nothing is written.
        OutputExistsError: if ``out`` exists and ``force`` is False.
        ArtefactError: if another process uses the run folder.
    """
    # In a run folder, a training or another report may be writing: its lock is taken, and what a
    # stopped writer has left is removed. Elsewhere nothing is shared.
    in_run = (out.parent / RUN_FILE).is_file()
    with locked(out.parent, "used") if in_run else nullcontext():
        if in_run:
            drop_temporary(out.parent)
        # All or nothing: readers see the old report until the new one is complete.
        with staged_folder(out, force=force) as folder:
            # Checked first: a number out of bounds stops the report before the page shows it.
            write_atomically(folder / "report.json", dump_json(checked_values(report.view)))
            write_atomically(folder / "index.html", render(report))
            for name, content in report.files.items():
                write_atomically(folder / name, content)
