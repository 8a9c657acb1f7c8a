"""Rendering pages from the package's templates: one file, with a table of contents, words explained, and no network."""

import base64
import hashlib
import re
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Any

import jinja2
from markupsafe import Markup

from wordcraft_kg.reports.charts import palette
from wordcraft_kg.reports.charts.standalone import resolved
from wordcraft_kg.reports.glossary import GLOSSARY, Term


class Outline:
    """What a page collects while it is rendered.

    Attributes:
        headings: titles of its sections by anchor, in order.
        terms: terms that it uses, by key.
    """

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
            KeyError: if the glossary does not have it.
        """
        term = self.terms[key] = GLOSSARY[key]
        shown = text or (f"{term.name} ({term.symbol})" if term.symbol else term.name)
        return Markup('<abbr title="{}">{}</abbr>').format(term.meaning, shown)


def render_page(template: str, *, data: Sequence[str] = (), **values: Any) -> str:
    """Return a page; labels and names are escaped, and a value that the template misses is an error.

    A template extends ``page.html.j2``. ``heading(title)`` puts a section into the table of contents, and ``term(key)``
    explains a word of :data:`~wordcraft_kg.reports.glossary.GLOSSARY`.

    Args:
        template: its file name.
        data: files beside the page to link to.
        values: what the template shows.
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
    environment.globals["palette"] = palette
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
