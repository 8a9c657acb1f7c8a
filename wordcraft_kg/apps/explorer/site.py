"""The site: pages rendered from templates, served on a port, or written as a static folder.

Both ways render the same pages by :class:`Site` and differ only in the addresses of pages.
"""

import json
import os
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

import jinja2
import msgspec
from markupsafe import Markup
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route, Router
from starlette.types import ASGIApp
from threadpoolctl import threadpool_limits

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Addresses, Page, PageState
from wordcraft_kg.apps.explorer.pages import HOME, PAGES
from wordcraft_kg.apps.web.guard import Guard, file_endpoint, static_texts, style_sheet
from wordcraft_kg.base import (
    ConfigError,
    Count,
    Hash,
    Record,
    UnknownEntityError,
    WordCraftKGError,
    as_values,
    dump_json,
    for_html,
    json_text,
    sha256_of,
    staged_folder,
    steps,
    write_atomically,
)
from wordcraft_kg.base.tensors import torch_threads
from wordcraft_kg.evaluation.scores import BECAUSE, main_support, strength
from wordcraft_kg.graphs import RecipeGraph
from wordcraft_kg.models.policies.sources import label_of
from wordcraft_kg.reports.pages import Outline, make_environment
from wordcraft_kg.runs.record import RUN_FILE


@dataclass
class Site:
    """Renders pages.

    Attributes:
        explored: content of the pages.
        address: returns the address of a page; empty where the site does not have it.
        file: returns the address of the site's own files, such as the style sheet, by file name.
        is_static: whether the site has no server, so that pages have no forms.
    """

    explored: Explored
    address: Addresses
    file: Callable[[str], str]
    is_static: bool = False

    @property
    def menu(self) -> list[tuple[Page[Any], str]]:
        """Pages in the menu with something to show, and their addresses."""
        pages = [page for page in PAGES.values() if page.title and page.is_there(self.explored)]
        addresses = [self.address(page, page.state()) for page in pages]
        # A static site lacks the pages that need a server.
        return [entry for entry in zip(pages, addresses, strict=True) if entry[1]]

    def page(self, page: Page[Any], state: PageState) -> str:
        """Return a page as HTML.

        Raises:
            WordCraftKGError: if the settings ask for something that is not there, or a folder has
                changed.
        """
        view = page.view(self.explored, state)
        return self._render(f"{page.name}.html.j2", page, state, view=view)

    def error(self, status: int, message: str) -> str:
        """Return an error page.

        Args:
            status: HTTP status, such as 404.
            message: sentence about the problem; any text, since templates escape it.

        Returns:
            the page as HTML.
        """
        return self._render("error.html.j2", HOME, HOME.state(), status=status, message=message)

    def _render(self, template: str, page: Page[Any], state: PageState, **values: Any) -> str:
        outline = Outline()

        def link(name: str, **fields: Any) -> str:
            return self.address(PAGES[name], PAGES[name].state(**fields))

        def here(**changes: Any) -> str:
            return self.address(page, msgspec.structs.replace(state, **changes))

        def entity(label: str) -> Markup:
            # The chosen model stays chosen on the pages that follow.
            model = getattr(state, "model", "")
            return _anchor(link("entity", entity=label, model=model), label)

        environment = _environment(page.package)
        return environment.get_template(template).render(
            site=self,
            page=page,
            state=state,
            outline=outline,
            heading=outline.heading,
            term=outline.term,
            link=link,
            here=here,
            entity=entity,
            a=_anchor,
            **values,
        )


def _anchor(address: str, text: str) -> Markup:
    """Return a link, or only its text where there is no address."""
    shown = for_html(text)
    # Markup.format escapes the address, for_html the text: both may hold labels from a stranger's
    # book.
    return Markup('<a href="{}">{}</a>').format(address, shown) if address else shown


