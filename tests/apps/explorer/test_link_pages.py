"""The pages of entities, links, pairs, ranks and two models: states, links, forms, labels and errors."""

import threading
from collections.abc import Callable
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from urllib.parse import parse_qsl, unquote, urlsplit

import numpy as np
import pytest

from tests.apps.explorer.labels import HOSTILE
from wordcraft_kg.apps.explorer import asked
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, State
from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.apps.explorer.pages.compare import Compare
from wordcraft_kg.apps.explorer.pages.entity import Entity
from wordcraft_kg.apps.explorer.pages.link import Link
from wordcraft_kg.apps.explorer.pages.pair import Pair
from wordcraft_kg.apps.explorer.pages.predictions import Predictions
from wordcraft_kg.apps.explorer.pages.recipes import Recipes
from wordcraft_kg.apps.explorer.rendering import Site
from wordcraft_kg.base.errors import ConfigError, UnknownEntityError, WordCraftKGError
from wordcraft_kg.base.records import checked_values
from wordcraft_kg.evaluation.links import judge_links, view_links
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split
from wordcraft_kg.graphs.folder import OpenedGraph, default_split, open_graph, write_graph_folder
from wordcraft_kg.graphs.recipes import RecipeBook
from wordcraft_kg.models.saving import save_scorer
from wordcraft_kg.models.scorers.baselines import NeighbourScorer

STATES: tuple[tuple[str, State], ...] = (
    ("entity", Entity("bread")),
    ("entity", Entity("water", model="kitchen-recipes", learned=True)),
    ("recipes", Recipes("water")),
    ("recipes", Recipes("bread", use="makes", part="train")),
    ("predictions", Predictions()),
    ("predictions", Predictions(known="all", relation="componentOf", side="head", sort="worst", page=2)),
    ("predictions", Predictions(model="kitchen-recipes", known="learned", entity="water", sort="label")),
    ("link", Link()),
    ("link", Link("flour", "combinesWith", "water", "kitchen-recipes")),
    ("link", Link("flour", "componentOf", "bread")),
    ("compare", Compare()),
    ("compare", Compare(one="kitchen-recipes", other="kitchen-complex", known="all", better="one", entity="water")),
    ("pair", Pair()),
    ("pair", Pair("flour", "water", "kitchen-recipes")),
)


class Found(HTMLParser):
    """The tags of a page, its forms and its text."""

    def __init__(self, page: str):
        super().__init__()
        self.page = page
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.forms: list[dict[str, str]] = []
        self.text = ""
        self._select = ""
        self.feed(page)
        self.text = " ".join(self.text.split())

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        values = dict(attributes)
        self.tags.append((tag, values))
        if tag == "form":
            self.forms.append({"action": values.get("action") or "", "class": values.get("class") or ""})
        elif tag == "input" and self.forms:
            self.forms[-1][values.get("name") or ""] = values.get("value") or ""
        elif tag == "select":
            self._select = values.get("name") or ""
        elif tag == "option" and ("selected" in values or self._select not in self.forms[-1]):
            self.forms[-1][self._select] = values.get("value") or ""

    def handle_endtag(self, tag: str) -> None:
        self.text += " " if tag in ("td", "th") else ""

    def handle_data(self, data: str) -> None:
        self.text += data

    @property
    def links(self) -> list[str]:
        return [values["href"] or "" for tag, values in self.tags if tag == "a" and values.get("href")]


def found(explored: Explored, name: str, state: State, *, is_static: bool = False) -> Found:
    def address(page: Page, state: State) -> str:
        return "" if is_static else page.address(state)

    return Found(Site(explored, address, lambda name: f"/files/{name}", is_static=is_static).page(PAGES[name], state))


def state_of(address: str) -> tuple[str, State]:
    parts = urlsplit(address)
    name, _, subject = parts.path.removeprefix("/").partition("/")
    return name, PAGES[name].read(unquote(subject), parse_qsl(parts.query, keep_blank_values=True))


@pytest.fixture(scope="module")
def opened_with(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Explored]:
    """Make a graph of recipes with the neighbour rule as a model, of the kind of knowledge that is asked for."""

    def make(rows: list[tuple[str, str, str]], kg: str = "partial", **settings: object) -> Explored:
        out = tmp_path_factory.mktemp("explored")
        graph = RecipeGraph.from_recipes(rows, name="mine")
        book = RecipeBook("mine", tuple(graph.recipe_labels()), graph.base)
        write_graph_folder(out / "graph", book, make_split(graph, SplitConfig(**settings)))
        opened = open_graph(out / "graph")
        scorer = NeighbourScorer(graph, opened.triples(kg))
        return Explored.open(out / "graph", [save_scorer(out / "model", scorer, opened, kg=kg)])

    return make


