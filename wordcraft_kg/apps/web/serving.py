"""Serve an application on a port until Ctrl-C."""

import errno
import logging
import os
import socket
import sys
import webbrowser
from collections.abc import Callable

from starlette.types import ASGIApp

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import whole
from wordcraft_kg.runs.run_folder import sigterm_as_interrupt

LARGEST_PORT = 65_535
_TICKS = 10
"""Ticks of uvicorn in a second."""
PATIENCE = 1
"""Seconds to finish requests after Ctrl-C."""
_WAITING = 128
"""Connections that may wait in the system until they are accepted."""
_ACCEPTED_AT_ONCE = 16
"""Connections accepted before older ones are closed: asyncio accepts as many as it lets wait."""


class _Once(logging.Filter):
    """Passes equal messages without traceback once, lest malformed requests fill the terminal."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: set[str] = set()

    def filter(self, record: logging.LogRecord) -> bool:
        # Errors with a traceback always pass: they are faults of the server.
        is_new = record.getMessage() not in self.seen
        self.seen.add(record.getMessage())
        return is_new or record.exc_info is not None


def listen(host: str, port: int) -> socket.socket:
    """Return a listening socket; port 0 takes a free port.

    Raises:
        ConfigError: if the host is unknown, or the port is in use or not permitted.
    """
    whole("port", port, 0, LARGEST_PORT)
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
    except (OSError, UnicodeError):
        raise ConfigError(
            f"`host` '{host}': unknown host; expected an address of this machine, such as "
            "127.0.0.1."
        ) from None
    # asyncio sets TCP_NODELAY only for a named protocol; otherwise a page may wait for 40 ms.
    listening = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen(_WAITING)
    except OSError as error:
        listening.close()
        reasons = {
            errno.EADDRINUSE: (
                "is in use by another program; choose another port (0 selects a free port)"
            ),
            errno.EACCES: "is not permitted for this user; choose a port above 1023",
            errno.EADDRNOTAVAIL: f"cannot be opened: '{host}' is not an address of this machine",
        }
        raise ConfigError(
            f"`port` {port} {reasons.get(error.errno or 0, error.strerror)}."
        ) from None
    return listening


def serve(
    app: ASGIApp,
    listening: socket.socket,
    started: Callable[[str], None],
    *,
    has_lifespan: bool = False,
    has_web_sockets: bool = False,
    in_browser: bool = False,
) -> None:
    """Serve until Ctrl-C or SIGTERM, and finish requests that take no longer than :data:`PATIENCE`.

    The number of connections is bounded and clients have deadlines, see
    :mod:`wordcraft_kg.apps.web.connections`.

    Args:
        app: the ASGI application.
        listening: a listening socket, which is closed at the end.
        started: called with the address when the server is ready.
        has_lifespan: whether the application needs the events of the ASGI lifespan protocol.
        has_web_sockets: whether the application accepts web sockets; needs the package websockets.
        in_browser: open the address in the browser if there is a screen.
    """
    import uvicorn

    from wordcraft_kg.apps.web import connections

    class Server(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            listening.listen(_WAITING)  # asyncio has set the number of connections accepted at once
            # False if the start has failed; a browser that asks earlier shows an error.
            if self.started:
                started(address_of(listening))
                sys.stdout.flush()
                if in_browser:
                    _open_browser(address_of(listening))

        async def on_tick(self, counter: int) -> bool:
            if counter % _TICKS == 0:
                connections.end_overdue(self.server_state.connections)
            return await super().on_tick(counter)

    # A class for each server: the limit of open files is that of the moment.
    class Connection(connections.Connection):
        limit = connections.most_connections()
        web_socket_limit = connections.most_web_sockets()

    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,  # requests are private
        lifespan="on" if has_lifespan else "off",
        http=Connection,
        ws="auto" if has_web_sockets else "none",
        # Messages are short texts: compressing them costs memory for each connection.
        ws_per_message_deflate=False,
        backlog=_ACCEPTED_AT_ONCE,
        timeout_keep_alive=connections.KEEP_ALIVE,
        server_header=False,
        timeout_graceful_shutdown=PATIENCE,
    )
    signal_once = _Once()
    logging.getLogger("uvicorn.error").addFilter(signal_once)
    try:
        with sigterm_as_interrupt():  # the server finishes requests and raises the signal again
            Server(config).run(sockets=[listening])
    except KeyboardInterrupt:
        pass  # the normal end
    finally:
        logging.getLogger("uvicorn.error").removeFilter(signal_once)
        listening.close()


def address_of(listening: socket.socket) -> str:
    """Return the web address of a listening socket, to open in a browser."""
    # An address for all networks is no address to open; this machine is always among them.
    host, port = listening.getsockname()[:2]
    shown = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    return f"http://[{shown}]:{port}" if ":" in shown else f"http://{shown}:{port}"


def _open_browser(address: str) -> None:
    """Open a page in the browser if there is a screen: a text browser would occupy the terminal."""
    screens = ("DISPLAY", "WAYLAND_DISPLAY")
    if sys.platform in ("darwin", "win32") or any(os.environ.get(name) for name in screens):
        webbrowser.open_new_tab(address)
