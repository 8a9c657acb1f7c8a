"""A recipe book as a game in the browser: discover items in the open, or make goals from a table.

The page plays alone: the server gives it out and learns nothing, and an exported page opens from
disk. Found items stay in the player's browser, under the graph's hash.
"""

import json
from pathlib import Path
from typing import Any

from markupsafe import Markup
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route, Router
from starlette.types import ASGIApp

from wordcraft_kg.apps.web.guard import Guard, file_endpoint, static_texts
from wordcraft_kg.base import ConfigError, staged_file
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.reports.pages import make_environment, policy_hash

PACKAGE = "wordcraft_kg.apps.text_agents"
FILES = ("game.css", "game.js")
MOST_EXPORTED = 10_000
"""Recipes of an exported page: about 300 KB, which mail and a slow phone still take."""


def export_game(graph: RecipeGraph, path: Path, *, force: bool = False) -> None:
    """Write a book's game as one file that opens from disk.

    Args:
        graph: recipes of the game.
        path: HTML file to write.
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
    page = _page(graph, policy=policy, style=Markup(style), script=Markup(script))
    with staged_file(path, force=force) as staged:
        staged.write_text(page, encoding="utf-8", newline="\n")


def make_game_app(graph: RecipeGraph, host: str) -> ASGIApp:
    """Return the web application that gives out a book's game.

    Args:
        graph: recipes of the game.
        host: host that the server listens on.

    Raises:
        ConfigError: if the book has no base.
    """
    page = _page(graph, policy="")

    async def game(_: Request) -> Response:
        return HTMLResponse(page, headers={"Cache-Control": "no-cache"})

    files = file_endpoint(PACKAGE, FILES, lambda message: PlainTextResponse(message, 404))
    router = Router([Route("/", game), Route("/files/{name}", files)], redirect_slashes=False)
    return Guard(router, host, (), lambda _, message: message, media_type="text/plain")


def _page(graph: RecipeGraph, **values: Any) -> str:
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
    }
    # Without "<", no label can end the element that holds the book.
    text = json.dumps(book, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    template = make_environment(PACKAGE).get_template("game.html.j2")
    return template.render(name=graph.name, book=Markup(text), **values)
