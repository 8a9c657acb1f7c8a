"""Asking agents, and looking at one that trains, in a real browser."""

import json
import shutil

import pytest

from tests.apps.explorer.browser.conftest import served
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.server import make_app


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
    lines.last.fill(f" {added} ")
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
        rows = page.locator("table").first.locator("tbody tr")
        names, actions = (
            rows.locator(cell).all_inner_texts() for cell in ("th", "td:first-of-type")
        )
        assert names == ["guided", "live"]
        assert actions[0] == actions[1]  # it is a copy
