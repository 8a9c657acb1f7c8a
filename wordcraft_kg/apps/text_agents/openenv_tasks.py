"""OpenEnv's Task API over HTTP: parts, numbers of tasks, and tasks by index."""

import json
from collections.abc import Callable
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from wordcraft_kg.apps.text_agents.named_games import GameList
from wordcraft_kg.base.errors import WordCraftKGError

NAME = "crafting"
"""Name of the environment, as in the addresses."""
_KINDS = {"valid": "validation"}
"""OpenEnv's names of parts, where they differ from ours."""


def _task(games: GameList, part: str, index: Any) -> dict[str, Any]:
    game = games.at(part, index)
    settings = game.play.settings
    own = {"depth": settings.depth, "distractors": settings.distractors}
    return {"id": game.name, "index": index, "split": part, **own}


def _range(games: GameList, asked: dict[str, Any]) -> list[dict[str, Any]]:
    part = asked.get("split", "")
    places = range(games.count(part))[asked.get("start") : asked.get("stop")]
    return [_task(games, part, index) for index in places]


_TASK_API: dict[str, Callable[[GameList, dict[str, Any]], dict[str, Any]]] = {
    "num_tasks": lambda games, asked: {"num_tasks": games.count(asked.get("split", ""))},
    "task": lambda games, asked: {"task": _task(games, asked.get("split", ""), asked.get("index"))},
    "tasks": lambda games, asked: {"tasks": _range(games, asked), "env_name": NAME},
    "task_range": lambda games, asked: {"tasks": _range(games, asked)},
}


def task_routes(games: GameList) -> list[Route]:
    """Return the addresses of the Task API for the games on offer."""
    parts = [{"name": part, "type": _KINDS.get(part, part)} for part in games.plays]
    routes = [
        Route("/list_environments", lambda request: JSONResponse([NAME])),
        Route(f"/{NAME}/splits", lambda request: JSONResponse(parts)),
    ]
    for name, find in _TASK_API.items():
        routes.append(Route(f"/{NAME}/{name}", _asked(games, find), methods=["POST"]))
    return routes


def _asked(games: GameList, find: Callable[..., Any]) -> Any:
    async def endpoint(request: Request) -> Response:
        try:
            asked = json.loads(await request.body())
            return JSONResponse(find(games, asked))
        except WordCraftKGError as error:
            return JSONResponse({"detail": str(error)}, 400)
        except (ValueError, TypeError, AttributeError, RecursionError):
            expected = 'expected a JSON object such as {"split": "train", "index": 0}.'
            return JSONResponse({"detail": expected}, 422)

    return endpoint
