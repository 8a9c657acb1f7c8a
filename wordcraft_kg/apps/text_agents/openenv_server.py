"""A server of crafting games for clients of OpenEnv, by its wire protocol.

TRL, verifiers and Inspect connect to such servers. A web socket (``/ws``) is a session, with a game
of its own; HTTP describes the games: ``/health``, ``/metadata``, ``/schema``, and the Task API
below ``/crafting``. OpenEnv itself is not needed here: it wants another version of ``mcp`` than
this package does.
"""

import asyncio
import json
import logging
from collections.abc import Callable, Collection
from contextlib import suppress
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, Router, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from wordcraft_kg import __version__
from wordcraft_kg.apps.text_agents.hosted_games import KeptGames
from wordcraft_kg.apps.text_agents.named_games import GameList
from wordcraft_kg.apps.text_agents.openenv_session import (
    ACTION_SCHEMA,
    OBSERVATION_SCHEMA,
    STATE_SCHEMA,
    CraftingSession,
)
from wordcraft_kg.apps.text_agents.openenv_tasks import NAME, task_routes
from wordcraft_kg.apps.web.guard import LOOPBACK, Guard, foreign_host, is_of_another_site
from wordcraft_kg.base.errors import WordCraftKGError

_FOREIGN = 1008
"""Code with which a web socket of a foreign page is closed."""
_LAST = 1.0
"""Seconds for the last message to a silent client."""
_JSON = "application/json"


class _Sessions:
    """All web sockets of a server: their number and their silence are bounded."""

    def __init__(self, begin: Callable[[], CraftingSession], most: int, idle: float):
        self.begin = begin
        self.most = most
        self.idle = idle
        self.active = 0

    async def serve(self, socket: WebSocket) -> None:
        """Carry the messages of a session until its client leaves, closes it, or is silent."""
        await socket.accept()
        if self.active >= self.most:
            error = f"{self.most:,} sessions are open, the most here; try again later."
            await socket.send_text(_error("CAPACITY_REACHED", error))
            await socket.close()
            return
        self.active += 1
        session = self.begin()
        try:
            await self._converse(socket, session)
        except WebSocketDisconnect:
            # The client has left while it was answered.
            pass
        except TimeoutError:
            error = f"the client was silent for {self.idle:g} seconds; connect again."
            # It may be gone, or read nothing: then nobody hears this.
            with suppress(RuntimeError, TimeoutError, WebSocketDisconnect):
                await asyncio.wait_for(socket.send_text(_error("SESSION_ERROR", error)), _LAST)
                await socket.close()
        finally:
            self.active -= 1
            _end(session)

    async def _converse(self, socket: WebSocket, session: CraftingSession) -> None:
        while True:
            message = await asyncio.wait_for(socket.receive(), self.idle)
            if message["type"] != "websocket.receive":
                return
            answer = _answer(session, message.get("text") or message.get("bytes") or "")
            if answer is None:
                await socket.close()
                return
            await asyncio.wait_for(socket.send_text(answer), self.idle)


def _end(session: CraftingSession) -> None:
    try:
        session.close()
    except OSError as error:
        logging.getLogger(__name__).error("a game's record was not saved: %s", error)


def _answer(session: CraftingSession, message: str | bytes) -> str | None:
    """Return the answer to a message; None to close the session."""
    try:
        asked = json.loads(message)
    except (RecursionError, ValueError):
        asked = None
    if not isinstance(asked, dict):
        return _error("INVALID_JSON", "expected a JSON object with type and data.")
    kind = asked.get("type")
    data = asked.get("data", {})
    if kind == "close":
        return None
    try:
        if kind == "reset" and isinstance(data, dict):
            return json.dumps({"type": "observation", "data": session.reset(data)})
        if kind == "step":
            return json.dumps({"type": "observation", "data": session.step(data)})
        if kind == "state":
            return json.dumps({"type": "state", "data": session.state})
    except WordCraftKGError as error:
        return _error("EXECUTION_ERROR", str(error))
    except OSError as error:
        return _error("EXECUTION_ERROR", f"the game's record was not saved ({error.strerror}).")
    expected = "expected reset with an object as data, step, state or close."
    return _error("UNKNOWN_TYPE", f"type {str(kind)[:60]!r}: {expected}")


def _error(code: str, message: str) -> str:
    return json.dumps({"type": "error", "data": {"message": message, "code": code}})


def make_openenv_app(
    games: GameList,
    *,
    keep: KeptGames | None = None,
    sessions: int = 256,
    idle: float = 900.0,
    host: str = LOOPBACK[0],
    more_hosts: Collection[str] = (),
) -> ASGIApp:
    """Return the server as an ASGI application.

    Args:
        games: the games on offer.
        keep: file for finished games; None records nothing.
        sessions: most sessions at a time; a further client is told so.
        idle: seconds without a message after which a session ends.
        host: address on which the server listens.
        more_hosts: further names by which clients may ask it, such as a proxy's.
    """
    open_sessions = _Sessions(lambda: CraftingSession(games, keep), sessions, idle)
    hosts = {*LOOPBACK, host.lower(), *(name.lower() for name in more_hosts)}
    about = {"name": NAME, "description": "crafting games by text", "version": __version__}
    schemas = {"action": ACTION_SCHEMA, "observation": OBSERVATION_SCHEMA, "state": STATE_SCHEMA}
    facts: dict[str, Any] = {
        "/health": {"status": "healthy"},
        "/metadata": about,
        "/schema": schemas,
    }
    routes = [Route(path, _constant(fact)) for path, fact in facts.items()]
    router = Router([*routes, *task_routes(games), WebSocketRoute("/ws", open_sessions.serve)])
    guarded = Guard(
        router, host, more_hosts, _page, methods=("GET", "HEAD", "POST"), media_type=_JSON
    )

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "websocket":
            await guarded(scope, receive, send)
            return
        socket = WebSocket(scope, receive, send)
        # A page of another site must not play here from its reader's browser.
        if foreign_host(socket.headers, hosts) or is_of_another_site(socket.headers):
            logging.getLogger(__name__).warning("refused a web socket of another site")
            await socket.close(_FOREIGN)
            return
        await router(scope, receive, send)

    return app


def _page(status: int, message: str) -> str:
    return json.dumps({"detail": message})


def _constant(fact: Any) -> Callable[[Request], Response]:
    return lambda request: JSONResponse(fact)
