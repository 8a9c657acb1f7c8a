"""Properties of every page: views, links, forms, accessibility, hostile labels, and errors."""

import re
import sys
from importlib.metadata import EntryPoint
from itertools import pairwise
from typing import Literal
from urllib.parse import parse_qsl, unquote, urlsplit

import pytest
from hypothesis import given, strategies as st

from tests.apps.explorer.shown import (
    HOSTILE,
    client_of,
    explored_by,
    explored_graph,
    look,
    state_of,
    view_of,
)
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.apps.explorer.pages import GROUP, PAGES, pages_by_name
from wordcraft_kg.apps.explorer.site import export_site
from wordcraft_kg.base import (
    ConfigError,
    Record,
    UnknownEntityError,
    WordCraftKGError,
    checked_values,
)

OF_MODELS = (
    "/entity/bread",
    "/entity/water?model=kitchen-recipes",
    "/recipes/water",
    "/recipes/bread?use=makes&part=train",
    "/link",
    "/link?head=flour&tail=water&model=kitchen-recipes",
    "/link?head=flour&relation=componentOf&tail=bread",
    "/pair",
    "/pair?a=flour&b=water&model=kitchen-recipes",
)

OF_AGENTS = (
    "/tasks",
    "/tasks?part=train&page=2&run=plain",
    "/tasks?part=all&depth=2",
    "/tasks?depth=3&goal=bread",
    "/tasks?success=never",
    "/episode",
    "/episode?part=train&task=7&distractor_seed=3&other=plain",
    "/episode?depth=2&task=3&distractors=2&other=plain&other=mlp",
    "/episode?goal=bread&table=flour&table=water&table=fire&selection=water&other=plain",
    "/episode?run=mlp&task=2",
    "/runs",
    "/run/guided",
    "/run/plain",
)

OF_GRAPHS = ("/path/bread",)

LARGEST = 300 * 1024

SLOW = (
    "/recipes/bread?use=makes&part=train",
    "/link?head=flour&relation=componentOf&tail=bread",
    "/tasks?part=train&page=2&run=plain",
    "/tasks?part=all&depth=2",
    "/tasks?depth=3&goal=bread",
    "/tasks?success=never",
    "/episode?part=train&task=7&distractor_seed=3&other=plain",
    "/episode?depth=2&task=3&distractors=2&other=plain&other=mlp",
    "/episode?run=mlp&task=2",
    "/run/plain",
)
"""Further states of pages whose first and fullest states are quick cases."""


def of_test(addresses):
    """Return addresses as cases of a test."""
    return [
        pytest.param(address, marks=pytest.mark.slow if address in SLOW else [])
        for address in addresses
    ]


@pytest.fixture
def shown(request, address):
    """The kitchen with models or with agents, as the page needs it."""
    return request.getfixturevalue("agents" if address in OF_AGENTS else "explored")


@pytest.fixture(scope="module")
def rendered():
    """Render a state, once for all tests of this file that read the same page: `rendered(shown,
    state)`."""
    pages = {}

    def rendered(shown, state):
        key = (id(shown), state)
        if key not in pages:
            pages[key] = look(shown, state)
        return pages[key]

    return rendered


@pytest.fixture(scope="module")
def viewed():
    """Make sure that a state has a view: `viewed(shown, state)`; many pages link to the same ones."""
    known = set()

    def viewed(shown, state):
        if (id(shown), state) not in known:
            view_of(shown, state)
            known.add((id(shown), state))

    return viewed


def state_at(address):
    return state_of(address)[1]


def filters_of(page):
    return [form for form in page.forms if form.attributes.get("class") == "filters"]


@pytest.mark.parametrize("address", of_test([*OF_MODELS, *OF_AGENTS, *OF_GRAPHS]))
def test_a_page_is_plain_accessible_and_small(shown, rendered, address):
    page = rendered(shown, state_at(address))
    assert len(page.page.encode()) < LARGEST
    headings = [int(tag[1]) for tag, _ in page.tags if tag in ("h1", "h2", "h3")]
    assert (headings[0], headings.count(1)) == (1, 1)
    assert all(after <= before + 1 for before, after in pairwise(headings))
    ids = [attributes["id"] for _, attributes in page.tags if attributes.get("id")]
    assert len(ids) == len(set(ids))
    # Data are no script: browsers run none of another type.
    assert not re.search(r"<script(?![^>]* src=)(?! type=.application/json)|<style", page.page)
    labelled = {
        attributes["for"] for tag, attributes in page.tags if tag == "label" and "for" in attributes
    }
    for tag, attributes in page.tags:
        assert not [name for name in attributes if name == "style" or name.startswith("on")]
        if tag in ("input", "select") and attributes.get("type") not in ("hidden", "checkbox"):
            assert attributes["id"] in labelled


