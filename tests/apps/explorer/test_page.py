"""Addresses and states: each state has an address, and each address its state; and pages from
outside."""

import sys
from importlib.metadata import EntryPoint
from typing import Literal
from urllib.parse import parse_qsl, unquote, urlsplit

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.apps.explorer.shown import client_of, explored_graph
from wordcraft_kg.apps.explorer.export import export_site
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.apps.explorer.pages import GROUP, PAGES, pages_by_name
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Record


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