@cache
def _environment(package: str) -> jinja2.Environment:
    # Charts look as in reports, and templates share their macros. The page's own package comes
    # first, so that a page from outside may replace a shared template; dict.fromkeys drops the
    # explorer's second mention.
    packages = dict.fromkeys(
        (package, HOME.package, "wordcraft_kg.apps.web", "wordcraft_kg.reports")
    )
    environment = make_environment(*packages)
    environment.globals["actions"] = {
        "label_of": label_of,
        "main_support": main_support,
        "strength": strength,
        "because": BECAUSE,
    }
    return environment


# --- served ---------------------------------------------------------------------------------------

PACKAGE = "wordcraft_kg.apps.explorer"
SCRIPTS = ("explorer.js",)


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
        Route("/", lambda _: RedirectResponse(HOME.address(HOME.state()))),
        Route(
            "/files/{name}",
            file_endpoint(PACKAGE, SCRIPTS, lambda message: server.error(404, message)),
        ),
        Route("/{name}", server.page),
        Route("/{name}/{subject:path}", server.page),
    ]
    return Guard(Router(routes), host, more_hosts, server.site.error)


class _Server:
    """Answers requests; Starlette runs the methods in threads."""

    def __init__(self, explored: Explored) -> None:
        self.explored = explored
        self.site = Site(
            explored, lambda page, state: page.address(state), lambda name: f"/files/{name}"
        )
        self.site.page(HOME, HOME.state())  # so that the first page is ready with the address

    def page(self, request: Request) -> Response:
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
            return self.error(
                400,
                "The address is not well-formed: its query cannot be read as UTF-8 names and "
                "values.",
            )
        try:
            state = page.read(subject, [entry for entry in query if entry != ("format", "json")])
            if ("format", "json") in query:
                values = as_values(page.view(self.explored, state))
                return Response(json_text(values), media_type="application/json")
            text = self.site.page(page, state)
        except UnknownEntityError as error:
            return self.error(404, str(error))
        except ConfigError as error:
            return self.error(400, str(error))
        except WordCraftKGError as error:
            # An opened folder has changed on disk, or does not support the query.
            return self.error(409, str(error))
        # Runs in training change, so browsers ask each time.
        return Response(text, media_type="text/html", headers={"Cache-Control": "no-cache"})

    def error(self, status: int, message: str) -> Response:
        return Response(self.site.error(status, message), status, media_type="text/html")


# --- as a static folder ---------------------------------------------------------------------------

LONGEST_NAME = 60
"""Letters of a file name that come from page settings: file systems allow 255 bytes."""


class ExportedSite(Record):
    """A static site (``site.json``).

    Attributes:
        graph: name of the graph.
        graph_hash: content hash of the graph.
        split_hash: hash of the split.
        pages: number of pages.
        models: SHA-256 of each model's weights, by name.
        runs: SHA-256 of each run's record, by name.
        skipped: messages of the errors that took the place of pages, by the page's address.
    """

    graph: str
    graph_hash: Hash
    split_hash: Hash
    pages: Count
    models: dict[str, str]
    runs: dict[str, str]
    skipped: dict[str, str]