@pytest.mark.parametrize("address", of_test([*OF_MODELS, *OF_AGENTS]))
def test_the_view_of_a_page_is_sound_and_its_links_lead_to_pages(shown, rendered, viewed, address):
    assert checked_values(view_of(shown, state_at(address)))
    page = rendered(shown, state_at(address))
    own = [link for link in page.links if link.startswith("/") and not link.startswith("/files")]
    assert len(own) > 5
    for link, (where, target) in zip(own, page.own, strict=True):
        assert PAGES[where].address(target) == link
    targets = [target for where, target in page.own if where in ("tasks", "episode", "runs", "run")]
    for target in dict.fromkeys(targets[:12] + targets[-6:]):
        viewed(shown, target)


@pytest.mark.parametrize("address", OF_MODELS)
def test_sending_a_form_as_it_stands_leads_to_the_same_view(explored, rendered, address):
    state = state_at(address)
    (form,) = filters_of(rendered(explored, state))
    where, _, subject = (form.attributes["action"] or "").removeprefix("/").partition("/")
    assert "?" not in where + subject, "a form replaces the query of its action"
    sent = PAGES[where].read(unquote(subject), form.fields)
    assert type(sent) is type(state)
    view = view_of(explored, sent)
    if getattr(state, "page", 1) == 1:
        assert view == view_of(explored, state)


LINK = {"tail": HOSTILE[0]}

QUICK_LABELS = (*HOSTILE[:3], "..")

PAGES_OF_LABEL = {
    "entity": (("entity", "entity", {}), ("recipes", "entity", {})),
    "pair": (("pair", "a", {"b": HOSTILE[0]}),),
    "link": (("link", "head", LINK), ("link", "head", {**LINK, "relation": "componentOf"})),
    "path": (("path", "entity", {}),),
}


@pytest.mark.parametrize(
    ("pages", "label"),
    [
        # A label takes up to a quarter of a second: four have marks of all kinds.
        pytest.param(
            pages,
            label,
            marks=[] if label in QUICK_LABELS else pytest.mark.slow,
            id=f"{name}-{label[:30]}",
        )
        for name, pages in PAGES_OF_LABEL.items()
        for label in HOSTILE
    ],
)
def test_hostile_labels_stay_text_and_their_links_lead_to_them(hostile_predictor, label, pages):
    explored = explored_by(hostile_predictor)
    for name, of_label, choices in pages:
        state = PAGES[name].state(**{of_label: label}, **choices)
        page, view = look(explored, state), view_of(explored, state)
        assert getattr(view, of_label, label) == label
        assert " ".join(label.split()) in page.text
        tags = [tag for tag, _ in page.tags]
        assert tags.count("script") == 1
        assert "img" not in tags
        entities = {target.entity for where, target in page.own if where in ("entity", "path")} - {
            ""
        }
        assert entities <= set(explored.opened.graph.entities)
        for form in filters_of(page) if name in ("entity", "recipes") else ():
            _, _, subject = (form.attributes["action"] or "").removeprefix("/").partition("/")
            assert (unquote(subject) or dict(form.fields)["entity"]) == label


NO_BREAD = "Did you mean 'bread'"


@pytest.mark.parametrize(
    ("address", "message"),
    [
        *((f"/{name}/braed", NO_BREAD) for name in ("entity", "recipes", "path")),
        ("/tasks?goal=braed", NO_BREAD),
        ("/tasks?page=99", "`page` 99"),
        ("/recipes", "has no entity"),
        ("/recipes/bread?page=9", "`page` 9"),
        ("/link?head=bread", "is missing"),
        ("/link?head=bread&tail=braed", NO_BREAD),
        ("/pair?b=bread", "is missing"),
        ("/pair?a=braed&b=bread", NO_BREAD),
        ("/pair?a=bread&b=braed", NO_BREAD),
        (
            "/episode?table=flouur&table=water",
            r"no entity 'flouur' in kitchen\. Did you mean 'flour'",
        ),
        ("/episode?run=giuded", "no run 'giuded'"),
        ("/episode?other=nobody", "no run 'nobody'"),
        ("/episode?table=flour&table=water&selection=fire", "selection"),
        ("/episode?table=flour&table=flour", "table"),
        ("/episode?task=99999", "`task`"),
        ("/episode?distractors=10000", "num_distractors"),
        ("/episode?part=valid", "no task"),
    ],
)
def test_what_cannot_be_shown_is_an_error_that_says_why(explored, address, message):
    with pytest.raises(WordCraftKGError, match=message) as error:
        view_of(explored, state_at(address))
    is_unknown = str(error.value).startswith(("no entity", "no model", "no run"))
    assert isinstance(error.value, UnknownEntityError) == is_unknown
    assert is_unknown or isinstance(error.value, ConfigError) or address == "/episode?part=valid"