@pytest.fixture(scope="module")
def hostile_model(opened_with: Callable[..., Explored]) -> Explored:
    rows = [(one, other, made) for one in HOSTILE for other in HOSTILE if one < other for made in HOSTILE[:3]]
    return opened_with(rows, train_ratio=0.7)


@pytest.mark.parametrize(("name", "state"), STATES)
def test_each_state_is_shown_and_all_its_links_lead_somewhere(explored: Explored, name: str, state: State):
    page = found(explored, name, state)
    checked_values(PAGES[name].view(explored, state))
    own = [link for link in page.links if link.startswith("/")]
    assert len(own) > 10
    for address in own:
        where, target = state_of(address)
        assert PAGES[where].address(target) == address
    assert len(page.page.encode()) < 300 * 1024


@pytest.mark.parametrize(("name", "state"), STATES)
def test_sending_a_form_as_it_stands_leads_to_the_same_view(explored: Explored, name: str, state: State):
    view = PAGES[name].view(explored, state)
    (form,) = [form for form in found(explored, name, state).forms if form.pop("class") == "filters"]
    action = form.pop("action")
    parts = urlsplit(action)
    assert not parts.query, "a form replaces the query of its action"
    where, _, subject = parts.path.removeprefix("/").partition("/")
    sent = PAGES[name].read(unquote(subject), form.items())
    assert where == name
    sent_view = PAGES[name].view(explored, sent)
    if getattr(state, "page", 1) == 1:
        assert sent_view == view


@pytest.mark.parametrize(("name", "state"), STATES)
def test_no_page_has_what_the_policy_forbids_or_a_control_without_a_label(explored: Explored, name: str, state: State):
    page = found(explored, name, state)
    ids = [values["id"] for _, values in page.tags if values.get("id")]
    assert len(ids) == len(set(ids))
    labelled = {values.get("for") for tag, values in page.tags if tag == "label"}
    for tag, values in page.tags:
        assert not [attribute for attribute in values if attribute == "style" or attribute.startswith("on")]
        if tag in ("select", "input") and values.get("type") != "hidden":
            assert values["id"] in labelled
    levels = [int(tag[1]) for tag, _ in page.tags if tag in ("h1", "h2", "h3")]
    assert levels[0] == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))


@pytest.mark.parametrize("label", HOSTILE)
def test_hostile_labels_stay_text_and_their_links_lead_to_them(hostile_model: Explored, label: str):
    other = HOSTILE[0]
    for name, state in (
        ("entity", Entity(label)),
        ("recipes", Recipes(label)),
        ("predictions", Predictions(entity=label, known="all")),
        ("link", Link(label, "combinesWith", other)),
        ("link", Link(label, "componentOf", other)),
        ("pair", Pair(label, other)),
    ):
        page = found(hostile_model, name, state)
        assert " ".join(label.split()) in page.text or name == "predictions"
        tags = [tag for tag, _ in page.tags]
        assert tags.count("script") == 1
        assert "img" not in tags
        targets = [state_of(link) for link in page.links if link.startswith("/")]
        entities = {target.entity for where, target in targets if where == "entity"}
        assert entities <= set(hostile_model.opened.graph.entities)
        for form in page.forms:
            if form["class"] == "filters" and name in ("entity", "recipes"):
                subject = unquote(urlsplit(form["action"]).path.removeprefix(f"/{name}").removeprefix("/"))
                assert (subject or form["entity"]) == label


def test_the_headline_of_predictions_is_that_of_the_report(explored: Explored):
    for name, one in explored.models.items():
        report = view_links(judge_links(one.model.scorer, one.model.opened))
        view = PAGES["predictions"].view(explored, Predictions(model=name, part="test"))
        assert view.metrics.mrr == pytest.approx(report.metrics["all"].mrr)
        assert f"{view.metrics.mrr:.3f}" in found(explored, "predictions", Predictions(model=name)).text


def test_ranks_of_what_was_learned_are_marked_as_memory(explored: Explored):
    assert "memory, no prediction" not in found(explored, "predictions", Predictions()).text
    some = found(explored, "predictions", Predictions(known="all"))
    assert "of these queries are for triples that the model has learned: their ranks are memory" in some.text
    assert "All of these queries" in found(explored, "predictions", Predictions(known="learned")).text


