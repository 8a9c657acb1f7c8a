"""Serving over the standard streams or over HTTP, until the client leaves or somebody ends it."""

import asyncio
import os
import signal
import socket
import sys
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Collection
from concurrent.futures import CancelledError
from contextlib import suppress
from functools import partial
from typing import Any

import anyio
from mcp.server import MCPServer
from mcp.server.stdio import stdio_server
from mcp.server.transport_security import TransportSecuritySettings
from mcp.shared.message import SessionMessage
from mcp_types import PARSE_ERROR, ErrorData, JSONRPCError, jsonrpc_message_adapter
from pydantic import ValidationError
from starlette.types import ASGIApp, Receive, Scope, Send

from wordcraft_kg.apps.web.guard import LONGEST_BODY, LOOPBACK, guarded
from wordcraft_kg.apps.web.serving import serve

PATH = "/mcp"
"""Where the server answers, below its address."""
LONGEST_LINE = 2**20
"""Bytes of a message on stdin."""
_AHEAD = 16
"""Messages that are read before those before them are answered."""
_CHUNK = 2**16


def serve_stdio(server: MCPServer[Any]) -> None:
    """Answer on stdout what comes in on stdin, until that is closed, Ctrl-C or SIGTERM.

    Whatever else is printed meanwhile goes to stderr.
    """
    try:
        with suppress(KeyboardInterrupt, asyncio.CancelledError):
            asyncio.run(_answer_stdin(server))
    except BaseExceptionGroup as group:
        _, others = group.split(BrokenPipeError)  # the client has left without closing stdin
        if others is not None:
            raise


def serve_http(
    server: MCPServer[Any],
    listening: socket.socket,
    host: str,
    more_hosts: Collection[str],
    started: Callable[[str], None],
) -> None:
    """Answer requests over streamable HTTP until Ctrl-C or SIGTERM.

    Args:
        server: the server.
        listening: see :func:`~wordcraft_kg.apps.web.serving.listen`.
        host: the address that it listens on.
        more_hosts: further names that it may be asked by.
        started: called with the address as soon as requests are answered.
    """
    app = make_http_app(server, host, more_hosts)
    serve(app, listening, lambda address: started(address + PATH), has_lifespan=True)


def make_http_app(server: MCPServer[Any], host: str = LOOPBACK[0], more_hosts: Collection[str] = ()) -> ASGIApp:
    """Return a server as an application that answers for a host, for this machine and for further names."""
    names = {*LOOPBACK, host.lower(), *(name.lower() for name in more_hosts)}
    shown = [f"[{name}]" if ":" in name else name for name in sorted(names)]
    hosts = [ending for name in shown for ending in (name, f"{name}:*")]
    app = server.streamable_http_app(
        streamable_http_path=PATH,
        # A call has one answer, and games have ids: neither streams nor sessions are needed.
        json_response=True,
        stateless_http=True,
        max_request_body_size=LONGEST_BODY,
        transport_security=TransportSecuritySettings(
            allowed_hosts=hosts, allowed_origins=[f"{scheme}://{one}" for scheme in ("http", "https") for one in hosts]
        ),
    )
    guard = guarded(app, host, more_hosts, lambda status, said: said, methods=("GET", "HEAD", "POST", "DELETE"))

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        await (app if scope["type"] == "lifespan" else guard)(scope, receive, send)

    return answer


async def _answer_stdin(server: MCPServer[Any]) -> None:
    task = asyncio.current_task()
    assert task is not None
    with suppress(NotImplementedError, RuntimeError, ValueError):  # Windows, or another thread than the first
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, task.cancel)
    messages = _Messages()
    async with stdio_server(stdin=messages) as (incoming, outgoing):  # type: ignore[arg-type]
        messages.answer = outgoing.send
        low = server._lowlevel_server
        await low.run(incoming, outgoing, low.create_initialization_options())


class _Messages:
    """The messages on stdin, line by line; what is none is answered with an error.

    Reading happens in a thread that nobody waits for: one that waits for input cannot be stopped, and Ctrl-C should
    end the server nevertheless.
    """

    def __init__(self) -> None:
        self.answer: Callable[[SessionMessage], Awaitable[None]] | None = None
        self._lines: asyncio.Queue[bytes | None] = asyncio.Queue(_AHEAD)
        self._loop = asyncio.get_running_loop()

    async def __aiter__(self) -> AsyncIterator[str]:
        threading.Thread(target=self._read, daemon=True).start()
        while (line := await self._lines.get()) is not None:
            reason = _fault_of(line)
            if reason is None:
                yield line.decode()
            elif self.answer is not None:
                error = JSONRPCError(jsonrpc="2.0", id=None, error=ErrorData(code=PARSE_ERROR, message=reason))
                with suppress(anyio.ClosedResourceError, anyio.BrokenResourceError):
                    await self.answer(SessionMessage(error))

    def _read(self) -> None:
        rest, read = b"", _stdin_reader()
        try:
            while chunk := read(_CHUNK):
                *lines, rest = (rest + chunk).split(b"\n")
                for line in lines:
                    self._put(line)
                rest = rest[: LONGEST_LINE + 1]  # what is too long is refused, not kept
            self._put(None)
        except (OSError, RuntimeError, CancelledError):
            pass  # the server has ended

    def _put(self, line: bytes | None) -> None:
        if line is None or line.strip():
            asyncio.run_coroutine_threadsafe(self._lines.put(line), self._loop).result()


def _stdin_reader() -> Callable[[int], bytes]:
    """Return what reads some bytes of stdin, without a lock that the end of the program would wait for."""
    if sys.stdin is None:
        return lambda size: b""
    try:
        return partial(os.read, sys.stdin.fileno())
    except (OSError, ValueError):  # it is no file
        return sys.stdin.buffer.read


def _fault_of(line: bytes) -> str | None:
    """Return why a line is no message; None if it is one."""
    if len(line) > LONGEST_LINE:
        return f"Parse error: the line is longer than {LONGEST_LINE:,} bytes"
    try:
        jsonrpc_message_adapter.validate_json(line.decode(), by_name=False)
    except UnicodeDecodeError:
        return "Parse error: the line is not UTF-8"
    except (ValidationError, ValueError, RecursionError):
        return "Parse error: the line is not a JSON-RPC message"
    return None
