"""A recipe book as a game in the browser: discover items in the open, or make goals from a table.

The page plays alone: the server gives it out and learns nothing, and an exported page opens from
disk. Found items stay in the player's browser, under the graph's hash.
"""

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route, Router
from starlette.types import ASGIApp

from wordcraft_kg.apps.web.guard import Guard, file_endpoint, static_texts
from wordcraft_kg.base import ConfigError, staged_file
from wordcraft_kg.graphs.book_files.words import RESULT, words_of
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.reports.pages import make_environment, policy_hash

PACKAGE = "wordcraft_kg.apps.text_agents"
FILES = ("game.css", "game.js")
MOST_EXPORTED = 10_000
"""Recipes of an exported page: about 300 KB, which mail and a slow phone still take."""
LONGEST_ICON = 16
"""Characters of an icon: an emoji of a family has 7, a word is no icon."""
NO_ICONS: Mapping[int, str] = {}


def icons_of(source: str, graph: RecipeGraph) -> dict[int, str]:
    """Return icons of results by entity, from a column ``emoji`` of a book's CSV file.

    A book without such a column, or in another form, has none.

    Args:
        source: what the user named as the book.
        graph: the graph of this book: its file was read before, so it is not too large.
    """
    path = Path(source)
    if path.suffix.lower() != ".csv" or not path.is_file():
        return {}
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as lines:
        # The line that names the base stands above the table.
        table = csv.DictReader(line for line in lines if not line.startswith("#"))
        names = table.fieldnames or ()
        results = [name for name in names if words_of(name) & RESULT]
        emoji = [name for name in names if name.strip().lower() == "emoji"]
        if not results or not emoji:
            return {}
        icons = {(row[results[0]] or "").strip(): row[emoji[0]] for row in table}
    return {
        graph.id_of(label): icon.strip()[:LONGEST_ICON]
        for label, icon in icons.items()
        if label in graph and icon and icon.strip()
    }


def export_game(
    graph: RecipeGraph, path: Path, icons: Mapping[int, str] = NO_ICONS, *, force: bool = False
) -> None:
    """Write a book's game as one file that opens from disk.

    Args:
        graph: recipes of the game.
        path: HTML file to write.
        icons: icons by entity, as :func:`icons_of` reads them.
        force: whether an existing file may be replaced.

    Raises:
        ConfigError: if the book has more than :data:`MOST_EXPORTED` recipes, or no base.
        OutputExistsError: if the file exists and ``force`` is False, or ``path`` is a folder.
    """
    if graph.num_recipes > MOST_EXPORTED:
        raise ConfigError(
            f"--export {path}: found {graph.num_recipes:,} recipes; a page holds at most "
            f"{MOST_EXPORTED:,}. Use --browser instead."
        )
    texts = static_texts(PACKAGE, FILES)
    style = texts["game.css"]
    script = texts["game.js"]
    # Nothing but this style and this script works on the page, whatever the labels are.
    policy = (
        f"default-src 'none'; style-src 'sha256-{policy_hash(style)}'; "
        f"script-src 'sha256-{policy_hash(script)}'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
    # Markup: the texts are the package's own; escaping would change the script.
    page = _page(graph, icons, policy=policy, style=Markup(style), script=Markup(script))
    with staged_file(path, force=force) as staged:
        staged.write_text(page, encoding="utf-8", newline="\n")


def make_game_app(graph: RecipeGraph, host: str, icons: Mapping[int, str] = NO_ICONS) -> ASGIApp:
    """Return the web application that gives out a book's game.

    Args:
        graph: recipes of the game.
        host: host that the server listens on.
        icons: icons by entity, as :func:`icons_of` reads them.

    Raises:
        ConfigError: if the book has no base.
    """
    page = _page(graph, icons, policy="")

    async def game(_: Request) -> Response:
        return HTMLResponse(page, headers={"Cache-Control": "no-cache"})

    files = file_endpoint(PACKAGE, FILES, lambda message: PlainTextResponse(message, 404))
    router = Router([Route("/", game), Route("/files/{name}", files)], redirect_slashes=False)
    return Guard(router, host, (), lambda _, message: message, media_type="text/plain")


def _page(graph: RecipeGraph, icons: Mapping[int, str], **values: Any) -> str:
    # If every entity has a recipe, a player could never begin.
    if not len(graph.base_ids):
        raise ConfigError(
            f"{graph.name} has no base: found a recipe for each entity. Name the entities that a "
            "player begins with in a line above the table: # base: water, earth"
        )
    rows = graph.sets.tolist()
    book = {
        "key": graph.hash,
        "labels": list(graph.entities),
        "base": graph.base_ids.tolist(),
        # The ids of each recipe's ingredients and result, without padding.
        "recipes": [[entity for entity in row if entity != graph.num_entities] for row in rows],
        "icons": dict(icons),
    }
    # Without "<", no label can end the element that holds the book.
    text = json.dumps(book, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    template = make_environment(PACKAGE).get_template("game.html.j2")
    return template.render(name=graph.name, book=Markup(text), **values)
