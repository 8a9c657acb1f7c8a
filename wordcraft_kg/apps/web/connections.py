"""HTTP connections with deadlines, in a bounded number: silent clients cannot occupy a server."""

import asyncio
import sys
from collections.abc import Collection

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

HEADER_WAIT = 30.0
"""Seconds until the header of a request must be complete.

They begin with the connection, or with the end of the last answer. A telephone that loses four
packets in a row needs 15.
"""
BODY_WAIT = 60.0
"""Seconds until the body of a request must be complete, from its header on; forms have < 1 KB."""
READING_WAIT = 60.0
"""Seconds in which a client must take at least one byte of an unsent answer.

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


def most_connections() -> int:
    """Return the maximum number of other connections, at most :data:`MOST_CONNECTIONS`."""
    return min(MOST_CONNECTIONS, most_web_sockets())


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
            waiting = [held for held in http if held._patience() is not None]
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
        patience = self._patience()
        return patience is not None and self.loop.time() - self._silent_since > patience

    def _patience(self) -> float | None:
        """Return the seconds for the client's next step, or None if it is the server's turn."""
        if self.transport.get_write_buffer_size():
            return READING_WAIT
        if self.cycle is None or self.cycle.response_complete:
            return HEADER_WAIT
        return BODY_WAIT if self.cycle.more_body else None


def end_overdue(connections: Collection[object]) -> None:
    """End all connections, as uvicorn lists them, whose clients are overdue."""
    for connection in list(connections):
        if isinstance(connection, Connection) and connection.is_overdue():
            connection.end()
