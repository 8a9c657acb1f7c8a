"""A page of another distribution: found by its entry point, with a template of its own."""

import sys
from importlib.metadata import EntryPoint

import pytest

from tests.apps.explorer.shown import client_of, explored_graph
from wordcraft_kg.apps.explorer.export import export_site
from wordcraft_kg.apps.explorer.pages import GROUP, PAGES, pages_by_name
from wordcraft_kg.base.errors import ConfigError

MODULE = """
from wordcraft_kg.apps.explorer.page import Page, State
from wordcraft_kg.base.records import Record

class Letters(State):
    letter: str = "a"

class Counted(Record):
    number: int

def _view(explored, state):
    return Counted(sum(state.letter in label for label in explored.opened.graph.entities))

PAGE = Page("letters", Letters, _view, title="Letters", package="outside_letters")
"""
TEMPLATE = '{% extends "base.html.j2" %}{% block body %}<h1>Letters</h1><p>{{ view.number }} entities</p>{% endblock %}'


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
    (tmp_path / "outside_letters" / "__init__.py").write_text(MODULE.replace('"letters"', '"entity"'))
    with pytest.raises(ConfigError, match="two pages have the name 'entity'"):
        pages_by_name([point])
