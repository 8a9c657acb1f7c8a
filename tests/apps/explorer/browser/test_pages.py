"""Properties of every page, labels that look like markup, and the search box by keyboard, in a real
browser."""

import json
import shutil
from dataclasses import replace

import pytest

from tests.apps.explorer.browser.conftest import served
from tests.apps.explorer.shown import HOSTILE
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.apps.explorer.site import make_app
from wordcraft_kg.evaluation.suggestions import ticked

PHONE = {"width": 360, "height": 640}

PAPER = {"width": 718, "height": 1000}
"""A4 in pixels, without its margins."""


def visit(page, address):
    """Open an address and return the page's heading."""
    page.goto(address)
    return page.locator("h1").inner_text()


SHORTEN = """() => document.querySelectorAll('tbody, ul, ol').forEach(
  (list) => [...list.children].slice(4).forEach((row) => row.remove())
)"""
"""Keeps the first rows of tables and lists: the others are of the same kind."""


def test_each_page_of_the_menu_is_reached_from_the_first_page(open_page, site, explored):
    page = open_page()
    visit(page, site)
    titles = [one.title for one in PAGES.values() if one.title and one.is_there(explored)]
    assert page.locator(".top nav a").all_inner_texts() == titles
    for title in titles:
        page.locator(".top nav").get_by_role("link", name=title, exact=True).click()
        assert page.locator(".top nav a[aria-current=page]").inner_text() == title
        assert page.locator("h1").count() == 1
        assert page.title().endswith(explored.opened.graph.name)
    page.locator(".brand a").click()
    assert page.url == f"{site}/home"


TOO_WIDE = """() => {
  const limit = document.documentElement.clientWidth;
  if (document.scrollingElement.scrollWidth <= limit) return [];
  const clipped = (e) =>
    e && (getComputedStyle(e).overflowX !== 'visible' || clipped(e.parentElement));
  return [...document.querySelectorAll('body *')]
    .filter(e => e.getBoundingClientRect().right > limit + 1 && !clipped(e.parentElement))
    .map(e => e.outerHTML.slice(0, 120));
}"""


@pytest.mark.parametrize("medium", ["screen", "print"])
def test_no_page_is_wider_than_a_phone_or_a_sheet_of_paper(open_page, visits, medium):
    page = open_page(viewport=PHONE if medium == "screen" else PAPER)
    page.emulate_media(media=medium)
    for address in visits(page):
        assert page.evaluate(TOO_WIDE) == [], address


FOCUSABLE = """() => [...document.querySelectorAll(
  'a[href], button, input, select, textarea, summary, [tabindex]'
)].filter(e => e.tabIndex >= 0 && !e.disabled && e.checkVisibility())
  .map((e, i) => (e.dataset.stop = i, e.outerHTML.slice(0, 100)))"""

FOCUSED = """() => {
  const e = document.activeElement, drawn = e.ownerSVGElement ? e.querySelector('circle, rect') : e;
  const style = getComputedStyle(e);
  const seen = drawn === e ? style.outlineStyle !== 'none' : getComputedStyle(drawn).strokeWidth;
  return [e.dataset.stop, seen && seen !== '0px' && seen !== '1px', e.outerHTML.slice(0, 100)];
}"""


def test_tab_reaches_everything_and_one_sees_where_one_is(open_page, visits):
    page = open_page()
    for address in visits(page):
        page.evaluate(SHORTEN)
        stops = page.evaluate(FOCUSABLE)
        reached = set()
        for _ in stops:
            page.keyboard.press("Tab")
            number, is_seen, element = page.evaluate(FOCUSED)
            assert number is not None, (address, element)
            assert is_seen, (address, element)
            reached.add(int(number))
        missing = set(range(min(len(stops), 150))) - reached
        assert not missing, (address, [stops[i] for i in missing])


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_that_matters(open_page, visits, scheme):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    options = {"resultTypes": ["violations"]}
    if scheme == "dark":
        options["runOnly"] = ["color-contrast"]  # all else is the same
    page = open_page(color_scheme=scheme)
    for address in visits(page):
        page.evaluate(SHORTEN)
        violations = axe.run(page, options=options).response["violations"]
        assert not [
            (one["id"], one["nodes"][:5]) for one in violations if one["impact"] != "minor"
        ], address


