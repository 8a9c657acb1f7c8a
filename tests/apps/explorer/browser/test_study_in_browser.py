"""People's pages in a real browser: by mouse, by keyboard alone, without a script, on a phone, and
under axe."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.apps.explorer.browser.conftest import served
from tests.apps.people.stored import lines_of
from wordcraft_kg.apps.people.study import HumanStudy, kept_answers
from wordcraft_kg.apps.people.study_config import StudyConfig
from wordcraft_kg.apps.people.web_app import make_study_app


@dataclass
class Served:
    """A study of two tasks a part, and where it is served."""

    address: str
    folder: Path

    def lines(self):
        return lines_of(self.folder)


@pytest.fixture
def study(kitchen, tmp_path):
    asked = HumanStudy(kitchen, StudyConfig(tasks=2, distractors=(8,), forms=1))
    folder = tmp_path / "study"
    with kept_answers(folder, asked) as answers, served(make_study_app(asked, answers)) as address:
        yield Served(address, folder)


@pytest.fixture
def open_page(study, open_page):
    """Open pages that are closed before the server that they load their files from."""
    return open_page


@pytest.fixture
def page(open_page, study):
    """A page with the first task."""
    page = open_page()
    begin(page, study)
    return page


def begin(page, study):
    """Agree, and go to the first task."""
    page.goto(study.address)
    page.get_by_role("button", name="Yes, I agree").click()
    page.get_by_role("link", name="Start").click()
    page.wait_for_url("**/task")


def thing(page, slot):
    """A thing on the table, from 0."""
    return page.locator(".table button").nth(slot)


def after(place):
    """The page after an answer."""
    return "**/feedback/*" if place < 2 else ("**/task" if place < 3 else "**/end")


def pick(page, first, second, check=lambda: None):
    """Answer with two things on the table, and check the page between them."""
    thing(page, first).click()
    page.wait_for_url(f"**first={first + 1}")
    check()
    thing(page, second).click()


def go_on(page):
    """Leave the feedback for the next task."""
    page.locator("a.next").click()
    page.wait_for_url("**/task")


def test_a_session_by_mouse(page, study):
    for place in range(4):
        pick(
            page, place, 5, lambda: page.locator(".table button", has_text="first item").wait_for()
        )
        page.wait_for_url(after(place))
        if place < 2:
            assert (
                page.locator("a.next")
                .inner_text()
                .startswith("Start the test" if place else "Next task")
            )
            go_on(page)
    assert page.get_by_role("heading", level=1).inner_text() == "Thank you for participating"
    assert all(
        line.actions == (line.table[place], line.table[5])
        for place, line in enumerate(study.lines())
    )


def test_a_session_by_keyboard_alone(open_page, study):
    page = open_page()
    page.goto(study.address)
    agree = page.get_by_role("button", name="Yes, I agree")
    for _ in range(5):
        if agree.evaluate("button => button === document.activeElement"):
            break
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    page.wait_for_url("**/s/*")
    page.keyboard.press("Enter")
    page.wait_for_url("**/task")
    for place, keys in enumerate((("1", "2"), ("0", "9"), ("5", "5"), ("3", "1"))):
        page.keyboard.press("7")
        page.wait_for_url("**first=7")
        page.keyboard.press("Escape")
        page.wait_for_url("**first=")
        page.keyboard.press(keys[0])
        page.wait_for_url(f"**first={keys[0].replace('0', '10')}")
        page.keyboard.press(keys[1])
        page.wait_for_url(after(place))
        if place < 2:
            page.keyboard.press("Enter")
            page.wait_for_url("**/task")
    slots = [tuple(line.table.index(label) for label in line.actions) for line in study.lines()]
    assert slots == [(0, 1), (9, 8), (4, 4), (2, 0)]


def test_the_rest_of_a_double_click_is_no_pick_but_a_key_is(page):
    """The second half of a double click on the next page is no pick but a key is."""
    thing(page, 3).click()
    page.wait_for_url("**first=4")
    page.evaluate(
        "performance.now = () => 399; const selected = document.querySelector('.selected');"
        "selected.dispatchEvent(new MouseEvent('click', { detail: 2, bubbles: true, cancelable: "
        "true }))"
    )
    page.wait_for_timeout(300)
    assert page.url.endswith("first=4")
    page.keyboard.press("4")
    page.wait_for_url("**/feedback/1")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_and_nothing_is_wider_than_a_phone(open_page, study, scheme):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    page = open_page(color_scheme=scheme, viewport={"width": 360, "height": 700})

    def check():
        page.wait_for_load_state("networkidle")  # contrast needs the stylesheet
        found = axe.run(page).response["violations"]
        assert not [(one["id"], [node["html"][:150] for node in one["nodes"]]) for one in found], (
            page.url
        )
        assert page.evaluate("document.documentElement.scrollWidth") <= 360, page.url

    for path in ("/declined", "/"):
        page.goto(f"{study.address}{path}")
        check()
    page.get_by_role("button", name="Yes, I agree").click()
    check()
    page.get_by_role("link", name="Start").click()
    for place in range(4):
        check()
        pick(page, place, 5, check)
        page.wait_for_url(after(place))
        if place < 2:
            check()
            go_on(page)
    check()