def test_a_model_of_the_full_graph_says_that_it_has_seen_everything(opened_with: Callable[..., Explored]):
    rows = [(f"part {i % 7}", f"other {i % 5}", f"thing {i}") for i in range(35)]
    explored = opened_with(rows, kg="full", kind="by-recipe-plain")
    page = found(explored, "predictions", Predictions())
    assert "nothing in the book is unseen to it" in page.text
    assert PAGES["predictions"].address(Predictions(known="learned")) in page.links
    assert "was trained on all recipes" in found(explored, "entity", Entity("part 1")).text
    test = explored.opened.split.recipes("test")[0]
    a, b, result = explored.opened.graph.labels(test)
    assert "has learned this link: its score is memory" in found(explored, "link", Link(a, "combinesWith", b)).text
    pair = found(explored, "pair", Pair(a, b))
    assert "what is in the book is memory to it" in pair.text
    assert result in pair.text


def test_a_book_without_a_split_has_pages_too(opened_with: Callable[..., Explored]):
    explored = opened_with([("a", "b", "c"), ("b", "c", "d"), ("a", "d", "e")], kg="full", kind="none")
    assert "This model was trained on all recipes" in found(explored, "predictions", Predictions()).text
    for name, state in (("entity", Entity("a")), ("link", Link()), ("pair", Pair()), ("recipes", Recipes("a"))):
        assert found(explored, name, state).text
    assert "are learned" in found(explored, "entity", Entity("a")).text


def test_a_model_with_folds_shows_probabilities_and_one_without_does_not(
    explored: Explored, opened_with: Callable[..., Explored]
):
    assert "%" in found(explored, "entity", Entity("bread")).text
    view = PAGES["entity"].view(explored, Entity("bread"))
    assert view.has_probabilities
    plain = opened_with([(f"part {i % 7}", f"other {i % 5}", f"thing {i}") for i in range(35)], kind="by-recipe-plain")
    assert not PAGES["entity"].view(plain, Entity("part 1")).has_probabilities
    test = plain.opened.split.held_out("test")[0]
    head, tail = plain.opened.graph.labels(test[[0, 2]])
    assert PAGES["link"].view(plain, Link(head, "combinesWith", tail)).probability is None


def test_a_scorer_of_links_says_that_it_cannot_say_what_a_pair_makes(explored: Explored):
    links = found(explored, "pair", Pair("flour", "water", "kitchen-complex"))
    assert "kitchen-complex scores links only" in links.text
    recipes = found(explored, "pair", Pair("flour", "water", "kitchen-recipes"))
    assert "scores links only" not in recipes.text
    assert "What they make, if they make something" in recipes.text


def test_without_a_model_entities_and_pairs_are_still_shown(kitchen_folder: Path):
    explored = Explored.open(kitchen_folder)
    assert "Nearest by words" in found(explored, "entity", Entity("bread")).text
    assert "In the book" in found(explored, "pair", Pair("flour", "water")).text
    for name, state in (("predictions", Predictions()), ("link", Link()), ("compare", Compare())):
        with pytest.raises(ConfigError, match="--model FOLDER"):
            PAGES[name].view(explored, state)
        assert not PAGES[name].is_there(explored)


@pytest.mark.parametrize(
    ("name", "state", "message"),
    [
        ("entity", Entity("braed"), "Did you mean 'bread'"),
        ("recipes", Recipes("braed"), "Did you mean 'bread'"),
        ("recipes", Recipes(), "names no entity"),
        ("recipes", Recipes("bread", page=9), "`page` 9"),
        ("predictions", Predictions(entity="braed"), "Did you mean 'bread'"),
        ("predictions", Predictions(page=0), "`page` 0"),
        ("predictions", Predictions(model="nothing"), "no model 'nothing'"),
        ("link", Link("bread"), "one of them is missing"),
        ("link", Link("bread", "combinesWith", "braed"), "Did you mean 'bread'"),
        ("compare", Compare(other="nothing"), "no model 'nothing'"),
        ("pair", Pair(b="bread"), "one of them is missing"),
        ("pair", Pair("braed", "bread"), "Did you mean 'bread'"),
    ],
)
def test_what_cannot_be_shown_is_an_error_that_says_why(explored: Explored, name: str, state: State, message: str):
    with pytest.raises(WordCraftKGError, match=message) as error:
        PAGES[name].view(explored, state)
    assert isinstance(error.value, UnknownEntityError if "no " in str(error.value)[:4] else ConfigError)