def test_each_page_works_without_javascript(open_page, site, visits):
    page = open_page(java_script_enabled=False)
    for _ in visits(page):
        assert page.locator("h1").inner_text()
        assert page.locator("main").inner_text()
    # A form leads to an address that says what was chosen.
    page.locator("#q").fill("bread")
    page.locator("#q").press("Enter")
    assert page.url == f"{site}/entities?q=bread"


def test_the_files_of_a_static_site_work_from_a_disk(open_page, static_site, explored):
    page = open_page()
    visit(page, (static_site / "index.html").as_uri())
    for title in page.locator(".top nav a").all_inner_texts():
        page.locator(".top nav").get_by_role("link", name=title, exact=True).click()
        assert page.locator(".top nav a[aria-current=page]").inner_text() == title
        assert page.url.startswith("file://")
    background = page.evaluate("getComputedStyle(document.querySelector('.top')).borderBottomStyle")
    assert background == "solid"  # its style sheet is there
    page.keyboard.press("/")
    page.keyboard.insert_text("brea")
    page.locator("#found li").first.wait_for()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.wait_for_url("**/bread.html")
    assert "bread" in page.locator("h1").inner_text()


LONG, MARKUP = max(HOSTILE, key=len), HOSTILE[1]


@pytest.fixture(scope="module")
def predicted_site(hostile_predictor):
    """The site of a graph of hostile labels with two models."""
    models = {name: replace(hostile_predictor, name=name) for name in ("one", "other")}
    with served(make_app(Explored(hostile_predictor.model.opened, models))) as address:
        yield address


@pytest.mark.parametrize(
    ("name", "choices"),
    [
        *(
            ("entity", {"entity": LONG}),
            ("entity", {"entity": MARKUP}),
            ("recipes", {"entity": LONG}),
        ),
        *(("link", {"head": LONG, "tail": MARKUP}), ("pair", {"a": LONG, "b": MARKUP})),
    ],
    ids=range(5),
)
def test_long_labels_and_markup_break_no_page_of_predictions(
    open_page, predicted_site, name, choices
):
    page, shown = open_page(viewport=PHONE), PAGES[name]
    page.goto(predicted_site + shown.address(shown.state(**choices)))
    assert page.evaluate(TOO_WIDE) == []
    assert page.locator("main img, main script").count() == 0
    for label in (choices.get("entity"), choices.get("head"), choices.get("a")):
        assert label is None or label in page.locator("h1").inner_text()


def test_slash_leads_to_the_search_and_enter_to_the_chosen_entity(open_page, site):
    page = open_page()
    page.goto(site)
    page.keyboard.press("/")
    assert page.evaluate("document.activeElement.id") == "q"
    page.keyboard.insert_text("bre")
    page.locator("#found li").first.wait_for()
    found = page.locator("#found li").all_inner_texts()
    assert found[0] == "bread"
    assert page.locator("#q").get_attribute("aria-expanded") == "true"
    page.keyboard.press("ArrowDown")
    assert page.locator("#found [aria-selected=true]").inner_text() == found[0]
    assert page.locator("#q").get_attribute("aria-activedescendant") == "found-0"
    page.keyboard.press("ArrowUp")
    assert page.locator("#found [aria-selected=true]").inner_text() == found[-1]
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.wait_for_url("**/entity?entity=bread")
    assert page.locator("h1").inner_text() == "bread"


def values_of(lines):
    return [lines.nth(i).input_value() for i in range(lines.count())]


