"""The search box, by keyboard alone, and the way back."""

from collections.abc import Callable
from typing import Any

OpenPage = Callable[..., Any]


def choices(page: Any) -> list[str]:
    page.locator("#found li").first.wait_for()
    return page.locator("#found li").all_inner_texts()


def test_slash_leads_to_the_search_and_enter_to_the_chosen_entity(open_page: OpenPage, site: str):
    page = open_page()
    page.goto(site)
    page.keyboard.press("/")
    assert page.evaluate("document.activeElement.id") == "q"
    page.keyboard.type("bre")
    found = choices(page)
    assert found[0] == "bread"
    assert page.locator("#q").get_attribute("aria-expanded") == "true"
    page.keyboard.press("ArrowDown")
    assert page.locator("#found [aria-selected=true]").inner_text() == found[0]
    assert page.locator("#q").get_attribute("aria-activedescendant") == "found-0"
    page.keyboard.press("ArrowUp")
    assert page.locator("#found [aria-selected=true]").inner_text() == found[-1]
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.wait_for_url("**/entity/bread")
    assert page.locator("h1").inner_text() == "bread"


def test_escape_closes_the_list_and_enter_then_lists_all_that_fit(open_page: OpenPage, site: str):
    page = open_page()
    page.goto(f"{site}/map")
    page.keyboard.press("/")
    page.keyboard.type("bre")
    choices(page)
    page.keyboard.press("Escape")
    assert page.locator("#found").is_hidden()
    page.locator("#q").fill("bre")
    page.keyboard.press("Enter")
    page.wait_for_url("**/entities?q=bre")
    assert "bread" in page.locator("main").inner_text()


def test_a_slash_in_a_text_is_a_slash(open_page: OpenPage, site: str):
    page = open_page()
    page.goto(f"{site}/map")
    page.locator("#entity").fill("")
    page.locator("#entity").press("/")
    assert page.locator("#entity").input_value() == "/"


def test_the_way_back_leads_through_the_states_before(open_page: OpenPage, site: str):
    page = open_page()
    page.goto(f"{site}/map")
    page.locator("#details a").first.click()
    chosen = page.locator("h1").inner_text()
    assert chosen.startswith("Map: ")
    page.locator("#colour").select_option("layer")
    page.wait_for_url("**colour=layer**")
    assert page.locator("h1").inner_text() == chosen
    page.go_back()
    assert "colour" not in page.url
    assert page.locator("#colour").input_value() == "group"
    assert page.locator("h1").inner_text() == chosen
    page.go_back()
    assert page.locator("h1").inner_text() == "Map"
    page.go_forward()
    assert page.locator("h1").inner_text() == chosen
