"""Addresses and states: each state has an address, and each address its state."""

from typing import Literal
from urllib.parse import parse_qsl, unquote, urlsplit

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wordcraft_kg.apps.explorer.page import Page, State
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Record


class Example(State):
    entity: str = ""
    sort: Literal["rank", "score"] = "rank"
    page: int = 1
    full: bool = False
    table: tuple[str, ...] = ()


class Nothing(Record):
    pass


PAGE = Page("example", Example, lambda *_: Nothing(), subject="entity")
LABELS = st.text(st.characters(codec="utf-8", exclude_categories=["Cs", "Cc"]), max_size=30)
SORTS, PAGES, TABLES = st.sampled_from(["rank", "score"]), st.integers(0, 10**6), st.lists(LABELS).map(tuple)


@given(st.builds(Example, LABELS, SORTS, PAGES, st.booleans(), TABLES))
def test_each_state_is_read_back_from_its_address(state):
    parts = urlsplit(PAGE.address(state))
    name, _, subject = parts.path.removeprefix("/").partition("/")
    assert (name, "/" in subject) == ("example", False)
    assert PAGE.read(unquote(subject), parse_qsl(parts.query, keep_blank_values=True)) == state


def test_choices_at_their_defaults_are_not_in_the_address():
    assert PAGE.address(Example()) == "/example"
    assert PAGE.address(Example("olive oil", page=2)) == "/example/olive%20oil?page=2"
    assert PAGE.address(Example(full=True, table=("a", "b,c"))) == "/example?full=true&table=a&table=b%2Cc"


@pytest.mark.parametrize("label", [".", "..", "a/b", "../../etc/passwd", "a\\b", "/", "...", "%2e%2e", "100 %"])
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
