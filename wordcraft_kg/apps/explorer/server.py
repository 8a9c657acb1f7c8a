"""The site as a web application: addresses to pages, errors, search, and the site's own files."""

import asyncio
import json
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from importlib.resources import files
from typing import Any, TypeVar
from urllib.parse import parse_qsl

import torch
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route, Router
from starlette.types import ASGIApp

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page
from wordcraft_kg.apps.explorer.pages import HOME, PAGES
from wordcraft_kg.apps.explorer.pages.entities import search_entities
from wordcraft_kg.apps.explorer.rendering import Site
from wordcraft_kg.apps.web.guard import Guard
from wordcraft_kg.apps.web.style_sheet import style_sheet
from wordcraft_kg.base.errors import ConfigError, UnknownEntityError, WordCraftKGError
from wordcraft_kg.base.records import as_values

T = TypeVar("T")
KEPT = 2**24
"""Bytes of rendered pages that are kept."""
THREADS = 8
"""Pages made at a time: more threads only wait for each other, fewer may all wait for one value."""
QUIET = 1.0
"""Seconds after the start that belong to the first page alone."""
SCRIPTS = ("explorer.js", "map.js")


def make_app(explored: Explored, host: str = "127.0.0.1", more_hosts: Collection[str] = ()) -> ASGIApp:
    """Return the application for a subject, to listen on a host and answer for further names, too."""
    server = _Server(explored)
    routes = [
        Route("/", server.home),
        Route("/search", server.search),
        Route("/files/{name}", server.file),
        Route("/{name}", server.page),
        Route("/{name}/{subject:path}", server.page),
    ]
    return Guard(Router(routes), host, more_hosts, server.site.error)


class _Server:
    def __init__(self, explored: Explored) -> None:
        self.explored = explored
        self.site = Site(explored, lambda page, state: page.address(state), lambda name: f"/files/{name}")
        self.files = {"explorer.css": (style_sheet(), "text/css")} | {
            name: (text, "text/javascript") for name, text in scripts().items()
        }
        # More of torch's own threads for each of these would only wait for each other: a table has ten rows.
        self._threads = ThreadPoolExecutor(THREADS, "pages", torch.set_num_threads, (1,))
        self._kept: OrderedDict[str, bytes] = OrderedDict()
        self._size = 0
        self._lock = threading.Lock()
        self._page(HOME, "", [])  # so that the first page is there when the address is

    async def home(self, _: Request) -> Response:
        return RedirectResponse(HOME.address(HOME.state()))

    async def file(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in self.files:
            return self._error(404, f"There is no file '{name[:60]}'.")
        text, kind = self.files[name]
        return Response(text, media_type=kind, headers={"Cache-Control": "no-cache"})

    async def search(self, request: Request) -> Response:
        """Return labels and addresses of the entities that a text may mean, as JSON."""
        wanted = request.query_params.get("q", "")[:200]
        found = await self._in_thread(self._suggestions, wanted)
        return _json(list(found.items()))

    async def page(self, request: Request) -> Response:
        name, subject = request.path_params["name"], request.path_params.get("subject", "")
        page = PAGES.get(name)
        if page is None or (subject and not page.subject):
            return self._error(404, f"There is no page '{name[:60]}'.")
        try:
            # Starlette's own parser accepts bytes that are no text, and any number of fields.
            query = parse_qsl(request.url.query, keep_blank_values=True, errors="strict", max_num_fields=200)
        except (ValueError, UnicodeError):
            message = "The address is not well-formed: its query cannot be read as UTF-8 names and values."
            return self._error(400, message)
        return await self._in_thread(self._page, page, subject, query)

    async def _in_thread(self, work: Callable[..., T], *arguments: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._threads, work, *arguments)

    def _page(self, page: Page[Any], subject: str, query: list[tuple[str, str]]) -> Response:
        as_json = ("format", "json") in query
        try:
            state = page.read(subject, [entry for entry in query if entry != ("format", "json")])
            if as_json:
                return _json(as_values(page.view(self.explored, state)))
            if page.is_live(self.explored, state):
                kept, caching = self.site.page(page, state).encode(), "no-store"
            else:
                kept, caching = self._kept_page(page.address(state), lambda: self.site.page(page, state)), "no-cache"
            return Response(kept, media_type="text/html", headers={"Cache-Control": caching})
        except UnknownEntityError as error:
            # Labels that do not fit a path are in the query; an unknown name may also be of a run or a model.
            wanted = (subject if page.subject == "entity" else "") or dict(query).get("entity", "")
            is_other = wanted in self.explored.opened.graph
            return self._error(404, str(error), {} if is_other else self._suggestions(wanted[:200]))
        except ConfigError as error:
            return self._error(400, str(error))
        except WordCraftKGError as error:
            # An opened folder has changed on the disk, or does not allow the question.
            return self._error(409, str(error))

    def _suggestions(self, wanted: str) -> dict[str, str]:
        entity = PAGES["entity"]
        labels = search_entities(self.explored.opened.graph, wanted)
        return {label: entity.address(entity.state(entity=label)) for label in labels}

    def _error(self, status: int, message: str, suggestions: dict[str, str] | None = None) -> Response:
        return Response(self.site.error(status, message, suggestions), status, media_type="text/html")

    def _kept_page(self, address: str, make: Callable[[], str]) -> bytes:
        """Return a page, made if it is not kept; the pages used longest ago are dropped."""
        with self._lock:
            if address in self._kept:
                self._kept.move_to_end(address)
                return self._kept[address]
        page = make().encode()
        with self._lock:
            if address not in self._kept:
                self._kept[address] = page
                self._size += len(page)
            while self._size > KEPT:
                self._size -= len(self._kept.popitem(last=False)[1])
        return page


def warm(explored: Explored) -> threading.Thread:
    """Make the views of the menu's pages in the background, so that their first visitor need not wait for them."""

    def make() -> None:
        time.sleep(QUIET)
        for page in PAGES.values():
            if page.title and page.is_there(explored):
                with suppress(WordCraftKGError):  # errors are reported when the page is opened
                    page.view(explored, page.state())

    thread = threading.Thread(target=make, daemon=True)
    thread.start()
    return thread


def scripts() -> dict[str, str]:
    """Return the site's scripts by file name."""
    folder = files("wordcraft_kg.apps.explorer") / "static"
    return {name: (folder / name).read_text(encoding="utf-8") for name in SCRIPTS}


def _json(values: Any) -> Response:
    return Response(json.dumps(values, ensure_ascii=False), media_type="application/json")
