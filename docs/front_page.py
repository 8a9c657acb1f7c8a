"""A hook for the website: the landing page's game and README's first screen, and the changelog, without
copies; addresses of earlier pages lead to the pages that have their content now.

    python docs/front_page.py

writes the repository's address, `repository` of [tool.wordcraft-kg] in pyproject.toml, wherever it
belongs: the package's links and CITATION.cff. The website's footer shows it.
"""

import json
import re
import tomllib
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any

from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.graphs.library import open_book
from wordcraft_kg.graphs.recipe_graph import RecipeGraph

ROOT = Path(__file__).parents[1]
PROJECT = ROOT / "pyproject.toml"
CITATION = ROOT / "CITATION.cff"
GAME = """<script>const FRONT_TASKS = {tasks};</script>
<script src="play/play.js"></script>
"""
GOALS = {
    "rainbow": ("sun", "bread", "rain"),
    "pizza": ("rope", "cheese", "dough"),
    "lighthouse": ("lamp", "cheese", "sea"),
    "parrot": ("bird", "lamp", "rainbow"),
}
"""Goals of the landing page and the items on its tables, from the book everyday."""
ICONS = {
    "bird": "M3 13c5 0 6-7 12-7l4 1 3 2-3 1c0 6-4 9-9 9-4 0-5-2-7-6zM10 19v3M15 9v.1",
    "bread": "M4 9a4 4 0 0 1 4-4h8a4 4 0 0 1 2 7v7H6v-7a4 4 0 0 1-2-3zM10 10v4M14 10v4",
    "cheese": "M2 14 14 5a9 9 0 0 1 8 9v5H2zM2 14h20M8 17v.1M15 16.5v.1M18 11v.1",
    "dough": "M2 12h20a10 8 0 0 1-20 0zM5 12a7 6.5 0 0 1 14 0M10 9v.1M13 8v.1",
    "lamp": "M8.5 15a7 7 0 1 1 7 0v3h-7zM9.5 21h5M12 15v-4",
    "rain": "M6 14a4 4 0 0 1 1-8 6 6 0 0 1 11 2 3 3 0 0 1 0 6zM8 17l-1 4M13 17l-1 4M18 17l-1 4",
    "rainbow": "M2 18a10 10 0 0 1 20 0M5.5 18a6.5 6.5 0 0 1 13 0M9 18a3 3 0 0 1 6 0",
    "rope": "M4 20c7 2 13-3 9-7s-9 0-7 3 11 2 14-11",
    "sea": "M2 8c3-3 6 3 10 0s7 3 10 0M2 13c3-3 6 3 10 0s7 3 10 0M2 18c3-3 6 3 10 0s7 3 10 0",
    "sun": "M17 12a5 5 0 1 1-10 0 5 5 0 0 1 10 0zM12 1v3M12 20v3M1 12h3M20 12h3M4 4l2 2M18 18l2 2"
    "M4 20l2-2M18 6l2-2",
}
"""A drawing of each item: the path of an SVG of 24 x 24 pixels."""
PLACE = "<!-- README -->"
"""The mark in index.md for README's text."""
END = "<!-- end of first screen -->"
"""The mark in README where its part of the landing page ends."""
MOVED = """<!doctype html>
<html lang="en">
<title>This page has moved</title>
<script>location.replace("{address}" + ("{address}".includes("#") ? "" : location.hash))</script>
<meta http-equiv="refresh" content="0; url={address}">
<p>This page has moved: <a href="{address}">{address}</a></p>
</html>
"""


def front_tasks() -> list[dict[str, Any]]:
    """Return the landing page's goals as play.js shows them: items, and the results of all pairs."""
    graph = RecipeGraph.from_book(open_book("everyday"))
    tasks = []
    for goal, table in GOALS.items():
        made = {}
        for first, second in combinations_with_replacement(range(len(table)), 2):
            if results := graph.labels(graph.results(table[first], table[second])):
                made[f"{first},{second}"] = results
        icons = [ICONS[item] for item in table]
        tasks.append({"goal": goal, "table": table, "icons": icons, "made": made})
    return tasks


def repository() -> str:
    """Return the repository's address; empty while there is none."""
    tools = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["tool"]
    return str(tools["wordcraft-kg"]["repository"])


def with_address(project: str, citation: str, address: str) -> tuple[str, str]:
    """Return the texts of pyproject.toml and CITATION.cff with an address, or without one."""
    project = re.sub(r"\[project\.urls\]\n.*\n\n", "", project)
    citation = re.sub(r"^repository-code: .*\n", "", citation, flags=re.MULTILINE)
    if address:
        following = "[project.optional-dependencies]"
        urls = f'[project.urls]\nRepository = "{address}"\n\n{following}'
        project = project.replace(following, urls, 1)
        citation = citation.replace("\nlicense:", f"\nrepository-code: {address}\nlicense:", 1)
    return project, citation


def on_config(config: Any) -> Any:
    """Show the repository's address in the footer: a link there asks no other host for anything."""
    if address := repository():
        config.extra["social"] = [{"icon": "material/source-branch", "link": address}]
    return config


def on_files(files: Any, *, config: Any) -> Any:
    """Add the changelog."""
    from mkdocs.structure.files import File

    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").replace("](docs/", "](")
    files.append(File.generated(config, "changelog.md", content=text))
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: object) -> str:
    """Put the game and README's first screen on the landing page; links lead to the site."""
    if page.file.src_uri == "index.md":
        screen, _, _ = (ROOT / "README.md").read_text(encoding="utf-8").partition(END)
        # The landing page asks README's question in its title.
        screen = re.sub(r"\A# .*\n\n\*\*.*?\*\* ", "", screen)
        game = GAME.format(tasks=json.dumps(front_tasks(), ensure_ascii=False))
        return markdown.replace(PLACE, game + "\n" + screen.replace("](docs/", "]("))
    return markdown


def on_post_build(*, config: Any) -> None:
    """Write a page that leads on at each address of ``extra: moved`` in mkdocs.yml."""
    for old, new in config.extra["moved"].items():
        address = "../" * old.count("/") + new.replace(".md", ".html")
        path = Path(config.site_dir, old).with_suffix(".html")
        path.write_text(MOVED.format(address=address), encoding="utf-8")


if __name__ == "__main__":
    texts = (path.read_text(encoding="utf-8") for path in (PROJECT, CITATION))
    for path, text in zip((PROJECT, CITATION), with_address(*texts, repository()), strict=True):
        write_atomically(path, text)
