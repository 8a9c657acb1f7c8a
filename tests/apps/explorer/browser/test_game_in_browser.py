"""A book's game in a real browser: items survive a reload, a lost goal shows its answer, sets are
combined by a button; by mouse, by keyboard, on a phone, and under axe."""

import pytest

from tests.apps.explorer.browser.conftest import served
from wordcraft_kg import RecipeGraph, open_graph
from wordcraft_kg.apps.text_agents.browser_game import export_game, make_game_app

PHONE = {"viewport": {"width": 380, "height": 800}, "has_touch": True, "color_scheme": "dark"}
RECIPES = [("water", "earth", "mud"), ("mud", "fire", "brick"), ("water", "fire", "steam")]


@pytest.fixture
def exported(tmp_path):
    """The address of a page, from disk, for recipes."""

    def exported(recipes):
        export_game(RecipeGraph.from_recipes(recipes, name="small"), tmp_path / "game.html")
        return (tmp_path / "game.html").as_uri()

    return exported


def click(page, *names):
    """Press buttons, one after the other."""
    for name in names:
        page.get_by_role("button", name=name, exact=True).click()


def counts(page):
    """The line of items and attempts."""
    return page.locator("#counts").inner_text()


@pytest.mark.browser
def test_items_are_made_by_two_clicks_and_survive_a_reload(open_page, exported):
    page = open_page(**PHONE)
    page.goto(exported(RECIPES))
    # A browser that has just started may lose what a page stores first.
    while page.evaluate("localStorage.getItem('stored')") is None:
        page.evaluate("localStorage.setItem('stored', 'yes')")
        page.reload()
    click(page, "water", "earth")
    assert page.locator("#message").inner_text() == "water + earth → mud. New!"
    page.reload()
    assert counts(page) == "4 of 6 items, 1 attempt."
    assert page.get_by_role("button", name="mud", exact=True).is_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= 380


@pytest.mark.browser
def test_damaged_storage_begins_a_new_game(open_page, exported):
    page = open_page()
    page.goto(exported(RECIPES))
    click(page, "water", "earth")
    start = '"known": [1, 2, 5], "attempts": 0, "hints": 0'
    for text in (
        "no JSON",
        '{"known": [99]}',
        '{"known": 3, "attempts": {}, "hints": null}',
        f'{{{start}, "how": {{"4": "length"}}}}',
        '{"known": [1, 2, 5, 5], "attempts": 0, "hints": 0, "how": {}}',
        '{"known": [1, 2, 5], "attempts": -5, "hints": 0, "how": {}}',
    ):
        page.evaluate(f"localStorage.setItem(Object.keys(localStorage)[0], {text!r})")
        page.reload()
        assert counts(page) == "3 of 6 items, 0 attempts."


@pytest.mark.browser
def test_hints_name_an_item_then_the_set_and_cost_attempts(open_page, exported):
    page = open_page()
    page.goto(exported(RECIPES[:1]))
    page.get_by_role("button", name="Hint").click()
    assert "is in a recipe of 2 that makes something new" in page.locator("#message").inner_text()
    page.get_by_role("button", name="Hint").click()
    assert page.locator("#message").inner_text() == "Try earth + water."
    assert counts(page) == "2 of 3 items, 10 attempts, 2 hints."
    click(page, "water", "earth")
    page.get_by_role("button", name="Hint").click()
    assert page.locator("#message").inner_text() == "Your items make nothing new any more."


@pytest.mark.browser
def test_a_lost_goal_shows_its_answer_and_a_goal_is_made_by_the_keyboard(open_page, exported):
    page = open_page()
    page.goto(exported(RECIPES[:1]))
    click(page, "Goals")
    assert page.locator("#goal").inner_text() == "Make: mud"
    page.keyboard.press("1")
    page.keyboard.press("1")
    outcome = page.locator("#outcome")
    assert "You did not make mud." in outcome.inner_text()
    assert "The answer: earth + water → mud" in outcome.inner_text()
    page.keyboard.press("Enter")
    page.keyboard.press("1")
    page.keyboard.press("2")
    assert "You made mud." in outcome.inner_text()
    assert page.locator("#goal-counts").inner_text() == "Goals made: 1 of 2."


@pytest.mark.browser
def test_the_focus_stays_on_the_item_and_a_second_tab_learns_of_discoveries(open_page, exported):
    page = open_page()
    address = exported(RECIPES)
    page.goto(address)
    tab = page.context.new_page()
    tab.goto(address)
    click(page, "water", "earth")
    assert page.evaluate("document.activeElement.textContent") == "earth"
    click(tab, "water", "water")
    page.reload()
    assert counts(page) == "4 of 6 items, 2 attempts."


@pytest.mark.browser
def test_a_set_is_complete_when_the_player_says_so(open_page, exported):
    page = open_page()
    page.goto(exported([("flour", "water", "yeast", "bread"), ("flour", "water", "dough")]))
    click(page, "flour", "water", "Combine")
    assert page.locator("#message").inner_text() == "flour + water → dough. New!"
    click(page, "flour", "water", "yeast", "Combine")
    assert "You have made all 5 items." in page.locator("#message").inner_text()


@pytest.mark.browser
@pytest.mark.parametrize("shown", ["Discover", "Goals"])
def test_axe_has_no_objection_to_the_served_game(open_page, shown):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    with served(make_game_app(open_graph("kitchen").graph, "127.0.0.1")) as address:
        page = open_page(color_scheme="light")
        page.goto(address)
        click(page, shown)
        assert axe.run(page).response["violations"] == []
