"""Takes the pictures of the guides to reports, the explorer and human studies; needs Chromium and
Playwright.

make pictures, or: python docs/make_pictures.py site/everyday demo
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

IMAGES = Path(__file__).parent / "images"
WIDTH = 1180
PICTURES = {
    "explorer-entity": ("entity/bread.html", 1180),
    "explorer-episode": ("episode", 900),
}
"""Page of the static site, or folder whose first page it is, and height of each picture."""
REPORTS = {
    "link_report": ("models/everyday-partial/report/index.html", 1390),
    "agent_report": ("reports/agents/index.html", 1810),
}
"""Report of the demo, and height of each picture."""
STUDY = ("people", "serve", "everyday", "--tasks", "20", "--port", "0", "--no-browser", "--json")


def of_the_site(browser: Browser, site: Path) -> None:
    """Take pictures of pages of the static site."""
    for name, (page, height) in PICTURES.items():
        path = site / page
        tab = browser.new_page(viewport={"width": WIDTH, "height": height})
        tab.goto((path if path.is_file() else min(path.iterdir())).as_uri())
        tab.wait_for_timeout(500)
        tab.screenshot(path=IMAGES / f"{name}.png")
        tab.close()


def of_reports(browser: Browser, demo: Path) -> None:
    """Take pictures of the demo's reports."""
    for name, (page, height) in REPORTS.items():
        tab = browser.new_page(viewport={"width": 1060, "height": height})
        tab.goto((demo / page).as_uri())
        tab.wait_for_timeout(500)
        tab.screenshot(path=IMAGES / f"{name}.png")
        tab.close()


def of_a_study(browser: Browser) -> None:
    """Take a picture of a study's first task, with one thing picked."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "wordcraft_kg", *STUDY, "--out", f"{folder}/study"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
            assert server.stdout is not None
            tab = browser.new_page(viewport={"width": 900, "height": 330})
            tab.goto(json.loads(server.stdout.readline())["address"])
            tab.locator("main button").first.click()
            tab.locator("main a").first.click()
            tab.keyboard.press("1")
            tab.wait_for_timeout(500)
            tab.screenshot(path=IMAGES / "people-task.png")
            server.terminate()


def main() -> None:
    """Take all pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("site", type=Path)
    parser.add_argument("demo", type=Path)
    given = parser.parse_args()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        of_the_site(browser, given.site.resolve())
        of_reports(browser, given.demo.resolve())
        of_a_study(browser)
        browser.close()


if __name__ == "__main__":
    main()
