"""Helpers of page tests: hostile labels, explored graphs, and a page as tags, forms, links and
text."""

from dataclasses import dataclass, field
from html.parser import HTMLParser
from urllib.parse import parse_qsl, unquote, urlsplit

from starlette.testclient import TestClient

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.apps.explorer.predictor import LinkPredictor
from wordcraft_kg.apps.explorer.site import Site, make_app
from wordcraft_kg.base.records import checked_values
from wordcraft_kg.graphs import OpenedGraph, RecipeGraph, default_split

HOSTILE = (
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "a/b",
    "..",
    "what?",
    "c#",
    "100 %",
    "%2e%2e",
    "back\\slash",
    "ein 'Apostroph' & ein \"Zitat\"",
    "émoji 🔥",
    "x" * 200,
)
"""Labels that are no harm to a book, and might be to a page, an address or a file name."""


@dataclass
class Form:
    """A form: its attributes, and the fields that a browser sends of it as it stands."""

    attributes: dict[str, str | None]
    fields: list[tuple[str, str]] = field(default_factory=list)


class Shown(HTMLParser):
    """The tags of a page, its forms, the addresses that it links to, and its text."""

    def __init__(self, page):
        super().__init__()
        self.page, self.text = page, ""
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.forms: list[Form] = []
        self._select, self._options = "", list[tuple[str, bool]]()
        self.feed(page)
        self.text = " ".join(self.text.split())

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.tags.append((tag, values))
        if tag == "form":
            self.forms.append(Form(values))
        elif (
            tag == "input"
            and "name" in values
            and (values.get("type") != "checkbox" or "checked" in values)
        ):
            self.forms[-1].fields.append((str(values["name"]), values.get("value") or ""))
        elif tag == "select":
            self._select, self._options = str(values["name"]), []
        elif tag == "option":
            self._options.append((values.get("value", "?") or "", "selected" in values))

    def handle_endtag(self, tag):
        self.text += " " if tag in ("td", "th", "option", "dt", "dd") else ""
        if tag == "select":
            chosen = [value for value, is_selected in self._options if is_selected] or [
                self._options[0][0]
            ]
            self.forms[-1].fields.append((self._select, chosen[-1]))

    def handle_data(self, data):
        if self._options and self._options[-1][0] == "?":
            self._options[-1] = (
                data,
                self._options[-1][1],
            )  # an option without a value is its text
        self.text += data

    @property
    def links(self):
        return [
            values["href"] or "" for tag, values in self.tags if tag == "a" and values.get("href")
        ]

    @property
    def own(self):
        """The pages of the site that it links to."""
        return [
            state_of(link)
            for link in self.links
            if link.startswith("/") and not link.startswith("/files")
        ]

    def form(self, name):
        """The fields of the form that has a field of this name."""
        return next(form.fields for form in self.forms if name in dict(form.fields))


def page_of(state):
    """Return the page of a state."""
    return next(page for page in PAGES.values() if page.state is type(state))


def view_of(explored, state):
    """Return the view of a state."""
    return page_of(state).view(explored, state)


def look(explored, state, *, is_static=False):
    """Render a state."""

    def address(page, state):
        return "" if is_static else page.address(state)

    return Shown(
        Site(explored, address, lambda name: f"/files/{name}", is_static=is_static).page(
            page_of(state), state
        )
    )


def state_of(address):
    """Return the page and state of an address."""
    parts = urlsplit(address)
    name, _, subject = parts.path.removeprefix("/").partition("/")
    return name, PAGES[name].read(unquote(subject), parse_qsl(parts.query, keep_blank_values=True))


def client_of(explored):
    """Return a browser of the site."""
    return TestClient(make_app(explored), base_url="http://localhost", follow_redirects=True)


def explored_graph(rows, base=None, split=None):
    """Return a graph without models and runs."""
    graph = rows if isinstance(rows, RecipeGraph) else RecipeGraph.from_recipes(rows, base)
    return Explored(OpenedGraph(graph, split or default_split(graph), "here"))


_EXPLORED: dict[int, tuple[LinkPredictor, Explored]] = {}


def explored_by(predictor):
    """Return a model's graph with the model, the same one each time."""
    known = _EXPLORED.setdefault(id(predictor), (predictor, Explored(predictor.model.opened)))
    known[1].models[predictor.name] = predictor
    return known[1]


def view_by(predictor, state):
    """Return the view of a state for a model, with sound values."""
    view = view_of(explored_by(predictor), state)
    assert checked_values(view)
    return view
