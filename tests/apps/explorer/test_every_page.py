"""Properties of every page: views, links, forms, accessibility, hostile labels, and errors."""

import re
from itertools import pairwise
from urllib.parse import unquote

import pytest

from tests.apps.explorer.shown import HOSTILE, Form, Shown, explored_by, look, view_of
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import State
from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.apps.explorer.pages.compare import Compare
from wordcraft_kg.apps.explorer.pages.entity import Entity, Recipes
from wordcraft_kg.apps.explorer.pages.episode import Episode
from wordcraft_kg.apps.explorer.pages.link import Link
from wordcraft_kg.apps.explorer.pages.map import Map
from wordcraft_kg.apps.explorer.pages.pair import Pair
from wordcraft_kg.apps.explorer.pages.path import Path
from wordcraft_kg.apps.explorer.pages.predictions import Predictions
from wordcraft_kg.apps.explorer.pages.runs import Run, Runs
from wordcraft_kg.apps.explorer.pages.tasks import Tasks
from wordcraft_kg.apps.explorer.predictor import LinkPredictor
from wordcraft_kg.base.errors import ConfigError, UnknownEntityError, WordCraftKGError
from wordcraft_kg.base.records import checked_values

OF_MODELS: tuple[State, ...] = (
    Entity("bread"),
    Entity("water", model="kitchen-recipes", learned=True),
    Recipes("water"),
    Recipes("bread", use="makes", part="train"),
    Predictions(),
    Predictions(known="all", relation="componentOf", side="head", sort="worst", page=2),
    Predictions(model="kitchen-recipes", known="learned", entity="water", sort="label"),
    Link(),
    Link("flour", "combinesWith", "water", "kitchen-recipes"),
    Link("flour", "componentOf", "bread"),
    Compare(),
    Compare(one="kitchen-recipes", other="kitchen-complex", known="all", better="one", entity="water"),
    Pair(),
    Pair("flour", "water", "kitchen-recipes"),
)
OF_AGENTS: tuple[State, ...] = (
    Tasks(),
    Tasks(part="train", page=2, run="plain"),
    Tasks(part="all", depth=2),
    Tasks(depth=3, goal="bread"),
    Tasks(success="never"),
    Episode(),
    Episode(part="train", task=7, distractor_seed=3, other=("plain",)),
    Episode(depth=2, task=3, distractors=2, other=("plain", "mlp")),
    Episode(goal="bread", table=("flour", "water", "fire"), selection="water", other=("plain",)),
    Episode(run="mlp", task=2),
    Runs(),
    Run("guided"),
    Run("plain"),
)
OF_GRAPHS: tuple[State, ...] = (Map(entity="bread"), Path(entity="bread"))
LARGEST = 300 * 1024


@pytest.fixture
def shown(request: pytest.FixtureRequest, state: State) -> Explored:
    """The kitchen with models or with agents, as the state needs it."""
    return request.getfixturevalue("agents" if state in OF_AGENTS else "explored")


def filters_of(page: Shown) -> list[Form]:
    return [form for form in page.forms if form.attributes.get("class") == "filters"]


@pytest.mark.parametrize("state", [*OF_MODELS, *OF_AGENTS, *OF_GRAPHS], ids=repr)
def test_a_page_is_plain_accessible_and_small(shown: Explored, state: State):
    page = look(shown, state)
    assert len(page.page.encode()) < LARGEST
    headings = [int(tag[1]) for tag, _ in page.tags if tag in ("h1", "h2", "h3")]
    assert (headings[0], headings.count(1)) == (1, 1)
    assert all(after <= before + 1 for before, after in pairwise(headings))
    ids = [attributes["id"] for _, attributes in page.tags if attributes.get("id")]
    assert len(ids) == len(set(ids))
    # Data are no script: browsers run none of another type.
    assert not re.search(r"<script(?![^>]* src=)(?! type=.application/json)|<style", page.page)
    labelled = {attributes["for"] for tag, attributes in page.tags if tag == "label" and "for" in attributes}
    for tag, attributes in page.tags:
        assert not [name for name in attributes if name == "style" or name.startswith("on")]
        if tag in ("input", "select") and attributes.get("type") not in ("hidden", "checkbox"):
            assert attributes["id"] in labelled


@pytest.mark.parametrize("state", [*OF_MODELS, *OF_AGENTS], ids=repr)
def test_the_view_of_a_page_is_sound_and_its_links_lead_to_pages(shown: Explored, state: State):
    assert checked_values(view_of(shown, state))
    page = look(shown, state)
    own = [link for link in page.links if link.startswith("/") and not link.startswith("/files")]
    assert len(own) > 5
    for address, (where, target) in zip(own, page.own, strict=True):
        assert PAGES[where].address(target) == address
    targets = [target for where, target in page.own if where in ("tasks", "episode", "runs", "run")]
    for target in dict.fromkeys(targets[:12] + targets[-6:]):
        view_of(shown, target)


