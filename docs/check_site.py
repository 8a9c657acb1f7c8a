"""Open every page of the website in Chromium, and print all problems; the exit code is 1 if there
are any.

    python docs/check_site.py SITE [PART]

Problems are requests to other hosts, console errors, broken links, pages above 300 KB, pages wider
than the screen at 360 and 1280 pixels, and axe's serious findings in light and dark. All guides are
checked, and two pages for each kind in the explorer; links in all pages. PART chooses pages to open
by a part in the name.
"""

import argparse
import functools
import shutil
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from itertools import chain, product
from pathlib import Path
from typing import Literal
from urllib.parse import unquote, urljoin, urlsplit

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, Request, sync_playwright

MOST_BYTES = 300_000
WIDTHS = (360, 1280)
SCHEMES: tuple[Literal["light", "dark"], ...] = ("light", "dark")
TOO_WIDE = "document.scrollingElement.scrollWidth - document.documentElement.clientWidth"


class Links(HTMLParser):
    """Collects a page's links and anchors."""

    def __init__(self, page: Path):
        """Read a page."""
        super().__init__()
        self.links: list[str] = []
        self.anchors = {""}
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect a tag's attributes."""
        for name, value in attrs:
            if value and name in ("href", "src"):
                self.links.append(value)
            elif value and name in ("id", "name"):
                self.anchors.add(value)


def broken_links(site: Path) -> Iterator[str]:
    """Yield each link to a file or an anchor that the website lacks."""
    pages = {page: Links(page) for page in sorted(site.rglob("*.html"))}
    for page, found in pages.items():
        for link in sorted(set(found.links)):
            at = urlsplit(urljoin(page.as_uri(), link))
            target = Path(unquote(at.path))
            target = target / "index.html" if target.is_dir() else target
            if at.scheme != "file" or page.name == "404.html":
                continue
            if not target.is_file():
                yield f"{page.relative_to(site)}: no file {link}"
            elif (
                target in pages
                and unquote(at.fragment) not in pages[target].anchors
                and at.fragment != "__skip"
            ):
                yield f"{page.relative_to(site)}: no anchor {link}"


def chosen(site: Path, part: str) -> list[str]:
    """Return the pages to open: all guides, and two for each kind in the explorer; exit without
    any.
    """
    kinds: Counter[str] = Counter()
    names = []
    for page in sorted(site.rglob("*.html")):
        name = page.relative_to(site).as_posix()
        kind = page.parent.relative_to(site).as_posix()
        kinds[kind] += 1
        if part in name and (kinds[kind] <= 2 or not kind.startswith("everyday/")):
            names.append(name)
    if not names:
        wanted = f"with '{part}' in the name" if part else "to open"
        sys.exit(
            f"No page {wanted} among {sum(kinds.values()):,} pages in '{site}'. Build the website: "
            "make site"
        )
    return names


def problems_of(page: Page, width: int, scheme: str) -> Iterator[str]:
    """Yield an open page's problems."""
    if (excess := page.evaluate(TOO_WIDE)) > 0:
        yield f"{excess} pixels too wide"
    options = {"resultTypes": ["violations"]}
    if scheme == "dark":
        options["runOnly"] = ["color-contrast"]  # all else is as in light
    if scheme == "light" or width == WIDTHS[-1]:
        for one in Axe().run(page, options=options).response["violations"]:
            if one["impact"] in ("serious", "critical"):
                yield f"axe: {one['id']}, such as {one['nodes'][0]['html'][:120]}"


class Quiet(SimpleHTTPRequestHandler):
    """Serves files without a log."""

    def log_message(self, *_: object) -> None:
        """Log nothing."""


def visit(site: Path, names: list[str]) -> Iterator[str]:
    """Open the pages by a server, in each width and colour scheme; yield the problems."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(site)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    home = f"http://127.0.0.1:{server.server_port}/"
    complaints: list[str] = []

    def check_request(request: Request) -> None:
        if not request.url.startswith((home, "data:", "blob:")):
            complaints.append(f"request to {request.url}")

    with sync_playwright() as playwright:
        arguments = ["--no-sandbox", "--disable-dev-shm-usage"]
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=arguments
        )
        for width, scheme in product(WIDTHS, SCHEMES):
            page = browser.new_page(viewport={"width": width, "height": 800}, color_scheme=scheme)
            page.on(
                "console",
                lambda message: message.type == "error" and complaints.append(message.text),
            )
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.on("request", check_request)
            for name in names:
                complaints.clear()
                page.goto(home + name)
                page.wait_for_timeout(100)
                complaints.extend(problems_of(page, width, scheme))
                yield from (
                    f"{name}, {width} px, {scheme}: {problem}"
                    for problem in dict.fromkeys(complaints)
                )
            page.close()
        browser.close()
    server.shutdown()


def main() -> None:
    """Print all problems, each at once."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("site", type=Path, help="folder of the website, as made by `make site`")
    parser.add_argument(
        "part", nargs="?", default="", help="open only pages with this part in the name"
    )
    arguments = parser.parse_args()
    site = arguments.site.resolve()
    names = chosen(site, arguments.part)
    large = (
        f"{page.relative_to(site)}: {page.stat().st_size:,} bytes; expected at most {MOST_BYTES:,}"
        for page in sorted(site.rglob("*.html"))
        if page.stat().st_size > MOST_BYTES
    )
    problems = 0
    for problem in chain(large, broken_links(site), visit(site, names)):
        print(problem, flush=True)
        problems += 1
    print(f"{problems} problems")
    sys.exit(problems > 0)


if __name__ == "__main__":
    main()
