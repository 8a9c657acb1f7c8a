"""The guard for web applications: permitted hosts and sites, request sizes, and error pages."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Collection
from contextlib import suppress
from importlib.resources import files
from urllib.parse import SplitResult, urlsplit

from h11 import LocalProtocolError
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from wordcraft_kg.base import WordCraftKGError, for_terminal
from wordcraft_kg.reports.pages import make_environment

POLICY = (
    "default-src 'none'; style-src 'self'; script-src 'self'; img-src 'self' data:; connect-src "
    "'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
"""Only local files are loaded and run, even with hostile labels."""
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    # With no-referrer, browsers would send "Origin: null" with local forms as well.
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
LONGEST_ADDRESS = 8_192
"""Bytes for path and query."""
LONGEST_BODY = 65_536
"""Bytes of a request's body: more than any form."""
LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Names of this machine, which are always permitted: no other machine can answer to them."""
_FOREIGN = 1008
"""Code with which a web socket of a foreign page is closed."""
WENT_WRONG = "Something went wrong. Please reload the page; the server's terminal has the reason."
"""Shown for an error of the server: the reason is for the person at the terminal."""


class Guard:
    """Refuses requests of other sites and of excessive size; shows errors without internals.

    A page of another site may let its own name point to this machine (DNS rebinding); its Host
    header gives the page away. A form of another site is known by its Origin header.
    """

    def __init__(
        self,
        app: ASGIApp,
        host: str,
        more_hosts: Collection[str],
        error_page: Callable[[int, str], str],
        *,
        methods: Collection[str] = ("GET", "HEAD"),
        media_type: str = "text/html",
    ):
        """Guard an application.

        Args:
            app: an application that lets errors through, such as a Router: Starlette's own class
                answers errors itself.
            host: host that the server listens on.
            more_hosts: further permitted host names, as behind a proxy.
            error_page: returns the HTML of an error from status and message.
            methods: permitted HTTP methods.
            media_type: type of the error pages.
        """
        self.app = app
        self.error_page = error_page
        self.methods = methods
        self.media_type = media_type
        self.hosts = {*LOOPBACK, host.lower(), *(name.lower() for name in more_hosts)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or let a web socket pass."""
        if scope["type"] == "websocket":
            headers = Headers(scope=scope)
            # A page of another site must not play here from its reader's browser.
            if _host_of(headers) not in self.hosts or is_of_another_site(headers):
                logging.getLogger(__name__).warning("refused a web socket of another site")
                await WebSocket(scope, receive, send).close(_FOREIGN)
                return
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        guarded = _Sender(send)
        refusal = self._refusal(scope) or await self._served(scope, receive, guarded)
        if refusal is None:
            return
        status, message = refusal
        response = Response(self.error_page(status, message), status, media_type=self.media_type)
        with suppress(LocalProtocolError):
            await response(scope, receive, guarded)

    async def _served(
        self, scope: Scope, receive: Receive, send: "_Sender"
    ) -> tuple[int, str] | None:
        """Let the application answer; return status and message if an error page is needed."""
        try:
            await self.app(scope, _limited(receive), send)
        except HTTPException as error:
            return error.status_code, error.detail
        except asyncio.CancelledError:
            # The server stops. A begun answer cannot become an error page any more.
            if send.has_begun:
                return None
            return 503, "The server is stopping. Please reload the page later."
        except WordCraftKGError as error:
            logging.getLogger(__name__).error("%s", error)
            return 500, WENT_WRONG
        except LocalProtocolError:
            return None  # the server has answered a malformed request itself
        except Exception:
            # The first part only: what follows may be a person's session code, and logs are kept.
            page = for_terminal(f"/{scope['path'].split('/')[1][:200]}")
            logging.getLogger(__name__).exception("error in a request for %s", page)
            if send.has_begun:  # let the server cut the answer, so that it is not taken for whole
                raise
            return 500, WENT_WRONG
        return None

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        """Return status and message if a request is refused; None if it may pass."""
        headers = Headers(scope=scope)
        host = _host_of(headers)
        if host not in self.hosts:
            return 421, f"This server does not accept requests for the host '{host[:60]}'."
        if scope["method"] not in self.methods:
            return 405, f"The method {scope['method'][:20]} is not allowed here."
        if scope["method"] == "POST" and is_of_another_site(headers):
            return 403, "This form was sent from another site. Please open the page on this site."
        length = len(scope.get("raw_path", b"")) + len(scope["query_string"])
        if length > LONGEST_ADDRESS:
            return 414, f"The address is too long (limit: {LONGEST_ADDRESS:,} bytes)."
        return None


def _host_of(headers: Headers) -> str:
    """Return the host that a request names; empty for an address that cannot be read."""
    return _split(f"//{headers.get('host', '')}").hostname or ""


def is_of_another_site(headers: Headers) -> bool:
    """Return whether a page of another site sent a form, or opens a web socket.

    Browsers send an Origin with both; programs without one cannot be lured.
    """
    origin = headers.get("origin")
    # Compare the port, too: another program on this machine is another site.
    return origin is not None and _split(origin).netloc != headers.get("host")


class _Sender:
    """Sends an answer with the headers of the guard.

    Attributes:
        has_begun: whether the status was sent, after which the answer can only be cut.
    """

    def __init__(self, send: Send):
        self.send = send
        self.has_begun = False

    async def __call__(self, message: Message) -> None:
        """Send a message; the first one of an answer carries the headers."""
        if message["type"] == "http.response.start":
            self.has_begun = True
            MutableHeaders(scope=message).update(HEADERS)
        await self.send(message)


def _limited(receive: Receive) -> Receive:
    """Return a receiver that counts the bytes, since a Content-Length may be missing or wrong."""
    received = 0

    async def limited() -> Message:
        nonlocal received
        message = await receive()
        received += len(message.get("body", b""))
        if received > LONGEST_BODY:
            raise HTTPException(413, f"The request is too large (limit: {LONGEST_BODY:,} bytes).")
        return message

    return limited


def _split(address: str) -> SplitResult:
    try:
        return urlsplit(address)
    except ValueError:
        return urlsplit("")


def style_sheet() -> str:
    """Return the style sheet for reports, extended for sites."""
    environment = make_environment("wordcraft_kg.apps.web", "wordcraft_kg.reports")
    return environment.get_template("explorer.css.j2").render()


def static_texts(package: str, names: Collection[str]) -> dict[str, str]:
    """Return texts from the folder ``static`` of a package, by name."""
    folder = files(package) / "static"
    return {name: (folder / name).read_text(encoding="utf-8") for name in names}


def file_endpoint(
    package: str, names: Collection[str], missing: Callable[[str], Response]
) -> Callable[[Request], Awaitable[Response]]:
    """Return the endpoint for ``/files/{name}``: the style sheet and static files.

    The files are read once. A name is only a key among them, never a path, so no other file of the
    machine can be asked for.

    Args:
        package: package with the folder ``static``.
        names: names of the static files.
        missing: returns the answer for another name, from a message.
    """
    texts = {"explorer.css": style_sheet(), **static_texts(package, names)}

    async def file(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in texts:
            return missing(f"The file '{name[:60]}' does not exist.")
        kind = "text/css" if name.endswith(".css") else "text/javascript"
        # no-cache lets browsers keep a file, but ask each time: another version has other files.
        return Response(texts[name], media_type=kind, headers={"Cache-Control": "no-cache"})

    return file
