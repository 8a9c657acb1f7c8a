"""Takes the pictures of docs/explorer.md from a static site of the book everyday; needs Chromium and Playwright.

make site && python docs/make_pictures.py site/everyday
"""

import argparse
import shutil
from pathlib import Path

from playwright.sync_api import sync_playwright

IMAGES = Path(__file__).parent / "images"
PICTURES = {
    "explorer-entity": ("entity/bread.html", 1180),
    "explorer-map": ("map/map.html", 900),
    "explorer-path": ("path/bread.html", 620),
    "explorer-episode": ("episode", 900),
}
"""Page and height of each picture."""


def main() -> None:
    """Take all pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site", type=Path)
    site = parser.parse_args().site.resolve()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for name, (page, height) in PICTURES.items():
            path = site / page
            found = path if path.is_file() else sorted(path.iterdir())[0]
            tab = browser.new_page(viewport={"width": 1180, "height": height})
            tab.goto(found.as_uri())
            tab.wait_for_timeout(500)
            tab.screenshot(path=IMAGES / f"{name}.png")
            tab.close()
        browser.close()


if __name__ == "__main__":
    main()
