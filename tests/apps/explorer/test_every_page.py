"""Properties of every page: views, links, forms, accessibility, hostile labels, and errors."""

import re
from itertools import pairwise
from urllib.parse import unquote

import pytest

from tests.apps.explorer.shown import HOSTILE, explored_by, look, state_of, view_of
from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.base.errors import ConfigError, UnknownEntityError, WordCraftKGError
from wordcraft_kg.base.records import checked_values

OF_MODELS = (
    "/entity/bread",
    "/entity/water?model=kitchen-recipes&learned=true",
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
    "entity": (("entity", "entity", {"learned": True}), ("recipes", "entity", {})),
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