@pytest.mark.parametrize("state", OF_MODELS, ids=repr)
def test_sending_a_form_as_it_stands_leads_to_the_same_view(explored: Explored, state: State):
    (form,) = filters_of(look(explored, state))
    where, _, subject = (form.attributes["action"] or "").removeprefix("/").partition("/")
    assert "?" not in where + subject, "a form replaces the query of its action"
    sent = PAGES[where].read(unquote(subject), form.fields)
    assert type(sent) is type(state)
    view = view_of(explored, sent)
    if getattr(state, "page", 1) == 1:
        assert view == view_of(explored, state)


def test_a_static_page_has_no_form(explored: Explored):
    assert not [state for state in OF_MODELS if filters_of(look(explored, state, is_static=True))]


@pytest.mark.parametrize("label", HOSTILE)
@pytest.mark.parametrize(
    "states",
    [
        lambda label: (Entity(label, learned=True), Recipes(label)),
        lambda label: (Predictions(entity=label, known="all"), Pair(label, HOSTILE[0])),
        lambda label: (Link(label, "combinesWith", HOSTILE[0]), Link(label, "componentOf", HOSTILE[0])),
        lambda label: (Map(entity=label), Path(entity=label)),
    ],
    ids=["entity", "predictions", "link", "map"],
)
def test_hostile_labels_stay_text_and_their_links_lead_to_them(hostile_predictor: LinkPredictor, label: str, states):
    explored = explored_by(hostile_predictor)
    for state in states(label):
        page, view = look(explored, state), view_of(explored, state)
        assert label in {getattr(view, name, label) for name in ("entity", "head", "a")}
        assert " ".join(label.split()) in page.text or isinstance(state, Predictions)
        tags = [tag for tag, _ in page.tags]
        assert tags.count("script") == (3 if isinstance(state, Map) else 1)  # two files, and the data of the links
        assert "img" not in tags
        entities = {target.entity for where, target in page.own if where in ("entity", "map", "path")} - {""}
        assert entities <= set(explored.opened.graph.entities)
        assert not isinstance(state, Map) or entities == set(explored.opened.graph.entities)
        for form in filters_of(page):
            if isinstance(state, Entity | Recipes):
                _, _, subject = (form.attributes["action"] or "").removeprefix("/").partition("/")
                assert (unquote(subject) or dict(form.fields)["entity"]) == label


@pytest.mark.parametrize(
    ("state", "message"),
    [
        (Entity("braed"), "Did you mean 'bread'"),
        (Recipes("braed"), "Did you mean 'bread'"),
        (Map(entity="braed"), "Did you mean 'bread'"),
        (Path(entity="braed"), "Did you mean 'bread'"),
        (Recipes(), "has no entity"),
        (Recipes("bread", page=9), "`page` 9"),
        (Predictions(entity="braed"), "Did you mean 'bread'"),
        (Predictions(page=0), "`page` 0"),
        (Predictions(page=99), "`page` 99"),
        (Predictions(model="nothing"), "no model 'nothing'"),
        (Link("bread"), "is missing"),
        (Link("bread", "combinesWith", "braed"), "Did you mean 'bread'"),
        (Compare(other="nothing"), "no model 'nothing'"),
        (Pair(b="bread"), "is missing"),
        (Pair("braed", "bread"), "Did you mean 'bread'"),
        (Pair("bread", "braed"), "Did you mean 'bread'"),
        (Tasks(goal="braed"), "Did you mean 'bread'"),
        (Tasks(page=99), "`page` 99"),
        (Episode(table=("flouur", "water")), r"no entity 'flouur' in kitchen\. Did you mean 'flour'"),
        (Episode(run="giuded"), "no run 'giuded'"),
        (Episode(other=("nobody",)), "no run 'nobody'"),
        (Episode(table=("flour", "water"), selection="fire"), "selection"),
        (Episode(table=("flour", "flour")), "table"),
        (Episode(task=99_999), "`task`"),
        (Episode(distractors=10_000), "num_distractors"),
        (Episode(part="valid"), "no task"),
    ],
    ids=repr,
)
def test_what_cannot_be_shown_is_an_error_that_says_why(explored: Explored, state: State, message: str):
    with pytest.raises(WordCraftKGError, match=message) as error:
        view_of(explored, state)
    is_unknown = str(error.value).startswith(("no entity", "no model", "no run"))
    assert isinstance(error.value, UnknownEntityError) == is_unknown
    assert is_unknown or isinstance(error.value, ConfigError) or state == Episode(part="valid")
