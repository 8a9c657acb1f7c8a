"""A browser, the site in it, and a page that may not complain about anything."""

import contextlib
import shutil
import threading
import time
from dataclasses import dataclass, field
from typing import Any

import pytest
import uvicorn

from wordcraft_kg.apps.explorer.pages import PAGES
from wordcraft_kg.apps.explorer.site import make_app
from wordcraft_kg.apps.web.serving import address_of, listen

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
ABORTED = "net::ERR_ABORTED"
"""The failure of a request that was given up for the next page."""
PATIENCE = 30_000
"""Milliseconds; nothing takes a tenth of that, unless the machine has much else to do."""


# Of a module, not of the session: while Playwright is there, no other test of the process may run
# an event loop.
@pytest.fixture(scope="module")
def chromium():
    """The system's Chromium."""
    sync_api = pytest.importorskip(
        "playwright.sync_api", reason="needs Playwright: pip install playwright"
    )
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        pytest.skip(f"needs a browser: one of {', '.join(BROWSERS)}")
    with sync_api.sync_playwright() as playwright:
        # Containers allow no sandbox, and have little shared memory.
        options = ["--no-sandbox", "--disable-dev-shm-usage"]
        found = playwright.chromium.launch(executable_path=program, args=options)
        yield found
        found.close()


@contextlib.contextmanager
def served(app):
    """Serve an application on a free port of this machine, and yield its address."""
    listening = listen("127.0.0.1", 0)
    server = uvicorn.Server(uvicorn.Config(app, log_config=None, lifespan="off", ws="none"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    while not server.started and thread.is_alive():
        time.sleep(0.01)
    try:
        yield address_of(listening)
    finally:
        server.should_exit = True
        thread.join(10)
        listening.close()


@pytest.fixture(scope="session")
def site(explored):
    """The kitchen's site."""
    with served(make_app(explored)) as address:
        yield address


@dataclass
class Opened:
    """Opens pages, and remembers console errors, failed requests, refused answers and dialogs."""

    browser: Any
    complaints: list[str] = field(default_factory=list)
    contexts: list[Any] = field(default_factory=list)

    def __call__(self, **options):
        """Return a new page; options are those of a browser's context."""
        context = self.browser.new_context(**options)
        context.set_default_timeout(PATIENCE)
        self.contexts.append(context)
        page = context.new_page()
        complain = self.complaints.append
        page.on(
            "console",
            lambda message: message.type in ("error", "warning") and complain(message.text),
        )
        page.on("pageerror", lambda error: complain(f"error: {error}"))
        page.on(
            "requestfailed",
            lambda request: request.failure != ABORTED and complain(f"failed: {request.url}"),
        )
        page.on(
            "response",
            lambda response: (
                response.status >= 400 and complain(f"{response.status}: {response.url}")
            ),
        )
        page.on("dialog", lambda dialog: (complain(f"dialog: {dialog.message}"), dialog.dismiss()))
        return page


@pytest.fixture
def open_page(chromium):
    """Open pages; at the end there must have been nothing to complain about."""
    opened = Opened(chromium)
    yield opened
    for context in opened.contexts:
        context.close()
    assert not opened.complaints


def addresses(explored):
    """Return an address or two of each page: the first one of a static site, and
    that of an entity."""
    states = []
    for page in PAGES.values():
        if page.is_there(explored):
            states.append((page, next(iter(page.states(explored)), page.state())))
            if "entity" in page.state.__struct_fields__:
                states.append((page, page.state(entity="bread")))
    return list(dict.fromkeys(page.address(state) for page, state in states))


@pytest.fixture
def visits(site, explored):
    """Open an address or two of each page, one after the other."""

    def visits(page):
        for address in addresses(explored):
            page.goto(site + address)
            yield address

    return visits
