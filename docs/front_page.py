"""A hook for the website: the README's first screen on the landing page, and the changelog, without
copies; addresses of earlier pages lead to the pages that have their content now.
"""

from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
BUTTONS = """
[Install](installation.md){ .md-button .md-button--primary }
[Play](play.md){ .md-button }
<a class="md-button" href="everyday/index.html">Explore</a>

"""
"""The way on, before README's finding. The explorer's pages join the finished website."""
FINDING = "<!-- finding -->"
END = "<!-- end of first screen -->"
"""The mark in README where the landing page ends."""
MOVED = """<!doctype html>
<html lang="en">
<title>This page has moved</title>
<meta http-equiv="refresh" content="0; url={address}">
<p>This page has moved: <a href="{address}">{address}</a></p>
</html>
"""


def on_page_markdown(markdown: str, *, page: Any, **_: object) -> str:
    """Put the README before the landing page's own text, and the changelog on its page; links lead
    to the site.
    """
    if page.file.src_uri == "index.md":
        screen, _, _ = (ROOT / "README.md").read_text(encoding="utf-8").partition(END)
        screen = screen.replace("](docs/", "](").replace(FINDING, BUTTONS + FINDING)
        return screen + markdown
    if page.file.src_uri == "changelog.md":
        return (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").replace("](docs/", "](")
    return markdown


def on_post_build(*, config: Any) -> None:
    """Write a page that leads on at each address of ``extra: moved`` in mkdocs.yml."""
    for old, new in config.extra["moved"].items():
        address = "../" * old.count("/") + new.replace(".md", ".html")
        path = Path(config.site_dir, old).with_suffix(".html")
        path.write_text(MOVED.format(address=address), encoding="utf-8")
