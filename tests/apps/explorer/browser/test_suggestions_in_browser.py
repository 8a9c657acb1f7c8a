"""The page of suggestions: ticked recipes become a table, from a server and from a disk."""

import pytest

from wordcraft_kg.evaluation.suggestion_files import ticked


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
