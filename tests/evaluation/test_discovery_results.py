"""Results of open-ended play: passed bottlenecks, reasons, and their page."""

import re
import xml.etree.ElementTree as ET
from html.parser import HTMLParser

import numpy as np
import pytest
from refusals import refuses

from wordcraft_kg.agents.discovery import NEVER
from wordcraft_kg.base.records import as_values
from wordcraft_kg.evaluation.discovery import (
    ORACLES,
    open_guide,
    view_discovery,
)
from wordcraft_kg.graphs import Recipe, RecipeGraph
from wordcraft_kg.reports.discovery_report import discovery_page

HOSTILE = "<img src=x onerror=alert(1)>"


class Tags(HTMLParser):
    def __init__(self, page):
        super().__init__()
        self.found = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.found += [tag, *(name for name, _ in attrs)]


@pytest.fixture(scope="module")
def hostile():
    names = [HOSTILE, "\"><script>alert('x')</script>", "{{ 7 * 7 }}", "a & b", "</svg>", "é"]
    rows = [(names[0], names[1], names[2]), (names[0], names[2], names[3])]
    rows += [(names[1], names[3], names[4]), (names[4], names[4], names[5])]
    graph = RecipeGraph.from_recipes(rows, names[:2])
    graph.name = "<script>book</script>"
    return graph


def test_no_label_of_a_book_becomes_markup(hostile):
    view, plays = view_discovery(hostile, ["random", "greedy"], attempts=9, runs=2)
    page = discovery_page(view, plays, hostile)
    tags = Tags(page).found
    assert "img" not in tags
    assert "onerror" not in tags
    # The page's own script alone, whose hash the page names.
    assert tags.count("script") == 1
    assert "{{ 7 * 7 }}" in page
    for svg in re.findall(r"<svg.*?</svg>", page, re.DOTALL):
        ET.fromstring(svg)
    assert "&lt;img" in page


def test_the_page_maps_discoveries_of_the_best_player_without_an_oracle(kitchen):
    view, plays = view_discovery(kitchen, ["random", "greedy"], attempts=60, runs=2)
    page = discovery_page(view, plays, kitchen)
    picture = next(svg for svg in re.findall(r"<svg.*?</svg>", page, re.DOTALL) if "round 0" in svg)
    cells = {
        rect.find("title").text.split(":")[0]: rect for rect in ET.fromstring(picture).iter("rect")
    }
    assert set(cells) == set(kitchen.entities)
    for label, rect in cells.items():
        attempts = plays.learnt[0, :, kitchen.id_of(label)]
        is_found = (attempts != NEVER).any()
        assert (rect.get("class") == "grid") != is_found
        if label in kitchen.base:
            assert "known at the start" in rect.find("title").text
    main = view.statistics.main
    assert main.entity in page
    assert f"<td>{main.needed_by}</td>" in page


def test_a_scorer_of_other_results_is_counted(recipes_folder, kitchen):
    # Each result is a made entity, and every second recipe takes the one of the next.
    rows = kitchen.recipe_labels()
    turned = [*rows[1:], rows[0]]
    changed = [
        row if place % 2 else Recipe(row.ingredients, following.result)
        for place, (row, following) in enumerate(zip(rows, turned, strict=True))
    ]
    wrong = RecipeGraph.from_recipes(changed, kitchen.base)
    guide = open_guide(recipes_folder, wrong)
    trained = {tuple(kitchen.labels(row)) for row in guide.recipes.scorer.recipes.tolist()}
    recipes = {tuple(wrong.labels(row)) for row in wrong.recipes.tolist()}
    assert guide.shared == len(trained & recipes)
    pairs = {recipe[:2] for recipe in trained} & {recipe[:2] for recipe in recipes}
    assert guide.contradicted == len(pairs - {recipe[:2] for recipe in trained & recipes}) > 0


def test_a_world_of_one_entity_or_of_thousands_of_results_of_a_pair():
    one = RecipeGraph(["water"], np.empty((0, 3), dtype=np.int64), [0], "one")
    with refuses("base"):
        view_discovery(one, ["random"])
    rows = [("a", "b", f"thing {number}") for number in range(5_000)]
    many = RecipeGraph.from_recipes(rows, ["a", "b"])
    view, plays = view_discovery(many, ["random-no-repeat", *ORACLES], attempts=4, runs=1)
    assert view.players["greedy"]["1"].mean == 5_002
    # Too many entities for bottlenecks and for a map.
    assert view.statistics.bottlenecks == ()
    assert "Found when" not in discovery_page(view, plays, many)
    assert as_values(view)["statistics"]["width"] == [2, 5_000]
