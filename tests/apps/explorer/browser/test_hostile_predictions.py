"""Pages of predictions with labels that are long, or look like markup, in a real browser."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.apps.explorer.browser.conftest import served
from tests.apps.explorer.browser.test_pages import PHONE, TOO_WIDE
from tests.apps.explorer.shown import HOSTILE
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.apps.explorer.server import make_app
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split
from wordcraft_kg.graphs.folder import open_graph, write_graph_folder
from wordcraft_kg.graphs.recipes import RecipeBook
from wordcraft_kg.models.saving import save_scorer
from wordcraft_kg.models.scorers.baselines import NeighbourScorer

LONG, MARKUP = max(HOSTILE, key=len), HOSTILE[1]


@pytest.fixture(scope="module")
def predicted_site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The site of a graph of hostile labels with two models."""
    out = tmp_path_factory.mktemp("hostile")
    rows = [(one, other, made) for one in HOSTILE for other in HOSTILE if one < other for made in (LONG, *HOSTILE[:2])]
    graph = RecipeGraph.from_recipes(rows, name="hostile")
    book = RecipeBook("hostile", tuple(graph.recipe_labels()), graph.base)
    write_graph_folder(out / "graph", book, make_split(graph, SplitConfig(train_ratio=0.7)))
    opened = open_graph(out / "graph")
    scorer = NeighbourScorer(graph, opened.split.partial)
    folders: list[Path] = [save_scorer(out / name, scorer, opened, kg="partial") for name in ("one", "other")]
    with served(make_app(Explored.open(out / "graph", folders))) as address:
        yield address


@pytest.mark.parametrize(
    ("name", "choices"),
    [
        ("entity", {"entity": LONG}),
        ("entity", {"entity": MARKUP, "learned": True}),
        ("recipes", {"entity": LONG}),
        ("predictions", {"known": "all"}),
        ("link", {"head": LONG, "tail": MARKUP}),
        ("compare", {"known": "all"}),
        ("pair", {"a": LONG, "b": MARKUP}),
    ],
    ids=range(7),
)
def test_long_labels_and_markup_break_no_page_of_predictions(open_page, predicted_site: str, name: str, choices):
    page, shown = open_page(viewport=PHONE), PAGES[name]
    page.goto(predicted_site + shown.address(shown.state(**choices)))
    assert page.evaluate(TOO_WIDE) == []
    assert page.locator("main img, main script").count() == 0
    for label in (choices.get("entity"), choices.get("head"), choices.get("a")):
        assert label is None or label in page.locator("h1").inner_text()


def test_a_form_that_is_sent_keeps_a_hostile_entity(open_page: Callable[..., Any], predicted_site: str):
    page, entity = open_page(), PAGES["entity"]
    for label in ("a/b", MARKUP):
        page.goto(predicted_site + entity.address(entity.state(entity=label)))
        page.get_by_label("Training links").select_option("true")
        page.wait_for_url("**learned=true**")
        assert page.locator("h1").inner_text() == label
        assert page.get_by_label("Training links").input_value() == "true"
