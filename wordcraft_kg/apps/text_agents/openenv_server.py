"""A server of crafting games for clients of OpenEnv, by its wire protocol.

TRL, verifiers and Inspect connect to such servers. A web socket (``/ws``) is a session, with a game
of its own; HTTP describes the games: ``/health``, ``/metadata``, ``/schema``, ``/openapi.json``,
and the Task API below ``/crafting``. It has no sessions: ``/reset`` answers with the beginning of a
game, and ``/step`` and ``/mcp`` say where to play it. OpenEnv itself is not needed here: it wants
another version of ``mcp`` than this package does.

:class:`CraftingSession` answers one client, and knows nothing of connections.
"""

import asyncio
import json
import logging
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, Router, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from wordcraft_kg import __version__
from wordcraft_kg.apps.text_agents.conversation import Conversation, Seat
from wordcraft_kg.apps.text_agents.plays import GameList, Play
from wordcraft_kg.apps.text_agents.results import Keep
from wordcraft_kg.apps.web.guard import LOOPBACK, Guard
from wordcraft_kg.base import (
    MAX_SIZE,
    ActionError,
    ConfigError,
    WordCraftKGError,
    whole,
)

_LAST = 1.0
"""Seconds for the last message to a silent client."""
LONGEST_ANSWER = 100_000
"""Characters at the end of an answer that are read: only its last line counts."""
_RESET = ("seed", "episode_id", "split", "index", "task_id")
_STEP = ({"answer"}, {"first", "second"}, {"items"}, {"look_up"})
# A client for language models shows this schema to the model, so it is a prompt.
ACTION_SCHEMA: dict[str, Any] = {
    "title": "CraftingAction",
    "type": "object",
    "required": ["answer"],
    "properties": {
        "answer": {
            "type": "string",
            "description": "text whose last line names two items, such as 'water + earth'",
        }
    },
    "additionalProperties": False,
}
_TEXT = {"type": "string"}
_WHOLE = {"type": "integer"}
OBSERVATION_SCHEMA: dict[str, Any] = {
    "title": "CraftingObservation",
    "type": "object",
    "properties": {
        "text": {**_TEXT, "description": "first the rules, then the reply; always the state"},
        "goal": _TEXT,
        "table": {"type": "array", "items": _TEXT},
        "attempts_left": _WHOLE,
        "task_id": {**_TEXT, "description": "name of the game"},
    },
}
STATE_SCHEMA: dict[str, Any] = {
    "title": "CraftingState",
    "type": "object",
    "properties": {"episode_id": {"type": ["string", "null"]}, "step_count": _WHOLE},
}
_BY_SOCKET = "HTTP has no sessions: send reset and step to the web socket /ws."
_NO_MCP = {
    "jsonrpc": "2.0",
    "id": None,
    "error": {"code": -32601, "message": f"{_BY_SOCKET} `wordcraft-kg mcp` serves tools by MCP."},
}
NAME = "crafting"
"""Name of the environment, as in the addresses."""
_KINDS = {"valid": "validation"}
"""OpenEnv's names of parts, where they differ from ours."""