@pytest.mark.parametrize("has_script", [True, False])
def test_a_table_is_edited_and_asked_again(open_page, site, has_script):
    page = open_page(java_script_enabled=has_script)
    page.goto(f"{site}/episode?part=train&task=3")
    before = page.locator("main").inner_text()
    page.get_by_text("Edit the table").click()
    lines = page.locator("input[name=table]")
    shown = values_of(lines)
    kept = [label for label in shown[1:] if label]
    added = next(label for label in ("honey", "fire", "salt", "water") if label not in shown)
    lines.first.fill("")
    lines.last.fill(added)
    page.get_by_role("button", name="Show actions").click()
    page.wait_for_url("**/episode?*table=*")
    assert "edited table" in page.locator("h1").inner_text()
    assert values_of(page.locator("input[name=table]")) == [*kept, added, "", "", ""]
    rows = page.locator("table").first.locator("tbody th").all_inner_texts()
    assert {row.removeprefix("▶ ").split("part of")[0].strip() for row in rows} == {*kept, added}
    # The selection is the first action, and takes effect at once with scripts.
    page.locator("#selection").select_option(added)
    if not has_script:
        page.get_by_role("button", name="Show actions").click()
    page.wait_for_url("**selection=*")
    assert f"Holding {added}" in page.locator("main").inner_text()
    assert page.locator("h3").all_inner_texts() == ["Action 1"]
    page.get_by_role("link", name="Back to the original table").click()
    assert page.locator("main").inner_text() == before
    for _ in range(3):
        page.go_back()
    assert page.locator("main").inner_text() == before


def test_a_training_is_followed_and_agents_are_compared(
    open_page, kitchen_folder, run_folder, tmp_path
):
    live = tmp_path / "live"
    shutil.copytree(run_folder, live, ignore=shutil.ignore_patterns("evaluation.json", "report"))
    record = json.loads((live / "run.json").read_text())
    (live / "run.json").write_text(
        json.dumps(record | {"status": "running", "ended": None, "outputs": {}})
    )
    lines = (live / "metrics.jsonl").read_bytes()
    last = json.loads(lines.splitlines()[-1])["step"]
    first = lines.index(b"\n") + 1
    (live / "metrics.jsonl").write_bytes(lines[: first + 20])  # the second line is half written
    with served(make_app(Explored.open(kitchen_folder, [], [run_folder, live]))) as site:
        page = open_page()
        page.goto(f"{site}/run/live")
        steps = page.locator("dl.facts > div", has_text="Steps").first
        assert steps.inner_text().split("\n")[1].startswith("0 of")
        (live / "metrics.jsonl").write_bytes(lines)
        page.locator("dl.facts", has_text=f"{last:,} of").wait_for()
        shutil.copytree(run_folder, live, dirs_exist_ok=True)
        page.locator("[data-live]").wait_for(state="detached")
        assert "done" in page.locator("dl.facts").inner_text()
        page.goto(f"{site}/episode")
        page.get_by_role("checkbox", name="live").click()
        page.wait_for_url("**other=live*")
        headings = page.locator("h2").all_inner_texts()
        assert {"guided", "live"} <= {heading.split()[0] for heading in headings if heading}


@pytest.mark.parametrize("place", ["server", "disk"])
def test_ticked_suggestions_are_saved_as_a_table_that_lengthens_a_book(
    open_page, site, static_site, explored, tmp_path, place
):
    page = open_page()
    address = f"{site}/suggestions"
    if place == "disk":
        address = (static_site / "suggestions" / "suggestions.html").as_uri()
    page.goto(address)
    save = page.get_by_role("button", name="Save ticked recipes")
    assert save.is_disabled()
    boxes = page.get_by_role("checkbox")
    names = []
    for number in (0, 3):
        boxes.nth(number).check()
        names.append(boxes.nth(number).get_attribute("aria-label"))
    assert page.get_by_role("status").inner_text() == "2 ticked"
    with page.expect_download() as download:
        save.click()
    table = tmp_path / "suggestions.csv"
    download.value.save_as(table)
    recipes = ticked(table, explored.opened.graph)
    assert {str(recipe) for recipe in recipes} == {name.replace("→", "->") for name in names}
