"""Serve an application on a port until Ctrl-C."""

import asyncio
import errno
import os
import socket
import sys
import webbrowser
from collections.abc import Callable

import h11
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from wordcraft_kg.base import ConfigError, whole
from wordcraft_kg.runs.run_folder import sigterm_as_interrupt

CLIENT_WAIT = 60.0
"""Seconds for a client's next step: a whole header, a whole body, or a byte of an unsent answer.

Slow clients may take any time in all.
"""
KEEP_ALIVE = 5
"""Seconds until an idle connection is closed; browsers then open another."""
MOST_CONNECTIONS = 512
"""Maximum number of connections, if the limit of open files allows."""
_OTHER_FILES = 64
"""Open files kept for the program, such as a database and its log."""
_BUSY = b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"


def most_web_sockets() -> int:
    """Return the maximum number of web sockets: a third of the permitted open files.

    Another third is for other connections. New connections are accepted in bursts, before old
    connections are closed: they need files as well.
    """
    if sys.platform == "win32":  # sockets are not files there
        return sys.maxsize
    import resource

    soft_limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft_limit == resource.RLIM_INFINITY:
        return sys.maxsize
    return max((soft_limit - _OTHER_FILES) // 3, 8)


class Connection(H11Protocol):
    """A connection that is closed if its client makes the server wait, or its place is needed.

    At the limit, the connection whose client has been silent for longest gives way, so that a
    visitor is served while others hold connections open. A connection whose answer is being
    computed never gives way.

    Attributes:
        limit: maximum number of connections of a server.
        web_socket_limit: maximum number of web sockets; a further one is refused by status 503.
        connections: the server's open connections, a set that all of them share.
    """

    limit = MOST_CONNECTIONS
    web_socket_limit = sys.maxsize
    connections: "set[Connection]"  # type: ignore[assignment]

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin a connection, and end another if there are too many."""
        super().connection_made(transport)
        self._silent_since = self.loop.time()
        self._unsent = 0
        # A web socket leaves this class, but stays in the set.
        http = [held for held in self.connections if isinstance(held, Connection)]
        if len(http) > self.limit:
            # The new connection waits for its client as well, so there is always one.
            waiting = [held for held in http if held._waits_for_client()]
            min(waiting, key=lambda held: held._silent_since).end()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Let a web socket leave this class, or refuse it if there are too many."""
        web_sockets = [
            connection for connection in self.connections if not isinstance(connection, Connection)
        ]
        if len(web_sockets) < self.web_socket_limit:
            super().handle_websocket_upgrade(event)
            return
        self.transport.write(_BUSY)
        self.transport.close()

    def data_received(self, data: bytes) -> None:
        """Read a part of a request; the time for its body begins with the end of its header."""
        request_before = self.cycle
        super().data_received(data)
        # Single bytes of a header do not begin the time anew, or a client could send one a minute.
        if self.cycle is not request_before:
            self._silent_since = self.loop.time()

    def on_response_complete(self) -> None:
        """Begin to wait for the next request."""
        self._silent_since = self.loop.time()
        super().on_response_complete()

    def end(self) -> None:
        """Close the connection at once, and free its place at once: the transport closes later."""
        self.connections.discard(self)
        self.transport.abort()

    def is_overdue(self) -> bool:
        """Whether the client has made the server wait for too long; call about once a second."""
        unsent = self.transport.get_write_buffer_size()
        if unsent < self._unsent:
            self._silent_since = self.loop.time()  # the client is reading
        self._unsent = unsent
        return self._waits_for_client() and self.loop.time() - self._silent_since > CLIENT_WAIT

    def _waits_for_client(self) -> bool:
        """Whether the client has the next step, and not the server."""
        has_unsent = self.transport.get_write_buffer_size() > 0
        is_between_requests = self.cycle is None or self.cycle.response_complete
        return has_unsent or is_between_requests or self.cycle.more_body


_TICKS = 10
"""Ticks of uvicorn in a second."""
PATIENCE = 1
"""Seconds to finish requests after Ctrl-C."""
_WAITING = 128
"""Connections that may wait in the system until they are accepted."""
_ACCEPTED_AT_ONCE = 16
"""Connections accepted before older ones are closed: asyncio accepts as many as it lets wait."""


def listen(host: str, port: int) -> socket.socket:
    """Return a listening socket; port 0 takes a free port.

    Raises:
        ConfigError: if the host is unknown, or the port is in use or not permitted.
    """
    whole("port", port, 0, 65_535)
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
    except (OSError, UnicodeError):
        raise ConfigError(
            f"`host` '{host}': unknown host; expected an address of this machine, such as "
            "127.0.0.1."
        ) from None
    is_dualstack = family == socket.AF_INET6 and socket.has_dualstack_ipv6()
    try:
        bound = socket.create_server(
            (host, port), family=family, backlog=_WAITING, dualstack_ipv6=is_dualstack
        )
    except OSError as error:
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
    # asyncio sets TCP_NODELAY only for a named protocol; otherwise a page may wait for 40 ms.
    return socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP, fileno=bound.detach())


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
    :mod:`wordcraft_kg.apps.web.serving`.

    Args:
        app: the ASGI application.
        listening: a listening socket, which is closed at the end.
        started: called with the address when the server is ready.
        has_lifespan: whether the application needs the events of the ASGI lifespan protocol.
        has_web_sockets: whether the application accepts web sockets; needs the package websockets.
        in_browser: open the address in the browser if there is a screen.
    """
    import uvicorn

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
                for connection in list(self.server_state.connections):
                    if isinstance(connection, Connection) and connection.is_overdue():
                        connection.end()
            return await super().on_tick(counter)

    # A class for each server: the limit of open files is that of the moment.
    class LimitedConnection(Connection):
        limit = min(MOST_CONNECTIONS, most_web_sockets())
        web_socket_limit = most_web_sockets()

    config = uvicorn.Config(
        app,
        log_config=None,
        log_level="error",  # a warning for each malformed request would fill the terminal
        access_log=False,  # requests are private
        lifespan="on" if has_lifespan else "off",
        http=LimitedConnection,
        ws="auto" if has_web_sockets else "none",
        # Messages are short texts: compressing them costs memory for each connection.
        ws_per_message_deflate=False,
        backlog=_ACCEPTED_AT_ONCE,
        timeout_keep_alive=KEEP_ALIVE,
        server_header=False,
        timeout_graceful_shutdown=PATIENCE,
    )
    try:
        with sigterm_as_interrupt():  # the server finishes requests and raises the signal again
            Server(config).run(sockets=[listening])
    except KeyboardInterrupt:
        pass  # the normal end
    finally:
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