class CraftingSession(Seat):
    """The games of a client, one at a time.

    Attributes:
        games: the games on offer.
    """

    def __init__(self, games: GameList, keep: Keep | None = None):
        """Wait for :meth:`reset`.

        Args:
            games: the games on offer.
            keep: records finished games; None records nothing.
        """
        self.games = games
        self._keep = keep
        self._episode: str | None = None
        self._steps = 0

    def reset(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Begin a game, and end the one before.

        Args:
            arguments: ``task_id``, the name of a game; or ``split`` and ``index``, with ``seed``
                as the distractor seed (0 by default); or neither: then ``seed`` draws the game, and
                without a seed the system does. ``episode_id`` is only repeated in the state.

        Returns:
            the first observation; its text has the rules.

        Raises:
            ConfigError: for another argument, a value out of range, or a game that is not offered.
            OSError: if the game before cannot be recorded: no other may begin until it is.
        """
        unknown = sorted(arguments.keys() - {*_RESET})
        if unknown:
            raise ConfigError(f"reset has no argument '{unknown[0][:60]}': {', '.join(_RESET)}.")
        play, task, distractor_seed = self._chosen(
            {key: value for key, value in arguments.items() if value is not None}
        )
        # Begun before the last game ends: a refused reset changes nothing.
        talk = play.begin(task, distractor_seed)
        self.close()
        talk.on_end = self._keep
        self.talk = talk
        episode = arguments.get("episode_id")
        self._episode = None if episode is None else str(episode)[:255]
        self._steps = 0
        return _observation(talk, talk.opening, reward=None)

    def step(self, action: Any) -> dict[str, Any]:
        """Act in the game; an invalid answer is part of the game, and no error.

        Args:
            action: ``answer``, a text as in all conversations; or ``first`` and ``second``, two
                items; or ``items``, a list of a set; or ``look_up``, an item. A number is taken for
                its text.

        Returns:
            the observation. After the end of the game an action changes nothing.

        Raises:
            ActionError: for an object with other keys.
            EpisodeError: before :meth:`reset`.
        """
        if not isinstance(action, dict) or action.keys() - {"metadata"} not in _STEP:
            raise ActionError('the action must be {"answer": "first + second"}.')
        talk = self._begun
        if talk.is_over:
            return _observation(talk, talk.after_the_end, reward=0.0)
        self._steps += 1
        if "answer" in action:
            reply = talk.hear(_text(action["answer"])[-LONGEST_ANSWER:])
        elif "look_up" in action:
            reply = talk.look_up_item(_text(action["look_up"]))
        else:
            items = action.get("items", [action.get("first"), action.get("second")])
            reply = talk.combine(*map(_text, items if isinstance(items, list) else [items]))
        return _observation(talk, reply, reward=talk.reward)

    @property
    def state(self) -> dict[str, Any]:
        """OpenEnv's state: the episode's id and the number of actions."""
        return {"episode_id": self._episode, "step_count": self._steps}

    def close(self) -> None:
        """End the game, as its client leaves: on a track, a game that was begun counts as it is."""
        talk = self.talk
        if talk is None:
            return
        # Otherwise a client could leave each game that goes wrong, and begin it again.
        is_counted = talk.is_over or (self.games.is_track and self._steps)
        if not is_counted:
            talk.on_end = None
        # Of a game that is over, this tries again what a full disk has refused.
        talk.end()

    def _chosen(self, arguments: dict[str, Any]) -> tuple[Play, int, int]:
        """Return the games, the task in them and the distractor seed that a client asks for."""
        if "task_id" in arguments:
            return self.games.named(arguments["task_id"])
        part = arguments.get("split", next(iter(self.games.plays)))
        if "seed" in arguments:
            whole("seed", arguments["seed"], 0, MAX_SIZE)
        if "index" in arguments:
            return *self.games.at(part, arguments["index"]), arguments.get("seed", 0)
        # A generator of its own for each call: a seed always draws the same game.
        rng = np.random.default_rng(arguments.get("seed"))
        index = int(rng.integers(self.games.count(part)))
        return *self.games.at(part, index), int(rng.integers(MAX_SIZE))


def _observation(talk: Conversation, text: str, *, reward: float | None) -> dict[str, Any]:
    game = talk.game
    observation = {
        "text": text,
        "goal": game.goal,
        "table": list(game.labels),
        "attempts_left": game.attempts_left,
        "task_id": talk.name,
    }
    metadata = {
        "success": game.is_made,
        "by_plan": game.by_plan,
        "invalid_actions": talk.invalid_actions,
        "look_ups": talk.look_ups,
    }
    return {
        "observation": observation,
        "reward": reward,
        "done": talk.is_over,
        "metadata": metadata,
    }


def _text(value: Any) -> str:
    """Return an answer as text: models also write numbers and lists, which the grammar reads."""
    return value if isinstance(value, str) else json.dumps(value)


class _Sessions:
    """All web sockets of a server: their number and their silence are bounded."""

    def __init__(self, begin: Callable[[], CraftingSession], max_sessions: int, idle: float):
        self.begin = begin
        self.most = max_sessions
        self.idle = idle
        self.active = 0

    async def serve(self, socket: WebSocket) -> None:
        """Carry the messages of a session until its client leaves, closes it, or is silent."""
        await socket.accept()
        if self.active >= self.most:
            await socket.send_text(
                _error("CAPACITY_REACHED", f"{self.most:,} sessions are open, the most here.")
            )
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
            reason = f"silent for {self.idle:g} seconds; connect again"
            # It may be gone, or read nothing: then nobody hears this.
            with suppress(RuntimeError, TimeoutError, WebSocketDisconnect):
                await asyncio.wait_for(socket.close(reason=reason), _LAST)
        finally:
            self.active -= 1
            try:
                session.close()
            except OSError as error:
                logging.getLogger(__name__).error("a game's record was not saved: %s", error)

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


def _answer(session: CraftingSession, message: str | bytes) -> str | None:
    """Return the answer to a message; None to close the session."""
    try:
        request = json.loads(message)
    except (RecursionError, ValueError):
        request = None
    if not isinstance(request, dict):
        return _error("INVALID_JSON", "expected a JSON object with type and data.")
    kind = request.get("type")
    data = request.get("data", {})
    if kind == "close":
        return None
    try:
        if kind == "reset" and isinstance(data, dict):
            answer = session.reset(data)
        elif kind == "step":
            answer = session.step(data)
        elif kind == "state":
            answer = session.state
        else:
            return _error(
                "UNKNOWN_TYPE",
                f"type {str(kind)[:60]!r}: expected reset with an object as data, step, state or "
                "close.",
            )
    except WordCraftKGError as error:
        return _error("EXECUTION_ERROR", str(error))
    except OSError as error:
        return _error("EXECUTION_ERROR", f"the game's record was not saved ({error.strerror}).")
    return json.dumps({"type": "state" if kind == "state" else "observation", "data": answer})


def _error(code: str, message: str) -> str:
    return json.dumps({"type": "error", "data": {"message": message, "code": code}})


def make_openenv_app(
    games: GameList,
    *,
    keep: Keep | None = None,
    sessions: int = 256,
    idle: float = 900.0,
    host: str = LOOPBACK[0],
    more_hosts: Collection[str] = (),
) -> ASGIApp:
    """Return the server as an ASGI application.

    Args:
        games: the games on offer.
        keep: records finished games; None records nothing.
        sessions: most sessions at a time; a further client is told so.
        idle: seconds without a message after which a session ends.
        host: address on which the server listens.
        more_hosts: further names by which clients may ask it, such as a proxy's.
    """
    open_sessions = _Sessions(lambda: CraftingSession(games, keep), sessions, idle)
    facts: dict[str, Any] = {
        "/health": {"status": "healthy"},
        "/metadata": {
            "name": NAME,
            "description": "crafting games by text",
            "version": __version__,
        },
        "/schema": {
            "action": ACTION_SCHEMA,
            "observation": OBSERVATION_SCHEMA,
            "state": STATE_SCHEMA,
        },
        "/state": CraftingSession(games).state,
        "/list_environments": [NAME],
        f"/{NAME}/splits": [{"name": part, "type": _KINDS.get(part, part)} for part in games.plays],
    }
    routes = [Route(path, _constant(fact)) for path, fact in facts.items()]
    routes += [
        Route("/step", _constant({"detail": _BY_SOCKET}, 409), methods=["POST"]),
        Route("/mcp", _constant(_NO_MCP), methods=["POST"]),
    ]
    for path, find in _QUERIES.items():
        routes.append(Route(path, _endpoint(games, find), methods=["POST"]))
    routes.append(Route("/openapi.json", _constant(_openapi(routes))))
    return Guard(
        Router([*routes, WebSocketRoute("/ws", open_sessions.serve)]),
        host,
        more_hosts,
        lambda _, message: json.dumps({"detail": message}),
        methods=("GET", "HEAD", "POST"),
        media_type="application/json",
    )


def _constant(fact: Any, status: int = 200) -> Callable[[Request], Response]:
    return lambda request: JSONResponse(fact, status)


def _openapi(routes: list[Route]) -> dict[str, Any]:
    """Return the addresses as an OpenAPI document, by which clients recognise the protocol."""
    answer = {"responses": {"200": {"description": "a JSON object"}}}
    return {
        "openapi": "3.1.0",
        "info": {"title": NAME, "version": __version__},
        "paths": {
            route.path: {
                method.lower(): answer for method in sorted((route.methods or set()) - {"HEAD"})
            }
            for route in routes
        },
    }


def _task(games: GameList, part: str, index: Any) -> dict[str, Any]:
    play, task = games.at(part, index)
    settings = play.settings
    return {
        "id": play.name(task),
        "index": index,
        "split": part,
        "depth": settings.depth,
        "distractors": settings.distractors,
    }


def _range(games: GameList, query: dict[str, Any]) -> list[dict[str, Any]]:
    part = query.get("split", "")
    places = range(games.count(part))[query.get("start") : query.get("stop")]
    return [_task(games, part, index) for index in places]


_QUERIES: dict[str, Callable[[GameList, dict[str, Any]], dict[str, Any]]] = {
    # Nobody goes on with a game that HTTP begins.
    "/reset": lambda games, query: CraftingSession(games).reset(query),
    f"/{NAME}/num_tasks": lambda games, query: {"num_tasks": games.count(query.get("split", ""))},
    f"/{NAME}/task": lambda games, query: {
        "task": _task(games, query.get("split", ""), query.get("index"))
    },
    f"/{NAME}/tasks": lambda games, query: {"tasks": _range(games, query), "env_name": NAME},
    f"/{NAME}/task_range": lambda games, query: {"tasks": _range(games, query)},
}
"""Addresses of requests with a JSON object, and functions that answer them for games on offer."""


def _endpoint(games: GameList, find: Callable[..., Any]) -> Any:
    async def endpoint(request: Request) -> Response:
        try:
            return JSONResponse(find(games, json.loads(await request.body() or b"{}")))
        except WordCraftKGError as error:
            return JSONResponse({"detail": str(error)}, 400)
        except (ValueError, TypeError, AttributeError, RecursionError):
            expected = 'expected a JSON object such as {"split": "train", "index": 0}.'
            return JSONResponse({"detail": expected}, 422)

    return endpoint