def export_site(explored: Explored, out: Path, *, force: bool = False) -> ExportedSite:
    """Write the pages that need no server into a folder, with ``index.html`` as the first.

    A page that cannot be computed becomes a page with the message, so that links to it work.

    Args:
        explored: content of the pages.
        out: folder to write; it appears when all pages are written.
        force: replace the folder if it exists.

    Returns:
        number of pages, hashes of the inputs, and skipped pages, as in ``site.json``.

    Raises:
        OutputExistsError: if the folder exists and ``force`` is False.
    """
    names = _file_names(explored)
    skipped = {}

    def address(page: Page[Any], state: PageState, *, seen_from: str) -> str:
        target = names.get((page.name, state))
        return "" if target is None else _relative(target, seen_from)

    # Pages need small sums alone: threads that wait for each other would take most of the time
    # where other work runs.
    with torch_threads(1), threadpool_limits(1), staged_folder(out, force=force) as folder:
        write_atomically(folder / "explorer.css", style_sheet())
        write_atomically(folder / "search.js", _search_script(explored.opened.graph, names))
        for name, text in static_texts(PACKAGE, SCRIPTS).items():
            write_atomically(folder / name, text)
        for (page, state), name in steps("writing pages", list(names.items())):
            # Links are relative to the file that they are in, so each file has a site of its own.
            site = Site(
                explored,
                partial(address, seen_from=name),
                partial(_relative, to=name),
                is_static=True,
            )
            try:
                text = site.page(PAGES[page], state)
            except WordCraftKGError as error:
                skipped[PAGES[page].address(state)] = _without_paths(str(error), explored)
                text = site.error(404, str(error))
            (folder / name).parent.mkdir(exist_ok=True)
            write_atomically(folder / name, _without_paths(text, explored).encode())
        exported = ExportedSite(
            graph=explored.opened.graph.name,
            graph_hash=explored.opened.graph.hash,
            split_hash=explored.opened.split.hash,
            pages=len(names),
            models={
                name: predictor.model.run.outputs["model.safetensors"]
                for name, predictor in explored.models.items()
            },
            runs={name: sha256_of(path / RUN_FILE) for name, path in explored.runs.items()},
            skipped=skipped,
        )
        write_atomically(folder / "site.json", dump_json(as_values(exported)))
    return exported


def _file_names(explored: Explored) -> dict[tuple[str, PageState], str]:
    """Return the file of each page by page name and settings."""
    # Servers and disks open index.html first, so the first page has no name of its own.
    names: dict[tuple[str, PageState], str] = {(HOME.name, HOME.state()): "index.html"}
    taken = {"index.html"}
    for page in PAGES.values():
        for state in page.states(explored):
            if (page.name, state) not in names:
                name = _unused(f"{page.name}/{_stem(page, state)}", taken)
                names[page.name, state] = name
                taken.add(name)
    return names


def _search_script(graph: RecipeGraph, names: Mapping[tuple[str, PageState], str]) -> str:
    """Return the script with the entities and their files, the most used entities first."""
    by_use = sorted(range(graph.num_entities), key=lambda i: -graph.use_counts[i])
    entity = PAGES["entity"]
    files = {
        label: names.get((entity.name, entity.state(entity=label)))
        for label in graph.labels(by_use)
    }
    entries = [(label, file) for label, file in files.items() if file]
    # A script, not a JSON file: browsers refuse to fetch files for a page that was opened from a
    # disk. ASCII only, so that the file's encoding does not matter.
    return f"window.entities = {json.dumps(entries, ensure_ascii=True)};\n"


def _unused(stem: str, taken: set[str]) -> str:
    """Return a file name that no page has.

    Labels may differ only in characters that file names cannot have.
    """
    name = f"{stem}.html"
    number = 1
    while name in taken:
        number += 1
        name = f"{stem}-{number}.html"
    return name


def _without_paths(text: str, explored: Explored) -> str:
    """Replace folders by names: paths on this machine are private."""
    folders = {
        name: predictor.folder for name, predictor in explored.models.items()
    } | explored.runs
    for name, folder in folders.items():
        # A relative path such as `run` tells nothing, and may be a word of a page.
        if folder.is_absolute():
            text = text.replace(str(folder), name)
            # Pages hold the path as HTML.
            text = text.replace(str(for_html(folder)), str(for_html(name)))
    return text


def _stem(page: Page[Any], state: PageState) -> str:
    """Return a file name from the settings other than the defaults; others may have the same.

    Only lower-case letters and digits: some file systems ignore case, and labels may have any
    characters, such as those that lead to another folder.
    """
    usual = page.state()
    values = [
        str(getattr(state, field))
        for field in state.__struct_fields__
        if getattr(state, field) != getattr(usual, field)
    ]
    plain = re.sub(r"[^a-z0-9]+", "-", "-".join(values).lower()).strip("-")
    # The cut may end with a hyphen.
    return plain[:LONGEST_NAME].strip("-") or page.name


def _relative(file: str, to: str) -> str:
    return os.path.relpath(file, os.path.dirname(to) or ".")