class Example(PageState):
    entity: str = ""
    sort: Literal["rank", "score"] = "rank"
    page: int = 1
    full: bool = False
    table: tuple[str, ...] = ()


class Nothing(Record):
    pass


PAGE = Page("example", Example, lambda *_: Nothing(), subject="entity")

LABELS = st.text(st.characters(codec="utf-8", exclude_categories=["Cs", "Cc"]), max_size=30)

SORTS, NUMBERS, TABLES = (
    st.sampled_from(["rank", "score"]),
    st.integers(0, 10**6),
    st.lists(LABELS).map(tuple),
)


@given(st.builds(Example, LABELS, SORTS, NUMBERS, st.booleans(), TABLES))
def test_each_state_is_read_back_from_its_address(state):
    parts = urlsplit(PAGE.address(state))
    name, _, subject = parts.path.removeprefix("/").partition("/")
    assert (name, "/" in subject) == ("example", False)
    assert PAGE.read(unquote(subject), parse_qsl(parts.query, keep_blank_values=True)) == state


def test_choices_at_their_defaults_are_not_in_the_address():
    assert PAGE.address(Example()) == "/example"
    assert PAGE.address(Example("olive oil", page=2)) == "/example/olive%20oil?page=2"
    assert (
        PAGE.address(Example(full=True, table=("a", "b,c")))
        == "/example?full=true&table=a&table=b%2Cc"
    )


@pytest.mark.parametrize(
    "label", [".", "..", "a/b", "../../etc/passwd", "a\\b", "/", "...", "%2e%2e", "100 %"]
)
def test_a_label_that_a_browser_would_take_for_a_folder_is_in_the_query(label):
    assert PAGE.address(Example(label)).startswith("/example?entity=")


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ([("pgae", "2")], "'pgae'; expected entity, sort, page, full, table. Did you mean 'page'?"),
        ([("page", "two")], "Expected `int`"),
        ([("sort", "name")], "Invalid enum value 'name'"),
        ([("page", "1"), ("page", "2")], "'page' is given twice: '1' and '2'"),
        ([("full", "perhaps")], "Expected `bool`"),
    ],
)
def test_an_address_that_cannot_be_meant_is_an_error_that_names_the_choice(query, message):
    with pytest.raises(ConfigError) as error:
        PAGE.read("", query)
    assert message.replace("`", "'") in str(error.value)


def test_an_empty_value_as_forms_send_it_is_the_default():
    assert PAGE.read("", [("sort", ""), ("page", "")]) == Example()


MODULE = """
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.base.records import Record

class Letters(PageState):
    letter: str = "a"

class Counted(Record):
    number: int

def _view(explored, state):
    return Counted(sum(state.letter in label for label in explored.opened.graph.entities))

PAGE = Page("letters", Letters, _view, title="Letters", package="outside_letters")
"""

TEMPLATE = (
    '{% extends "base.html.j2" %}{% block body %}<h1>Letters</h1><p>{{ view.number }} '
    "entities</p>{% endblock %}"
)


@pytest.fixture
def point(tmp_path, monkeypatch):
    package = tmp_path / "outside_letters"
    (package / "templates").mkdir(parents=True)
    (package / "__init__.py").write_text(MODULE)
    (package / "templates" / "letters.html.j2").write_text(TEMPLATE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "outside_letters", raising=False)
    return EntryPoint("letters", "outside_letters:PAGE", GROUP)


def test_a_page_from_outside_is_served_exported_and_in_the_menu(point, tmp_path, monkeypatch):
    found = pages_by_name([point])
    assert list(found) == [*PAGES, "letters"]
    monkeypatch.setitem(PAGES, "letters", found["letters"])
    explored = explored_graph([("a", "ab", "c")])
    client = client_of(explored)
    assert "2 entities" in client.get("/letters").text
    assert client.get("/letters?letter=c&format=json").json() == {"number": 1}
    assert 'href="/letters"' in client.get("/home").text
    export_site(explored, tmp_path / "site")
    assert "2 entities" in (tmp_path / "site" / "letters" / "letters.html").read_text()


def test_two_pages_of_one_name_are_refused(point, tmp_path):
    (tmp_path / "outside_letters" / "__init__.py").write_text(
        MODULE.replace('"letters"', '"entity"')
    )
    with pytest.raises(ConfigError, match="two pages have the name 'entity'"):
        pages_by_name([point])
