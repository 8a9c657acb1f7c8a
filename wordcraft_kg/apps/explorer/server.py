"""The site as a web application."""

import asyncio
import os
import sys
import threading
import time
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import lru_cache
from typing import Any, TypeVar
from urllib.parse import parse_qsl

import torch
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route, Router
from starlette.types import ASGIApp

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.apps.explorer.pages import HOME, PAGES
from wordcraft_kg.apps.explorer.pages.entities import search_entities
from wordcraft_kg.apps.explorer.rendering import Site
from wordcraft_kg.apps.web.guard import Guard, file_endpoint
from wordcraft_kg.base.artefacts import json_text
from wordcraft_kg.base.errors import ConfigError, UnknownEntityError, WordCraftKGError
from wordcraft_kg.base.records import as_values

T = TypeVar("T")
PACKAGE = "wordcraft_kg.apps.explorer"
SCRIPTS = ("explorer.js",)
_KEPT = 256
"""Rendered pages in memory, 50 KB each."""
_THREADS = 8
"""Concurrently rendered pages: more threads compete, fewer may all wait for one value."""
_THREAD_NAME = "pages"
"""Beginning of the names of all threads that compute pages."""
_QUIET = 1.0
"""Seconds after the start, reserved for the first page."""


def make_app(
    explored: Explored, host: str = "127.0.0.1", more_hosts: Collection[str] = ()
) -> ASGIApp:
    """Return the web application for this content.

    Args:
        explored: the content of all pages.
        host: name or address of this host; requests that name another host are refused, so that
            a foreign web page cannot read the answers (DNS rebinding).
        more_hosts: further names under which the server is reached, as behind a proxy.

    Returns:
        an ASGI application, for uvicorn or a test client.
    """
    server = _Server(explored)
    routes = [
        Route("/", server.home),
        Route("/search", server.search),
        Route(
            "/files/{name}",
            file_endpoint(PACKAGE, SCRIPTS, lambda message: server.error(404, message)),
        ),
        Route("/{name}", server.page),
        Route("/{name}/{subject:path}", server.page),
    ]
    return Guard(Router(routes), host, more_hosts, server.site.error)


class _Server:
    def __init__(self, explored: Explored) -> None:
        self.explored = explored
        self.site = Site(
            explored, lambda page, state: page.address(state), lambda name: f"/files/{name}"
        )
        # More torch threads would only compete: a table has ten rows.
        self._threads = ThreadPoolExecutor(_THREADS, _THREAD_NAME, torch.set_num_threads, (1,))
        self._kept = lru_cache(_KEPT)(self._rendered)
        self._page(HOME, "", [])  # so that the first page is ready with the address

    async def home(self, _: Request) -> Response:
        return RedirectResponse(HOME.address(HOME.state()))

    async def search(self, request: Request) -> Response:
        matches = await self._in_thread(self._suggestions, request.query_params.get("q", "")[:200])
        return _json(list(matches.items()))

    async def page(self, request: Request) -> Response:
        name = request.path_params["name"]
        subject = request.path_params.get("subject", "")
        page = PAGES.get(name)
        if page is None or (subject and not page.subject):
            return self.error(404, f"The page '{name[:60]}' does not exist.")
        try:
            # The parser of Starlette accepts invalid bytes and any number of fields.
            query = parse_qsl(
                request.url.query, keep_blank_values=True, errors="strict", max_num_fields=200
            )
        except (ValueError, UnicodeError):
            message = (
                "The address is not well-formed: its query cannot be read as UTF-8 names and "
                "values."
            )
            return self.error(400, message)
        return await self._in_thread(self._page, page, subject, query)

    async def _in_thread(self, work: Callable[..., T], *arguments: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._threads, work, *arguments)

    def _page(self, page: Page[Any], subject: str, query: list[tuple[str, str]]) -> Response:
        as_json = ("format", "json") in query
        try:
            state = page.read(subject, [entry for entry in query if entry != ("format", "json")])
            if as_json:
                return _json(as_values(page.view(self.explored, state)))
            is_live = page.is_live(self.explored, state)
            text = self._rendered(page, state) if is_live else self._kept(page, state)
            headers = {"Cache-Control": "no-store" if is_live else "no-cache"}
            return Response(text, media_type="text/html", headers=headers)
        except UnknownEntityError as error:
            # Labels that do not fit a path are in the query; the unknown name may also be a run or
            # a model.
            label = (subject if page.subject == "entity" else "") or dict(query).get("entity", "")
            is_other = label in self.explored.opened.graph
            return self.error(404, str(error), {} if is_other else self._suggestions(label[:200]))
        except ConfigError as error:
            return self.error(400, str(error))
        except WordCraftKGError as error:
            # An opened folder has changed on disk, or does not support the query.
            return self.error(409, str(error))

    def _suggestions(self, wanted: str) -> dict[str, str]:
        entity = PAGES["entity"]
        labels = search_entities(self.explored.opened.graph, wanted)
        return {label: entity.address(entity.state(entity=label)) for label in labels}

    def error(
        self, status: int, message: str, suggestions: dict[str, str] | None = None
    ) -> Response:
        return Response(
            self.site.error(status, message, suggestions), status, media_type="text/html"
        )

    def _rendered(self, page: Page[Any], state: PageState) -> bytes:
        return self.site.page(page, state).encode()


def warm(explored: Explored) -> threading.Thread:
    """Compute all menu pages' values in the background, for the first visitor."""

    def make() -> None:
        time.sleep(_QUIET)
        for page in PAGES.values():
            if page.title and page.is_there(explored):
                with suppress(WordCraftKGError):  # errors are reported when the page is opened
                    page.view(explored, page.state())

    thread = threading.Thread(target=make, name=f"{_THREAD_NAME}-first", daemon=True)
    thread.start()
    return thread


def end_process() -> None:
    """End the process with exit code 0, if threads have computed pages, without waiting for them.

    A thread in torch cannot be interrupted, and Python would wait for its page. Nothing is lost:
    the server writes no files.
    """
    if any(thread.name.startswith(_THREAD_NAME) for thread in threading.enumerate()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)


def _json(values: Any) -> Response:
    return Response(json_text(values), media_type="application/json")