def test_a_model_compared_with_itself_does_not_differ(explored: Explored):
    view = PAGES["compare"].view(explored, Compare(one="kitchen-recipes", other="kitchen-recipes"))
    assert view.headline is not None
    assert view.headline.models[1].difference == 0
    assert (view.ranks.better_one, view.ranks.better_other) == (0, 0)
    assert PAGES["compare"].view(explored, Compare(other="kitchen-complex")).ranks.one == "kitchen-recipes"


def test_too_few_unseen_triples_leave_no_headline(opened_with: Callable[..., Explored]):
    rows = [(f"part {i % 3}", f"other {i % 4}", f"thing {i}") for i in range(9)]
    explored = opened_with(rows, kind="by-recipe-plain")
    explored.models["again"] = explored.models["model"]
    view = PAGES["compare"].view(explored, Compare())
    assert view.headline is None
    assert "There is no headline: only" in found(explored, "compare", Compare()).text


def test_many_recipes_of_an_entity_are_on_pages_of_their_own(opened_with: Callable[..., Explored]):
    rows = [("hub", f"part {i:04}", f"thing {i:04}") for i in range(600)]
    explored = opened_with(rows, kg="full", kind="none")
    page = found(explored, "entity", Entity("hub"))
    assert "12 of 600 shown" in page.text
    assert len(page.page.encode()) < 100 * 1024
    assert PAGES["recipes"].address(Recipes("hub")) in page.links
    last = found(explored, "recipes", Recipes("hub", page=6))
    assert "501 to 600 of 600 recipes" in last.text
    states = set(PAGES["recipes"].states(explored))
    assert states == {Recipes("hub", page=page) for page in range(1, 7)}


def test_a_static_page_has_no_form(explored: Explored):
    for name, state in STATES:
        forms = [form for form in found(explored, name, state, is_static=True).forms if form["class"] == "filters"]
        assert forms == []


def test_ranks_are_made_once_however_many_ask(
    kitchen_folder: Path, links_folder: Path, monkeypatch: pytest.MonkeyPatch
):
    explored = Explored.open(kitchen_folder, [links_folder])
    made = []
    rank_graph = asked.rank_graph
    monkeypatch.setattr(asked, "rank_graph", lambda predictor: made.append(1) or rank_graph(predictor))
    views = []
    threads = [
        threading.Thread(target=lambda: views.append(PAGES["predictions"].view(explored, Predictions())))
        for _ in range(6)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (len(made), len(views)) == (1, 6)
    assert all(view == views[0] for view in views)


def test_a_graph_without_recipes_has_no_pair_in_the_menu():
    graph = RecipeGraph.from_recipes([])
    explored = Explored(OpenedGraph(graph, default_split(graph), "empty"))
    assert not PAGES["pair"].is_there(explored)
    for name, state in (("entity", Entity()), ("pair", Pair())):
        with pytest.raises(ConfigError, match="The graph has no"):
            PAGES[name].view(explored, state)


def test_what_speaks_for_a_prediction_is_named_beside_it(explored: Explored):
    view = PAGES["entity"].view(explored, Entity("bread", model="kitchen-recipes"))
    text = found(explored, "entity", Entity("bread", model="kitchen-recipes")).text
    named = 0
    for slot in view.slots:
        for row in slot.best:
            assert row.reason is not None
            for witness in row.reason.witnesses:
                head, tail = slot.head or row.entity, slot.tail or row.entity
                like = (head, witness.head) if witness.tail == tail else (tail, witness.tail)
                recipe = witness.recipes[0]
                shown = f"{like[0]} is like {like[1]}: {recipe.ingredient_a} + {recipe.ingredient_b} → {recipe.result}"
                assert shown in text
                named += 1
    assert named > 10


def test_a_link_shows_how_far_each_train_recipe_speaks_for_it(explored: Explored):
    split = explored.opened.split
    head, _, tail = split.held_out("test")[0].tolist()
    a, b = split.graph.labels(np.array([head, tail]))
    state = Link(a, "combinesWith", b, "kitchen-recipes")
    view, text = PAGES["link"].view(explored, state), found(explored, "link", state).text
    assert view.reason.witnesses
    for witness in view.reason.witnesses:
        assert f"{witness.head} combinesWith {witness.tail}" in text
        assert f"{witness.weight:.3f} {100 * witness.share:.0f} %" in text
